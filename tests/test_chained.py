"""Logs without an IMU: motions between keyframes, legs, known positions; what is refused and what is told."""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from robot_logs import BIAS_M, robot_log
from scipy import stats

import graphnav as gn
from factors import so3
from graphnav.config import Config
from graphnav.errors import ConfigError, LogError, SolveError
from graphnav.evaluation import evaluate
from graphnav.log import Face, Odometer, Position, RelativePose, SensorLog, SurveyedPoint
from graphnav.readers import read, write
from graphnav.run import Run
from graphnav.smooth import smooth

SEEDS = range(40)
#: East, north and heading of the 9 x 9 covariance.
PLANE = [2, 3, 4]


@cache
def log(seed: int = 0, legs: str = "known") -> SensorLog:
    return robot_log(seed, legs=legs)


@cache
def run(seed: int = 0, legs: str = "known") -> Run:
    return smooth(dataclasses.replace(log(seed, legs), truth=None))


def planar_error(seed: int, legs: str, t_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Error of heading, east and north at a time with its covariance."""
    truth, state = log(seed, legs).truth, run(seed, legs).trajectory.at(t_s)
    row = int(np.searchsorted(truth.t_s, t_s - 1e-6))
    turn = so3.log(so3.from_quaternion(truth.quat_nb[row]).T @ state.rotation_nb[0])
    return np.r_[turn[2], (state.pos_n[0] - truth.pos_n_m[row])[:2]], state.cov[0][np.ix_(PLANE, PLANE)]


# Consistency ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("legs", ["none", "known", "unknown"])
@pytest.mark.parametrize("t_s", [20.0, 40.0])
def test_errors_are_as_large_as_the_covariances_say(legs: str, t_s: float) -> None:
    """Heading, east and north over 40 runs: 120 degrees of freedom, false alarm 1e-4 in each of six tests."""
    total = 0.0
    for seed in SEEDS:
        error, cov = planar_error(seed, legs, t_s)
        total += error @ np.linalg.solve(cov, error)
    low, high = stats.chi2.ppf([5e-5, 1 - 5e-5], 3 * len(SEEDS))
    assert low < total < high


def test_velocity_is_the_mean_to_the_next_keyframe_with_its_covariance() -> None:
    """East and north at 20 s over 40 runs; false alarm 1e-4."""
    total = 0.0
    for seed in SEEDS:
        states, truth = run(seed).trajectory, log(seed).truth
        k = int(np.searchsorted(states.t_s, 20.0 - 1e-6))
        rows = np.searchsorted(truth.t_s, states.t_s[k : k + 2] - 1e-6)
        mean = np.diff(truth.pos_n_m[rows], axis=0)[0] / np.diff(truth.t_s[rows])[0]
        error = (states.vel_n[k] - mean)[:2]
        total += error @ np.linalg.solve(states.cov[k][6:8, 6:8], error)
    low, high = stats.chi2.ppf([5e-5, 1 - 5e-5], 2 * len(SEEDS))
    assert low < total < high
    np.testing.assert_array_equal(run().trajectory.vel_n[-1], run().trajectory.vel_n[-2])


def test_scanner_is_calibrated_against_known_legs() -> None:
    found = [run(seed).calibration["lidar_range_bias"] for seed in SEEDS]
    assert all(c.sigma < 0.3 * BIAS_M for c in found)
    assert np.std([c.value for c in found]) == pytest.approx(BIAS_M, rel=0.5)


def test_legs_hold_the_path() -> None:
    alone, known = (evaluate(run(legs=legs).trajectory, log(legs=legs)).rms_m[:2] for legs in ("none", "known"))
    assert np.linalg.norm(known) < 0.03 < np.linalg.norm(alone)


# Keyframes and what lies between them -----------------------------------------------------------------------


def test_keyframes_further_apart_lose_nothing() -> None:
    """The chain is condensed, not thinned out: the same estimate and covariance at common keyframes."""
    fine = smooth(log(), Config.from_dict({"keyframes": {"interval_s": 0.1}})).trajectory
    coarse = run().trajectory
    rows = np.searchsorted(fine.t_s, coarse.t_s - 1e-6)
    assert len(fine) > 9 * len(coarse)
    np.testing.assert_allclose(fine.pos_n[rows], coarse.pos_n, atol=2e-4)
    np.testing.assert_allclose(fine.cov[rows, 3:5, 3:5], coarse.cov[:, 3:5, 3:5], rtol=0.05, atol=1e-7)


def test_motions_carry_the_state_between_keyframes() -> None:
    fine = smooth(log(), Config.from_dict({"keyframes": {"interval_s": 0.1}})).trajectory
    between = run().trajectory.at(fine.t_s)
    # what the motions of one second leave is spread evenly; the finer graph spreads it by their covariances
    np.testing.assert_allclose(between.pos_n, fine.pos_n, atol=3e-3)
    straight = run().trajectory.without_bridge().at(fine.t_s)
    assert np.abs(straight.pos_n - fine.pos_n).max() > 2 * np.abs(between.pos_n - fine.pos_n).max()
    on = run().trajectory
    np.testing.assert_array_equal(on.at(on.t_s).vel_n[:-1], on.vel_n[:-1])
    np.testing.assert_allclose(on.at(on.t_s).pos_n, on.pos_n, atol=1e-12)


def test_every_scan_has_a_keyframe() -> None:
    shifted = dataclasses.replace(log(), lidar_points=log().lidar_points.replace(t_s=log().lidar_points.t_s + 0.037))
    t_s = smooth(shifted).trajectory.t_s
    inside = np.unique(shifted.lidar_points.t_s)[:-1]  # the last scan is after the last motion
    assert np.isin(inside.round(6), t_s.round(6)).all()


def test_known_positions_take_part() -> None:
    base, truth = log(legs="none"), log(legs="none").truth
    rows = np.arange(50, 400, 50)
    fixes = Position(t_s=truth.t_s[rows], pos_n_m=truth.pos_n_m[rows], sigma_n_m=np.full((len(rows), 3), 0.005))
    end = SurveyedPoint(pos_n_m=truth.pos_n_m[-1], sigma_m=0.005, t_s=float(truth.t_s[-1]))
    late = SurveyedPoint(pos_n_m=truth.pos_n_m[-1], sigma_m=0.005, t_s=99.0)
    found = smooth(dataclasses.replace(base, position=fixes, surveyed=(end, late)))
    assert np.linalg.norm(evaluate(found.trajectory, base).rms_m) < 0.05
    assert found.diagnostics.warnings == [
        "1 of 9 positions and surveyed points are outside the record of relative poses"
    ]


# Methods, files, truth --------------------------------------------------------------------------------------


def test_dead_reckoning_is_the_chain_itself() -> None:
    reckoned, alone = smooth(log(), method="dead-reckoning").trajectory, run(legs="none").trajectory
    assert reckoned.cov is None
    states = reckoned.at(alone.t_s)
    np.testing.assert_allclose(states.pos_n, alone.pos_n, atol=1e-9)


def test_methods_side_by_side() -> None:
    found = gn.compare(log(), methods=["batch", "dead-reckoning"])
    assert [row.error for row in found.rows] == [None, None]
    assert np.linalg.norm(found.rows[0].rms_m) < np.linalg.norm(found.rows[1].rms_m)


@pytest.mark.parametrize("method", ["isam2", "rts", "ekf", "dead-reckoning-cpoem"])
def test_methods_that_need_an_imu_say_so(method: str) -> None:
    with pytest.raises(
        ConfigError, match=f"{method} needs an IMU, and log robot has none: .* batch and dead-reckoning"
    ):
        smooth(log(), method=method)


def test_truth_plays_no_part() -> None:
    np.testing.assert_array_equal(smooth(log()).trajectory.pos_n, run().trajectory.pos_n)


def test_through_a_folder(tmp_path: Path) -> None:
    write(log(), tmp_path / "robot")
    again = smooth(read(tmp_path / "robot"))
    np.testing.assert_array_equal(again.trajectory.pos_n, run().trajectory.pos_n)
    np.testing.assert_array_equal(smooth(tmp_path / "robot").trajectory.cov, run().trajectory.cov)
    again.save(tmp_path / "run")


def test_without_covariances() -> None:
    found = smooth(log(), Config.from_dict({"covariance": False}))
    assert found.trajectory.cov is None
    assert found.calibration["lidar_range_bias"].sigma is None
    np.testing.assert_allclose(found.trajectory.pos_n, run().trajectory.pos_n, atol=1e-12)


# What is told and what is refused ---------------------------------------------------------------------------


def test_what_takes_no_part_is_told() -> None:
    t_s = log().relative_pose.t_from_s
    wheels = Odometer(
        t_s=t_s, speed_m_s=np.full(len(t_s), 0.3), sigma_m_s=0.02, slip_sigma_m_s=0.01, scale_sigma=0.05,
        mounting_sigma_deg=np.ones(3),
    )  # fmt: skip
    static = log().initial.replace(static_until_s=1.0)
    more = dataclasses.replace(log(), odometer=wheels, face=Face(length_m=10.0), lidar=None, initial=static)
    assert smooth(more).diagnostics.warnings == [
        "the table odometer is not used without an IMU",
        "the section [face] is not used without an IMU",
        "initial.static_until_s is not used without an IMU: the motions say when it stands",
        "the table lidar_points is not used: declare the scanner in a section [lidar]",
    ]


def changed(**columns: np.ndarray) -> SensorLog:
    return dataclasses.replace(log(legs="none"), relative_pose=log().relative_pose.replace(**columns))


def test_a_gap_is_refused() -> None:
    poses = log().relative_pose
    keep = np.arange(len(poses)) != 100
    columns = {f.name: getattr(poses, f.name)[keep] for f in RelativePose.column_fields() if f.name[:5] != "sigma"}
    message = (
        r"table relative_pose, row 101, t_from_s: 10\.100000 s, but .* ends at 10\.000000 s.* nothing bridges a gap"
    )
    with pytest.raises(LogError, match=message):
        smooth(changed(**columns))


def test_motions_that_overlap_are_refused() -> None:
    t_to = log().relative_pose.t_to_s.copy()
    t_to[7] += 0.05
    with pytest.raises(LogError, match=r"row 9, t_from_s: .* nothing bridges an overlap; let every motion begin"):
        smooth(changed(t_to_s=t_to))


def test_a_motion_that_takes_no_time_is_refused() -> None:
    t_to = log().relative_pose.t_to_s.copy()
    t_to[3] = log().relative_pose.t_from_s[3]
    with pytest.raises(LogError, match=r"row 4, t_to_s: 0\.300000 s is not after t_from_s"):
        smooth(changed(t_to_s=t_to))


def test_a_covariance_without_an_error_in_some_direction_is_refused() -> None:
    cov = log().relative_pose.cov_upper.copy()
    cov[5] = 0.0
    with pytest.raises(LogError, match=r"row 6, c_00 \.\.\. c_55: the covariance is not positive definite"):
        smooth(changed(cov_upper=cov))


def test_neither_imu_nor_relative_poses() -> None:
    with pytest.raises(LogError, match="no imu table and no relative_pose table; smoothing needs an IMU, or relative"):
        smooth(dataclasses.replace(log(), relative_pose=None))


def test_a_missing_initial_pose() -> None:
    with pytest.raises(LogError, match=r"log\.toml, \[initial\]: missing"):
        smooth(dataclasses.replace(log(), initial=None))


def test_too_few_iterations_are_no_result() -> None:
    with pytest.raises(SolveError, match="not converged after 1 iterations"):
        smooth(log(), Config.from_dict({"batch": {"max_iterations": 1}}))


@pytest.mark.parametrize("what", [gn.bound, gn.observe])
def test_what_needs_an_imu_says_what_does_not(what) -> None:
    with pytest.raises(LogError, match=r"no imu table, which this needs; without one, .* smoothed by batch"):
        what(log())
