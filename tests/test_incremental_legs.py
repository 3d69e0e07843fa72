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
from graphnav.legs import Windows, condense
from graphnav.log import Landmark, SensorLog
from graphnav.preintegration import Preintegrated
from graphnav.problem import Problem, X
from graphnav.smooth import posed
from graphnav.solvers import incremental
from graphnav.solvers.incremental_legs import LegFeed

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


@cache
def causal_error(given: SensorLog, chosen: Config) -> np.ndarray:
    """East and north, once the survey at the far end has told the heading, which is all of the error before."""
    keyframe_s = prepared(given, chosen)[0].keyframe_s
    off = error(keyframe_s, passed(given, chosen).causal.pos_n, given)
    return off[keyframe_s > given.events.t_s[1] + 5, :2]


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
    """Over the seeds."""
    squares = [
        sum(float((causal_error(log(seed), Config.from_dict({"lidar": {"use": use}})) ** 2).mean()) for seed in SEEDS)
        for use in (True, False)
    ]
    assert squares[0] < 0.5 * squares[1]


def test_it_ends_where_batch_does() -> None:
    """Where the path along which detections are brought together is another, so is the result, by a sigma."""
    apart = run(1, True, "isam2").trajectory.pos_n - run(1).trajectory.pos_n
    sigma = np.sqrt(np.diagonal(run(1).trajectory.cov, axis1=1, axis2=2)[:, 3:6])
    assert (np.abs(apart) / sigma).max() < 0.05


def test_several_keyframes_per_update() -> None:
    few, many = causal_error(log(), config(keyframes_per_update=5)), causal_error(log(), config())
    assert np.sqrt((few**2).mean()) < 1.5 * np.sqrt((many**2).mean())


# what it costs ------------------------------------------------------------------------------------------------


def test_the_cost_of_an_update_does_not_grow() -> None:
    """Variables eliminated anew, without checks for relinearization and closed path, which have a cost of their own.

    It does where a leg seen again after minutes is the same variable: all between is eliminated anew.
    """
    most = {}
    for gap_s in (30.0, 1e9):
        isam2 = {"leg_gap_s": gap_s, "relinearize_skip": 1 << 20}
        chosen = Config.from_dict({"isam2": isam2, "closed_path": {"form": "off"}})
        most[gap_s] = [int(part.max()) for part in np.array_split(passed(log(), chosen).reeliminated, 4)]
    assert max(most[30.0]) < 1.25 * most[30.0][0]
    assert max(most[1e9]) > 1.5 * most[1e9][0]


# what goes wrong ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "spoilt",
    [
        lambda given: false_circles(given, 0.05, 1),
        lambda given: wrong_numbers(given, 0.2, 1),
        lambda given: all_legs_moved(given, given.events.t_s[1] + 30, 0.5),
        lambda given: lidar_gap(given, given.events.t_s[1] + 10, given.events.t_s[1] + 50),
    ],
)
def test_wrong_readings_do_little_harm(spoilt) -> None:
    """Half a metre that all legs move, taken for the machine's, would be ten times the error."""
    rms = [np.sqrt((causal_error(each, config()) ** 2).mean()) for each in (spoilt(log()), log())]
    assert rms[0] < 1.5 * rms[1]


def test_a_leg_that_moved_is_another_and_one_wrong_window_is_left_out() -> None:
    """Along the true path: nothing is refused; one wrong window is; from a second one on in a row the leg is new."""
    plain, *_ = fed(log(), config())
    assert plain.refused == 0
    problem, _ = prepared(log(), config())
    windows, points = Windows.of(problem), log().lidar_points
    w = len(windows.centre) // 2
    for count in (1, 3):
        range_m = points.range_m.copy()
        range_m[windows.row[w] : windows.row[w + count]] += 1.0
        given = replace(log(), lidar_points=points.replace(range_m=range_m))
        spoilt, *_ = fed(given, config())
        assert 0 < spoilt.refused <= (1 if count == 1 else 2) * 4
        assert (spoilt.variables > plain.variables) == (count == 3)


