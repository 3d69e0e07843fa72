"""The pipeline: a recorded log in, the best trajectory it supports out, with covariances.

Frontend (cycles, closed path, rest, keyframes) - then by the method: a factor graph (assemble, solve, covariances), or
a baseline (Kalman filter, RTS smoother, dead reckoning) on the same problem. A log whose motion comes from relative
poses in place of an IMU has a smaller graph of its own (`graphnav.chained`).
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

from factors.so3 import Array, to_quaternion
from graphnav._memory import peak_bytes
from graphnav._stages import ProgressHook, Stages
from graphnav.camera_clock import UNSETTLED
from graphnav.camera_outcome import camera_warnings, disparity_warnings, left_out_counts
from graphnav.camera_score import camera_score_warnings
from graphnav.config import Config
from graphnav.errors import ConfigError, SolveError
from graphnav.frontends.rest import rest_spans
from graphnav.frontends.units import refuse_wrong_units
from graphnav.holes import leg_hole, range_hole
from graphnav.keyframes import run_frontend
from graphnav.log import SensorLog
from graphnav.methods import GRAPH_METHODS, LEG_METHODS, METHODS, STEREO_METHODS, UWB_METHODS
from graphnav.outcome import calibration, covariances, history, leg_warnings, smoothed_trajectory, stops, warnings
from graphnav.problem import Problem, pose_problem
from graphnav.range_outcome import (
    AnchorCount,
    anchor_counts,
    clock_warnings,
    contradictory,
    freed_warning,
    geometry_warnings,
    range_residuals,
    range_warnings,
    rejected,
)
from graphnav.rival_paths import rival_warning
from graphnav.run import Calibration, Diagnostics, RangeResiduals, Run
from graphnav.scanned import with_scanned_legs
from graphnav.sighted import Sighted, with_stereo
from graphnav.solution import solve_batch, solve_isam2
from graphnav.solved import Solved
from graphnav.trajectory import Trajectory


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
    method : one of `graphnav.methods.METHODS`: "batch", "isam2", "rts", "rts-online", "ekf", ...
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
    config = Config.given(config)
    if method in UWB_METHODS and config.uwb.estimate_time_offset:
        raise ConfigError(f"{method} estimates no time offset of ranges: batch and isam2 do, or declare time_offset_s")
    stages = Stages(progress)
    log = _opened(log, stages)
    return replace(_by_method(log, config, method, stages), log_name=log.name)


def _by_method(log: SensorLog, config: Config, method: str, stages: Stages) -> Run:
    if method in ("uwb", "uwb-vbukf"):
        from graphnav.ranged import run_ranges

        return run_ranges(log, config, method, stages)
    config = _looking(config, method, log)
    if method == "stereo":
        from graphnav.stereo_filtered import run_stereo

        return run_stereo(_sighted(log, config, stages, alone=True), config, stages)
    if log.imu is None:
        sighted = _sighted(log, config, stages)
        if sighted.log.relative_pose is not None or sighted.guide is not None:
            from graphnav.chained import run_chain

            return run_chain(sighted, config, method, stages)
    problem = _posed(log, config, stages)
    if method in GRAPH_METHODS:
        return _by_graph(problem, method, stages)
    if method in LEG_METHODS:
        from graphnav.leg_filtered import run_leg_filter

        return run_leg_filter(problem, method, stages)
    if method in UWB_METHODS:
        from graphnav.ranged import run_range_filter

        return run_range_filter(problem, method, stages)
    if method in STEREO_METHODS:
        from graphnav.stereo_filtered import run_vio

        return run_vio(problem, method, stages)
    from graphnav.filtered import run_baseline

    return run_baseline(problem, method, stages)


def _looking(config: Config, method: str, log: SensorLog) -> Config:
    """With what the method makes of a stereo camera: nothing but motions, or nothing at all."""
    if method in GRAPH_METHODS or log.imu is None:
        return config
    form = "loose" if method in ("stereo", "vio-kf") else "off"
    return config.model_copy(update={"stereo": config.stereo.model_copy(update={"form": form})})


def posed(log: SensorLog | str | Path, config: Config, stages: Stages) -> Problem:
    """Read and check a log, find cycles and rest, place the keyframes."""
    return _posed(_opened(log, stages), config, stages)


def _posed(log: SensorLog, config: Config, stages: Stages) -> Problem:
    sighted = _sighted(log, config, stages)
    with stages.stage("frontend"):
        rest = rest_spans(log)
        refuse_wrong_units(log, rest)
        log, notes = with_scanned_legs(sighted.log, config)
        frontend = run_frontend(log, config, rest, sighted.guide)
        return pose_problem(log, config, frontend, (*sighted.notes, *notes))


def _sighted(log: SensorLog, config: Config, stages: Stages, *, alone: bool = False) -> Sighted:
    with stages.stage("frontend") as tick:
        return with_stereo(log, config, tick, alone=alone)


def _opened(log: SensorLog | str | Path, stages: Stages) -> SensorLog:
    """The log; one that is read here loses its truth, which is for judging alone."""
    with stages.stage("read"):
        if isinstance(log, SensorLog):
            return log
        from graphnav.readers import read

        return replace(read(log), truth=None)


def _by_graph(problem: Problem, method: str, stages: Stages) -> Run:
    solved = (solve_batch if method == "batch" else solve_isam2)(problem, stages)
    if not solved.result.converged:
        steps = solved.result.iterations
        also = "" if solved.ranges is None else " and the positions of its UWB anchors"
        also += "" if solved.doubt is None else ", whose ranges contradict each other"
        raise SolveError.not_converged(len(steps), steps[-1].step_sigmas, also, solved.suspects)
    with stages.stage("covariance") as tick:
        blocks = covariances(problem, solved.result, tick) if problem.config.covariance else None
        ends = stops(problem, solved.result) if problem.config.covariance else None
        # half a gigabyte for a shift, and of no further use
        solved.result = replace(solved.result, bayes_tree=None)
    return replace(_report(problem, solved, blocks, method, stages), stops=ends)


def _report(problem: Problem, solved: Solved, blocks: dict[int, Array] | None, method: str, stages: Stages) -> Run:
    values, count = solved.result.values, len(problem.keyframe_s)
    trajectory = smoothed_trajectory(problem, values, blocks)
    causal = None
    if solved.causal is not None:
        c = solved.causal
        causal = Trajectory(problem.keyframe_s, c.pos_n, to_quaternion(c.rotation_nb), c.vel_n)
    steps = [dict(vars(step)) for step in solved.result.iterations]
    found = calibration(problem, values, blocks)
    noted = warnings(problem, solved.biases_moved)
    if solved.legs is not None and problem.log.lidar is not None:
        noted += leg_warnings(problem.log.lidar, found, solved.legs, solved.legs_left_out, problem.keyframe_s)
        noted += leg_hole(solved.legs, solved.legs_left_out, problem.keyframe_s, problem.frontend.rest_s)
    of_ranges, counts, residuals = _of_ranges(problem, solved, trajectory, found)
    noted += of_ranges
    left_out = rejected(counts)
    if solved.camera is not None and solved.camera_left_out is not None:
        noted += camera_warnings(problem, solved.camera, solved.camera_left_out)
        noted += camera_score_warnings(solved.camera_score)
        noted += disparity_warnings(problem.log.stereo, found)
        noted += [UNSETTLED] if solved.camera_late else []
        left_out |= left_out_counts(solved.camera_left_out)
    diagnostics = Diagnostics(
        method=method,
        converged=solved.result.converged,
        iterations=len(steps),
        keyframes=count,
        seconds=stages.total(),
        peak_rss_mb=peak_bytes() / 1e6,
        rejected=left_out,
        warnings=noted,
        history=steps,
    )
    known = history(problem, values)
    return Run(trajectory, found, diagnostics, problem.config, causal, known, ranges=residuals)


def _of_ranges(
    problem: Problem, solved: Solved, trajectory: Trajectory, found: dict[str, Calibration]
) -> tuple[list[str], list[AnchorCount], RangeResiduals | None]:
    """What the user should know of the ranges, how many were left out by anchor, and what is left of each."""
    uwb, values = problem.log.uwb, solved.result.values
    if solved.ranges is None or uwb is None:
        return [], [], None
    counts = anchor_counts(uwb, solved.ranges, solved.ranges_left_out, values)
    may_be = () if solved.doubt is None else solved.doubt.anchors
    freed = None if solved.doubt is None or solved.doubt.problem is None else solved.doubt.problem.log.uwb
    of_anchors = range_warnings(freed or uwb, counts, found, may_be)
    score = None if contradictory(of_anchors) else solved.clock_score
    lines = [] if freed is None else [freed_warning(may_be[0], found)]
    lines += geometry_warnings(uwb) + of_anchors
    lines += [] if solved.rival is None else [rival_warning(solved.rival, uwb)]
    lines += clock_warnings(problem.config.uwb, found, solved.clock_moved, score) + range_hole(uwb, trajectory)
    return lines, counts, range_residuals(uwb, solved.ranges, solved.ranges_left_out, values)


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
