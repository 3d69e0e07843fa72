"""The filter's measurements, whitened row by row, from the residual functions of `factors`.

A residual e(state) that noise alone should make up is linearized at the nominal state: ``z = -e`` and
``H = d e / d x``, both by the noise's sigma (Zheng et al. (2021), equations 18-25).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors import closed_path, odometry, stationary
from factors.so3 import Array, skew, transpose
from graphnav.baselines.inputs import Inputs
from graphnav.baselines.states import GYRO_BIAS, MOUNTING, PHI, POS, SCALE, SIZE, VEL, Nominal
from graphnav.log import Odometer

#: Names of the kinds of measurement; their index is kept with every innovation.
KINDS = ("speed", "constraint", "zero velocity", "zero rate", "closed path", "position")
SPEED, CONSTRAINT, ZERO_VELOCITY, ZERO_RATE, CLOSED_PATH, POSITION = range(6)


@dataclass(frozen=True)
class Rows:
    """Whitened scalar measurements: h (M, 19), z (M,), epoch (M,) they belong to, kind (M,)."""

    h: Array
    z: Array
    epoch: np.ndarray[tuple[int, ...], np.dtype[np.int64]]
    kind: np.ndarray[tuple[int, ...], np.dtype[np.int64]]


def joined(parts: list[Rows]) -> Rows:
    """All rows in order of their epochs."""
    if not parts:
        return Rows(np.empty((0, SIZE)), np.empty(0), np.empty(0, np.int64), np.empty(0, np.int64))
    h, z, epoch, kind = (np.concatenate([getattr(p, n) for p in parts]) for n in ("h", "z", "epoch", "kind"))
    order = np.argsort(epoch, kind="stable")
    return Rows(np.ascontiguousarray(h[order]), z[order], epoch[order], kind[order])


def _rows(h: Array, z: Array, epoch: int, kind: int) -> Rows:
    return Rows(h, z, np.full(len(z), epoch), np.full(len(z), kind))


def odometer_rows(
    rotation_nb: Array,
    vel_n: Array,
    nominal: Nominal,
    speed_m_s: Array,
    rate_b: Array,
    odometer: Odometer,
    epoch: np.ndarray[tuple[int, ...], np.dtype[np.int64]],
    constrained: np.ndarray[tuple[int, ...], np.dtype[np.bool_]],
) -> Rows:
    """Speed along the machine, and no velocity across it, at E samples: `odometry.velocity_residual`.

    Parameters
    ----------
    rotation_nb, vel_n : (E, 3, 3) and (E, 3) nominal states at the samples.
    speed_m_s : (E,); rate_b : (E, 3) angular rate, bias taken out; epoch : (E,) epochs of the samples.
    constrained : (E,) whether the sideways and upward rows are taken at a sample.
    """
    lever = odometer.lever_arm_b_m
    calibration = np.broadcast_to(nominal.calibration, (len(speed_m_s), 4))
    error, by_pose, by_vel, by_calibration = odometry.velocity_residual(
        rotation_nb, vel_n, calibration, speed_m_s, rate_b, lever
    )
    h = np.zeros((len(speed_m_s), 3, SIZE))
    h[..., VEL] = by_vel
    h[..., PHI] = by_pose[..., :3] @ transpose(rotation_nb)
    h[..., MOUNTING] = by_calibration[..., 1:]
    h[..., SCALE] = by_calibration[..., 0]
    if lever.any():
        # the lever arm's velocity is w x l with w less the gyro bias
        h[..., GYRO_BIAS] = by_vel @ rotation_nb @ skew(lever)
    sigma = np.array([odometer.slip_sigma_m_s, odometer.sigma_m_s, odometer.slip_sigma_m_s])
    wanted = np.zeros((len(speed_m_s), 3), bool)
    wanted[:, 1] = True
    wanted[:, ::2] = constrained[:, None]
    z, h = -error / sigma, h / sigma[:, None]
    kind = np.broadcast_to([CONSTRAINT, SPEED, CONSTRAINT], wanted.shape)
    return Rows(h[wanted], z[wanted], np.broadcast_to(epoch[:, None], wanted.shape)[wanted], kind[wanted])


def zero_velocity_rows(rotation_nb: Array, vel_n: Array, sigma_m_s: float, epoch: int) -> Rows:
    """Zero velocity at rest, ``R^T v = 0``, where the nominal attitude and velocity are (3, 3) and (3,).

    In the body's axes: in those of n a predicted velocity that is wrong by the tilt would seem to tell the heading.
    """
    h = np.zeros((3, SIZE))
    h[:, VEL] = rotation_nb.T / sigma_m_s
    h[:, PHI] = rotation_nb.T @ skew(vel_n) / sigma_m_s
    return _rows(h, -rotation_nb.T @ vel_n / sigma_m_s, epoch, ZERO_VELOCITY)


def zero_rate_rows(nominal: Nominal, mean_rate_b: Array, rate_sigma: float, earth_rate_n: Array, epoch: int) -> Rows:
    """A mean rate at rest that is bias and Earth rate: `stationary.zero_rate_residual`.

    Parameters
    ----------
    mean_rate_b : (3,) mean gyro sample over the interval, rad/s; rate_sigma : its noise.
    """
    error, by_attitude, by_bias = stationary.zero_rate_residual(
        nominal.rotation_nb, nominal.gyro_bias_b, mean_rate_b, earth_rate_n
    )
    h = np.zeros((3, SIZE))
    h[:, PHI] = by_attitude @ nominal.rotation_nb.T / rate_sigma
    h[:, GYRO_BIAS] = by_bias / rate_sigma
    return _rows(h, -error / rate_sigma, epoch, ZERO_RATE)


def rest_rows(inputs: Inputs, i: int, ahead: Nominal, rotations: Array, velocities: Array, middle: int) -> Rows:
    """Zero velocity and zero rate in the rest before keyframe i, whose epochs have these states (E, 3, 3), (E, 3).

    At rest the position stays within a sigma, so the mean velocity, that of the epoch in the middle, is zero within it.
    """
    start, end = float(inputs.keyframe_s[i - 1]), float(inputs.keyframe_s[i])
    rate, rate_sigma = inputs.imu.samples.mean_rate(start, end), inputs.noise.gyro_density / np.sqrt(end - start)
    rest, last = inputs.config.rest, len(rotations) - 1
    velocity_sigma = min(rest.velocity_sigma_m_s, rest.position_sigma_m / (end - start))
    return joined(
        [
            zero_velocity_rows(rotations[middle], velocities[middle], velocity_sigma, middle),
            zero_rate_rows(ahead, rate, float(rate_sigma), inputs.earth_rate_n, last),
        ]
    )


@dataclass(frozen=True)
class FirstPass:
    """A closed-path point as it was passed: nominal state and the covariance (19, 19) of its error."""

    nominal: Nominal
    covariance: Array


def closed_path_rows(
    nominal: Nominal, first: FirstPass, advance_m: Array, sigma_m: Array, rows: list[int], with_first: bool, epoch: int
) -> Rows:
    """The advance since the first pass in the machine frame: `closed_path.relative_residual`.

    The first pass is no state of the filter: it counts as known (the published filter), or its own covariance is added
    to the noise. In both the two passes are taken for independent, which they are not.

    Parameters
    ----------
    advance_m, sigma_m : (3,) expected advance and its sigmas (right, forward, up).
    rows : which of the three count; with_first : whether the first pass's covariance is added.
    """
    past = first.nominal
    error, by_first, by_pos, by_calibration = closed_path.relative_residual(
        past.rotation_nb, past.pos_n, nominal.pos_n, past.calibration, advance_m
    )
    noise = np.diag(sigma_m**2)
    if with_first:
        by_past = np.zeros((3, SIZE))
        by_past[:, PHI] = by_first[:, :3] @ past.rotation_nb.T
        by_past[:, POS] = by_first[:, 3:] @ past.rotation_nb.T
        by_past[:, SCALE], by_past[:, MOUNTING] = by_calibration[:, 0], by_calibration[:, 1:]
        noise = noise + by_past @ first.covariance @ by_past.T
    h = np.zeros((3, SIZE))
    h[:, POS] = by_pos
    root = np.linalg.cholesky(noise[np.ix_(rows, rows)])
    return _rows(np.linalg.solve(root, h[rows]), np.linalg.solve(root, -error[rows]), epoch, CLOSED_PATH)


def position_rows(nominal: Nominal, pos_n: Array, sigma_n: Array, epoch: int) -> Rows:
    """An absolute position (equations 21-22)."""
    h = np.zeros((3, SIZE))
    h[:, POS] = np.diag(1 / sigma_n)
    return _rows(h, (pos_n - nominal.pos_n) / sigma_n, epoch, POSITION)
