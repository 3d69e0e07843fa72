"""Initial values: dead reckoning with the gyro's attitude and whatever tells speed or position.

Nothing here sees truth. Heading comes from the log's declared initial state; tilt and gyro bias from the first rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from factors.inertial import Motion, predict
from factors.odometry import Travel
from factors.so3 import Array
from graphnav.baselines.dead_reckoning import turned, walked
from graphnav.frontends.alignment import aligned
from graphnav.frontends.range_epochs import fixes_by_ranges, is_unknown, start_position
from graphnav.log import SensorLog
from graphnav.motions import Steps, camera_steps, stepped
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


def dead_reckoning(
    log: SensorLog,
    keyframe_s: Array,
    motion: Motion,
    travel: Travel | None,
    start: States,
    fixes: tuple[tuple[float, Array, Array], ...],
    gravity_m_s2: float,
    earth_rate_n: Array,
    camera: Steps | None = None,
) -> States:
    """States at all keyframes.

    Attitude is the gyro's. Position is, in this order of preference: the odometer's displacements; the fixes,
    interpolated; a camera's motions; the integrated IMU.

    Parameters
    ----------
    motion : one minor interval for each interval between keyframes (its end), from `factors.inertial`.
    travel : odometer over the same intervals, or None.
    start : one state.
    camera : how far a camera's motions lead, or None.
    """
    count = len(keyframe_s)
    rotation = turned(start.rotation_nb[0], motion, keyframe_s, earth_rate_n)
    if travel is not None and log.odometer is not None:
        pos, vel = walked(rotation, start.pos_n[0], travel, log.odometer, keyframe_s, np.zeros(4))
        return States(rotation, pos, vel)
    if len(fixes) >= 4:
        return _by_fixes(keyframe_s, rotation, fixes)
    if camera is not None:
        return States(rotation, *stepped(camera, keyframe_s, rotation, start.pos_n[0], start.vel_n[0]))
    pos, vel = np.empty((count, 3)), np.empty((count, 3))
    pos[0], vel[0] = start.pos_n[0], start.vel_n[0]
    for k in range(count - 1):
        row = np.array([k])
        _, p, v = predict(rotation[row], pos[row], vel[row], motion, row, gravity_m_s2, earth_rate_n)
        pos[k + 1], vel[k + 1] = p[0], v[0]
    return States(rotation, pos, vel)


def _by_fixes(keyframe_s: Array, rotation: Array, fixes: tuple[tuple[float, Array, Array], ...]) -> States:
    from scipy.interpolate import PchipInterpolator

    t = np.array([fix[0] for fix in fixes])
    curve = PchipInterpolator(t, np.array([fix[1] for fix in fixes]), axis=0)
    inside = np.clip(keyframe_s, t[0], t[-1])
    vel = curve(inside, 1)
    return States(rotation, curve(inside) + vel * (keyframe_s - inside)[:, None], vel)


def start_state(problem: Problem) -> tuple[States, Array]:
    """Declared initial state, levelled by the first rest, and the gyro bias (3,) that the rest shows."""
    initial = problem.initial
    rotation, bias = aligned(
        problem.imu.samples, problem.frontend.rest_s, initial, problem.noise, problem.gravity_m_s2,
        problem.earth_rate_n,
    )  # fmt: skip
    pos = initial.pos_n_m
    if is_unknown(initial) and problem.frontend.ranging:
        pos, _ = start_position(problem.log, rotation, float(problem.keyframe_s[0]), problem.frontend.rest_s)
    elif is_unknown(initial) and problem.frontend.fixes:
        pos = problem.frontend.fixes[0][1]
    return States(rotation[None], pos[None], initial.vel_n_m_s[None]), bias


def initial_values(problem: Problem, data: Preintegrated, start: States) -> gtsam.Values:
    """Dead-reckoned states, preintegration biases and zero calibration as GTSAM values."""
    import gtsam

    fixes = problem.frontend.fixes
    if data.travel is None and len(fixes) < 4 and problem.frontend.ranging:
        fixes = fixes_by_ranges(problem.log, start.rotation_nb[0]) or fixes
    states = dead_reckoning(
        problem.log, problem.keyframe_s, data.motion, data.travel, start, fixes, problem.gravity_m_s2,
        problem.earth_rate_n, camera_steps(problem),
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
