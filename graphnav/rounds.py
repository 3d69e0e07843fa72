"""Solving in rounds: bring readings together, leave out what disagrees, and repeat where the biases moved too far."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from factors.advance import AdvanceFamily
from factors.so3 import Array
from graphnav._memory import release
from graphnav._stages import Stages
from graphnav.agreement import agreeing_camera, agreeing_ranges
from graphnav.anchor_doubt import ContradictionError, Doubt, contradicting
from graphnav.camera import Camera, camera_readings
from graphnav.costs import parted, suspects
from graphnav.graph import SmoothingGraph, build_graph
from graphnav.initial import States
from graphnav.leg_advances import leg_advances
from graphnav.leg_agreement import agreeing
from graphnav.legs import LegReadings, condense, uses_legs
from graphnav.mounting_score import MountingScore, mounting_score
from graphnav.outcome import estimated_biases, smoothed_trajectory
from graphnav.preintegration import Preintegrated, preintegrate
from graphnav.problem import D, L, Problem, RangeClock, T
from graphnav.range_clock import ClockScore, clock_score, estimates_clock, moved, offset_in, settled
from graphnav.range_rounds import on_the_clock, posed_ranges
from graphnav.ranges import RangeReadings
from graphnav.rival_paths import Rival
from graphnav.solvers import absolute, batch
from graphnav.trajectory import Trajectory

if TYPE_CHECKING:
    import gtsam


#: Iterations after which readings of legs that contradict each other are looked for: they slow convergence down.
_COMPROMISE = 10


@dataclass
class Solved:
    """A solver's outcome.

    Attributes
    ----------
    result : estimates and their square-root information.
    data : the condensed sensor data that it was solved with.
    biases_moved : whether the biases still moved at the end; clock_moved : whether the time offset of ranges did.
    clock : with which the ranges were carried.
    clock_score : what the ranges say of a time offset that is no variable, or None; mounting_score : what all says of
        the camera's angles that are none.
    suspects : where it did not converge, what of the log stands out.
    legs : the readings of legs that were used, or None; legs_left_out : those that disagreed.
    ranges : the UWB ranges that were used, or None; ranges_left_out : those that disagreed.
    camera : what the camera said that was used, or None; camera_left_out : what disagreed.
    advances : pairs of legs tied by the push of their support, or None.
    causal : the states that an incremental solver knew from the past alone, or None.
    doubt : where ranges contradicted each other, which anchor may be wrong; else None.
    rival : a path that ranges fit as well, or None.
    """

    result: batch.BatchResult
    data: Preintegrated
    biases_moved: bool
    legs: LegReadings | None = None
    legs_left_out: LegReadings | None = None
    ranges: RangeReadings | None = None
    ranges_left_out: RangeReadings | None = None
    camera: Camera | None = None
    camera_left_out: Camera | None = None
    advances: AdvanceFamily | None = None
    causal: States | None = None
    clock_moved: bool = False
    clock: RangeClock = field(default_factory=RangeClock)
    clock_score: ClockScore | None = None
    mounting_score: MountingScore | None = None
    doubt: Doubt | None = None
    rival: Rival | None = None
    suspects: str = ""


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
    config, lidar = problem.config.batch, problem.log.lidar
    problem, values = on_the_clock(problem, stages, data, values)
    along: Trajectory | None = None
    history: list[batch.Iteration] = []
    advances: AdvanceFamily | None = None
    for round_ in range(config.bias_move_rounds):
        left_out = None  # what an earlier round left out may agree along a better path
        with stages.stage("assemble"):
            along = smoothed_trajectory(problem, values, None) if values.exists(T(0)) else None
            readings = leg_readings(problem, data, values)
            advances = None if readings is None else leg_advances(problem, readings, values)
            ranges, ranges_left_out = posed_ranges(problem, data, values, along), None
            camera, camera_left_out = posed_camera(problem, values), None
            graph = build_graph(problem, data, readings, advances, ranges, camera)
            for factor in predicted:
                graph.native.add(factor)
        with stages.stage("solve") as tick:
            if ranges is not None and problem.config.uwb.loss != "none":
                values, fit = agreeing_ranges(graph, problem.config.uwb, values)
                if wary and contradicting(problem, graph, ranges, fit, values):
                    raise ContradictionError
                ranges_left_out, ranges = ranges.only(~fit), ranges.only(fit)
                graph = replace(graph, ranges=ranges.family)
            if camera is not None:
                values, camera, camera_left_out = agreeing_camera(graph, problem.config, camera, values)
                graph = graph.seen_by(camera)
            result = _solved(problem, graph, values, tick, _COMPROMISE if readings is not None else None)
            if problem.config.closed_path.form == "absolute" and not predicted:
                result = absolute.solve_cycle_by_cycle(problem, graph, result)
            history += result.iterations
            if readings is not None and lidar is not None:
                agree = agreeing(graph, readings, lidar, result.values)
                if agree is None:
                    values = result.values
                else:  # and start afresh, away from the compromise
                    left_out, readings = readings.only(~agree), readings.only(agree)
                    graph = graph.only_legs(readings, lidar)
                if agree is not None or not result.converged:
                    result = _solved(problem, graph, values, tick)
                    history += result.iterations
        gyro, accel = estimated_biases(problem, result.values)
        clock = replace(problem.clock, later_s=offset_in(result.values))
        better, clock_moved = biases_moved(problem, data, gyro, accel), not settled(problem.clock, clock)
        if not (better or clock_moved) or not result.converged or round_ == config.bias_move_rounds - 1:
            break
        with stages.stage("assemble") as tick:
            data = preintegrated(problem, gyro, accel, tick) if better else data
            problem, values = moved(problem, clock), result.values
    score = None
    if ranges is not None and not estimates_clock(problem):
        with stages.stage("solve"):
            score = clock_score(
                problem, graph, ranges, smoothed_trajectory(problem, result.values, None), result.values
            )
    sits = None
    if camera is not None and result.converged:
        with stages.stage("solve"):
            sits = mounting_score(problem, graph, result.values)
    apart = parted((ranges, ranges_left_out), (camera, camera_left_out))
    suspected = "" if result.converged else suspects(graph, result.values, apart)
    result = batch.BatchResult(result.values, result.bayes_tree, tuple(history), result.converged, result.order)
    return Solved(
        result, data, better, readings, left_out, ranges, ranges_left_out, camera, camera_left_out, advances,
        clock_moved=clock_moved, clock=problem.clock, clock_score=score, mounting_score=sits, suspects=suspected,
    )  # fmt: skip


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
    if camera is not None:
        camera.insert(problem, values)
    return camera


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
