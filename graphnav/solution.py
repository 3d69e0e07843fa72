"""Solving a posed problem as a graph: condense the sensors, start from dead reckoning, and solve in rounds."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np

from factors.position import position_factor
from graphnav._stages import Stages
from graphnav.anchor_doubt import ContradictionError, Doubt, doubted
from graphnav.costs import suspecting
from graphnav.errors import SolveError
from graphnav.frontends.range_epochs import is_unknown, start_position
from graphnav.graph import build_factors, build_graph
from graphnav.initial import States, initial_values, start_state
from graphnav.legs import uses_legs
from graphnav.motions import guiding_readings
from graphnav.native_factors import FactorAt
from graphnav.preintegration import Preintegrated
from graphnav.problem import Problem, X
from graphnav.range_rounds import posed_ranges
from graphnav.ranges import range_readings, uses_ranges
from graphnav.rival_paths import rival_path
from graphnav.rounds import posed_camera, preintegrated, solved_in_rounds
from graphnav.solved import Solved
from graphnav.solvers import batch, incremental

if TYPE_CHECKING:
    import gtsam

#: Joint sigmas at which a path is good enough to bring readings of legs together along it.
_ROUGH_SIGMAS = 1000.0


def solve_batch(problem: Problem, stages: Stages) -> Solved:
    """Batch smoothing from dead reckoning."""
    with stages.stage("assemble") as tick:
        start, gyro_bias = start_state(problem)
        data = preintegrated(problem, gyro_bias, np.zeros(3), tick)
        values = initial_values(problem, data, start)
    if uses_ranges(problem) and problem.has_calibration and not is_unknown(problem.initial):
        values = _roughly(problem, stages, data, values, ranges=False)
    if uses_legs(problem):
        values = _roughly(problem, stages, data, values)
    return _solve_rounds(problem, stages, data, values, [])


def _roughly(
    problem: Problem, stages: Stages, data: Preintegrated, values: gtsam.Values, ranges: bool = True
) -> gtsam.Values:
    """Roughly what is said without legs, and without ranges where these are not wanted.

    Readings of legs are brought together along a path right over a few seconds. An odometer whose scale is not yet
    known leads metres aside, where ranges to anchors near one plane put the machine on its other side.
    """
    with stages.stage("assemble"):
        heard = posed_ranges(problem, data, values) if ranges else None
        graph = build_graph(problem, data, ranges=heard, camera=posed_camera(problem, values))
    with stages.stage("solve"), suspecting(graph):
        most = problem.config.batch.max_iterations
        return batch.solve(graph, values, max_iterations=most, tolerance_sigma=_ROUGH_SIGMAS, exact=False).values


def solve_isam2(problem: Problem, stages: Stages) -> Solved:
    """iSAM2 through the keyframes, then batch iterations from its estimate: its thresholds leave millimetres behind."""
    with stages.stage("assemble") as tick:
        start, gyro_bias = start_state(problem)
        data = preintegrated(problem, gyro_bias, np.zeros(3), tick)
        ranges = range_readings(problem, data.gyro_bias_b, data.accel_bias_b)
        factors = _near_the_start(problem, start) + build_factors(problem, data, ranges, guiding_readings(problem))
    with stages.stage("solve") as tick:
        passed = incremental.solve(problem, data, factors, start, problem.config.isam2, tick)
        del factors
    # legs are condensed along the same path as in batch: where it is another one, so is the result, by up to a sigma
    values = _roughly(problem, stages, data, passed.values) if uses_legs(problem) else passed.values
    solved = _solve_rounds(problem, stages, data, values, passed.predicted)
    solved.causal = passed.causal
    return solved


def _near_the_start(problem: Problem, start: States) -> list[FactorAt]:
    """On iSAM2's way alone: the position that ranges gave at the start, where the log declares none.

    Steps along what the first few ranges leave open are not controlled, and anchors near one plane have two solutions.
    At three sigmas it counts the ranges of the start a ninth more; the batch iterations do without it.
    """
    if not (is_unknown(problem.initial) and problem.frontend.ranging):
        return []
    first, rest = float(problem.keyframe_s[0]), problem.frontend.rest_s
    pos, cov = start_position(problem.log, start.rotation_nb[0], first, rest)
    return [FactorAt(0, position_factor(X(0), pos, 3 * np.sqrt(np.diag(cov))))]


def _solve_rounds(
    problem: Problem,
    stages: Stages,
    data: Preintegrated,
    values: gtsam.Values,
    predicted: list[gtsam.NonlinearFactor],
) -> Solved:
    """Solve; where ranges contradict each other or fit more than one path, see to that."""
    import gtsam

    if not uses_ranges(problem) or problem.config.uwb.loss == "none":
        return solved_in_rounds(problem, stages, data, values, predicted)
    began = gtsam.Values(values)
    try:
        solved = solved_in_rounds(problem, stages, data, values, predicted, wary=True)
    except (ContradictionError, SolveError) as error:
        doubt = doubted(problem, stages, data, gtsam.Values(began))
        if doubt.problem is None and not isinstance(error, ContradictionError):
            raise
        return _despite(problem, stages, data, began, predicted, doubt)
    return _likeliest(problem, stages, data, began, predicted, solved)


def _despite(
    problem: Problem,
    stages: Stages,
    data: Preintegrated,
    values: gtsam.Values,
    predicted: list[gtsam.NonlinearFactor],
    doubt: Doubt,
) -> Solved:
    """Ranges that contradict each other: with the constant of the only anchor that explains it free, or as they are."""
    if doubt.problem is None or doubt.values is None:
        solved = solved_in_rounds(problem, stages, data, values, predicted)
    else:
        solved = solved_in_rounds(doubt.problem, stages, data, doubt.values, predicted)
    solved.doubt = doubt
    return solved


def _likeliest(
    problem: Problem,
    stages: Stages,
    data: Preintegrated,
    began: gtsam.Values,
    predicted: list[gtsam.NonlinearFactor],
    solved: Solved,
) -> Solved:
    """The solution, or a path apart from it that ranges fit better; with that which they fit as well."""
    if not solved.result.converged:
        return solved
    rival = rival_path(problem, stages, data, began, solved.result.values)
    if rival is not None and rival.better > 0:
        with suppress(SolveError):  # the solution that there is stands, and the other is told beside it
            again = solved_in_rounds(problem, stages, data, rival.values, predicted)
            solved = again if again.result.converged else solved
    solved.rival = rival
    return solved
