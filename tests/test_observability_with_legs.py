"""Observability of the LiDAR's calibration from legs: covariances, and what a log says of each of its eight numbers."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import gtsam
import numpy as np
import pytest
from engine_logs import until
from lidar_logs import BARE, SPEC, log, run, tiny
from scipy.stats import chi2

from graphnav._stages import Stages
from graphnav.analysis import observe
from graphnav.config import Config
from graphnav.graph import build_graph
from graphnav.leg_priors import lidar_sigmas
from graphnav.log import SensorLog
from graphnav.observability import FACE_STATES, LIDAR_STATES, Observability, of_graph
from graphnav.problem import B, C, D, Problem, V, X
from graphnav.report.observability import plot, render
from graphnav.rounds import Solved
from graphnav.run import ACCEL_NAMES, GYRO_NAMES, LIDAR_NAMES, ODOMETER_NAMES
from graphnav.simulation.lidar import draw_lidar_errors
from graphnav.simulation.world import streams
from graphnav.smooth import posed
from graphnav.solution import solve_batch
from graphnav.solvers import joint_states
from graphnav.solvers.joint_states import graph_covariances

SEEDS = range(8)
NAMES = [state.name for state in (*FACE_STATES, *LIDAR_STATES)]


def solved(recorded: SensorLog) -> tuple[Problem, Solved]:
    problem = posed(replace(recorded, truth=None), Config(), Stages(None))
    return problem, solve_batch(problem, Stages(None))


@cache
def of_seed(seed: int = 0) -> tuple[Problem, Solved]:
    return solved(log(seed))


@cache
def observed(causal: bool = False, seed: int = 0, count: int = 20) -> Observability:
    problem, found = of_seed(seed)
    return of_graph(
        problem, found.data, found.result.values, legs=found.legs, advances=found.advances, causal=causal, count=count
    )


def final(name: str) -> float:
    """Ratio at the end."""
    return float(observed().ratio[-1, NAMES.index(name)])


def covariances(recorded: SensorLog, keyframes: list[int], causal: bool = False) -> np.ndarray:
    problem, found = solved(recorded)
    return graph_covariances(
        problem, found.data, found.result.values, keyframes, legs=found.legs, advances=found.advances, causal=causal
    )


def test_joint_covariances_are_those_of_the_dense_inverse() -> None:
    problem, found = solved(tiny())
    values, last = found.result.values, len(problem.keyframe_s) - 1
    linear = build_graph(problem, found.data, found.legs, found.advances).linearize(values)
    ordering = gtsam.Ordering.NaturalGaussianFactorGraph(linear)
    size = {"x": 6, "v": 3, "b": 6, "c": 4, "k": 1, "l": 4, "d": 8}
    at, place = {}, 0
    for k in range(ordering.size()):
        key = ordering.at(k)
        at[key] = np.arange(place, place + size[chr(key >> 56)])
        place += len(at[key])
    root = np.linalg.inv(np.linalg.qr(linear.jacobian(ordering)[0], mode="r"))
    keyframes = [0, 7, last]
    given = graph_covariances(problem, found.data, values, keyframes, legs=found.legs, advances=found.advances)
    assert given.shape == (3, 27, 27)
    for cov, i in zip(given, keyframes, strict=True):
        e = max(i - 1, 0)
        own = [X(i), V(i), B(int(problem.bias_epoch[e])), C(int(problem.calibration_epoch[e])), D(0)]
        part = root[np.concatenate([at[key] for key in own])]
        att, pos, vel, accel, gyro, scale, mount, scanner = np.split(part, [3, 6, 9, 12, 15, 16, 19])
        turn = values.atPose3(X(i)).rotation().matrix()
        in_order = np.vstack([vel, turn @ att, turn @ pos, gyro, accel, mount, scale, scanner])
        expected = in_order @ in_order.T
        sigma = np.sqrt(np.diag(expected))
        assert np.abs((cov - expected) / np.outer(sigma, sigma)).max() < 1e-5


def test_sigmas_at_the_end_are_those_of_the_run() -> None:
    expected = [
        run().calibration[name].sigma * unit_si
        for name, unit_si, _ in (*GYRO_NAMES, *ACCEL_NAMES, *ODOMETER_NAMES[1:], ODOMETER_NAMES[0], *LIDAR_NAMES)
    ]
    for causal in (False, True):
        assert observed(causal).sigma[-1, 9:] == pytest.approx(expected, rel=1e-3)


def test_causal_begins_with_what_is_declared_and_only_gains() -> None:
    causal, smoothed = (observed(causal).sigma[:, 19:] for causal in (True, False))
    assert causal[0] == pytest.approx(lidar_sigmas(log().lidar), rel=1e-6)
    assert (np.diff(causal, axis=0) < 1e-6 * causal[:-1]).all()
    # one and the same number, whatever keyframe it is looked at from
    assert smoothed == pytest.approx(np.tile(smoothed[-1], (len(smoothed), 1)), rel=1e-4)


def test_causal_is_the_log_cut_off_there() -> None:
    """Cut where a window of detections is over: the log cut off has the same windows."""
    whole = replace(log(), events=None, face=None, surveyed=())
    problem, found = solved(whole)
    assert found.legs is not None
    i = next(i for i in sorted(joint_states._seen(problem, found.legs).values()) if problem.keyframe_s[i] > 60.0)
    causal = graph_covariances(
        problem, found.data, found.result.values, [i], legs=found.legs, advances=found.advances, causal=True
    )[0]
    t_s, centre = problem.keyframe_s, np.unique(found.legs.window)
    over_s = (t_s[centre][1:] + t_s[centre][:-1]) / 2
    cut = until(whole, float(t_s[i]))
    # the next window has begun, and is not known yet
    kept = cut.lidar_points.t_s <= over_s[over_s <= t_s[i]][-1]
    columns = {name: getattr(cut.lidar_points, name)[kept] for name in ("t_s", "feature", "range_m", "angle_rad")}
    cut = replace(cut, lidar_points=cut.lidar_points.replace(**columns))
    cut_problem, _ = solved(cut)
    expected = covariances(cut, [len(cut_problem.keyframe_s) - 1])[0]
    assert np.sqrt(np.diag(causal)) == pytest.approx(np.sqrt(np.diag(expected)), rel=0.05)


def test_without_legs_nothing_changes() -> None:
    apart = observe(replace(log(), lidar=None, lidar_points=None), kind="smoothed")
    unused = observe(log(), BARE, kind="smoothed")
    assert unused.states == FACE_STATES == apart.states
    assert np.array_equal(unused.covariance, apart.covariance)


def test_the_scanners_states_come_last() -> None:
    found = observe(log(), kind="smoothed")
    assert found.states == (*FACE_STATES, *LIDAR_STATES)
    assert len(found.information) == 18
    assert found.sigma[-1] == pytest.approx(observed().sigma[-1], rel=1e-6)


def test_what_is_not_declared_is_held_and_not_told() -> None:
    held = replace(tiny(), lidar=tiny().lidar.replace(range_scale_sigma=None, mounting_sigma_deg=None))
    problem, found = solved(held)
    o = of_graph(problem, found.data, found.result.values, legs=found.legs, count=3)
    assert o.states[19:] == LIDAR_STATES[1:5]
    assert o.sigma.shape[1] == 23


# What a log says of each -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name", ["LiDAR range bias", "LiDAR angle scale", "LiDAR angle quadratic", "LiDAR mounting about up"]
)
def test_is_found_five_times_better_than_declared(name: str) -> None:
    assert final(name) < 1 / 5


@pytest.mark.parametrize(
    "name", ["LiDAR angle bias", "LiDAR range scale", "LiDAR mounting about right", "LiDAR mounting about forward"]
)
def test_is_not(name: str) -> None:
    assert final(name) > 1 / 5


def test_angle_bias_and_mounting_about_up_are_known_in_their_sum_alone() -> None:
    """Turned scanner and turned readings are the same: the sum is known, the difference as it was declared."""
    o = observed()
    at = [NAMES.index(name) for name in ("LiDAR angle bias", "LiDAR mounting about up")]
    pair = o.covariance[-1][np.ix_(at, at)]
    total = np.sqrt(pair.sum())
    assert total < 0.1 * o.reference[-1, at[1]]
    # of two normal numbers whose sum is known, each keeps what both priors leave of it
    declared = o.reference[-1, at]
    left = 1 / np.sqrt((1 / declared**2).sum())
    assert np.sqrt(pair[0, 0]) == pytest.approx(left, rel=0.02)
    found = [d for d in o.weakest[-1] if "LiDAR angle bias" in {s.name for s in d.states}]
    assert len(found) == 1
    amount = dict(zip((s.name for s in found[0].states), found[0].amounts, strict=True))
    assert set(amount) == {"LiDAR angle bias", "LiDAR mounting about up"}
    assert amount["LiDAR mounting about up"] == pytest.approx(-amount["LiDAR angle bias"], rel=0.03)


def scatter(rows: np.ndarray) -> float:
    """NEES of combinations (K, 8) of the eight numbers, summed over the seeds, one draw of K squares each."""
    squares = 0.0
    for seed in SEEDS:
        e = draw_lidar_errors(SPEC.lidar, streams(seed).lidar, 1.0)
        angle = [np.radians(e.angle_bias_deg), e.angle_scale, np.degrees(e.angle_quadratic_per_deg)]
        truth = np.r_[e.range_scale, e.range_bias_m, angle, e.mounting_rad]
        error = rows @ (of_seed(seed)[1].result.values.atVector(D(0)) - truth)
        cov = rows @ observed(seed=seed, count=2).covariance[-1, 19:, 19:] @ rows.T
        squares += float(error @ np.linalg.solve(cov, error))
    return squares


def test_errors_scatter_as_the_covariance_says() -> None:
    """The eight of the scanner, the two that are one in their sum and difference; false-alarm rate 1e-3."""
    rows = np.eye(8)
    rows[7, 2], rows[2, 7] = 1.0, -1.0
    low, high = chi2.interval(1 - 1e-3, 8 * len(SEEDS))
    assert low < scatter(rows) < high


@pytest.mark.parametrize("row", [np.eye(8)[0], np.eye(8)[2] + np.eye(8)[7]], ids=["range scale", "turn"])
def test_range_scale_and_the_scanners_turn_scatter_as_the_covariance_says(row: np.ndarray) -> None:
    """Those that an error of the path's velocity shows in first; false-alarm rate 1e-3."""
    low, high = chi2.interval(1 - 1e-3, len(SEEDS))
    assert low < scatter(row[None]) < high


def test_report_names_them(capsys: pytest.CaptureFixture[str], tmp_path) -> None:
    for causal in (False, True):
        render(observed(causal))
        told = capsys.readouterr().err
        assert all(state.name in told for state in LIDAR_STATES)
        assert "nan" not in told
    assert plot(observed(), tmp_path / "legs.png").stat().st_size > 10_000
