"""Legs in iSAM2: better causal estimates, updates of bounded cost, and readings that are wrong."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import gtsam
import numpy as np
import pytest
from lidar_changes import all_legs_moved, false_circles, lidar_gap, wrong_numbers
from test_legs_in_the_graph import log, run

from factors.so3 import from_quaternion
from graphnav import graph as build
from graphnav import initial as initial_
from graphnav import preintegration as preintegration_
from graphnav._metrics import truth_at
from graphnav._stages import Stages
from graphnav.config import Config
from graphnav.initial import initial_values
from graphnav.legs import Windows, condense, of_window
from graphnav.leg_means import velocity_variance
from graphnav.log import Landmark, SensorLog
from graphnav.preintegration import Preintegrated
from graphnav.problem import D, L, Problem, X
from graphnav.smooth import posed, smooth
from graphnav.solvers import incremental
from graphnav.solvers.incremental_legs import LegFeed
from graphnav.trajectory import Trajectory

SEEDS = range(4)


def config(**isam2) -> Config:
    return Config.from_dict({"isam2": isam2})


@cache
def prepared(given: SensorLog, chosen: Config) -> tuple[Problem, Preintegrated]:
    problem = posed(replace(given, truth=None), chosen, Stages(None))
    return problem, preintegration_.preintegrate(problem, initial_.start_state(problem)[1], np.zeros(3))


def passed(given: SensorLog, chosen: Config) -> incremental.IncrementalResult:
    """iSAM2 alone, without the batch iterations that `smooth` puts after it."""
    problem, data = prepared(given, chosen)
    factors = build.build_factors(problem, data)
    return incremental.solve(problem, data, factors, initial_.start_state(problem)[0], chosen.isam2)


def error(t_s: np.ndarray, pos_n: np.ndarray, given: SensorLog) -> np.ndarray:
    known, pos, _ = truth_at(given.truth, t_s)
    return pos_n[known] - pos


def causal_error(given: SensorLog, chosen: Config) -> np.ndarray:
    problem, _ = prepared(given, chosen)
    return error(problem.keyframe_s, passed(given, chosen).causal.pos_n, given)


class AtTruth:
    """Estimates that are the truth, for the legs alone."""

    def __init__(self, problem: Problem, given: SensorLog) -> None:
        _, pos, quat = truth_at(given.truth, problem.keyframe_s)
        self.theta = gtsam.Values()
        for i, (rotation, p) in enumerate(zip(from_quaternion(quat), pos, strict=True)):
            self.theta.insert(X(i), gtsam.Pose3(gtsam.Rot3(rotation), p))

    def pose(self, i: int) -> np.ndarray:
        return self.theta.atPose3(X(i)).matrix()


def fed(given: SensorLog, chosen: Config) -> tuple[LegFeed, gtsam.NonlinearFactorGraph, gtsam.Values]:
    """All windows of a log along the true path."""
    problem, data = prepared(given, chosen)
    feed, graph, values = LegFeed(problem, data), gtsam.NonlinearFactorGraph(), gtsam.Values()
    feed.feed(AtTruth(problem, given), len(problem.keyframe_s) - 1, graph, values)
    return feed, graph, values


# what it is worth ---------------------------------------------------------------------------------------------


def test_causal_estimates_are_better_with_legs() -> None:
    """Over the seeds, horizontally, once the survey at the far end has told the heading."""
    squares = {True: 0.0, False: 0.0}
    for seed in SEEDS:
        survey_s = log(seed).events.t_s[1] + 5
        for use in squares:
            causal = run(seed, use, "isam2").causal
            off = error(causal.t_s, causal.pos_n, log(seed))[:, :2]
            squares[use] += float((off[causal.t_s > survey_s] ** 2).sum(axis=1).mean())
    print(squares)
    assert squares[True] < 0.5 * squares[False]


@pytest.mark.parametrize("seed", SEEDS)
def test_it_ends_where_batch_does(seed: int) -> None:
    apart = run(seed, True, "isam2").trajectory.pos_n - run(seed).trajectory.pos_n
    sigma = np.sqrt(np.diagonal(run(seed).trajectory.cov, axis1=1, axis2=2)[:, 3:6])
    print((np.abs(apart) / sigma).max())
    assert (np.abs(apart) / sigma).max() < 0.3


def test_several_keyframes_per_update() -> None:
    few, many = causal_error(log(), config(keyframes_per_update=5)), causal_error(log(), config())
    print(np.sqrt((few**2).mean(0)), np.sqrt((many**2).mean(0)))
    assert np.sqrt((few**2).mean()) < 1.5 * np.sqrt((many**2).mean())


# what it costs ------------------------------------------------------------------------------------------------


def test_the_cost_of_an_update_does_not_grow() -> None:
    """Variables eliminated anew, without checks for relinearization and closed path, which have a cost of their own.

    It does where a leg seen again after minutes is the same variable.
    """
    most = {}
    for gap_s in (30.0, 1e9):
        chosen = Config.from_dict(
            {"isam2": {"leg_gap_s": gap_s, "relinearize_skip": 1 << 20}, "closed_path": {"form": "off"}}
        )
        each = passed(log(), chosen).reeliminated
        quarters = np.array_split(each, 4)
        most[gap_s] = [int(q.max()) for q in quarters]
        print(gap_s, most[gap_s], [float(q.mean()) for q in quarters])
    assert max(most[30.0][1:]) < 1.5 * most[30.0][0] + 20


# what goes wrong ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "spoilt",
    [
        lambda given: false_circles(given, 0.05, 1),
        lambda given: wrong_numbers(given, 0.2, 1),
        lambda given: all_legs_moved(given, 120.0, 0.5),
        lambda given: lidar_gap(given, 60.0, 100.0),
    ],
)
def test_wrong_readings_do_little_harm(spoilt) -> None:
    bad, good = spoilt(log()), log()
    rms = [np.sqrt((causal_error(each, config()) ** 2).mean()) for each in (bad, good)]
    print(rms)
    assert rms[0] < 1.5 * rms[1]
