"""Logs without an IMU as a `Run`: relative poses carry the state, all else is as in the graph with an IMU."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from factors.increments import npt_int
from factors.so3 import Array, to_quaternion, transpose
from graphnav._memory import peak_bytes
from graphnav._stages import Stages
from graphnav.agreement import agreeing_camera, agreeing_ranges
from graphnav.camera import Camera
from graphnav.camera_errors import camera_known
from graphnav.camera_outcome import disparity_warnings, left_out_counts
from graphnav.chain_graph import (
    chain_graph,
    chain_values,
    leg_readings,
    mean_velocity,
    reckoned,
)
from graphnav.chain_problem import ChainProblem, pose_chain
from graphnav.chain_ranges import SCALE, anchor_calibration, chain_readings, heard, placed, rejected_by_anchor
from graphnav.config import Config
from graphnav.costs import parted, suspects
from graphnav.errors import ConfigError, SolveError
from graphnav.frontends.units import refuse_wrong_units
from graphnav.keyframes import run_frontend
from graphnav.markov_errors import slots
from graphnav.problem import SIZES, A, D, E, X
from graphnav.run import CAMERA_NAMES, LIDAR_NAMES, Calibration, Diagnostics, Run
from graphnav.sighted import Sighted
from graphnav.solvers import batch
from graphnav.solvers.covariance import joint_marginals
from graphnav.tracks import track_readings
from graphnav.trajectory import Trajectory

if TYPE_CHECKING:
    from collections.abc import Callable

    import gtsam

#: What takes part in a graph without an IMU.
METHODS = ("batch", "dead-reckoning")
_NO_SPANS = np.zeros((0, 2))
_DIMS = {**{chr(letter): size for letter, size in SIZES.items()}, "s": 1}
#: Tables and sections that only a graph with an IMU makes use of.
_UNUSED = {"odometer": "table odometer", "face": "section [face]"}


def run_chain(sighted: Sighted, config: Config, method: str, stages: Stages) -> Run:
    """Smooth a log that has relative poses in place of an IMU.

    Raises
    ------
    LogError : bad input; ConfigError : a method that needs an IMU; SolveError : no convergence, or a singular problem.
    """
    log = sighted.log
    if method not in METHODS:
        raise ConfigError(
            f"{method} needs an IMU, and log {log.name} has none: its relative poses serve {' and '.join(METHODS)}"
        )
    if log.uwb is not None and config.uwb.use and config.uwb.estimate_time_offset:
        raise ConfigError(
            f"uwb.estimate_time_offset needs an IMU, and log {log.name} has none: declare uwb.time_offset_s in log.toml"
        )
    with stages.stage("frontend"):
        refuse_wrong_units(log, _NO_SPANS)
        frontend = run_frontend(replace(log, odometer=None), config, _NO_SPANS, sighted.guide)
        problem = pose_chain(log, config, frontend, sighted.notes)
    with stages.stage("assemble"):
        way = placed(problem, reckoned(problem))
    if method == "dead-reckoning":
        return Run(way, {}, _diagnostics(problem, method, stages, ()), config)
    return _smoothed(problem, way, stages)


def _smoothed(problem: ChainProblem, way: Trajectory, stages: Stages) -> Run:
    config = problem.config
    with stages.stage("assemble"):
        readings, ranges = leg_readings(problem, way), chain_readings(problem)
        tracks = track_readings(problem)
        camera = None if tracks is None else Camera(None, tracks)
        graph = chain_graph(problem, readings, ranges, camera)
        values = chain_values(problem, way, readings, ranges, camera)
    rejected: dict[str, int] = {}
    heard_apart, left_out = None, None
    with stages.stage("solve") as tick:
        if ranges is not None and config.uwb.loss != "none":
            values, fit = agreeing_ranges(graph, config.uwb, values)
            heard_apart, ranges = ranges.only(~fit), ranges.only(fit)
            graph = replace(graph, ranges=ranges.family)
            rejected = rejected_by_anchor(problem, heard_apart)
        if camera is not None:
            values, camera, left_out = agreeing_camera(graph, config, camera, values)
            graph = graph.seen_by(camera)
            rejected |= left_out_counts(left_out)
        result = batch.solve(
            graph,
            values,
            max_iterations=config.batch.max_iterations,
            tolerance_sigma=config.batch.tolerance_sigma,
            first=graph.chain,
            progress=tick,
        )
    if not result.converged:
        found = suspects(graph, result.values, parted((ranges, heard_apart), (camera, left_out)))
        raise SolveError.not_converged(len(result.iterations), result.iterations[-1].step_sigmas, suspects=found)
    with stages.stage("covariance") as tick:
        blocks = _covariances(problem, result, tick) if config.covariance else None
    trajectory = _trajectory(problem, result.values, blocks)
    calibration = {**_calibration(problem, result.values, blocks), **anchor_calibration(problem, result.values, blocks)}
    told = _diagnostics(problem, "batch", stages, result.iterations, rejected, calibration)
    return Run(trajectory, calibration, told, config)


def _covariances(
    problem: ChainProblem, result: batch.BatchResult, progress: Callable[[float, float], None] | None
) -> dict[int, Array]:
    """Joint covariance of every keyframe with its neighbour, and of scanner, camera and anchors."""
    neighbours = _neighbours(len(problem.keyframe_s)).tolist()
    groups: dict[int, tuple[int, ...]] = {X(i): (X(i), X(j)) for i, j in enumerate(neighbours)}
    groups |= {key: (key,) for key in (D(0), E(0)) if result.values.exists(key)}
    groups |= {A(a): (A(a),) for a in heard(problem, result.values)}
    if result.values.exists(SCALE):
        groups[SCALE] = (SCALE,)
    assert result.bayes_tree is not None
    dims = {**_DIMS, "m": slots(problem)}
    return joint_marginals(result.bayes_tree, result.order, lambda key: dims[chr(key >> 56)], groups, progress)


def _neighbours(count: int) -> npt_int:
    """The keyframe after each one; the last has the one before it."""
    return np.append(np.arange(1, count), count - 2)


def _trajectory(problem: ChainProblem, values: gtsam.Values, blocks: dict[int, Array] | None) -> Trajectory:
    """Poses and mean velocities between them, with their joint covariance."""
    t_s, count = problem.keyframe_s, len(problem.keyframe_s)
    poses = np.array([values.atPose3(X(i)).matrix() for i in range(count)])
    rotation, pos = poses[:, :3, :3], poses[:, :3, 3]
    cov = None
    if blocks is not None:
        other = _neighbours(count)
        step_s = (t_s[other] - t_s)[:, None, None]
        # attitude, position in n and velocity from both poses' perturbations, which GTSAM has in the body frame
        by_poses = np.zeros((count, 9, 12))
        by_poses[:, :3, :3] = np.eye(3)
        by_poses[:, 3:6, 3:6] = rotation
        by_poses[:, 6:, 3:6], by_poses[:, 6:, 9:] = -rotation / step_s, rotation[other] / step_s
        cov = by_poses @ np.array([blocks[X(i)] for i in range(count)]) @ transpose(by_poses)
    return Trajectory(t_s, pos, to_quaternion(rotation), mean_velocity(pos, t_s), cov, problem.chain)


def _calibration(
    problem: ChainProblem, values: gtsam.Values, blocks: dict[int, Array] | None
) -> dict[str, Calibration]:
    """The scanner's, where there are legs, and the camera's, where anything of it is unknown."""
    found: dict[str, Calibration] = {}
    for key, names in ((D(0), LIDAR_NAMES), (E(0), CAMERA_NAMES)):
        if values.exists(key):
            value = values.atVector(key).tolist()
            sigma = [None] * len(value) if blocks is None else np.sqrt(np.diag(blocks[key])).tolist()
            found |= {
                name: Calibration(v / size, None if s is None else s / size, unit)
                for (name, size, unit), v, s in zip(names, value, sigma, strict=True)
            }
    if problem.log.stereo is not None:
        for name in camera_known(problem.log.stereo):
            found.pop(name, None)
    return found


def _diagnostics(
    problem: ChainProblem,
    method: str,
    stages: Stages,
    iterations: tuple[batch.Iteration, ...],
    rejected: dict[str, int] | None = None,
    calibration: dict[str, Calibration] | None = None,
) -> Diagnostics:
    steps = [dict(vars(step)) for step in iterations]
    return Diagnostics(
        method=method,
        converged=True,
        iterations=max(len(steps), 1),
        keyframes=len(problem.keyframe_s),
        seconds=stages.total(),
        peak_rss_mb=peak_bytes() / 1e6,
        rejected=rejected or {},
        warnings=_warnings(problem) + disparity_warnings(problem.log.stereo, calibration or {}),
        history=steps,
    )


def _warnings(problem: ChainProblem) -> list[str]:
    """What the log holds that takes no part, and what the user should know of its camera."""
    log = problem.log
    found = list(problem.notes)
    found += [
        f"the {what} is not used without an IMU" for name, what in _UNUSED.items() if getattr(log, name) is not None
    ]
    given = (len(log.position) if log.position is not None else 0) + len(log.surveyed)
    unused = given - len(problem.frontend.fixes)
    if unused and problem.config.position.use:
        found.append(f"{unused} of {given} positions and surveyed points are outside the record of relative poses")
    if problem.initial.static_until_s is not None:
        found.append("initial.static_until_s is not used without an IMU: the motions say when it stands")
    if log.lidar_points is not None and log.lidar is None:
        found.append("the table lidar_points is not used: declare the scanner in a section [lidar]")
    return found
