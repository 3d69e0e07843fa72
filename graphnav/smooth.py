"""The pipeline: a recorded log in, the best trajectory it supports out, with covariances.

Frontend (cycles, closed path, rest, keyframes) - assemble (preintegration, factors, dead-reckoned initial values) -
solve (batch or iSAM2) - covariances.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from factors.so3 import Array, to_quaternion
from graphnav._memory import peak_bytes, release
from graphnav.config import Config
from graphnav.errors import ConfigError, SolveError
from graphnav.frontends.rest import rest_spans
from graphnav.frontends.units import refuse_wrong_units
from graphnav.graph import build_factors, build_graph
from graphnav.initial import States, initial_values, start_state
from graphnav.keyframes import run_frontend
from graphnav.log import SensorLog
from graphnav.outcome import calibration, covariances, estimated_biases, smoothed_trajectory, warnings
from graphnav.preintegration import Preintegrated, preintegrate
from graphnav.problem import Problem, pose_problem
from graphnav.run import Diagnostics, Run
from graphnav.solvers import absolute, batch, incremental
from graphnav.trajectory import Trajectory

if TYPE_CHECKING:
    from collections.abc import Iterator

    import gtsam

METHODS = ("batch", "isam2")

ProgressHook = Callable[[str, float, float], None]


class _Stages:
    """Seconds per stage, and progress passed on with the stage's name."""

    def __init__(self, hook: ProgressHook | None) -> None:
        self.hook = hook
        self.began = time.perf_counter()
        self.seconds = dict.fromkeys(("read", "frontend", "assemble", "solve", "covariance"), 0.0)

    @contextmanager
    def stage(self, name: str) -> Iterator[Callable[[float, float], None] | None]:
        began = time.perf_counter()
        hook = self.hook
        if hook is None:
            yield None
        else:
            hook(name, 0, 1)
            yield lambda done, total: hook(name, done, total)
            hook(name, 1, 1)
        self.seconds[name] += time.perf_counter() - began

    def total(self) -> dict[str, float]:
        return {**self.seconds, "total": time.perf_counter() - self.began}


def smooth(
    log: SensorLog | str | Path,
    config: Config | None = None,
    method: str = "batch",
    progress: ProgressHook | None = None,
) -> Run:
    """Smooth a recorded log.

    Parameters
    ----------
    log : a `SensorLog`, or the folder of one.
    config : choices of method; None for the defaults.
    method : "batch" or "isam2".
    progress : called as ``progress(stage, done, total)``.

    Returns
    -------
    Run, converged and complete.

    Raises
    ------
    LogError, ConfigError : bad input.
    SolveError : the problem is singular or did not converge; nothing is returned half done.
    """
    if method not in METHODS:
        raise ConfigError(f'unknown method "{method}"; known: {", ".join(METHODS)}')
    config = config or Config()
    stages = _Stages(progress)
    with stages.stage("read"):
        if not isinstance(log, SensorLog):
            from graphnav.readers import read

            log = replace(read(log), truth=None)
    with stages.stage("frontend"):
        rest = rest_spans(log)
        refuse_wrong_units(log, rest)
        frontend = run_frontend(log, config, rest)
        problem = pose_problem(log, config, frontend)
    solver = _solve_batch if method == "batch" else _solve_isam2
    solved = solver(problem, stages)
    if not solved.result.converged:
        last = solved.result.iterations[-1]
        raise SolveError(
            f"not converged after {len(solved.result.iterations)} iterations (last step {last.step_sigmas:.3g} sigma);"
            " raise batch.max_iterations, or check the log's sigmas"
        )
    with stages.stage("covariance") as tick:
        blocks = covariances(problem, solved.result, tick) if config.covariance else None
        # half a gigabyte for a shift, and of no further use
        solved.result = replace(solved.result, bayes_tree=None)
    return _report(problem, solved, blocks, method, stages)


class _Solved:
    """A solver's outcome: whether the biases still moved at the end, and the causal states of an incremental one."""

    def __init__(self, result: batch.BatchResult, biases_moved: bool) -> None:
        self.result, self.biases_moved = result, biases_moved
        self.causal: States | None = None


