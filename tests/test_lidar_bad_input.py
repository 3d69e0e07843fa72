"""Spoilt LiDAR data: the result stays right, or the run says what it could not use."""

from __future__ import annotations

import dataclasses
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from graphnav import leg_means
from graphnav.evaluation import evaluate
from graphnav.leg_agreement import DISAGREES
from graphnav.log import SensorLog
from graphnav.run import Run
from graphnav.simulation.lidar_figures import LidarSpec
from graphnav.simulation.scenarios import LIDAR
from graphnav.simulation.shearer import simulate_shearer
from graphnav.smooth import smooth
from tests import lidar_changes

#: Two cuts of 30 m at three times the speed. The scanner's own errors are small: a spoilt log keeps those of the place
#: where the leg was seen before.
SPEC = replace(
    LIDAR, length_m=30.0, cycles=2, speed_m_s=0.3, static_s=20.0, tail_s=1.0, pause_s=3.0, retreat_m=24.0,
    crossing_m=20.0, end_work_s=None, duration_s=None, att_error_deg=None, mounting_deg=None,
    lidar=LidarSpec(
        range_scale=1e-5, range_bias_m=1e-4, angle_quadratic_per_deg=1e-7, angle_scale=1e-4, angle_bias_deg=1e-3,
        draw=True,
    ),
)  # fmt: skip
SEEDS = range(2)


@cache
def log(seed: int) -> SensorLog:
    return simulate_shearer("spoilt", SPEC, seed)


def run(spoilt: SensorLog) -> Run:
    return smooth(dataclasses.replace(spoilt, truth=None))


@cache
def clean(seed: int) -> Run:
    return run(log(seed))


def off(spoilt: Run, seed: int) -> float:
    """Largest difference from the run on the log as it was, in sigmas of the spoilt run."""
    apart = spoilt.trajectory.pos_n - clean(seed).trajectory.pos_n
    return float((np.abs(apart) / np.sqrt(np.diagonal(spoilt.trajectory.cov, axis1=1, axis2=2)[:, 3:6])).max())


def half(seed: int) -> float:
    return float(log(seed).imu.t_s[-1]) / 2


@pytest.mark.parametrize("seed", SEEDS)
def test_a_sound_log_leaves_nothing_out(seed: int) -> None:
    assert not clean(seed).diagnostics.warnings


@pytest.mark.parametrize("change", [lidar_changes.false_circles, lidar_changes.wrong_numbers])
@pytest.mark.parametrize("seed", SEEDS)
def test_false_detections_are_left_out_and_told(change: object, seed: int) -> None:
    spoilt = run(change(log(seed), 0.05, seed))
    assert off(spoilt, seed) < 0.5
    (line,) = spoilt.diagnostics.warnings
    count, of = (int(word) for word in line.split(" LiDAR detections")[0].split(" of "))
    # two in a hundred of the false ones fall close to the leg, or among so few that the median is theirs
    assert 0.04 < count / of < 0.055


@pytest.mark.parametrize("seed", SEEDS)
def test_a_minute_without_lidar_is_bridged(seed: int) -> None:
    spoilt = run(lidar_changes.lidar_gap(log(seed), half(seed), half(seed) + 60))
    assert off(spoilt, seed) < 3
    assert not spoilt.diagnostics.warnings


@pytest.mark.parametrize("seed", SEEDS)
def test_without_legs_in_view_the_sigmas_grow(seed: int) -> None:
    """For three fifths of the log; the largest error within 4.5 sigma (false-alarm rate 1e-5 each place)."""
    spoilt = run(lidar_changes.no_legs(log(seed), 0.4 * half(seed), 1.6 * half(seed)))
    sigma = np.sqrt(np.diagonal(spoilt.trajectory.cov, axis1=1, axis2=2)[:, 3:6])
    error = evaluate(spoilt.trajectory, log(seed)).error_n_m
    assert (np.abs(error) < 4.5 * sigma[: len(error)]).all()
    known = np.sqrt(np.diagonal(clean(seed).trajectory.cov, axis1=1, axis2=2)[:, 3:6])
    assert sigma.max(axis=0)[1] > 1.2 * known.max(axis=0)[1]
    (line,) = (each for each in spoilt.diagnostics.warnings if each.startswith("no leg is seen from"))
    told_s = np.array([float(word) for word in line.split(" s,")[0].split(" from ")[1].split(" to ")])
    assert np.abs(told_s - half(seed) * np.array([0.4, 1.6])).max() < 6  # where the last and first legs are condensed


@pytest.mark.parametrize("seed", SEEDS)
def test_a_scanner_five_degrees_off_is_found_and_told(seed: int) -> None:
    spoilt = run(lidar_changes.mounting_off(log(seed), 5.0))
    assert off(spoilt, seed) < 0.5
    found, was = (r.calibration["lidar_mounting_up"] for r in (spoilt, clean(seed)))
    assert found.value == pytest.approx(was.value - 5.0, abs=4 * found.sigma)
    (line,) = spoilt.diagnostics.warnings
    assert "lidar_mounting_up" in line and "check [lidar]" in line


@pytest.mark.parametrize("by_m", [0.5, (0.3, 0.5)])
@pytest.mark.parametrize("seed", SEEDS)
def test_legs_that_all_moved_do_not_move_the_machine(by_m: float | tuple[float, float], seed: int) -> None:
    spoilt = run(lidar_changes.all_legs_moved(log(seed), 1.2 * half(seed), by_m))
    assert off(spoilt, seed) < 1.5
    assert any("legs that moved need new numbers" in line for line in spoilt.diagnostics.warnings)


def test_a_leg_is_split_where_it_steps() -> None:
    """Three readings each of two legs in turn; the first steps by 0.3 m, the second far less than its noise."""
    leg, t_s = np.array([0, 1, 0, 1, 0, 1]), np.arange(6.0)
    place = np.zeros((6, 3))
    place[[1, 3, 5], 0] = [5.0, 5.05, 5.0]
    place[4, 1] = 0.3
    found, before = leg_means.split(leg, t_s, place, np.full(6, 0.01))
    assert found.tolist() == [0, 1, 0, 1, 2, 1]
    assert before.tolist() == [0]
    # much later it may be dead reckoning that has drifted
    assert leg_means.split(leg, t_s * 100, place, np.full(6, 0.01))[1].size == 0


def test_detections_apart_from_a_group() -> None:
    """Nine of 1,000 in three groups, far off; none where errors are normal (false-alarm rate 1e-4)."""
    rng = np.random.default_rng(1)
    place = rng.normal(0, 0.01, (1000, 3))
    groups = leg_means.Groups.of(np.arange(1000) % 3)
    variance = np.full(1000, 0.01**2)
    assert not leg_means.apart(groups, place, variance).any()
    place[::111, 0] += 2.0
    assert np.flatnonzero(leg_means.apart(groups, place, variance)).tolist() == list(range(0, 1000, 111))


def test_disagreement_is_beyond_chance() -> None:
    """A million readings with normal errors in range and angle: none as far off as what is left out."""
    rng = np.random.default_rng(2)
    assert np.hypot(*rng.standard_normal((2, 1_000_000))).max() < DISAGREES
