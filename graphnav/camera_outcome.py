"""What became of a camera's motions: how many were left out, and what the user should know of it."""

from __future__ import annotations

import numpy as np

from factors.so3 import Array
from graphnav.camera import CameraReadings
from graphnav.problem import Problem

#: The longest time without a relative pose that is passed over, s.
_GAP_S = 10.0


def camera_warnings(problem: Problem, used: CameraReadings, left_out: CameraReadings | None) -> list[str]:
    """One line for each thing that the camera's part in the solution could not use.

    Parameters
    ----------
    used, left_out : relative poses that agree with all else, and those that do not.
    """
    poses, lines = problem.log.relative_pose, []
    assert poses is not None
    wrong = 0 if left_out is None else len(left_out.row)
    outside = len(poses) - len(used.row) - wrong
    if wrong and left_out is not None:
        first_s = float(poses.t_from_s[left_out.row].min())
        lines.append(
            f"{wrong} of {len(poses)} relative poses disagree with the rest and were left out, the first at"
            f" {first_s:.1f} s"
        )
    if outside:
        lines.append(f"{outside} of {len(poses)} relative poses are outside the IMU record, or shorter than a keyframe")
    start_s, end_s = longest_gap(problem, poses.t_from_s[used.row], poses.t_to_s[used.row])
    if end_s - start_s > _GAP_S:
        lines.append(f"no relative pose from {start_s:.0f} to {end_s:.0f} s: the IMU alone bridges it")
    return lines


def longest_gap(problem: Problem, from_s: Array, to_s: Array) -> tuple[float, float]:
    """Start and end of the longest time that no motion (K,) covers, within the record and outside rest."""
    order = np.argsort(from_s)
    first, last = problem.keyframe_s[0], problem.keyframe_s[-1]
    ends = np.maximum.accumulate(np.r_[first, to_s[order]])
    starts = np.r_[from_s[order], last]
    spans = [(float(a), float(b)) for a, b in zip(ends, starts, strict=True) if b > a]
    for rest_from, rest_to in problem.frontend.rest_s:
        spans = [part for span in spans for part in _without(span, float(rest_from), float(rest_to))]
    return max(spans, key=lambda span: span[1] - span[0], default=(float(first), float(first)))


def _without(span: tuple[float, float], start: float, end: float) -> list[tuple[float, float]]:
    """What a span leaves outside another one."""
    parts = [(span[0], min(span[1], start)), (max(span[0], end), span[1])]
    return [part for part in parts if part[1] > part[0]]
