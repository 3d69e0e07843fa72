"""Solving rounds of ranges: their variables beside the others, and their clock before outliers are looked for."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from graphnav._stages import Stages
from graphnav.graph import build_graph
from graphnav.outcome import smoothed_trajectory
from graphnav.preintegration import Preintegrated
from graphnav.problem import Problem, RangeClock, T
from graphnav.range_clock import estimates_clock, moved, offset_in, settled, with_offset
from graphnav.ranges import RangeReadings, RangeStates, range_readings, uses_ranges
from graphnav.solvers import batch
from graphnav.solvers.elimination import eliminated_last
from graphnav.trajectory import Trajectory

if TYPE_CHECKING:
    import gtsam

#: Times that ranges are moved before outliers are looked for, iterations and joint sigmas of each rough solution.
_CLOCK_ROUNDS, _CLOCK_ITERATIONS, _CLOCK_SIGMAS = 6, 10, 0.1


def posed_ranges(
    problem: Problem, data: Preintegrated, values: gtsam.Values, along: Trajectory | None = None
) -> RangeReadings | None:
    """UWB ranges, whose variables are added to the values; `along` : a path, where their time offset is one."""
    readings = range_readings(problem, data.gyro_bias_b, data.accel_bias_b)
    if readings is not None:
        if estimates_clock(problem):
            readings = with_offset(problem, readings, along)
        RangeStates.of(problem, readings).insert(problem, values)
    return readings


def on_the_clock(
    problem: Problem, stages: Stages, data: Preintegrated, values: gtsam.Values
) -> tuple[Problem, gtsam.Values]:
    """The problem with its ranges moved by their time offset, where that is asked for, and values that go with it.

    All ranges take part, with Huber's loss where outliers are looked for: at a wrong time many look like one. The path
    along which the tag's velocity is taken comes from a first solution without an offset.
    """
    config = problem.config.uwb
    if not (uses_ranges(problem) and estimates_clock(problem)):
        return problem, values
    along: Trajectory | None = None
    for _ in range(_CLOCK_ROUNDS):
        with stages.stage("assemble"):
            graph = build_graph(problem, data, ranges=posed_ranges(problem, data, values, along))
            if graph.ranges is not None and config.loss != "none":
                graph = replace(graph, ranges=replace(graph.ranges, loss="huber", scale=config.loss_sigmas))
        with stages.stage("solve"):
            values = batch.solve(
                graph, values, max_iterations=_CLOCK_ITERATIONS, tolerance_sigma=_CLOCK_SIGMAS, exact=False
            ).values
            root, _ = eliminated_last(graph.linearize(values), T(0))
        clock = RangeClock(offset_in(values), 1 / root)
        done = along is not None and settled(problem.clock, clock)
        problem, along = moved(problem, clock), smoothed_trajectory(problem, values, None)
        if done:
            break
    return problem, values
