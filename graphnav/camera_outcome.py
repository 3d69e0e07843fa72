"""What became of a camera's motions: how many were left out, and what the user should know of it."""

from __future__ import annotations

import numpy as np

from factors.so3 import Array
from graphnav.camera import Camera
from graphnav.keyframes import SAME_S
from graphnav.leg_means import npt_bool
from graphnav.log import Stereo
from graphnav.motions import MotionReadings
from graphnav.problem import Problem, X
from graphnav.run import Calibration
from graphnav.tracks import TrackReadings

#: The longest time without the camera that is passed over, s, and the share of readings of features left out that is.
_GAP_S, _MANY = 10.0, 0.2
#: Sigmas from which on what all disparities are too large by is told to be more than was declared.
_FAR_SIGMAS = 5.0
#: Times without frames are holes where they are also so many times as long as usual.
_UNUSUAL = 5.0


def camera_warnings(problem: Problem, used: Camera, left_out: Camera) -> list[str]:
    """One line for each thing that the camera's part in the solution could not use.

    Parameters
    ----------
    used, left_out : what agrees with all else, and what does not.
    """
    lines = []
    if used.motions is not None:
        lines += _motion_warnings(problem, used.motions, left_out.motions)
    if used.tracks is not None:
        lines += _track_warnings(problem, used.tracks, left_out.tracks)
    start_s, end_s = longest_gap(problem, *_covered(problem, used))
    if end_s - start_s > _GAP_S:
        lines.append(f"the camera says nothing from {start_s:.0f} to {end_s:.0f} s: the IMU alone bridges it")
    return lines


def left_out_counts(left_out: Camera) -> dict[str, int]:
    """How many rows of each table were left out."""
    counts = {"relative_pose": left_out.motions, "stereo_tracks": left_out.tracks}
    return {table: len(part.row) for table, part in counts.items() if part is not None and len(part.row)}


def disparity_warnings(stereo: Stereo | None, found: dict[str, Calibration]) -> list[str]:
    """A line where all disparities are too large or too small by more than is declared.

    With the prior p taken out of the estimate ``m +- s``, the readings alone say ``m p^2 / (p^2 - s^2)``, to
    ``p s / sqrt(p^2 - s^2)``; by p and this together it is ``m / sqrt(p^2 - s^2)`` sigmas off.

    Parameters
    ----------
    stereo : with all that is allowed for; found : the calibration.
    """
    item, prior = found.get("camera_disparity"), 0.0 if stereo is None else stereo.disparity_sigma_px
    if item is None or item.sigma is None or not item.sigma < prior:
        return []
    told = prior**2 - item.sigma**2
    sigmas, alone, own = abs(item.value) / told**0.5, item.value * prior**2 / told, prior * item.sigma / told**0.5
    if sigmas < _FAR_SIGMAS:
        return []
    return [
        f"all disparities seem to be {abs(alone):.2g} +- {own:.1g} px too {'large' if alone > 0 else 'small'}, where"
        f" {prior:.2g} px are allowed for ({sigmas:.0f} sigmas): check the pair's calibration, or declare"
        " disparity_sigma_px of [stereo], and it is estimated"
    ]


def _motion_warnings(problem: Problem, used: MotionReadings, left_out: MotionReadings | None) -> list[str]:
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
    return lines


def _track_warnings(problem: Problem, used: TrackReadings, left_out: TrackReadings | None) -> list[str]:
    wrong = 0 if left_out is None else len(left_out.row)
    if wrong <= _MANY * (wrong + len(used.row)):
        return []
    share = 100 * wrong / (wrong + len(used.row))
    return [
        f"{share:.0f} % of the readings of tracked features disagree with the rest and were left out:"
        " the camera is moving among things that move, or [stereo] is not its calibration"
    ]


def _covered(problem: Problem, used: Camera) -> tuple[Array, Array]:
    """Starts and ends of the times between keyframes that the camera ties."""
    starts, ends = [], []
    if used.motions is not None and problem.log.relative_pose is not None:
        poses = problem.log.relative_pose
        starts.append(poses.t_from_s[used.motions.row])
        ends.append(poses.t_to_s[used.motions.row])
    if used.tracks is not None:
        keys = used.tracks.family.point_key
        order = np.lexsort((used.tracks.family.pose_key, keys))
        at = problem.keyframe_s[used.tracks.family.pose_key[order] - X(0)]
        tied = (np.diff(keys[order]) == 0) & ~_over_a_hole(problem, at[:-1], at[1:])
        starts.append(at[:-1][tied])
        ends.append(at[1:][tied])
    return np.concatenate(starts), np.concatenate(ends)


def _over_a_hole(problem: Problem, from_s: Array, to_s: Array) -> npt_bool:
    """Whether a time without any frame lies between two sights (K,) of a feature: few are found again after it."""
    assert problem.log.stereo_tracks is not None
    frame_s = np.unique(problem.log.stereo_tracks.t_s)
    steps_s = np.diff(frame_s)
    holes = np.flatnonzero(steps_s > max(_GAP_S, _UNUSUAL * float(np.median(steps_s))))
    found = np.zeros(len(from_s), bool)
    for start_s, end_s in zip(frame_s[holes], frame_s[holes + 1], strict=True):
        found |= (from_s < start_s + SAME_S) & (to_s > end_s - SAME_S)
    return found


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
