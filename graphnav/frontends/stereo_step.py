"""The motion of the camera from one pair to the next, as the tracks tell it: to drop those that do not fit it.

It is found from three tracks at a time (RANSAC over P3P), and only as good as this use needs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graphnav.frontends._opencv import opencv
from graphnav.frontends.stereo_features import Places
from graphnav.log import Stereo

#: Tolerance, and trials.
_TOLERANCE_PX, _TRIALS = 2.0, 60
_LEAST = 8


@dataclass(frozen=True)
class Step:
    """``X' = rotation X + pos_m`` from the camera's frame before to that now, and which points fit it."""

    rotation: Places
    pos_m: Places
    fits: npt.NDArray[np.bool_]


def step(camera: Stereo, uv_px: Places, disparity_px: Places, now_px: Places) -> Step | None:
    """The motion that takes points (N, 2) with their disparities (N,) to `now_px`; None if most fit none.

    With too few to tell there is none either.
    """
    if len(uv_px) < _LEAST:
        return None
    cv2 = opencv()
    matrix = np.array([[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1.0]])
    solved, turn, pos_m, inliers = cv2.solvePnPRansac(
        _points(camera, uv_px, disparity_px), now_px.copy(), matrix, None, iterationsCount=_TRIALS,
        reprojectionError=_TOLERANCE_PX, flags=cv2.SOLVEPNP_P3P,
    )  # fmt: skip
    if not solved or inliers is None or 2 * len(inliers) < len(uv_px):
        return None
    fits = np.zeros(len(uv_px), bool)
    fits[inliers.ravel()] = True
    return Step(np.asarray(cv2.Rodrigues(turn)[0], float), np.asarray(pos_m, float).ravel(), fits)


def _points(camera: Stereo, uv_px: Places, disparity_px: Places) -> Places:
    depth = camera.fx_px * camera.baseline_m / disparity_px
    x = (uv_px[:, 0] - camera.cx_px) / camera.fx_px * depth
    y = (uv_px[:, 1] - camera.cy_px) / camera.fy_px * depth
    return np.ascontiguousarray(np.column_stack([x, y, depth]))
