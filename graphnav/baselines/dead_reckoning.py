"""Dead reckoning: the gyro's attitude and the odometer's distance; and the same corrected along the closed path.

The methods that Zheng et al. (2021), table 3, and the LiDAR paper's table 3 compare with; closed path as in
S. Wang et al., IEEE T-ASE 16 (2019) 1468 (both papers' reference), equations 5-6 of Zheng. Attitude is never corrected.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors import so3
from factors.inertial import Motion
from factors.odometry import Travel
from factors.so3 import Array, from_quaternion
from graphnav.baselines.inputs import Inputs
from graphnav.baselines.plan import Advance, advances, fixes
from graphnav.frontends.alignment import aligned
from graphnav.frontends.condense import condensed, joined_motion, joined_travel
from graphnav.log import Odometer


@dataclass(frozen=True)
class Compensation:
    """Sensor errors taken out beforehand: gyro_bias_b (3,), rad/s; calibration (4,) [scale, mounting angles rad]."""

    gyro_bias_b: Array
    calibration: Array


@dataclass(frozen=True)
class Track:
    """States at keyframes: rotation_nb (N, 3, 3), pos_n and vel_n (N, 3)."""

    rotation_nb: Array
    pos_n: Array
    vel_n: Array


def at_rest(inputs: Inputs) -> tuple[Array, Compensation]:
    """Levelled attitude (3, 3) at the start, and the gyro bias that the first rest shows: what any operator does."""
    rotation, bias = aligned(
        inputs.imu.samples, inputs.rest_s, inputs.initial, inputs.noise, inputs.gravity_m_s2, inputs.earth_rate_n
    )
    return rotation, Compensation(bias, np.zeros(4))


def as_declared(inputs: Inputs) -> tuple[Array, Compensation]:
    """The declared attitude, and nothing known of the sensors."""
    return from_quaternion(inputs.initial.quat_nb_wxyz), Compensation(np.zeros(3), np.zeros(4))


def traditional(inputs: Inputs, rotation_nb: Array, known: Compensation, minor_s: float) -> Track:
    """Dead reckoning from the declared position.

    Parameters
    ----------
    rotation_nb : (3, 3) attitude at the start; known : sensor errors taken out; minor_s : step of the attitude, s.
    """
    odometer = inputs.log.odometer
    assert odometer is not None
    count = len(inputs.keyframe_s) - 1
    biases = np.broadcast_to(known.gyro_bias_b, (count, 3)), np.zeros((count, 3))
    blocks = [
        (block.ends, block.travel)
        for block in condensed(inputs.imu.samples, odometer, inputs.keyframe_s, minor_s, *biases)
    ]
    motion = joined_motion([ends for ends, _ in blocks])
    travel = joined_travel([part for _, part in blocks if part is not None])
    rotation = turned(rotation_nb, motion, inputs.keyframe_s, inputs.earth_rate_n)
    pos, vel = walked(rotation, inputs.initial.pos_n_m, travel, odometer, inputs.keyframe_s, known.calibration)
    return Track(rotation, pos, vel)


def turned(rotation_nb: Array, motion: Motion, keyframe_s: Array, earth_rate_n: Array) -> Array:
    """Attitudes (N, 3, 3) at the keyframes from the gyro's turns between them."""
    count = len(keyframe_s)
    rotation = np.empty((count, 3, 3))
    rotation[0] = rotation_nb
    earth = so3.exp(-earth_rate_n * np.diff(keyframe_s)[:, None])
    for k in range(count - 1):
        rotation[k + 1] = earth[k] @ rotation[k] @ motion.rotation[k]
    # without the round-off of thousands of products
    return so3.from_quaternion(so3.to_quaternion(rotation))


