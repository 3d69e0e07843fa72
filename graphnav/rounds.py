"""Solving in rounds: bring readings together, leave out what disagrees, and repeat where the biases moved too far."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from factors.so3 import Array
from graphnav._memory import release
from graphnav._stages import Stages
from graphnav.agreement import agreeing_camera, agreeing_ranges
from graphnav.anchor_doubt import ContradictionError, contradicting
from graphnav.camera import Camera, camera_readings
from graphnav.camera_clock import CLOCK_ROUNDS, camera_later, camera_settled, on_its_clock, unknown_clock
from graphnav.camera_score import camera_score
from graphnav.costs import parted, suspecting, suspects
from graphnav.graph import SmoothingGraph, build_graph
from graphnav.leg_advances import leg_advances
from graphnav.leg_agreement import agreeing
from graphnav.legs import LegReadings, condense, uses_legs
from graphnav.outcome import estimated_biases, smoothed_trajectory
from graphnav.preintegration import Preintegrated, preintegrate
from graphnav.problem import D, L, Problem, T
from graphnav.range_clock import clock_score, estimates_clock, moved, offset_in, settled
from graphnav.range_rounds import on_the_clock, posed_ranges
from graphnav.solved import Said, Solved
from graphnav.solvers import absolute, batch

if TYPE_CHECKING:
    import gtsam


#: Iterations after which readings of legs that contradict each other are looked for: they slow convergence down.
_COMPROMISE = 10


def solved_in_rounds(
    problem: Problem,
    stages: Stages,
    data: Preintegrated,
    values: gtsam.Values,
    predicted: list[gtsam.NonlinearFactor],
    wary: bool = False,
) -> Solved:
    """Solve; where the biases moved too far for first-order correction, preintegrate at the better ones and repeat.

    Parameters
    ----------
    data, values : condensed sensor data and the values to start from.
    predicted : absolute closed-path priors that iSAM2 made on its way; batch makes its own where there are none.
    wary : whether to stop where ranges contradict each other.

    Raises
    ------
    ContradictionError : they do.
    """
    rounds = problem.config.batch.bias_move_rounds
    rounds = max(rounds, CLOCK_ROUNDS) if unknown_clock(problem) else rounds
    problem, values = on_the_clock(problem, stages, data, values)
    history: list[batch.Iteration] = []
    for round_ in range(rounds):
        # what an earlier round left out may agree along a better path
        with stages.stage("assemble"):
            later_s = camera_later(values)
            graph, said = _assembled(problem, data, values, predicted)
        with stages.stage("solve") as tick, suspecting(graph):
            graph, said, values = _in_agreement(problem, graph, said, values, wary)
            graph, said, result = _with_legs_in_agreement(problem, graph, said, values, bool(predicted), tick)
        history += result.iterations
        gyro, accel = estimated_biases(problem, result.values)
        clock = replace(problem.clock, later_s=offset_in(result.values))
        better, clock_moved = biases_moved(problem, data, gyro, accel), not settled(problem.clock, clock)
        late = not camera_settled(later_s, camera_later(result.values))
        if not (better or clock_moved or late) or not result.converged or round_ == rounds - 1:
            break
        with stages.stage("assemble") as tick:
            data = preintegrated(problem, gyro, accel, tick) if better else data
            problem, values = moved(problem, clock), result.values
    with stages.stage("solve"):
        told = _told(problem, graph, said, result)
    return Solved(
        **vars(said), **told, result=replace(result, iterations=tuple(history)), data=data,
        biases_moved=better, clock_moved=clock_moved, camera_late=late, clock=problem.clock,
    )  # fmt: skip


def _assembled(
    problem: Problem, data: Preintegrated, values: gtsam.Values, predicted: list[gtsam.NonlinearFactor]
) -> tuple[SmoothingGraph, Said]:
    """The graph of all that was measured, as it looks from `values`, to which variables are added."""
    along = smoothed_trajectory(problem, values, None) if values.exists(T(0)) else None
    legs = leg_readings(problem, data, values)
    advances = None if legs is None else leg_advances(problem, legs, values)
    said = Said(
        legs=legs, advances=advances, ranges=posed_ranges(problem, data, values, along),
        camera=posed_camera(problem, values),
    )  # fmt: skip
    graph = build_graph(problem, data, legs, advances, said.ranges, said.camera)
    for factor in predicted:
        graph.native.add(factor)
    return graph, said


def _in_agreement(
    problem: Problem, graph: SmoothingGraph, said: Said, values: gtsam.Values, wary: bool
) -> tuple[SmoothingGraph, Said, gtsam.Values]:
    """Without ranges, and what a camera saw, that disagree with all else; and values near the solution."""
    ranges, camera = said.ranges, said.camera
    if ranges is not None and problem.config.uwb.loss != "none":
        values, fit = agreeing_ranges(graph, problem.config.uwb, values)
        if wary and contradicting(problem, graph, ranges, fit, values):
            raise ContradictionError
        said = replace(said, ranges=ranges.only(fit), ranges_left_out=ranges.only(~fit))
        graph = replace(graph, ranges=ranges.only(fit).family)
    if camera is not None:
        values, camera, left_out = agreeing_camera(graph, problem.config, camera, values)
        said, graph = replace(said, camera=camera, camera_left_out=left_out), graph.seen_by(camera)
    return graph, said, values


def _with_legs_in_agreement(
    problem: Problem,
    graph: SmoothingGraph,
    said: Said,
    values: gtsam.Values,
    predicted: bool,
    progress: Callable[[float, float], None] | None,
) -> tuple[SmoothingGraph, Said, batch.BatchResult]:
    """The solution, after readings of legs that disagree are left out; its iterations are those of both solves."""
    legs, lidar = said.legs, problem.log.lidar
    result = _solved(problem, graph, values, progress, None if legs is None else _COMPROMISE)
    if problem.config.closed_path.form == "absolute" and not predicted:
        result = absolute.solve_cycle_by_cycle(problem, graph, result)
    if legs is None or lidar is None:
        return graph, said, result
    agree = agreeing(graph, legs, lidar, result.values)
    if agree is None:
        values = result.values
    else:  # and start afresh, away from the compromise
        said = replace(said, legs=legs.only(agree), legs_left_out=legs.only(~agree))
        graph = graph.only_legs(legs.only(agree), lidar)
    if agree is not None or not result.converged:
        before = result.iterations
        result = _solved(problem, graph, values, progress)
        result = replace(result, iterations=(*before, *result.iterations))
    return graph, said, result


def _told(problem: Problem, graph: SmoothingGraph, said: Said, result: batch.BatchResult) -> dict[str, Any]:
    """What the solution says of what is no variable of it, and where it is none, what stands out."""
    if not result.converged:
        apart = parted((said.ranges, said.ranges_left_out), (said.camera, said.camera_left_out))
        return {"suspects": suspects(graph, result.values, apart)}
    found: dict[str, Any] = {}
    if said.ranges is not None and not estimates_clock(problem):
        along = smoothed_trajectory(problem, result.values, None)
        found["clock_score"] = clock_score(problem, graph, said.ranges, along, result.values)
    if said.camera is not None:
        found["camera_score"] = camera_score(problem, graph, result.values)
    return found


def _solved(
    problem: Problem,
    graph: SmoothingGraph,
    values: gtsam.Values,
    progress: Callable[[float, float], None] | None,
    iterations: int | None = None,
) -> batch.BatchResult:
    config = problem.config.batch
    # places and leans of legs, bilinear with the height, settle last; spread over all of them that is nothing to any
    legs = 0 if graph.legs is None else len(np.unique(graph.legs.leg_key))
    return batch.solve(
        graph,
        values,
        max_iterations=min(config.max_iterations, iterations or config.max_iterations),
        tolerance_sigma=config.tolerance_sigma * float(np.sqrt(1 + legs)),
        first=graph.chain,
        progress=progress,
    )


def leg_readings(problem: Problem, data: Preintegrated, values: gtsam.Values) -> LegReadings | None:
    """LiDAR readings condensed at the poses in `values`, to which the legs' places and the calibration are added."""
    if not uses_legs(problem):
        return None
    readings = condense(problem, values, data.gyro_bias_b, data.accel_bias_b)
    if not values.exists(D(0)):
        values.insert(D(0), np.zeros(8))
    for j, place_n in enumerate(readings.place_n):
        if not values.exists(L(j)):
            values.insert(L(j), np.array([place_n[0], place_n[1], 0.0, 0.0]))
    return readings


