"""Drift by the measure of the KITTI odometry benchmark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from factors import so3
from factors.relative_pose import relative
from graphnav._metrics import Indices
from graphnav._schema import Array
from graphnav.errors import GraphnavError


@dataclass(frozen=True)
class Drift:
    """Mean error of segments, relative to their length.

    Attributes
    ----------
    translation_percent : of the length.
    rotation_deg_m : deg per metre.
    segments : how many there are.
    """

    translation_percent: float
    rotation_deg_m: float
    segments: int


def kitti_drift(
    estimate: tuple[Array, Array], truth: tuple[Array, Array], lengths_m: Sequence[float], step: int = 1
) -> Drift:
    """Relative errors of segments of the true path, averaged over all starts and lengths.

    A segment of a length begins at a pose and ends at the first pose that is at least so far along the true path. Its
    errors are the translation and the rotation of ``(truth step)^-1 (estimated step)``, divided by the length. (The
    benchmark starts at every tenth pose, and its lengths are 100 to 800 m.)

    Parameters
    ----------
    estimate, truth : rotations (N, 3, 3) and positions (N, 3) of the same N poses, each in a frame of its own.
    lengths_m : of the segments.
    step : poses from one start to the next.

    Raises
    ------
    GraphnavError : the path is shorter than every length.
    """
    travelled = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(truth[1], axis=0), axis=1)))
    translation, rotation = [], []
    for length in lengths_m:
        first = np.arange(0, len(travelled), step)
        last = np.searchsorted(travelled, travelled[first] + length)
        first, last = first[last < len(travelled)], last[last < len(travelled)]
        turn, way = _segments(truth, first, last)
        turn_found, way_found = _segments(estimate, first, last)
        off_turn, off_way = relative(turn, way, turn_found, way_found)
        translation.append(np.linalg.norm(off_way, axis=1) / length)
        rotation.append(np.linalg.norm(so3.log(off_turn), axis=1) / length)
    segments = sum(len(part) for part in translation)
    if not segments:
        raise GraphnavError(f"the path is {travelled[-1]:.1f} m long, shorter than every segment {list(lengths_m)} m")
    return Drift(
        float(100 * np.concatenate(translation).mean()),
        float(np.rad2deg(np.concatenate(rotation).mean())),
        segments,
    )


def _segments(poses: tuple[Array, Array], first: Indices, last: Indices) -> tuple[Array, Array]:
    rotation, pos = poses
    return relative(rotation[first], pos[first], rotation[last], pos[last])
