"""Motions that the camera did not give: what the user is told of them, and when they are an error."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from test_stereo_in_the_graph import log_of

from graphnav.config import Config
from graphnav.errors import LogError
from graphnav.frontends.motion_failures import failure_note, refuse_contradiction
from graphnav.frontends.stereo_odometry import FailedMotion, StereoMotions
from graphnav.sighted import with_stereo

FEW = "3 matches, 20 are needed"


def found(good: int, reasons: list[str]) -> StereoMotions:
    failures = tuple(FailedMotion(float(k), k + 1.0, reason) for k, reason in enumerate(reasons))
    return StereoMotions(None, np.zeros(good), np.zeros(good), np.zeros(good), failures, 0.0)


def by_imu(count: int) -> list[str]:
    return [f"the rotation is {5 + k / 10:.1f} sigmas from that of the IMU" for k in range(count)]


def test_a_failure_or_two_are_no_matter() -> None:
    assert failure_note(found(200, by_imu(2))) == ""


def test_failures_of_one_kind_count_together() -> None:
    """Whatever numbers their reasons have in them."""
    note = failure_note(found(20, [FEW, *by_imu(3)]))
    assert note.startswith("no motion from 4 of 24 keyframes to the next, 3 times: the rotation is 5.0 sigmas from")
    assert "(that at 1.0 s); positions may be far off: [stereo] may not be this camera's calibration" in note


def test_failures_for_want_of_features_do_not_blame_the_calibration() -> None:
    note = failure_note(found(20, [FEW, FEW, *by_imu(1)]))
    assert note == f"no motion from 3 of 23 keyframes to the next, 2 times: {FEW}"


def test_a_camera_that_mostly_contradicts_the_gyro_is_refused() -> None:
    refuse_contradiction(found(10, by_imu(10)), "shift")
    with pytest.raises(LogError, match=r"^log shift: 11 of 21 motions .* first at 0\.0 s .*T_bc_quat_wxyz"):
        refuse_contradiction(found(10, by_imu(11)), "shift")
    refuse_contradiction(found(10, [FEW] * 30), "shift")


def test_a_wrong_mounting_is_told_on_the_way() -> None:
    """The body's axes for the camera's: the very log without the mistake is without a word."""
    log = log_of(1)
    assert with_stereo(log, Config()).notes == ()
    wrong = dataclasses.replace(log, stereo=log.stereo.replace(T_bc_quat_wxyz=[1.0, 0.0, 0.0, 0.0]))
    assert "[stereo] may not be this camera's calibration" in with_stereo(wrong, Config()).notes[0]
