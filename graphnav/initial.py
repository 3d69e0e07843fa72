"""Initial values: dead reckoning with the gyro's attitude and whatever tells speed or position.

Nothing here sees truth. Heading comes from the log's declared initial state; tilt and gyro bias from the first rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from factors import so3
from factors.increments import Samples
from factors.inertial import Motion, predict
from factors.odometry import Travel
from factors.so3 import Array, from_quaternion
from graphnav.log import SensorLog
from graphnav.preintegration import Preintegrated
from graphnav.problem import B, C, K, Problem, V, X, creep_cycles

if TYPE_CHECKING:
    import gtsam


@dataclass(frozen=True)
class States:
    """States at N keyframes: rotation_nb (N, 3, 3), pos_n (N, 3), vel_n (N, 3)."""

    rotation_nb: Array
    pos_n: Array
    vel_n: Array


def rest_bias(samples: Samples, rest_s: Array, rotation_nb: Array, earth_rate_n: Array) -> Array:
    """Gyro bias (3,) from the first rest: mean rate less Earth rate; zero when there is no rest at the start."""
    if not len(rest_s):
        return np.zeros(3)
    inside = (samples.edge_s[:-1] >= rest_s[0, 0]) & (samples.edge_s[1:] <= rest_s[0, 1])
    if not inside.any():
        return np.zeros(3)
    return np.asarray(samples.gyro_b[inside].mean(axis=0) - rotation_nb.T @ earth_rate_n)


def levelled(
    samples: Samples, rest_s: Array, rotation_nb: Array, start_s: float, tilt_sigma_rad: float, tilt_noise_rad: float
) -> Array:
    """The declared attitude, its tilt from the accelerometers where the log starts at rest and they know better."""
    at_start = len(rest_s) and rest_s[0, 0] - start_s < 2.0
    if not at_start or tilt_noise_rad > tilt_sigma_rad:
        return rotation_nb
    inside = (samples.edge_s[:-1] >= rest_s[0, 0]) & (samples.edge_s[1:] <= rest_s[0, 1])
    if not inside.any():
        return rotation_nb
    up_b = samples.accel_b[inside].mean(axis=0)
    up_b = up_b / np.linalg.norm(up_b)
    expected = rotation_nb.T @ np.array([0.0, 0.0, 1.0])
    axis = np.cross(expected, up_b)
    sine = np.linalg.norm(axis)
    if sine < 1e-9:
        return rotation_nb
    turn = so3.exp(axis / sine * np.arctan2(sine, expected @ up_b))
    return rotation_nb @ so3.transpose(turn)


def dead_reckoning(
    log: SensorLog,
    keyframe_s: Array,
    motion: Motion,
    travel: Travel | None,
    start: States,
    fixes: tuple[tuple[float, Array, Array], ...],
    gravity_m_s2: float,
    earth_rate_n: Array,
) -> States:
    """States at all keyframes.

    Attitude is the gyro's. Position is, in this order of preference: the odometer's displacements; the fixes,
    interpolated; the integrated IMU.

    Parameters
    ----------
    motion : one minor interval for each interval between keyframes (its end), from `factors.inertial`.
    travel : odometer over the same intervals, or None.
    start : one state.
    """
    count = len(keyframe_s)
    rotation = np.empty((count, 3, 3))
    rotation[0] = start.rotation_nb[0]
    turn = so3.exp(-earth_rate_n * np.diff(keyframe_s)[:, None])
    for k in range(count - 1):
        rotation[k + 1] = turn[k] @ rotation[k] @ motion.rotation[k]
    rotation = _orthonormal(rotation)
    if travel is not None and log.odometer is not None:
        return _by_odometer(log, keyframe_s, rotation, travel, start)
    if len(fixes) >= 4:
        return _by_fixes(keyframe_s, rotation, fixes)
    pos, vel = np.empty((count, 3)), np.empty((count, 3))
    pos[0], vel[0] = start.pos_n[0], start.vel_n[0]
    for k in range(count - 1):
        row = np.array([k])
        _, p, v = predict(rotation[row], pos[row], vel[row], motion, row, gravity_m_s2, earth_rate_n)
        pos[k + 1], vel[k + 1] = p[0], v[0]
    return States(rotation, pos, vel)


def _by_odometer(log: SensorLog, keyframe_s: Array, rotation: Array, travel: Travel, start: States) -> States:
    odometer = log.odometer
    assert odometer is not None
    lever = rotation @ odometer.lever_arm_b_m
    step = np.einsum("kij,kj->ki", rotation[:-1], travel.mean_b[:, :, 1]) * travel.distance_m[:, None]
    speed = np.interp(keyframe_s, odometer.t_s, odometer.speed_m_s)
    vel = rotation[:, :, 1] * speed[:, None]
    # an interval without odometer samples is crossed at the speed between its ends
    empty = travel.samples == 0
    step[empty] = ((vel[1:] + vel[:-1]) / 2 * np.diff(keyframe_s)[:, None])[empty]
    wheel = start.pos_n[0] + lever[0] + np.concatenate([np.zeros((1, 3)), np.cumsum(step, axis=0)])
    return States(rotation, wheel - lever, vel)


def _by_fixes(keyframe_s: Array, rotation: Array, fixes: tuple[tuple[float, Array, Array], ...]) -> States:
    from scipy.interpolate import PchipInterpolator

    t = np.array([fix[0] for fix in fixes])
    curve = PchipInterpolator(t, np.array([fix[1] for fix in fixes]), axis=0)
    inside = np.clip(keyframe_s, t[0], t[-1])
    vel = curve(inside, 1)
    return States(rotation, curve(inside) + vel * (keyframe_s - inside)[:, None], vel)


def _orthonormal(rotation: Array) -> Array:
    """Remove the round-off of thousands of products."""
    return so3.from_quaternion(so3.to_quaternion(rotation))


def start_state(problem: Problem) -> tuple[States, Array]:
    """Declared initial state, levelled by the first rest, and the gyro bias (3,) that the rest shows."""
    initial, rest = problem.initial, problem.frontend.rest_s
    rotation = from_quaternion(initial.quat_nb_wxyz)
    rotation = levelled(
        problem.imu.samples,
        rest,
        rotation,
        float(problem.keyframe_s[0]),
        float(np.radians(initial.att_sigma_deg[:2].max())),
        problem.noise.accel_bias / problem.gravity_m_s2,
    )
    bias = rest_bias(problem.imu.samples, rest, rotation, problem.earth_rate_n)
    if np.abs(bias).max() > 5 * problem.noise.gyro_bias:
        bias = np.zeros(3)
    return States(rotation[None], initial.pos_n_m[None], initial.vel_n_m_s[None]), bias


def initial_values(problem: Problem, data: Preintegrated, start: States) -> gtsam.Values:
    """Dead-reckoned states, preintegration biases and zero calibration as GTSAM values."""
    import gtsam

    states = dead_reckoning(
        problem.log, problem.keyframe_s, data.motion, data.travel, start, problem.frontend.fixes,
        problem.gravity_m_s2, problem.earth_rate_n,
    )  # fmt: skip
    values = gtsam.Values()
    for i in range(len(problem.keyframe_s)):
        values.insert(X(i), gtsam.Pose3(gtsam.Rot3(states.rotation_nb[i]), states.pos_n[i]))
        values.insert(V(i), states.vel_n[i])
    first_of_epoch = np.searchsorted(problem.bias_epoch, np.arange(problem.bias_epoch[-1] + 1))
    for e, k in enumerate(first_of_epoch):
        values.insert(B(e), gtsam.imuBias.ConstantBias(data.accel_bias_b[k], data.gyro_bias_b[k]))
    if problem.has_calibration:
        for e in range(int(problem.calibration_epoch[-1]) + 1):
            values.insert(C(e), np.zeros(4))
    face = problem.log.face
    for c in creep_cycles(problem):
        values.insert(K(c), np.array([face.creep_m if face else 0.0]))
    return values
