"""A roadway's wall and what a scanner at rest sees of it, made without the simulator."""

from __future__ import annotations

import numpy as np
import pytest

from graphnav.errors import GraphnavError
from graphnav.frontends._open3d import open3d
from graphnav.frontends.registration import Sight

#: Noise of one reading, and the beams from the forward axis to the left.
RANGE_M, ANGLE_RAD = 0.01, np.radians(0.05)
BEAMS_RAD = np.radians(np.arange(-16.0, 16.0, 0.25))


def needs_open3d() -> None:
    """Skip the test where Open3D cannot be loaded."""
    try:
        open3d()
    except GraphnavError as error:
        pytest.skip(str(error))


def wall(rng: np.random.Generator, rough_m: float = 0.1, slant: float = 0.0, from_m=-10.0, to_m=10.0) -> np.ndarray:
    """Corners of a wall 12.5 m ahead, every half metre from left to right, ``(K, 2)`` right and forward."""
    across = np.arange(from_m, to_m + 1e-9, 0.5)
    return np.column_stack([across, 12.5 + slant * across + rough_m * rng.standard_normal(len(across))])


def ranges(corners: np.ndarray, place: np.ndarray, angle_rad: np.ndarray) -> np.ndarray:
    """True ranges of beams from a place (right, forward, turn) to the nearest piece of wall; NaN for none."""
    start, run = corners[:-1] - place[:2], np.diff(corners, axis=0)
    beam = np.stack([-np.sin(angle_rad + place[2]), np.cos(angle_rad + place[2])], axis=-1)[..., None, :]
    across = beam[..., 0] * run[:, 1] - beam[..., 1] * run[:, 0]
    share = (start[:, 0] * beam[..., 1] - start[:, 1] * beam[..., 0]) / across
    distance = (start[:, 0] * run[:, 1] - start[:, 1] * run[:, 0]) / across
    distance = np.where((share >= 0) & (share <= 1) & (distance > 0), distance, np.inf).min(axis=-1)
    return np.where(np.isfinite(distance), distance, np.nan)


def sight(rng: np.random.Generator, corners: np.ndarray, place: np.ndarray, scans: int = 125) -> Sight:
    """The mean of some scans from a place, in its own axes, with the sigma that their scatter shows."""
    white = rng.standard_normal((2, scans, len(BEAMS_RAD)))
    # a beam's error of angle is one of where it went, not of what the scanner says of it
    seen = ranges(corners, np.asarray(place, float), BEAMS_RAD - ANGLE_RAD * white[0]) + RANGE_M * white[1]
    there = np.flatnonzero(np.isfinite(seen).all(axis=0))
    mean, angle = seen[:, there].mean(axis=0), BEAMS_RAD[there]
    points = mean[:, None] * np.column_stack([-np.sin(angle), np.cos(angle)])
    return Sight(points, seen[:, there].std(axis=0, ddof=1) / np.sqrt(scans))
