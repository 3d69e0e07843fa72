"""LiDAR legs as landmarks in the graph: positions, calibration, creep of information, and what is left out of use."""

from __future__ import annotations

import dataclasses
from dataclasses import replace

import numpy as np
import pytest
from lidar_logs import SPEC, log, run
from scipy import stats

from graphnav import legs
from graphnav._stages import Stages
from graphnav.config import Config
from graphnav.evaluation import evaluate
from graphnav.leg_priors import lidar_sigmas
from graphnav.rounds import leg_readings
from graphnav.simulation.lidar import draw_lidar_errors
from graphnav.simulation.world import streams
from graphnav.smooth import posed, smooth
from graphnav.solution import solve_batch

SEEDS = range(4)


def drawn(seed: int) -> dict[str, float]:
    """What the scanner's calibration truly is, in the units of `Run.calibration`."""
    e = draw_lidar_errors(SPEC.lidar, streams(seed).lidar, 1.0)
    return {"lidar_range_scale": e.range_scale, "lidar_range_bias": e.range_bias_m}


def rms(seed: int, use: bool) -> np.ndarray:
    return evaluate(run(seed, use).trajectory, log(seed)).rms_m


def test_legs_bring_the_position_closer() -> None:
    """On average over the seeds, horizontally, where legs tell something."""
    with_legs, without = (np.mean([rms(seed, use)[:2] ** 2 for seed in SEEDS]) ** 0.5 for use in (True, False))
    assert with_legs < 0.7 * without


def test_position_sigmas_are_right() -> None:
    """NEES at the end of the log, one draw a seed; false-alarm rate 1e-3."""
    squares = 0.0
    for seed in SEEDS:
        judged = evaluate(run(seed).trajectory, log(seed))
        error, cov = judged.error_n_m[-1], run(seed).trajectory.cov[-1, 3:6, 3:6]
        squares += float(error @ np.linalg.solve(cov, error))
    low, high = stats.chi2.interval(1 - 1e-3, 3 * len(SEEDS))
    assert low < squares < high


@pytest.mark.parametrize("seed", SEEDS)
def test_the_range_calibration_is_found(seed: int) -> None:
    """Within 4.5 sigma (false-alarm rate 1e-5 each), and the bias far better than declared."""
    found = run(seed).calibration
    for name, truth in drawn(seed).items():
        assert abs(found[name].value - truth) < 4.5 * found[name].sigma
    assert found["lidar_range_bias"].sigma < 0.2 * log(seed).lidar.range_bias_sigma_m


def test_nothing_is_lost_in_condensing() -> None:
    """Every detection within the record is in one reading, and no reading mixes legs."""
    problem = posed(replace(log(), truth=None), Config(), Stages(None))
    solved = solve_batch(problem, Stages(None))
    readings = leg_readings(problem, solved.data, solved.result.values)
    points = log().lidar_points
    assert readings is not None
    assert readings.count.sum() == len(points)
    assert np.array_equal(readings.feature, np.unique(points.feature))
    assert len(readings.leg) < len(points) / 20


@pytest.mark.parametrize("seed", SEEDS)
def test_residuals_are_of_the_declared_size(seed: int) -> None:
    """Chi-square of the readings by their number less what was estimated: 1, within what a model of noise can give."""
    problem = posed(replace(log(seed), truth=None), Config(), Stages(None))
    solved = solve_batch(problem, Stages(None))
    readings = leg_readings(problem, solved.data, solved.result.values)
    error, *_ = readings.family(log(seed).lidar).residuals(solved.result.values)
    freedom = error.size - 4 * len(readings.feature)
    assert 0.8 < float((error**2).sum()) / freedom < 1.25


def test_averages_of_detections_know_the_scanners_errors() -> None:
    """Means over 0.5 m claim to know no more of the scanner than means over 0.1 m, and are as right (4.5 sigma)."""
    fine = Config.from_dict({"lidar": {"window_m": 0.1}, "keyframes": {"interval_s": 0.3}})
    found = smooth(replace(log(3), truth=None), fine).calibration
    for name, coarse in run(3).calibration.items():
        if name.startswith("lidar"):
            assert coarse.sigma > 0.95 * found[name].sigma
    for name, truth in drawn(3).items():
        for c in (found[name], run(3).calibration[name]):
            assert abs(c.value - truth) < 4.5 * c.sigma


def test_isam2_ends_where_batch_does() -> None:
    """But for where the rough path stopped along which the detections were brought together."""
    apart = run(0, True, "isam2").trajectory.pos_n - run(0).trajectory.pos_n
    sigma = np.sqrt(np.diagonal(run(0).trajectory.cov, axis1=1, axis2=2)[:, 3:6])
    assert (np.abs(apart) / sigma).max() < 0.3


def test_without_use_it_is_as_if_not_recorded() -> None:
    bare = dataclasses.replace(log(), truth=None, lidar=None, lidar_points=None)
    assert np.array_equal(smooth(bare).trajectory.pos_n, run(0, False).trajectory.pos_n)


def test_filters_say_that_they_do_not_use_it() -> None:
    warnings = run(0, True, "ekf").diagnostics.warnings
    assert any("lidar_points" in line for line in warnings)


def test_a_scanner_that_is_not_declared_is_named() -> None:
    found = smooth(dataclasses.replace(log(), truth=None, lidar=None)).diagnostics.warnings
    assert any("[lidar]" in line for line in found)


def test_windows_of_a_record_shorter_than_one() -> None:
    keyframe_s = np.array([0.0, 1.0, 2.0])
    centre = legs._centres(keyframe_s, 10.0)
    assert centre.tolist() == [1]
    assert legs._nearest(keyframe_s[centre], np.array([0.0, 1.9])).tolist() == [0, 0]
    assert legs._centres(np.arange(11.0), 4.0).tolist() == [2, 6, 10]


def test_declared_sigmas_in_si() -> None:
    lidar = log().lidar
    sigmas = lidar_sigmas(lidar)
    assert sigmas[0] == lidar.range_scale_sigma and sigmas[1] == lidar.range_bias_sigma_m
    assert sigmas[2] == pytest.approx(np.radians(lidar.angle_bias_sigma_deg))
    assert sigmas[4] == pytest.approx(lidar.angle_quadratic_sigma_per_deg * 180 / np.pi)
    held = lidar_sigmas(lidar.replace(range_scale_sigma=None, mounting_sigma_deg=None))
    assert held[0] == 1e-7 and (held[5:] == 1e-7).all()