def walked(
    rotation: Array, pos_n: Array, travel: Travel, odometer: Odometer, keyframe_s: Array, calibration: Array
) -> tuple[Array, Array]:
    """Positions and velocities (N, 3) from attitudes and odometer: ``v_b = Exp(-alpha) [0, y / (1 + scale), 0]``.

    Zheng (2021), equations 1-4 solved for the displacement; calibration : (4,) [scale, alpha rad].
    """
    forward_b = so3.exp(-calibration[1:])[:, 1] / (1 + calibration[0])
    lever = rotation @ odometer.lever_arm_b_m
    along = travel.mean_b @ forward_b
    step = np.einsum("kij,kj->ki", rotation[:-1], along) * travel.distance_m[:, None]
    vel = rotation @ forward_b * np.interp(keyframe_s, odometer.t_s, odometer.speed_m_s)[:, None]
    # an interval without odometer samples is crossed at the speed between its ends
    empty = travel.samples == 0
    step[empty] = ((vel[1:] + vel[:-1]) / 2 * np.diff(keyframe_s)[:, None])[empty]
    wheel = pos_n + lever[0] + np.concatenate([np.zeros((1, 3)), np.cumsum(step, axis=0)])
    return wheel - lever, vel


def along_closed_path(inputs: Inputs, track: Track, known: Compensation) -> Track:
    """The track pulled to the positions that the previous cycle predicts, and to surveyed points, by least variance.

    Since the last correction dead reckoning has gone astray in proportion to the distance: sideways and upward by the
    declared attitude and mounting errors, along by the declared scale error (what is compensated already keeps a tenth
    of it). Each prediction is as uncertain as the corrected point it comes from and the push.
    """
    closing, surveyed = advances(inputs), fixes(inputs)
    to_m = so3.exp(known.calibration[1:])
    pos, variance = track.pos_n.copy(), np.diag(inputs.initial.pos_sigma_m**2)
    rate = _astray(inputs, known)
    corrected: dict[int, tuple[Array, Array]] = {}
    kept = {first for points in closing.values() for first, _ in points}
    gone, shift = 0.0, np.zeros(3)
    for i in range(len(pos)):
        if i > 0:
            gone += float(np.linalg.norm(track.pos_n[i] - track.pos_n[i - 1]))
        pos[i] = track.pos_n[i] + shift
        to_n = track.rotation_nb[i] @ to_m.T
        targets = [_predicted(track, corrected[first], first, advance, to_m) for first, advance in closing.get(i, ())]
        targets += [(p, np.diag(sigma**2)) for p, sigma in surveyed.get(i, ())]
        if targets:
            variance = variance + to_n @ np.diag((rate * gone) ** 2) @ to_n.T
            gone = 0.0
        for target, noise in targets:
            gain = variance @ np.linalg.inv(variance + noise)
            pos[i] = pos[i] + gain @ (target - pos[i])
            variance = variance - gain @ variance
        shift = pos[i] - track.pos_n[i]
        if i in kept:
            corrected[i] = pos[i], variance + to_n @ np.diag((rate * gone) ** 2) @ to_n.T
    return Track(track.rotation_nb, pos, track.vel_n)


def _astray(inputs: Inputs, known: Compensation) -> Array:
    """Error of dead reckoning by distance travelled (3,) in m (right, forward, up), 1 sigma."""
    odometer, attitude = inputs.log.odometer, np.radians(inputs.initial.att_sigma_deg)
    assert odometer is not None
    share = 0.1 if known.calibration.any() else 1.0
    mounting = share * np.radians(odometer.mounting_sigma_deg)
    return np.array(
        [np.hypot(attitude[2], mounting[2]), share * odometer.scale_sigma, np.hypot(attitude[0], mounting[0])]
    )


def _predicted(
    track: Track, past: tuple[Array, Array], first: int, advance: Advance, to_m: Array
) -> tuple[Array, Array]:
    """Position that the first pass predicts for the second (equation 6), and its covariance."""
    pos_n, variance = past
    to_n = track.rotation_nb[first] @ to_m.T
    return pos_n + to_n @ advance.advance_m, variance + to_n @ np.diag(advance.sigma_m**2) @ to_n.T
