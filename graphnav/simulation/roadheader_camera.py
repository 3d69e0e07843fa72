"""Rendered stereo pairs of the roadheader: one scene for each seed, one random stream for each frame."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from graphnav.simulation.exposure import Drift, develop
from graphnav.simulation.lamps import glow
from graphnav.simulation.ray_caster import cast
from graphnav.simulation.ripmap import ripmap
from graphnav.simulation.roadheader_figures import RoadheaderSpec
from graphnav.simulation.roadway_surfaces import box
from graphnav.simulation.textures import TEXEL_M, textures

Array = npt.NDArray[np.float64]
Grey = npt.NDArray[np.uint8]

#: Axes of the camera (right, down, ahead) in the body (right, forward, up).
R_BC = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


class StereoCamera:
    """Renders pairs at given poses.

    Parameters
    ----------
    spec : roadway, camera, lamps and dust.
    seed : a sequence of the log's image stream: it draws the walls, the drift of the dust and each frame's noise.
    """

    def __init__(self, spec: RoadheaderSpec, seed: np.random.SeedSequence) -> None:
        self.spec, light = spec, spec.light
        walls, dust, self._frames = (
            np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, k)) for k in range(3)
        )
        self._maps = ripmap(textures(spec.roadway, np.random.default_rng(walls)))
        self._drift = Drift.drawn(light, spec.camera, np.random.default_rng(dust))

    @cached_property
    def _glow(self) -> tuple[npt.NDArray[np.float32], ...]:
        return tuple(glow(self.spec.light, self.spec.camera, shift) for shift in (0.0, self.spec.camera.baseline_m))

    def light(self, pos_n: Array, rot_nb: Rotation, right: bool = False) -> Array:
        """Light from the walls, airlight and depth (m) of one camera of the pair, ``(3, height, width)``."""
        camera, rot_nc = self.spec.camera, rot_nb.as_matrix() @ R_BC
        place_n = pos_n + rot_nb.apply(camera.lever_arm_b_m) + right * camera.baseline_m * rot_nc[:, 0]
        found = np.empty((3, camera.height_px, camera.width_px))
        figures = (camera.focal_px, (camera.width_px - 1) / 2, (camera.height_px - 1) / 2)
        axes = tuple(map(tuple, rot_nc.tolist()))
        cast(
            tuple(box(self.spec.roadway)),
            *self._maps,
            TEXEL_M,
            tuple(place_n.tolist()),
            axes,
            figures,
            self._glow[right],
            *found,
        )
        return found

    def pair(self, frame: int, t_s: float, pos_n: Array, rot_nb: Rotation) -> tuple[Grey, Grey]:
        """The two 8-bit images of a frame, the left one first."""
        figures, camera = self.spec.light, self.spec.camera
        seed = np.random.SeedSequence(self._frames.entropy, spawn_key=(*self._frames.spawn_key, frame))
        rng = np.random.Generator(np.random.SFC64(seed))
        dust = self._drift.at(t_s, camera)
        grey = np.empty((2, camera.height_px, camera.width_px), np.uint8)
        for side in range(2):
            light, air, _ = self.light(pos_n, rot_nb, right=bool(side))
            noise = rng.standard_normal(light.shape, dtype=np.float32)
            exposed = (figures.exposure, figures.full_electrons, figures.read_electrons)
            develop(grey[side], light, air, dust, noise, exposed)
        return grey[0], grey[1]
