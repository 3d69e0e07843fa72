"""Scenes for tests of the rendered roadway: short ones, blank or dotted walls, and where a point ought to be seen."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from graphnav.simulation import roadway_surfaces as on
from graphnav.simulation.ripmap import ripmap
from graphnav.simulation.roadheader_camera import StereoCamera
from graphnav.simulation.roadheader_figures import ROADHEADER, CameraSpec, RoadheaderSpec, RoadwaySpec
from graphnav.simulation.textures import TEXEL_M

#: A roadway of 8 m: its textures take a third of the time.
SHORT = replace(ROADHEADER, roadway=RoadwaySpec(face_m=6.5))
SEED = np.random.SeedSequence(3)
#: Camera axes in the body by the log format's own quaternion, which turns the body's axes to right, down, ahead.
R_BC = Rotation.from_quat([0.7071067811865476, -0.7071067811865476, 0.0, 0.0], scalar_first=True)


@cache
def rendered(spec: RoadheaderSpec = SHORT) -> StereoCamera:
    camera = StereoCamera(spec, SEED)
    camera.light(np.zeros(3), Rotation.identity())  # what it keeps from then on it lends to `painted`
    return camera


def painted(images: list[np.ndarray], spec: RoadheaderSpec = SHORT) -> StereoCamera:
    """A camera in a roadway with these textures."""
    camera = StereoCamera.__new__(StereoCamera)
    camera.__dict__.update(rendered().__dict__)
    if (spec.light, spec.camera) != (SHORT.light, SHORT.camera):
        camera.__dict__.pop("_glow", None)
    camera.spec, camera._maps = spec, ripmap(images)
    return camera


def blank(grey: float = 0.5, roadway: RoadwaySpec = SHORT.roadway) -> list[np.ndarray]:
    sizes = [[round(size / TEXEL_M) for size in on.extent_m(roadway, surface)] for surface in range(on.COUNT)]
    return [np.full((across, along), grey, np.float32) for along, across in sizes]


def dot(image: np.ndarray, along_m: float, across_m: float, sigma_m: float) -> None:
    """Add a round bright spot to a texture at a place on its surface."""
    across, along = ((np.arange(size) + 0.5) * TEXEL_M for size in image.shape)
    square = (along[None] - along_m) ** 2 + (across[:, None] - across_m) ** 2
    image += (0.5 * np.exp(-square / 2 / sigma_m**2)).astype(np.float32)


def expected_px(camera: CameraSpec, point_n: np.ndarray, pos_n: np.ndarray, rot_nb: Rotation) -> np.ndarray:
    """Column in the left image, column in the right one, row: by the pinhole model alone."""
    point_b = rot_nb.inv().apply(point_n - pos_n) - camera.lever_arm_b_m
    x, y, z = R_BC.inv().apply(point_b)
    f = 212 / np.tan(np.deg2rad(43.5)) * camera.width_px / 424
    u, v = (camera.width_px - 1) / 2 + f * x / z, (camera.height_px - 1) / 2 + f * y / z
    return np.array([u, u - f * camera.baseline_m / z, v])
