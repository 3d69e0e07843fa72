"""Sensor data condensed between keyframes: IMU factors, end-of-interval motion and odometer travel."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from factors import inertial, odometry
from factors.increments import compensated_increments
from factors.inertial import Motion, cumulate
from factors.odometry import Travel
from factors.so3 import Array
from graphnav.problem import B, Problem, V, X

if TYPE_CHECKING:
    from collections.abc import Callable

    import gtsam

#: Keyframe intervals preintegrated at a time: bounds the memory of the increments.
_BLOCK = 500


@dataclass(frozen=True)
class Preintegrated:
    """Sensor data condensed between keyframes at given biases.

    Attributes
    ----------
    gyro_bias_b, accel_bias_b : (N-1, 3) biases preintegrated at.
    imu_factors : N-1 GTSAM factors.
    motion : end-of-interval motion, one minor interval each.
    travel : odometer over the intervals, or None.
    """

    gyro_bias_b: Array
    accel_bias_b: Array
    imu_factors: list[gtsam.NonlinearFactor]
    motion: Motion
    travel: Travel | None


def preintegrate(
    problem: Problem, gyro_bias_b: Array, accel_bias_b: Array, progress: Callable[[float, float], None] | None = None
) -> Preintegrated:
    """Condense IMU and odometer between keyframes, in blocks of keyframes.

    Parameters
    ----------
    gyro_bias_b, accel_bias_b : (3,) or (N-1, 3) biases to preintegrate at, rad/s and m/s^2.
    """
    import gtsam

    t, count = problem.keyframe_s, len(problem.keyframe_s) - 1
    gyro_bias_b = np.broadcast_to(gyro_bias_b, (count, 3))
    accel_bias_b = np.broadcast_to(accel_bias_b, (count, 3))
    params = inertial.preintegration_params(problem.noise, problem.gravity_m_s2, problem.earth_rate_n)
    imu_factors: list[gtsam.NonlinearFactor] = []
    motions: list[Motion] = []
    travels: list[Travel] = []
    odometer = problem.log.odometer
    for lo in range(0, count, _BLOCK):
        hi = min(lo + _BLOCK, count)
        bounds = t[lo : hi + 1]
        block = problem.imu.samples.block(bounds[0], bounds[-1])
        increments = compensated_increments(block, bounds, problem.minor_s, gyro_bias_b[lo:hi], accel_bias_b[lo:hi])
        motion = cumulate(increments)
        motions.append(_ends(motion))
        if odometer is not None:
            rows = slice(np.searchsorted(odometer.t_s, bounds[0]), np.searchsorted(odometer.t_s, bounds[-1] + 1e-6))
            travels.append(odometry.preintegrate_speed(odometer.t_s[rows], odometer.speed_m_s[rows], bounds, motion))
        per_interval = _interval_params(problem, bounds, params)
        pims = inertial.preintegrations(increments, per_interval, gyro_bias_b[lo:hi], accel_bias_b[lo:hi])
        for i, pim in enumerate(pims, start=lo):
            imu_factors.append(gtsam.ImuFactor(X(i), V(i), X(i + 1), V(i + 1), B(int(problem.bias_epoch[i])), pim))
        if progress is not None:
            progress(hi, count)
    travel = (
        Travel(*(np.concatenate(parts) for parts in zip(*(_fields(x) for x in travels), strict=True)))
        if travels
        else None
    )
    joined = [np.concatenate(parts) for parts in zip(*(_fields(m)[1:] for m in motions), strict=True)]
    return Preintegrated(gyro_bias_b, accel_bias_b, imu_factors, Motion(np.arange(count + 1), *joined), travel)


def _fields(x: Motion | Travel) -> list[Array]:
    return list(vars(x).values())


def _ends(motion: Motion) -> Motion:
    last = motion.first[1:] - 1
    first = np.arange(len(last) + 1)
    return Motion(
        first, motion.elapsed_s[last], motion.rotation[last], motion.velocity_b[last], motion.position_b[last]
    )


def _interval_params(
    problem: Problem, bounds: Array, params: gtsam.PreintegrationParams
) -> gtsam.PreintegrationParams | list[gtsam.PreintegrationParams]:
    """Larger noise in intervals with bridged samples: there the signal is a guess."""
    bridged = problem.imu.bridged_s
    touching = bridged[(bridged[:, 1] > bounds[0]) & (bridged[:, 0] < bounds[-1])]
    if not len(touching):
        return params
    # independent holes add up in variance
    guessed = np.zeros(len(bounds) - 1)
    for a, b in touching:
        length = np.minimum(b, bounds[1:]) - np.maximum(a, bounds[:-1])
        guessed += np.maximum(length, 0.0) ** 2
    out = [params] * len(guessed)
    for k in np.flatnonzero(guessed):
        share = np.sqrt(guessed[k] / (bounds[k + 1] - bounds[k]))
        noise = replace(
            problem.noise,
            gyro_density=float(np.hypot(problem.noise.gyro_density, problem.imu.gyro_spread * share)),
            accel_density=float(np.hypot(problem.noise.accel_density, problem.imu.accel_spread * share)),
        )
        out[k] = inertial.preintegration_params(noise, problem.gravity_m_s2, problem.earth_rate_n)
    return out