def _solve_batch(problem: Problem, stages: _Stages) -> _Solved:
    """Batch smoothing from dead reckoning."""
    with stages.stage("assemble") as tick:
        start, gyro_bias = start_state(problem)
        data = _preintegrate(problem, gyro_bias, np.zeros(3), tick)
        values = initial_values(problem, data, start)
    return _solve_rounds(problem, stages, data, values, [])


def _solve_isam2(problem: Problem, stages: _Stages) -> _Solved:
    """iSAM2 through the keyframes, then batch iterations from its estimate: its thresholds leave millimetres behind."""
    with stages.stage("assemble") as tick:
        start, gyro_bias = start_state(problem)
        data = _preintegrate(problem, gyro_bias, np.zeros(3), tick)
        factors = build_factors(problem, data)
    with stages.stage("solve") as tick:
        passed = incremental.solve(problem, data, factors, start, problem.config.isam2, tick)
        del factors
    solved = _solve_rounds(problem, stages, data, passed.values, passed.predicted)
    solved.causal = passed.causal
    return solved


def _solve_rounds(
    problem: Problem,
    stages: _Stages,
    data: Preintegrated,
    values: gtsam.Values,
    predicted: list[gtsam.NonlinearFactor],
) -> _Solved:
    """Solve; where the biases moved too far for first-order correction, preintegrate at the better ones and repeat.

    Parameters
    ----------
    data, values : condensed sensor data and the values to start from.
    predicted : absolute closed-path priors that iSAM2 made on its way; batch makes its own where there are none.
    """
    config = problem.config.batch
    history: list[batch.Iteration] = []
    for round_ in range(config.bias_move_rounds):
        with stages.stage("assemble"):
            graph = build_graph(problem, data)
            for factor in predicted:
                graph.native.add(factor)
        with stages.stage("solve") as tick:
            result = batch.solve(
                graph,
                values,
                max_iterations=config.max_iterations,
                tolerance_sigma=config.tolerance_sigma,
                progress=tick,
            )
            if problem.config.closed_path.form == "absolute" and not predicted:
                result = absolute.solve_cycle_by_cycle(problem, graph, result)
        history += result.iterations
        gyro, accel = estimated_biases(problem, result.values)
        moved = biases_moved(problem, data, gyro, accel)
        if not moved or not result.converged or round_ == config.bias_move_rounds - 1:
            break
        with stages.stage("assemble") as tick:
            data = _preintegrate(problem, gyro, accel, tick)
            values = result.values
    result = batch.BatchResult(result.values, result.bayes_tree, tuple(history), result.converged, result.order)
    return _Solved(result, moved)


def _preintegrate(
    problem: Problem, gyro: Array, accel: Array, progress: Callable[[float, float], None] | None
) -> Preintegrated:
    """Preintegrate, and let go of the raw samples' memory: the solve needs it."""
    data = preintegrate(problem, gyro, accel, progress)
    samples, imu = problem.imu.samples, problem.log.imu
    release(samples.edge_s, samples.gyro_b, samples.accel_b, imu.t_s if imu is not None else None)
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


def _report(problem: Problem, solved: _Solved, blocks: dict[int, Array] | None, method: str, stages: _Stages) -> Run:
    values, count = solved.result.values, len(problem.keyframe_s)
    trajectory = smoothed_trajectory(problem, values, blocks)
    causal = None
    if solved.causal is not None:
        c = solved.causal
        causal = Trajectory(problem.keyframe_s, c.pos_n, to_quaternion(c.rotation_nb), c.vel_n)
    history = [dict(vars(step)) for step in solved.result.iterations]
    diagnostics = Diagnostics(
        method=method,
        converged=solved.result.converged,
        iterations=len(history),
        keyframes=count,
        seconds=stages.total(),
        peak_rss_mb=peak_bytes() / 1e6,
        warnings=warnings(problem, solved.biases_moved),
        history=history,
    )
    return Run(trajectory, calibration(problem, values, blocks), diagnostics, problem.config, causal)


class _CallableModule(ModuleType):
    """Module and function share the name ``graphnav.smooth``: see `graphnav._PUBLIC`."""

    def __call__(
        self,
        log: SensorLog | str | Path,
        config: Config | None = None,
        method: str = "batch",
        progress: ProgressHook | None = None,
    ) -> Run:
        """See `smooth`."""
        return smooth(log, config, method, progress)


sys.modules[__name__].__class__ = _CallableModule