# how it is fed ------------------------------------------------------------------------------------------------


def test_few_legs_are_followed_as_long_as_they_are_in_view() -> None:
    """All of a window's where that many are asked for; of few each is tied to many keyframes."""
    few, graph, _ = fed(log(), config(legs_followed=4))
    every, *_ = fed(log(), config(legs_followed=1000))
    windows = len(few.windows.centre)
    assert few.readings <= 5 * windows
    assert every.readings > 10 * windows
    of_leg: dict[int, int] = {}
    for k in range(graph.size()):
        keys = graph.at(k).keys()
        if len(keys) == 3:
            of_leg[keys[1]] = of_leg.get(keys[1], 0) + 1
    assert len(of_leg) == few.variables
    assert np.median(list(of_leg.values())) > 10


def test_no_variable_gathers_factors_without_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("graphnav.solvers.incremental_legs._READINGS", 30)
    sizes: dict[int, int] = {}
    update = incremental._Session.update

    def counted(self: incremental._Session, i: int, relinearize: bool) -> None:
        for k in range(self.pending.size()):
            for key in self.pending.at(k).keys():
                sizes[key] = sizes.get(key, 0) + 1
        update(self, i, relinearize)

    monkeypatch.setattr(incremental._Session, "update", counted)
    result = passed(log(), config())
    ours = {key: n for key, n in sizes.items() if chr(key >> 56) in "ld"}
    assert max(ours.values()) < 30 + 20
    assert sum(chr(key >> 56) == "d" for key in ours) > 10
    # and the whole graph gets none of them
    assert not any(chr(key >> 56) in "ld" for key in result.values.keys())


def test_a_survey_counts_once() -> None:
    """One prior at the surveyed place, however often the leg is out of view in between."""
    number = int(log().lidar_points.feature[0])
    mark = Landmark(feature=number, pos_n_m=np.array([1.0, 2.0, 3.0]), sigma_m=0.05)
    given = replace(log(), lidar=log().lidar.replace(landmark=(mark,)))
    _, graph, _ = fed(given, config(leg_gap_s=0.0))
    priors = [graph.at(k) for k in range(graph.size())]
    surveyed = [f for f in priors if isinstance(f, gtsam.PriorFactorVector) and np.allclose(f.prior()[:2], [1.0, 2.0])]
    assert len(surveyed) == 1


def test_window_by_window_is_the_same_as_all_at_once() -> None:
    """Same readings along one path, to what the velocities at its keyframes make of it between them."""
    problem, data = prepared(log(), config())
    start, _ = initial_.start_state(problem)
    values = initial_values(problem, data, start)
    whole = condense(problem, values, data.gyro_bias_b, data.accel_bias_b)
    windows = Windows.of(problem)
    assert windows.row[0] == 0 and windows.row[-1] == len(log().lidar_points)
    poses = [values.atPose3(X(i)).matrix() for i in range(len(problem.keyframe_s))]
    feed = LegFeed(problem, data)

    class Given:
        theta = values

        def pose(self, i: int) -> np.ndarray:
            return poses[i]

    feed.problem = replace(problem, config=config(legs_followed=1000))
    for w in range(0, len(windows.centre), 10):
        part, rows = feed._condensed(w, Given()), whole.keyframe == windows.centre[w]
        order = np.argsort(whole.feature[whole.leg[rows]])
        assert np.array_equal(part.feature, whole.feature[whole.leg[rows]][order])
        assert np.array_equal(part.count, whole.count[rows][order])
        assert np.abs(part.range_m - whole.range_m[rows][order]).max() < 3e-3
        assert np.abs(part.angle_rad - whole.angle_rad[rows][order]).max() < 1e-3
        assert part.sigma == pytest.approx(whole.sigma[rows][order], rel=1e-4)
