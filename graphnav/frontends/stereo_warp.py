"""How the patch of a wall is turned, sheared and stretched on its way from one image to another.

A wall around a point is a plane ``n . X = 1`` in the camera's frame. As ``1 / z = n . m`` for the normalised place
``m = (x, y, 1)``, disparity ``d = fx b / z`` is linear in the image and its slope tells n. A camera that has moved by
``X' = R X + t`` sees the plane through the homography ``m' ~ (R + t n^T) m``, whose derivative at the point is the
warp of its patch (Hartley and Zisserman 2004, sec. 13.1).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from graphnav.frontends.stereo_features import Places
from graphnav.log import Stereo


class Planes(NamedTuple):
    """Walls around points: normalised places ``(N, 3)`` and the planes' n (N, 3), 1/m, in one camera's frame."""

    place: Places
    normal_1_m: Places


class Warps(NamedTuple):
    """Steps in the patch -> in the left and in the right image ``(N, 2, 2)``, and disparities (N,) expected there."""

    left: Places
    right: Places
    disparity_px: Places


def planes(camera: Stereo, uv_px: Places, disparity_px: Places, slope: Places) -> Planes:
    """Walls around points at `uv_px` (N, 2) whose disparity changes by `slope` (N, 2) px per px."""
    focal = np.array([camera.fx_px, camera.fy_px])
    xy = (uv_px - [camera.cx_px, camera.cy_px]) / focal
    along = slope * focal / (camera.fx_px * camera.baseline_m)
    ahead = disparity_px / (camera.fx_px * camera.baseline_m) - (along * xy).sum(axis=1)
    return Planes(np.column_stack([xy, np.ones(len(xy))]), np.column_stack([along, ahead]))


def of_slope(slope: Places) -> Places:
    """Warp ``(N, 2, 2)`` from the left to the right image, where ``u_right = u - d - slope . p``."""
    warp = np.tile(np.eye(2), (len(slope), 1, 1))
    warp[:, 0] -= slope
    return warp


def warps(camera: Stereo, seen: Planes, rotation: Places, pos_m: Places) -> Warps:
    """What became of patches since the camera was where the planes are told.

    Parameters
    ----------
    seen : in the frame of the camera then.
    rotation, pos_m : (N, 3, 3), (N, 3) with ``X' = R X + t`` from then to now.
    """
    focal = np.array([camera.fx_px, camera.fy_px])
    steps = rotation[:, :, :2] + pos_m[:, :, None] * seen.normal_1_m[:, None, :2]
    inverse_depth = (seen.normal_1_m * seen.place).sum(axis=1)
    now = np.einsum("nij,nj->ni", rotation, seen.place) + pos_m * inverse_depth[:, None]
    xy = now[:, :2] / now[:, 2:]
    left = (steps[:, :2] - xy[:, :, None] * steps[:, None, 2]) / now[:, 2, None, None]
    left = left * focal[:, None] / focal
    turned = np.einsum("nij,nj->ni", rotation, seen.normal_1_m)
    normal = turned / (1 + (turned * pos_m).sum(axis=1))[:, None]
    slope = camera.fx_px * camera.baseline_m * normal[:, :2] / focal
    right = of_slope(slope) @ left
    return Warps(left, right, camera.fx_px * camera.baseline_m * inverse_depth / now[:, 2])
