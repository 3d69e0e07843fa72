"""The limit: the posterior Cramer-Rao bound of the graph, linearised at the truth.

No estimator that is given the log's measurements and priors has, on average over their errors, a smaller mean-square
error than the inverse of the information matrix at the true states (H. Van Trees, Detection, Estimation and Modulation
Theory, Part I, 1968, section 2.4). Poses and velocities are taken from the truth table. Biases, calibrations, creep and
the places of LiDAR legs, which no log records, are their best estimates given the true poses: close enough, for the
Jacobians change with them in second order only. Detections of legs are brought together along the true path.

One log is one draw of the errors: its rms over the bound scatters about 1 from log to log even for a perfect
estimator. Mean squares over many seeds tell (`benchmarks/accuracy.py`).
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from factors.known import jacobian_factor
from factors.so3 import Array, from_quaternion
from graphnav import _metrics as metrics
from graphnav._stages import ProgressHook, Stages
from graphnav.config import Config
from graphnav.errors import ConfigError, GraphnavError
from graphnav.evaluation import evaluate
from graphnav.graph import SmoothingGraph, build_graph
from graphnav.leg_advances import leg_advances
from graphnav.legs import LegReadings, condense
from graphnav.limits import Bound
from graphnav.log import SensorLog, Truth
from graphnav.outcome import covariances, estimated_biases, smoothed_trajectory
from graphnav.preintegration import preintegrate
from graphnav.problem import L, Problem, V, X
from graphnav.range_clock import estimates_clock, moved, with_offset
from graphnav.ranges import RangeReadings, range_readings
from graphnav.smooth import posed
from graphnav.solution import solve_batch
from graphnav.solved import Solved
from graphnav.solvers.batch import BatchResult
from graphnav.solvers.elimination import eliminate, elimination
from graphnav.trajectory import Trajectory

if TYPE_CHECKING:
    from collections.abc import Callable

    import gtsam

    from factors.advance import AdvanceFamily

#: Gauss-Newton steps for what no log records; the problem in it is close to linear, less so with legs.
_STEPS, _STEPS_WITH_LEGS = 2, 4


def bound(log: SensorLog | str | Path, config: Config | None = None, progress: ProgressHook | None = None) -> Bound:
    """The posterior Cramer-Rao bound of a log with truth, beside what the batch smoother achieves on it.

    Parameters
    ----------
    log : a `SensorLog` with truth, or the folder of one; the smoother is not shown its truth.
    config : choices of method: keyframes, and which measurements take part.
    progress : called as ``progress(stage, done, total)``.

    Raises
    ------
    GraphnavError : no truth, or truth that leaves out a keyframe.
    LogError, ConfigError, SolveError : as from `graphnav.smooth`.
    """
    if not isinstance(log, SensorLog):
        from graphnav.readers import read

        log = read(log)
    config = Config.given(config)
    if config.closed_path.form == "absolute":
        raise ConfigError(
            'closed_path.form = "absolute" counts the same measurements twice and has no bound; use "relative"'
        )
    if log.truth is None:
        raise GraphnavError(f"log {log.name} has no truth table to linearise at; add truth.parquet or truth.csv")
    stages = Stages(progress)
    problem = posed(replace(log, truth=None), config, stages)
    pos, quat, vel = _true_states(log.name, log.truth, problem.keyframe_s)
    solved = solve_batch(problem, stages)
    estimate = smoothed_trajectory(problem, solved.result.values, None)
    solved.result = replace(solved.result, bayes_tree=None)  # large, and another one follows
    with stages.stage("covariance") as tick:
        values = _with_states(problem, solved.result.values, pos, quat, vel)
        limit = _at_truth(problem, solved, values, tick)
    return Bound(log.name, limit, evaluate(estimate, log))


def _true_states(name: str, truth: Truth, t_s: Array) -> tuple[Array, Array, Array]:
    """Positions, quaternions and velocities at the keyframes, all of which truth must cover."""
    known, pos, quat, vel = metrics.truth_states(truth, t_s)
    if not known.all():
        raise GraphnavError(
            f"log {name}: truth covers {truth.t_s[0]:.3f} to {truth.t_s[-1]:.3f} s and {int(known.sum())} of"
            f" {len(t_s)} keyframes, the bound needs all (first without: {t_s[~known][0]:.3f} s);"
            " cut the log to the span of its truth"
        )
    return pos, quat, vel


def _with_states(problem: Problem, values: gtsam.Values, pos: Array, quat: Array, vel: Array) -> gtsam.Values:
    """The values with the given poses and velocities in place of the estimates."""
    import gtsam

    placed = gtsam.Values(values)
    rotation = from_quaternion(quat)
    for i in range(len(problem.keyframe_s)):
        placed.update(X(i), gtsam.Pose3(gtsam.Rot3(rotation[i]), pos[i]))
        placed.update(V(i), vel[i])
    return placed


def _along(problem: Problem, solved: Solved, values: gtsam.Values) -> tuple[LegReadings | None, AdvanceFamily | None]:
    """Readings of legs along the poses in `values` and their advances; places are added to `values`. None without legs.

    What the smoother found to disagree is no measurement of the model, and is left out here too.
    """
    if solved.legs is None:
        return None, None
    readings = condense(problem, values, *estimated_biases(problem, values))
    advances = leg_advances(problem, readings, values)
    if solved.legs_left_out is not None:
        out = set(_named(solved.legs_left_out))
        readings = readings.only(np.array([named not in out for named in _named(readings)], bool))
    j = 0
    while values.exists(L(j)):
        values.erase(L(j))
        j += 1
    for j, place_n in enumerate(readings.place_n):
        values.insert(L(j), np.array([place_n[0], place_n[1], 0.0, 0.0]))
    return readings, advances


def _named(readings: LegReadings) -> list[tuple[int, int]]:
    """Keyframe and feature number of every reading."""
    return list(zip(readings.keyframe.tolist(), readings.feature[readings.leg].tolist(), strict=True))


def _ranges(problem: Problem, solved: Solved, values: gtsam.Values) -> RangeReadings | None:
    """The ranges that the smoother used, carried with the biases in `values`, at the times that it found."""
    problem = moved(problem, solved.clock)
    readings = range_readings(problem, *estimated_biases(problem, values))
    if readings is not None and estimates_clock(problem):
        readings = with_offset(problem, readings, smoothed_trajectory(problem, values, None))
    if readings is None or solved.ranges_left_out is None:
        return readings
    return readings.only(~np.isin(readings.row, solved.ranges_left_out.row))


def _graph(
    problem: Problem,
    solved: Solved,
    values: gtsam.Values,
    legs: LegReadings | None,
    advances: AdvanceFamily | None,
) -> SmoothingGraph:
    """The problem, preintegrated at the biases in `values`."""
    data = preintegrate(problem, *estimated_biases(problem, values))
    graph = build_graph(problem, data, legs, advances, _ranges(problem, solved, values), solved.camera)
    lidar = problem.log.lidar
    return graph if legs is None or lidar is None else graph.only_legs(legs, lidar)


def _at_truth(
    problem: Problem, solved: Solved, values: gtsam.Values, tick: Callable[[float, float], None] | None
) -> Trajectory:
    """The states of `values` with the inverse information as their covariance, all else at its best given them."""
    legs, advances = _along(problem, solved, values)
    graph = _graph(problem, solved, values, legs, advances)
    for _ in range(_STEPS if legs is None else _STEPS_WITH_LEGS):
        values = values.retract(_rest_given_states(graph.linearize(values), values))
    graph = _graph(problem, solved, values, legs, advances)
    tree, order = elimination(graph.condensed(values)[0], graph.chain)
    blocks = covariances(problem, BatchResult(values, tree, (), True, order), tick)
    return replace(smoothed_trajectory(problem, values, blocks), bridge=None)


def _rest_given_states(linear: gtsam.GaussianFactorGraph, values: gtsam.Values) -> gtsam.VectorValues:
    """Gauss-Newton step of all but poses and velocities, which are held: their columns dropped."""
    import gtsam

    reduced, sizes = gtsam.GaussianFactorGraph(), values.zeroVectors()
    for k in range(linear.size()):
        factor = linear.at(k)
        keys = factor.keys()
        if all(_is_state(key) for key in keys):
            continue
        matrix, right = factor.jacobian()
        left, blocks, at = list[int](), list[Array](), 0
        for key in keys:
            end = at + len(sizes.at(key))
            if not _is_state(key):
                left.append(key)
                blocks.append(matrix[:, at:end])
            at = end
        reduced.push_back(jacobian_factor(left, blocks, -right))
    return eliminate(reduced, gtsam.Ordering.ColamdGaussianFactorGraph(reduced)).optimize()


def _is_state(key: int) -> bool:
    return chr(key >> 56) in "xv"


class _CallableModule(ModuleType):
    """Module and function share the name ``graphnav.bound``: see `graphnav._PUBLIC`."""

    def __call__(
        self, log: SensorLog | str | Path, config: Config | None = None, progress: ProgressHook | None = None
    ) -> Bound:
        """See `bound`."""
        return bound(log, config, progress)


sys.modules[__name__].__class__ = _CallableModule
