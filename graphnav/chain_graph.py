"""The smoothing problem of a log without an IMU: keyframes tied by measured motions.

Variables: ``X(i)`` pose T_nb at keyframe i, legs ``L(j)`` and the scanner's calibration ``D(0)``, errors of UWB
anchors ``A(a)`` and their Markov part ``M(i)``. Wheels and cameras
measure how the pose changes and nothing else, so there is no velocity, bias or gravity in it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from factors.position import position_factor
from factors.relative_pose import between_factor
from factors.so3 import Array, from_quaternion, to_quaternion
from graphnav.camera import Camera
from graphnav.chain_problem import ChainProblem
from graphnav.chain_ranges import SCALE, scale_prior
from graphnav.graph import SmoothingGraph
from graphnav.leg_priors import leg_priors
from graphnav.legs import LegReadings, gathered
from graphnav.native_factors import pose_prior
from graphnav.problem import D, L, X
from graphnav.ranges import RangeReadings, RangeStates
from graphnav.trajectory import Trajectory

if TYPE_CHECKING:
    import gtsam


def reckoned(problem: ChainProblem) -> Trajectory:
    """The chain laid at the declared initial pose: poses (N,) at the keyframes, without covariances."""
    turned, moved = problem.chain.at(problem.keyframe_s)
    start = from_quaternion(problem.initial.quat_nb_wxyz)
    pos = problem.initial.pos_n_m + moved @ start.T
    return Trajectory(
        problem.keyframe_s, pos, to_quaternion(start @ turned), mean_velocity(pos, problem.keyframe_s), None,
        problem.chain,
    )  # fmt: skip


def mean_velocity(pos_n: Array, t_s: Array) -> Array:
    """Mean velocity (N, 3) from each keyframe to the next; the last one has that of the interval before it."""
    vel = np.diff(pos_n, axis=0) / np.diff(t_s)[:, None]
    return np.concatenate([vel, vel[-1:]])


def leg_readings(problem: ChainProblem, way: Trajectory) -> LegReadings | None:
    """LiDAR readings at the keyframes, each of which has its own; None where no legs take part."""
    log = problem.log
    if log.lidar_points is None or log.lidar is None or not problem.config.lidar.use:
        return None
    return gathered(log, problem.config, way, np.arange(len(problem.keyframe_s)))


def chain_values(
    problem: ChainProblem,
    way: Trajectory,
    readings: LegReadings | None,
    ranges: RangeReadings | None = None,
    camera: Camera | None = None,
) -> gtsam.Values:
    """Initial values: the dead-reckoned poses, legs and features where they were first seen, the rest as declared."""
    import gtsam

    values = gtsam.Values()
    for i, (rotation, pos) in enumerate(zip(way.rotation_nb, way.pos_n, strict=True)):
        values.insert(X(i), gtsam.Pose3(gtsam.Rot3(rotation), pos))
    if readings is not None:
        values.insert(D(0), np.zeros(8))
        for j, place_n in enumerate(readings.place_n):
            values.insert(L(j), np.array([place_n[0], place_n[1], 0.0, 0.0]))
    if ranges is not None:
        RangeStates.of(problem, ranges).insert(problem, values)
        if scale_prior(problem) is not None:
            values.insert(SCALE, np.zeros(1))
    if camera is not None:
        camera.insert(problem, values)
    return values


def chain_graph(
    problem: ChainProblem,
    readings: LegReadings | None,
    ranges: RangeReadings | None = None,
    camera: Camera | None = None,
) -> SmoothingGraph:
    """The initial pose, a motion between every two keyframes, known positions, legs, ranges and tracked features."""
    import gtsam

    native = gtsam.NonlinearFactorGraph()
    native.add(pose_prior(problem.initial))
    motions = problem.chain.between(problem.keyframe_s)
    for i, motion in enumerate(zip(motions.rotation, motions.pos, motions.cov, strict=True)):
        native.add(between_factor(X(i), X(i + 1), *motion))
    for t, pos_n, sigma_n in problem.frontend.fixes:
        native.add(position_factor(X(problem.frontend.index(t)), pos_n, sigma_n))
    if ranges is not None:
        for _, factor in RangeStates.of(problem, ranges).factors(problem):
            native.add(factor)
        prior = scale_prior(problem)
        if prior is not None:
            native.add(prior)
    family = None if ranges is None else ranges.family
    tracks = None
    if camera is not None and camera.tracks is not None:
        tracks = camera.tracks.family
        for prior in camera.beside(problem):
            native.add(prior)
    lidar = problem.log.lidar
    if readings is None or lidar is None:
        return SmoothingGraph(native, None, ranges=family, tracks=tracks)
    lean = float(np.tan(np.radians(problem.config.lidar.lean_sigma_deg)))
    for prior in leg_priors(lidar, readings.feature, readings.place_n[:, 2], lean):
        native.add(prior)
    return SmoothingGraph(native, None, readings.family(lidar), None, [], family, None, tracks)
