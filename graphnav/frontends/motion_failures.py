"""Why the camera gave no motion between keyframes, for the user: in one line, or as an error where it is too often.

A rotation that is not the gyro's, again and again, is no matter of images: one of both is not as the log declares it,
and a scale of turns that is wrong comes from focal lengths that are, as does the scale of the way.
"""

from __future__ import annotations

import re
from collections import Counter

from graphnav.errors import LogError
from graphnav.frontends.stereo_motion import BY_IMU
from graphnav.frontends.stereo_odometry import FailedMotion, StereoMotions

#: Share of motions that may fail without a word: the IMU bridges a frame or two.
_FEW = 0.02
#: Share of motions that contradict the gyro from which on the log is refused, and the fewest motions to judge by.
_MOST, _LEAST_LINKS = 0.5, 10
_SUSPECTS = (
    "[stereo] may not be this camera's calibration (fx_px, cx_px, cy_px, T_bc_quat_wxyz), or its clock be off"
    " (time_offset_s)"
)


def failure_note(found: StereoMotions) -> str:
    """What the user should know of the failures, and where to look; empty where they are few."""
    failures, links = found.failures, _links(found)
    if len(failures) <= _FEW * links:
        return ""
    kind, count = Counter(_kind(each) for each in failures).most_common(1)[0]
    first = next(each for each in failures if _kind(each) == kind)
    note = f"no motion from {len(failures)} of {links} keyframes to the next, {count} times: {first.reason}"
    if not _by_imu(first):
        return note
    return f"{note} (that at {first.t_from_s:.1f} s); positions may be far off: {_SUSPECTS}"


def refuse_contradiction(found: StereoMotions, name: str) -> None:
    """Refuse a camera that contradicts the gyro in most motions.

    Raises
    ------
    LogError
        It does.
    """
    wrong = [each for each in found.failures if _by_imu(each)]
    if _links(found) < _LEAST_LINKS or len(wrong) <= _MOST * _links(found):
        return
    problem = (
        f"{len(wrong)} of {_links(found)} motions of the camera do not turn as the gyro does, the first at"
        f" {wrong[0].t_from_s:.1f} s ({wrong[0].reason}): {_SUSPECTS}"
    )
    fix = 'check both, and the sigmas of [imu]; stereo_motions.rotation_prior = "off" goes on without the comparison'
    raise LogError(problem, where=f"log {name}", fix=fix)


def _links(found: StereoMotions) -> int:
    return len(found.inliers) + len(found.failures)


def _by_imu(failed: FailedMotion) -> bool:
    return failed.reason.endswith(BY_IMU)


def _kind(failed: FailedMotion) -> str:
    """The reason without its numbers."""
    return re.sub(r"\d+(\.\d+)?", "", failed.reason)
