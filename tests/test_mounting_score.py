"""A camera that does not sit as declared, though the log says it does exactly: told from the whole solution."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2
from test_stereo_in_the_graph import log_of, smoothed

import graphnav.rounds
from factors import so3
from graphnav.log import SensorLog
from graphnav.mounting_score import MountingScore, mounting_score, mounting_warnings
from graphnav.run import Run

#: False-alarm rate of a score of a camera that sits as declared.
ALARM = 1e-4


def turned(log: SensorLog, **deg: float) -> SensorLog:
    """The log with a mounting declared that is off: the camera is turned by so much against it."""
    angle = np.radians([deg.get(axis, 0.0) for axis in ("right", "down", "forward")])
    quat = so3.to_quaternion(so3.from_quaternion(log.stereo.T_bc_quat_wxyz) @ so3.exp(-angle))
    return dataclasses.replace(log, stereo=log.stereo.replace(T_bc_quat_wxyz=quat))


@cache
def scored(seed: int, down: float) -> tuple[Run, MountingScore | None]:
    found: list[MountingScore | None] = []

    def spied(*given: object) -> MountingScore | None:
        found.append(mounting_score(*given))  # type: ignore[arg-type]
        return found[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(graphnav.rounds, "mounting_score", spied)
        run = smoothed(turned(log_of(seed), down=down))
    return run, found[-1]


def test_a_camera_that_sits_as_declared_is_without_a_word() -> None:
    run, score = scored(2, 0.0)
    assert score is not None and score.sigmas**2 < chi2.isf(ALARM, 1)
    assert run.diagnostics.warnings == []


def test_a_camera_turned_by_five_degrees_is_told() -> None:
    run, score = scored(1, 5.0)
    assert score is not None and score.sigmas > 5.0
    (line,) = run.diagnostics.warnings
    assert "against T_bc_quat_wxyz" in line and "mounting_sigma_deg" in line


def test_the_score_is_what_estimation_finds() -> None:
    """The step of the score against the angle that is a variable, known beforehand to 10 deg."""
    _, score = scored(1, 5.0)
    log = turned(log_of(1), down=5.0)
    free = dataclasses.replace(log, stereo=log.stereo.replace(mounting_sigma_deg=[10.0] * 3))
    run = smoothed(free)
    found = run.calibration["camera_angle_down"]
    assert score is not None
    assert abs(np.degrees(score.angle_rad[1]) - found.value) < found.sigma
    assert abs(found.value - 5.0) < 4 * found.sigma < 2.5
    assert not any("seems turned" in line for line in run.diagnostics.warnings)


def test_only_what_is_far_off_is_told() -> None:
    assert mounting_warnings(None) == []
    angle = np.radians([0.0, 2.0, 0.0])
    assert mounting_warnings(MountingScore(angle, 4.9)) == []
    assert "seems turned by about 2 deg" in mounting_warnings(MountingScore(angle, 5.1))[0]
