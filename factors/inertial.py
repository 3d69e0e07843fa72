"""IMU preintegration between keyframes with datasheet noise, Earth rate and biases in epochs.

C. Forster et al., "On-Manifold Preintegration for Real-Time Visual-Inertial Odometry", IEEE T-RO 33 (2017), as
GTSAM implements it (`ImuFactor`); Earth rate through `PreintegrationParams.setOmegaCoriolis`. What GTSAM takes as one
sample is a minor interval of the two-speed algorithm in `factors.increments`, which also removes the error of
g * Omega * dt / 2 that per-sample integration leaves at rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from factors import so3
from factors.increments import Increments, npt_int
from factors.noise import diagonal
from factors.so3 import Array

if TYPE_CHECKING:
    from collections.abc import Iterator

    import gtsam

RAD_S_PER_DEG_H = np.pi / 180 / 3600
RAD_PER_DEG_SQRT_H = np.pi / 180 / 60
M_S2_PER_MG = 9.80665e-3


@dataclass(frozen=True)
class ImuNoise:
    """IMU errors in SI units, all 1-sigma.

    Attributes
    ----------
    gyro_density : angular random walk, rad/sqrt(s).
    accel_density : velocity random walk, m/s/sqrt(s).
    gyro_bias, accel_bias : turn-on bias, rad/s and m/s^2.
    gyro_bias_walk, accel_bias_walk : bias random walk, rad/s/sqrt(s) and m/s^2/sqrt(s).
    """

    gyro_density: float
    accel_density: float
    gyro_bias: float
    accel_bias: float
    gyro_bias_walk: float = 0.0
    accel_bias_walk: float = 0.0

    @classmethod
    def from_datasheet(
        cls,
        *,
        gyro_random_walk_deg_sqrt_h: float,
        accel_random_walk_mg_sqrt_hz: float,
        gyro_bias_deg_h: float,
        accel_bias_mg: float,
        gyro_bias_walk_deg_h_sqrt_h: float = 0.0,
        accel_bias_walk_mg_sqrt_h: float = 0.0,
    ) -> ImuNoise:
        """Convert the figures of a datasheet; 1 mg is 9.80665e-3 m/s^2."""
        return cls(
            gyro_density=gyro_random_walk_deg_sqrt_h * RAD_PER_DEG_SQRT_H,
            accel_density=accel_random_walk_mg_sqrt_hz * M_S2_PER_MG,
            gyro_bias=gyro_bias_deg_h * RAD_S_PER_DEG_H,
            accel_bias=accel_bias_mg * M_S2_PER_MG,
            gyro_bias_walk=gyro_bias_walk_deg_h_sqrt_h * RAD_S_PER_DEG_H / 60,
            accel_bias_walk=accel_bias_walk_mg_sqrt_h * M_S2_PER_MG / 60,
        )


def preintegration_params(
    noise: ImuNoise, gravity_m_s2: float, earth_rate_n: Array, accel_extra_density: float = 0.0
) -> gtsam.PreintegrationParams:
    """GTSAM parameters for n east-north-up.

    Parameters
    ----------
    noise : sensor noise.
    gravity_m_s2 : magnitude of gravity, along -up.
    earth_rate_n : (3,) Earth rotation in n, rad/s.
    accel_extra_density : further accelerometer noise, m/s/sqrt(s), for intervals with bridged samples.
    """
    import gtsam

    params = gtsam.PreintegrationParams.MakeSharedU(gravity_m_s2)
    params.setGyroscopeCovariance(np.eye(3) * noise.gyro_density**2)
    params.setAccelerometerCovariance(np.eye(3) * (noise.accel_density**2 + accel_extra_density**2))
    params.setIntegrationCovariance(np.eye(3) * 1e-12)
    params.setOmegaCoriolis(np.asarray(earth_rate_n, float))
    return params


def preintegrations(
    increments: Increments,
    params: gtsam.PreintegrationParams | list[gtsam.PreintegrationParams],
    gyro_bias_b: Array,
    accel_bias_b: Array,
) -> Iterator[gtsam.PreintegratedImuMeasurements]:
    """One preintegrated measurement for every interval of `increments`.

    Parameters
    ----------
    increments : from `compensated_increments`, with the same biases.
    params : for all intervals, or one for each.
    gyro_bias_b, accel_bias_b : (K, 3) biases at which to preintegrate, rad/s and m/s^2.

    Yields
    ------
    A preintegration, valid until the next one is asked for: factors copy it.
    """
    import gtsam

    count = len(increments.first) - 1
    gyro_bias_b = np.broadcast_to(gyro_bias_b, (count, 3))
    accel_bias_b = np.broadcast_to(accel_bias_b, (count, 3))
    interval = np.repeat(np.arange(count), np.diff(increments.first))
    half_s, rate, force = _half_steps(increments)
    # GTSAM removes the bias itself: give back what compensation took
    rate += gyro_bias_b[interval][:, None]
    force += accel_bias_b[interval][:, None]
    each = params if isinstance(params, list) else [params]
    pim = gtsam.PreintegratedImuMeasurements(each[0], gtsam.imuBias.ConstantBias())
    first = increments.first.tolist()
    for k in range(count):
        bias = gtsam.imuBias.ConstantBias(accel_bias_b[k], gyro_bias_b[k])
        if len(each) > 1:
            pim = gtsam.PreintegratedImuMeasurements(each[k], bias)
        else:
            pim.resetIntegrationAndSetBias(bias)
        for m in range(first[k], first[k + 1]):
            dt = half_s[m]
            pim.integrateMeasurement(force[m, 0], rate[m, 0], dt)
            pim.integrateMeasurement(force[m, 1], rate[m, 1], dt)
        yield pim


def _half_steps(increments: Increments) -> tuple[list[float], Array, Array]:
    """Two constant rates and forces for each minor interval that GTSAM integrates to its exact end.

    GTSAM steps a tangent vector theta by ``J_r(theta)^-1 w dt``, velocity by ``R f dt`` and position by ``v dt + R f
    dt^2 / 2`` with R from the start of the step. Two steps have room for a given rotation, velocity *and* position;
    one step with the mean force would put the machine where a constant force takes it, centimetres off under
    vibration near the minor interval's own frequency.

    Returns
    -------
    half durations (M), s; rates and forces (M, 2, 3) in the body frame at the start of each half.
    """
    motion = cumulate(increments)
    starts = increments.first[:-1]
    dt = increments.dt_s[:, None]
    theta_end = so3.log(motion.rotation)
    theta = _shifted(theta_end, starts)
    middle = (theta + theta_end) / 2
    rotation, rotation_middle = so3.exp(theta), so3.exp(middle)
    velocity = _shifted(motion.velocity_b, starts)
    gained_v = motion.velocity_b - velocity
    gained_p = motion.position_b - _shifted(motion.position_b, starts) - velocity * dt
    force = np.stack([4 * gained_p / dt**2 - gained_v / dt, 3 * gained_v / dt - 4 * gained_p / dt**2], axis=1)
    turn = (theta_end - theta) / dt
    rate = np.stack([_times(so3.right_jacobian(theta), turn), _times(so3.right_jacobian(middle), turn)], axis=1)
    body = np.stack(
        [_times(so3.transpose(rotation), force[:, 0]), _times(so3.transpose(rotation_middle), force[:, 1])], axis=1
    )
    return (increments.dt_s / 2).tolist(), rate, body


def _times(matrix: Array, vector: Array) -> Array:
    return np.asarray(np.einsum("kij,kj->ki", matrix, vector))


def _shifted(values: Array, starts: npt_int) -> Array:
    """The value at the start of each minor interval: the one before, and zero at the start of a group."""
    out = np.empty_like(values)
    out[1:] = values[:-1]
    out[starts] = 0.0
    return out


@dataclass(frozen=True)
class Motion:
    """Preintegrated motion in numpy, at the end of every minor interval, relative to its interval's start.

    Attributes
    ----------
    first : (K+1,) grouping of the minor intervals, as in `Increments`.
    elapsed_s : (M,) time since the interval's start.
    rotation : (M, 3, 3); velocity_b, position_b : (M, 3), without gravity and Earth rate.
    """

    first: npt_int
    elapsed_s: Array
    rotation: Array
    velocity_b: Array
    position_b: Array


def cumulate(increments: Increments) -> Motion:
    """Compose minor increments within every interval."""
    from factors.composition import cumulated

    parts = cumulated(
        increments.first, increments.dt_s, increments.rotation_b, increments.velocity_b, increments.position_b
    )
    return Motion(increments.first, *parts)


def predict(
    rotation_nb: Array,
    pos_n: Array,
    vel_n: Array,
    motion: Motion,
    index: npt_int,
    gravity_m_s2: float,
    earth_rate_n: Array,
) -> tuple[Array, Array, Array]:
    """States after the motions ``motion[index]``, started at the given states; all (K, ...).

    Forster et al. (2017), equation 26, on the rotating Earth to first order in its turn: with ``a(s)`` the specific
    force in the axes of n at the start, ``v = v_0 + g t + int a - Omega x int s a - 2 Omega x (p - p_0)`` and its
    integral.

    Raises
    ------
    ValueError : states that are not as many as `index`.
    """
    from factors.composition import predicted

    count = len(index)
    rotation = _rows(rotation_nb, (count, 3, 3))
    pos, vel, earth = _rows(pos_n, (count, 3)), _rows(vel_n, (count, 3)), _rows(earth_rate_n, (3,))
    moved = (motion.elapsed_s, motion.rotation, motion.velocity_b, motion.position_b)
    return predicted(rotation, pos, vel, moved, index, gravity_m_s2, earth)


def _rows(values: Array, shape: tuple[int, ...]) -> Array:
    """Values in the one layout that compiled loops are made for, which do not look at bounds."""
    return np.ascontiguousarray(np.broadcast_to(np.asarray(values, float), shape))


def bias_walk_factor(key_1: int, key_2: int, accel_sigma: float, gyro_sigma: float) -> gtsam.NonlinearFactor:
    """Random walk of accelerometer (m/s^2) and gyro (rad/s) bias between two epochs: a native between-factor."""
    import gtsam

    noise = diagonal(np.r_[np.full(3, accel_sigma), np.full(3, gyro_sigma)])
    return gtsam.BetweenFactorConstantBias(key_1, key_2, gtsam.imuBias.ConstantBias(), noise)
