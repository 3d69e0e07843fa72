"""Ranges stamped by a clock that is off: estimated when asked, told when not, said to be unobservable at rest."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from uwb_logs import Errors, passing

import graphnav as gn
from graphnav import range_clock
from graphnav._stages import Stages
from graphnav.analysis import observe
from graphnav.config import Config
from graphnav.errors import ConfigError
from graphnav.evaluation import evaluate
from graphnav.log import SensorLog
from graphnav.run import Run
from graphnav.smooth import posed
from graphnav.solution import solve_batch
from graphnav.trajectory import Trajectory

SEEDS = range(2)
ASKED = {"uwb": {"estimate_time_offset": True}}
#: Markov errors and constants as in the scenario, and ranges by reflection.
USUAL = Errors(markov_m=0.02, constant_m=0.003, multipath=0.05)


@cache
def swinging(seed: int, late_s: float = 0.0) -> SensorLog:
    """To and fro by 2 m past the anchors, after a rest; every range stamped `late_s` late."""
    log = passing(seed, USUAL, seconds=18.0, rest_s=6.0, tag_start=(0.5, 4.0, 0.0), swing_m=2.0)
    assert log.uwb is not None
    return replace(log, uwb=replace(log.uwb, t_s=log.uwb.t_s + late_s))


@cache
def run(seed: int, late_s: float = 0.0, asked: bool = False, method: str = "batch") -> Run:
    return gn.smooth(replace(swinging(seed, late_s), truth=None), Config.from_dict(ASKED if asked else {}), method)


def rms_m(seed: int, late_s: float, asked: bool) -> float:
    return float(np.linalg.norm(evaluate(run(seed, late_s, asked).trajectory, swinging(seed)).rms_m))


# Asked ------------------------------------------------------------------------------------------------------


def test_the_offset_is_found_and_its_sigma_is_honest() -> None:
    """Each within 4 sigmas, and the sum of 4 squares like chi-square: false alarm 1 in 500."""
    off = []
    for seed in SEEDS:
        for late_s in (-0.2, 0.2):
            found = run(seed, late_s, asked=True).calibration["uwb_time_offset"]
            assert found.sigma is not None and found.sigma < 0.02 and found.unit == "s"
            off.append((found.value + late_s) / found.sigma)
    assert np.abs(off).max() < 4
    assert 0.09 < np.square(off).sum() < 18.5


@pytest.mark.parametrize("late_s", [-0.2, 0.2])
def test_positions_are_as_without_an_offset(late_s: float) -> None:
    """Root mean squares over the seeds: at most a tenth more than on time, and well below those not asked."""
    rms = {
        key: np.sqrt(np.mean([rms_m(seed, *key) ** 2 for seed in SEEDS]))
        for key in ((0.0, False), (late_s, False), (late_s, True))
    }
    assert rms[late_s, True] < 1.1 * rms[0.0, False]
    assert rms[late_s, True] < 0.75 * rms[late_s, False]


def test_nothing_is_lost_by_asking() -> None:
    for seed in SEEDS:
        assert rms_m(seed, 0.0, True) < 1.1 * rms_m(seed, 0.0, False)


def test_isam2_ends_where_batch_does() -> None:
    batch, isam2 = (run(0, 0.2, True, method).calibration["uwb_time_offset"] for method in ("batch", "isam2"))
    assert batch.sigma is not None
    assert abs(isam2.value - batch.value) < 0.2 * batch.sigma


def test_at_rest_the_offset_is_not_observable_and_said_to_be() -> None:
    log = passing(0, USUAL, seconds=9.0, rest_s=9.0)
    config = Config.from_dict(ASKED)
    found = gn.smooth(replace(log, truth=None), config)
    offset = found.calibration["uwb_time_offset"]
    assert abs(offset.value) < 0.05 and offset.sigma == pytest.approx(0.2, rel=0.02)
    assert any("time offset of UWB ranges is not observable" in line for line in found.diagnostics.warnings)
    told = observe(log, config)
    assert (told.states[-1].name, told.verdicts[-1]) == ("UWB time offset", "not observable")


def test_motion_makes_it_observable_from_the_start_on() -> None:
    """By the causal covariances, and no other state is told to be known better than when the clock is right."""
    log = swinging(0)
    asked, plain = observe(log, Config.from_dict(ASKED)), observe(log)
    assert asked.verdicts[-1] == "observable"
    assert 6.0 < asked.since_s[-1] < 10.0
    assert (asked.sigma[-1, :-1] > plain.sigma[-1] * (1 - 1e-6)).all()


def test_the_bound_counts_the_offset() -> None:
    log = swinging(1, 0.2)
    asked, plain = gn.bound(log, Config.from_dict(ASKED)).overall, gn.bound(swinging(1)).overall
    assert asked.bound_3d_m >= plain.bound_3d_m * (1 - 1e-3)
    assert asked.rms_3d_m < 2 * asked.bound_3d_m


def test_methods_that_cannot_refuse() -> None:
    with pytest.raises(ConfigError, match="imu-uwb estimates no time offset"):
        gn.smooth(swinging(0), Config.from_dict(ASKED), "imu-uwb")


# Not asked --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("late_s", "word"), [(-0.2, "early"), (0.2, "late")])
def test_a_clock_that_is_off_is_told(late_s: float, word: str) -> None:
    for seed in SEEDS:
        lines = [line for line in run(seed, late_s).diagnostics.warnings if "estimate_time_offset" in line]
        assert len(lines) == 1 and f"s {word} against the IMU" in lines[0]


def test_a_clock_that_is_right_is_not_accused() -> None:
    """At 5 sigmas: false alarm 1 in 2 million a log."""
    for seed in SEEDS:
        assert not any("stamped" in line for line in run(seed).diagnostics.warnings)


def test_the_score_is_standard_normal_on_time() -> None:
    """Squares of 10 logs without an offset like chi-square with 10 degrees of freedom: false alarm 1 in 500."""
    found = []
    for seed in range(10):
        log = passing(seed, Errors(), seconds=14.0, rest_s=4.0, tag_start=(0.5, 4.0, 0.0), swing_m=2.0)
        score = solve_batch(posed(replace(log, truth=None), Config(), Stages(None)), Stages(None)).clock_score
        assert score is not None
        found.append(score.offset_s / score.sigma_s)
    assert 1.48 < np.square(found).sum() < 29.6


# Parts ------------------------------------------------------------------------------------------------------


def test_a_tag_aside_turns_with_the_machine() -> None:
    """Its mean velocity over the window is the chord of its circle."""
    t, rate, arm = np.linspace(0, 2, 401), 0.7, np.array([0.0, 1.5, 0.0])
    quat = np.column_stack([np.cos(rate * t / 2), 0 * t, 0 * t, np.sin(rate * t / 2)])
    way = Trajectory(t, np.zeros((401, 3)), quat, np.zeros((401, 3)))
    at, window = np.array([0.5, 1.0, 1.0]), 0.2
    found = range_clock._velocity(way, at, np.tile(arm, (3, 1)), window)
    speed = 1.5 * np.sin(rate * window) / window
    expected = -speed * np.column_stack([np.cos(rate * at), np.sin(rate * at), 0 * at])
    np.testing.assert_allclose(found, expected, atol=1e-4)


def test_markov_errors_stay_in_the_radio_s_own_time() -> None:
    """Moved ranges keep their part of the same vectors; ranges moved out of the record are left out."""
    problem = posed(replace(swinging(0), truth=None), Config(), Stages(None))
    later = range_clock.moved(problem, replace(problem.clock, later_s=0.2))
    no_bias = np.zeros((len(problem.keyframe_s) - 1, 3))
    here, there = (gn.ranges.range_readings(p, no_bias, no_bias) for p in (problem, later))
    assert here is not None and there is not None
    assert 0 < len(here.row) - len(there.row) <= 9
    common = np.isin(here.row, there.row)
    for name in ("markov_key", "next_key", "slot", "markov_m"):
        own, other = getattr(here.family, name)[common], getattr(there.family, name)
        np.testing.assert_allclose(other, own, rtol=0, atol=1e-12)
    back = range_clock.moved(later, problem.clock)
    np.testing.assert_allclose(back.log.uwb.t_s, problem.log.uwb.t_s, atol=1e-12)


def test_ranges_before_the_record_are_no_matter() -> None:
    """The first stamped a hair before the IMU's first sample: no span holds it, and it takes no part."""
    log = swinging(0)
    assert log.uwb is not None and log.imu is not None
    t_s = log.uwb.t_s - (log.uwb.t_s[8] - log.imu.start_s) - 1e-12
    found = gn.smooth(replace(log, truth=None, uwb=replace(log.uwb, t_s=t_s)))
    assert found.diagnostics.converged
