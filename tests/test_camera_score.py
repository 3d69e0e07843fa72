"""A camera that sits or is stamped otherwise than declared as exact: told from the whole solution."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2
from test_stereo_in_the_graph import log_of, smoothed

import graphnav.rounds
from factors import so3
from graphnav.camera_score import CameraScore, Score, camera_score, camera_score_warnings
from graphnav.log import SensorLog
from graphnav.run import Run

#: False-alarm rate of a score of a camera as declared.
ALARM = 1e-4
LATER_S = 0.05


def turned(log: SensorLog, **deg: float) -> SensorLog:
    """The log with a mounting declared that is off: the camera is turned by so much against it."""
    angle = np.radians([deg.get(axis, 0.0) for axis in ("right", "down", "forward")])
    quat = so3.to_quaternion(so3.from_quaternion(log.stereo.T_bc_quat_wxyz) @ so3.exp(-angle))
    return dataclasses.replace(log, stereo=log.stereo.replace(T_bc_quat_wxyz=quat))


def early(log: SensorLog, later_s: float, **stereo: float) -> SensorLog:
    """The log with images that are stamped so much before they were taken."""
    tracks = log.stereo_tracks.replace(t_s=log.stereo_tracks.t_s - later_s)
    return dataclasses.replace(log, stereo_tracks=tracks, stereo=log.stereo.replace(**stereo))


@cache
def scored(seed: int, down: float = 0.0, later_s: float = 0.0, form: str = "tight") -> tuple[Run, CameraScore]:
    found: list[CameraScore] = []

    def spied(*given: object) -> CameraScore:
        found.append(camera_score(*given))  # type: ignore[arg-type]
        return found[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(graphnav.rounds, "camera_score", spied)
        run = smoothed(early(turned(log_of(seed), down=down), later_s), form=form)
    return run, found[-1]


def test_a_camera_as_declared_is_without_a_word() -> None:
    run, score = scored(2)
    for each in (score.angles, score.later):
        assert each is not None and each.sigmas**2 < chi2.isf(ALARM, 1)
    assert run.diagnostics.warnings == []


def test_a_camera_turned_by_five_degrees_is_told() -> None:
    run, score = scored(1, down=5.0)
    assert score.angles is not None and score.angles.sigmas > 5.0
    (line,) = run.diagnostics.warnings
    assert "against T_bc_quat_wxyz" in line and "mounting_sigma_deg" in line


def test_the_score_is_what_estimation_finds() -> None:
    """The step of the score against the angle that is a variable, known beforehand to 10 deg."""
    _, score = scored(1, down=5.0)
    log = turned(log_of(1), down=5.0)
    free = dataclasses.replace(log, stereo=log.stereo.replace(mounting_sigma_deg=[10.0] * 3))
    run = smoothed(free)
    found = run.calibration["camera_angle_down"]
    assert score.angles is not None
    assert abs(np.degrees(score.angles.step[1]) - found.value) < found.sigma
    assert abs(found.value - 5.0) < 4 * found.sigma < 2.5
    assert not any("seems turned" in line for line in run.diagnostics.warnings)


@pytest.mark.parametrize("form", ["tight", "loose"])
def test_images_stamped_too_early_are_told(form: str) -> None:
    run, score = scored(1, later_s=LATER_S, form=form)
    assert score.later is not None and score.later.sigmas > 5.0
    (line,) = (each for each in run.diagnostics.warnings if "stamped" in each)
    assert "too early" in line and "time_offset_s" in line and "time_sigma_s" in line


def of(step: list[float], sigmas: float, besides: float) -> Score:
    return Score(np.array(step), sigmas, besides)


def test_only_what_is_far_off_is_told() -> None:
    assert camera_score_warnings(None) == []
    angle, nothing = np.radians([0.0, 2.0, 0.0]).tolist(), of([0.01], 1.0, 1.0)
    assert camera_score_warnings(CameraScore(of(angle, 4.9, 4.9), nothing)) == []
    assert "seems turned by about 2 deg" in camera_score_warnings(CameraScore(of(angle, 5.1, 5.1), nothing))[0]


def test_of_a_turn_and_a_delay_that_look_alike_one_is_told() -> None:
    """The likelier; the other as well where it is far off with the first one free."""
    angle = np.radians([0.0, 2.0, 0.0]).tolist()
    (line,) = camera_score_warnings(CameraScore(of(angle, 7.0, 1.0), of([-0.02], 9.0, 6.0)))
    assert "0.02 s too late (9 sigmas): add -0.02" in line
    assert len(camera_score_warnings(CameraScore(of(angle, 7.0, 6.0), of([-0.02], 9.0, 8.0)))) == 2