def posed_camera(problem: Problem, values: gtsam.Values) -> Camera | None:
    """What the camera says, whose variables are added to the values."""
    camera = camera_readings(problem)
    if camera is None:
        return None
    camera.insert(problem, values)
    return on_its_clock(problem, camera, values)


def preintegrated(
    problem: Problem, gyro: Array, accel: Array, progress: Callable[[float, float], None] | None
) -> Preintegrated:
    """Preintegrate, and let go of the raw samples' memory: the solve needs it."""
    data = preintegrate(problem, gyro, accel, progress)
    problem.imu.release()
    release(problem.log.imu.t_s if problem.log.imu is not None else None)
    return data


def biases_moved(problem: Problem, data: Preintegrated, gyro: Array, accel: Array) -> bool:
    """Whether the estimates left the range where first-order bias correction is exact enough.

    Within a minor interval of length T a gyro bias error turns the force by half of it, an acceleration
    ``g db T / 2``; it must stay below a twentieth of the accelerometer's declared bias, which takes it up as a
    constant. The second-order term over an interval between keyframes of length D, ``g db^2 D^2 / 6``, likewise.
    """
    gyro_moved = np.abs(gyro - data.gyro_bias_b).max()
    accel_moved = np.abs(accel - data.accel_bias_b).max()
    length = float(np.diff(problem.keyframe_s).max())
    gravity = problem.gravity_m_s2
    in_minor = gravity * gyro_moved * problem.minor_s / 2
    between = gravity * gyro_moved**2 * length**2 / 6 + accel_moved * gyro_moved * length
    return bool(max(in_minor, between) > 0.05 * problem.noise.accel_bias)
