"""A stereo camera in a roadway of 4 x 5.5 m: points on walls, floor and roof, and what the camera reads of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors import so3, stereo
from factors.stereo import StereoCamera
from graphnav.frontends.stereo_bundle import Matches
from graphnav.log import Frames, SensorLog, Stereo, StereoTracks

CAMERA = StereoCamera(212.0, 212.0, 212.0, 120.0, 0.095)
WIDTH_PX, HEIGHT_PX = 424, 240
SIGMA_PX = 0.5
#: Camera axes (right, down, forward) in n, looking along y.
FORWARD = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def roadway(rng: np.random.Generator, count: int, length_m: float = 60.0) -> np.ndarray:
    """Points (count, 3) in n on the walls at +-2 m, the floor at 0 and the roof at 5.5 m."""
    side = rng.choice(4, count, p=np.array([5.5, 5.5, 4.0, 4.0]) / 19)
    along, over = rng.uniform(-2, length_m, count), rng.random(count)
    across = np.select([side == 0, side == 1], [-2.0, 2.0], -2 + 4 * over)
    height = np.select([side == 2, side == 3], [0.0, 5.5], 5.5 * over)
    return np.column_stack([across, along, height])


def in_view(rotation: np.ndarray, pos: np.ndarray, points: np.ndarray, reach_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Which points a camera sees, (N,) bool, and their pixels (K, 3)."""
    seen = (points - pos) @ rotation
    front = np.flatnonzero((seen[:, 2] > 0.3) & (seen[:, 2] < reach_m))
    pixels = stereo.project(CAMERA, seen[front])
    inside = (pixels[:, :2] > 0).all(axis=1) & (pixels[:, :2] < WIDTH_PX).all(axis=1)
    inside &= (pixels[:, 2] > 0) & (pixels[:, 2] < HEIGHT_PX)
    mask = np.zeros(len(points), bool)
    mask[front[inside]] = True
    return mask, pixels[inside]


def matched(
    rng: np.random.Generator,
    rotation: np.ndarray,
    pos: np.ndarray,
    disparity_px: tuple[float, float],
    count: int,
    sigma_px: float = SIGMA_PX,
) -> tuple[np.ndarray, np.ndarray]:
    """Readings (count, 3) of the same points before and after a motion, at random pixels and disparities."""
    many = 8 * count
    u, v, d = rng.uniform(0, WIDTH_PX, many), rng.uniform(0, HEIGHT_PX, many), rng.uniform(*disparity_px, many)
    first = np.column_stack([u, u - d, v])
    moved = (stereo.triangulate(CAMERA, first) - pos) @ rotation
    front = moved[:, 2] > 0.2
    first, second = first[front], stereo.project(CAMERA, moved[front])
    inside = (second[:, 0] > 0) & (second[:, 0] < WIDTH_PX) & (second[:, 2] > 0) & (second[:, 2] < HEIGHT_PX)
    first, second = first[inside][:count], second[inside][:count]
    assert len(first) == count
    return first + rng.normal(0, sigma_px, first.shape), second + rng.normal(0, sigma_px, second.shape)


def mistaken(rng: np.random.Generator, second: np.ndarray, share: float) -> tuple[np.ndarray, np.ndarray]:
    """The readings with a share of them anywhere in the image, and which, (N,) bool."""
    wrong = np.zeros(len(second), bool)
    wrong[rng.permutation(len(second))[: round(share * len(second))]] = True
    count = int(wrong.sum())
    second = second.copy()
    left = rng.uniform(0, WIDTH_PX, count)
    second[wrong] = np.column_stack([left, left - rng.uniform(1, 12, count), rng.uniform(0, HEIGHT_PX, count)])
    return second, wrong


def matches(first: np.ndarray, second: np.ndarray, sigma_px: float = SIGMA_PX) -> Matches:
    return Matches(np.ascontiguousarray(first), np.ascontiguousarray(second), sigma_px)


def error_of(rotation: np.ndarray, pos: np.ndarray, rotation_true: np.ndarray, pos_true: np.ndarray) -> np.ndarray:
    """(6,) e of ``T_true = T Exp(e)`` to first order."""
    return np.r_[so3.log(rotation.T @ rotation_true), rotation.T @ (pos_true - pos)]


@dataclass(frozen=True)
class Drive:
    """True camera poses of frames (F, 3, 3), (F, 3) in n at times (F,)."""

    t_s: np.ndarray
    rotation: np.ndarray
    pos: np.ndarray


def drive(along_m: np.ndarray, rate_hz: float = 10.0) -> Drive:
    """Along the roadway at y = `along_m`, swaying a little."""
    frame = np.arange(len(along_m))
    sway = np.column_stack([0.02 * np.sin(along_m), 0.05 * np.sin(0.4 * along_m), 0.01 * np.sin(1.3 * along_m)])
    pos = np.column_stack([0.3 * np.sin(0.3 * along_m), along_m, 1.6 + 0.05 * np.sin(0.9 * along_m)])
    return Drive(frame / rate_hz, FORWARD @ so3.exp(sway), pos)


def tracked(
    rng: np.random.Generator, driven: Drive, points: np.ndarray, sigma_px: float = SIGMA_PX, reach_m: float = 10.0
) -> StereoTracks:
    """What a perfect tracker gives; every point can be seen from a distance of its own, up to `reach_m`."""
    own_reach = rng.uniform(2.0, reach_m, len(points))
    rows = []
    for t, rotation, pos in zip(driven.t_s, driven.rotation, driven.pos, strict=True):
        mask, pixels = in_view(rotation, pos, points, reach_m)
        track = np.flatnonzero(mask)
        near = np.linalg.norm(points[track] - pos, axis=1) < own_reach[track]
        pixels = pixels[near] + rng.normal(0, sigma_px, (int(near.sum()), 3))
        rows.append(np.column_stack([np.full(len(pixels), t), track[near], pixels]))
    t, track, left, right, v = np.concatenate(rows).T
    return StereoTracks(t_s=t, track=track.astype(np.int64), u_left_px=left, u_right_px=right, v_px=v)


def stereo_log(tracks: StereoTracks, sigma_px: float = SIGMA_PX) -> SensorLog:
    section = Stereo(
        fx_px=CAMERA.fx_px, fy_px=CAMERA.fy_px, cx_px=CAMERA.cx_px, cy_px=CAMERA.cy_px, baseline_m=CAMERA.baseline_m,
        sigma_px=sigma_px,
    )  # fmt: skip
    return SensorLog(name="roadway", frames=Frames(latitude_deg=35.0), stereo=section, stereo_tracks=tracks)
