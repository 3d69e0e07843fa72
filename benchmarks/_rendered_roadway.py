"""Frames of the simulated roadheader's left camera a second apart, and where the walls have moved to between them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from graphnav._schema import Array
from graphnav.frontends._opencv import Image
from graphnav.frontends.image_quality import Matches
from graphnav.simulation.roadheader import frame_times, machine_of
from graphnav.simulation.roadheader_camera import R_BC, StereoCamera
from graphnav.simulation.roadheader_figures import ROADHEADER
from graphnav.simulation.world import image_seed

#: Between the frames: the machine moves 8 cm in it, or turns some 2 deg.
_STEP_S = 1.0
_REACH_PX = 2.0


@dataclass(frozen=True)
class Scene:
    """Two frames, and what is known of them.

    Attributes
    ----------
    depth_m : ``(H, W)`` along the first frame's optical axis.
    turn, shift_m : ``(3, 3)`` and ``(3,)`` taking points of the first camera's frame to the second's.
    """

    first: Image
    second: Image
    depth_m: Array
    turn: Array
    shift_m: Array

    def moved(self, points_px: Array) -> Array:
        """``(N, 2)`` where the walls at the first frame's points are in the second."""
        camera = ROADHEADER.camera
        centre = np.array([camera.width_px - 1, camera.height_px - 1]) / 2
        rays = np.column_stack([(points_px - centre) / camera.focal_px, np.ones(len(points_px))])
        there = (self._depth(points_px)[:, None] * rays) @ self.turn.T + self.shift_m
        found: Array = centre + camera.focal_px * there[:, :2] / there[:, 2:]
        return found

    def confirmed(self, found: Matches) -> NDArray[np.bool_]:
        """``(N,)`` which matches are within two pixels of where the walls are."""
        right: NDArray[np.bool_] = np.linalg.norm(self.moved(found.first_px) - found.second_px, axis=1) <= _REACH_PX
        return right

    def disparity_px(self, points_px: Array) -> Array:
        """``(N,)`` that the stereo pair has there: f b / d, equation 10."""
        found: Array = ROADHEADER.camera.focal_px * ROADHEADER.camera.baseline_m / self._depth(points_px)
        return found

    def _depth(self, points_px: Array) -> Array:
        found: Array = scipy.ndimage.map_coordinates(self.depth_m, points_px[:, ::-1].T, order=1, mode="nearest")
        return found


@lru_cache(maxsize=8)
def scenes(count: int, seed: int = 0) -> tuple[Scene, ...]:
    """Evenly spaced over the drive of one seed of roadheader-stereo."""
    machine = machine_of(ROADHEADER, seed)
    t_s = frame_times(ROADHEADER, machine)
    camera = StereoCamera(ROADHEADER, image_seed(seed))
    step = round(_STEP_S / float(np.diff(t_s[:2])[0]))
    start = int(np.searchsorted(t_s, t_s[0] + 70.0))  # after the rest
    return tuple(
        _scene(camera, machine, t_s, int(frame), step) for frame in np.linspace(start, len(t_s) - 2 * step, count)
    )


def _scene(camera: StereoCamera, machine: object, t_s: Array, frame: int, step: int) -> Scene:
    frames = [frame, frame + step]
    pos_n, rot_nb = machine.poses(t_s[frames])  # type: ignore[attr-defined]
    first, second = (camera.pair(k, float(t_s[k]), pos_n[i], rot_nb[i])[0] for i, k in enumerate(frames))
    places, axes = [], []
    for i in range(2):
        axes.append(rot_nb[i].as_matrix() @ R_BC)
        places.append(pos_n[i] + rot_nb[i].apply(ROADHEADER.camera.lever_arm_b_m))
    turn = axes[1].T @ axes[0]
    return Scene(first, second, camera.light(pos_n[0], rot_nb[0])[2], turn, axes[1].T @ (places[0] - places[1]))
