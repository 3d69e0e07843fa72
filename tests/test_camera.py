"""Relative poses of a camera beside an IMU: consistency, gaps, wrong motions, the mounting, bad input."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from camera_logs import with_camera
from scipy.stats import chi2

import graphnav as gn
from factors import so3
from graphnav.errors import LogError
from graphnav.log import SensorLog
from graphnav.run import Run

SEEDS = range(8)
#: Two-sided 99.9 % band of the mean of K squared errors in sigmas: false alarms are one in a thousand.
ALARM = 1e-3


def smoothed(log: SensorLog, method: str = "batch") -> Run:
    return gn.smooth(dataclasses.replace(log, truth=None), method=method)


def at_the_end(run: Run, log: SensorLog) -> np.ndarray:
    """Squared position error in sigmas at the last keyframe: one number of three degrees of freedom a log."""
    assert log.truth is not None and run.trajectory.cov is not None
    error = run.trajectory.pos_n[-1] - log.truth.pos_n_m[-1]
    return error @ np.linalg.solve(run.trajectory.cov[-1, 3:6, 3:6], error)


def changed(log: SensorLog, row: int, pos_m: np.ndarray, turn_rad: np.ndarray) -> SensorLog:
    """With one relative pose wrong by so much."""
    poses = log.relative_pose
    pos, quat = poses.pos_m.copy(), poses.quat.copy()
    pos[row] += pos_m
    quat[row] = so3.to_quaternion(so3.from_quaternion(quat[row]) @ so3.exp(turn_rad))
    return dataclasses.replace(log, relative_pose=poses.replace(pos_m=pos, quat=quat))


def test_errors_are_as_large_as_their_sigmas() -> None:
    squares = []
    for seed in SEEDS:
        log = with_camera(seed)
        run = smoothed(log)
        squares.append(at_the_end(run, log))
        assert run.diagnostics.rejected == {} and run.diagnostics.warnings == []
    low, high = chi2.ppf([ALARM / 2, 1 - ALARM / 2], 3 * len(squares))
    assert low < np.sum(squares) < high


def test_a_camera_holds_what_an_imu_alone_loses() -> None:
    log = with_camera(0)
    with_, without = (smoothed(each) for each in (log, dataclasses.replace(log, relative_pose=None)))
    errors = [gn.evaluate(run.trajectory, log).max_m for run in (with_, without)]
    assert max(errors[0]) < 0.1 * max(errors[1])


def test_isam2_ends_where_batch_does() -> None:
    log = with_camera(1)
    batch, isam2 = smoothed(log), smoothed(log, "isam2")
    sigma = np.sqrt(np.diagonal(batch.trajectory.cov, axis1=1, axis2=2)[:, 3:6])
    assert (np.abs(batch.trajectory.pos_n - isam2.trajectory.pos_n) < 0.05 * sigma).all()


def test_its_causal_states_know_the_camera() -> None:
    log = with_camera(1)
    run = smoothed(log, "isam2")
    assert run.causal is not None
    assert max(gn.evaluate(run.causal, log).max_m) < 1.0


def test_a_gap_is_bridged_with_grown_covariance() -> None:
    whole, log = with_camera(2), with_camera(2, spans=((60.0, 75.0),))
    run, known = smoothed(log), smoothed(whole)
    assert "the camera says nothing from 60 to 76 s: the IMU alone bridges it" in run.diagnostics.warnings
    at = int(np.searchsorted(run.trajectory.t_s, 68.0))
    other = int(np.searchsorted(known.trajectory.t_s, 68.0))
    assert run.trajectory.cov[at, 4, 4] > 1.5 * known.trajectory.cov[other, 4, 4]
    error = run.trajectory.pos_n - log.truth.pos_n_m[np.searchsorted(log.truth.t_s, run.trajectory.t_s - 1e-6)]
    sigma = np.sqrt(np.diagonal(run.trajectory.cov, axis1=1, axis2=2)[:, 3:6])
    assert (np.abs(error) < 4.5 * sigma).all()  # of some 350 errors that depend on each other


@pytest.mark.parametrize("rows", [(30,), (5, 20, 21, 40)])
def test_wrong_motions_are_found_and_left_out(rows: tuple[int, ...]) -> None:
    """Up to half a metre and 3 degrees off, with the covariance of a good one."""
    log = with_camera(3)
    wrong = log
    for k, row in enumerate(rows):
        wrong = changed(wrong, row, np.array([0.1, 0.0, 0.5]) * (-1) ** k, np.array([0.0, 0.05, 0.0]))
    run, good = smoothed(wrong), smoothed(log)
    assert run.diagnostics.rejected == {"relative_pose": len(rows)}
    assert f"{len(rows)} of {len(log.relative_pose)} relative poses disagree" in run.diagnostics.warnings[0]
    sigma = np.sqrt(np.diagonal(run.trajectory.cov, axis1=1, axis2=2)[:, 3:6])
    assert (np.abs(run.trajectory.pos_n - good.trajectory.pos_n) < 2.0 * sigma).all()


def test_an_unknown_mounting_is_estimated_as_its_sigma_says() -> None:
    squares = []
    for seed in SEEDS:
        rng = np.random.default_rng([seed, 5])
        mounting = rng.normal(0, np.r_[np.radians([1.0] * 3), [0.05] * 3])
        log = with_camera(seed, mounting=mounting)
        run = smoothed(log)
        found = [run.calibration[name] for name in run.calibration if name.startswith("camera_")]
        unit = np.r_[np.radians([1.0] * 3), np.ones(3)]
        value, sigma = (np.array([getattr(each, part) for each in found]) for part in ("value", "sigma"))
        squares.append(((value - mounting / unit) / sigma) ** 2)
        squares.append([at_the_end(run, log) / 3] * 3)
    # the six errors of a log depend on each other weakly: 6 + 3 degrees of freedom a log
    low, high = chi2.ppf([ALARM / 2, 1 - ALARM / 2], 9 * len(SEEDS))
    assert low < sum(float(np.sum(each)) for each in squares) < high


def test_a_known_mounting_is_no_calibration() -> None:
    assert not any(name.startswith("camera_") for name in smoothed(with_camera(0)).calibration)


def test_it_can_be_left_out() -> None:
    log = with_camera(0)
    config = gn.Config.from_dict({"relative_pose": {"use": False}})
    run = gn.smooth(dataclasses.replace(log, truth=None), config)
    alone = smoothed(dataclasses.replace(log, relative_pose=None, stereo=None))
    np.testing.assert_allclose(run.trajectory.pos_n[-1], alone.trajectory.pos_n[-1])


def test_motions_outside_the_record_are_told() -> None:
    log = with_camera(0)
    poses = log.relative_pose
    late = poses.replace(t_from_s=poses.t_from_s + 10.0, t_to_s=poses.t_to_s + 10.0)
    run = smoothed(dataclasses.replace(log, relative_pose=late))
    assert any("are outside the IMU record" in line for line in run.diagnostics.warnings)


def test_a_covariance_that_is_none_is_refused_by_row() -> None:
    log = with_camera(0)
    poses = log.relative_pose
    upper = np.tile(np.eye(6)[np.triu_indices(6)], (len(poses), 1))
    upper[3, 0] = 0.0
    with pytest.raises(LogError, match=r"row 4.*not positive definite"):
        smoothed(dataclasses.replace(log, relative_pose=poses.replace(cov_upper=upper)))
