"""Sensor data condensed between keyframes: IMU factors, end-of-interval motion and odometer travel."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from factors import inertial
from factors.inertial import Motion
from factors.odometry import Travel
from factors.so3 import Array
from graphnav.frontends.condense import condensed, joined_motion, joined_travel
from graphnav.problem import B, Problem, V, X

if TYPE_CHECKING:
    from collections.abc import Callable

    import gtsam


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
    for block in condensed(problem.imu.samples, problem.log.odometer, t, problem.minor_s, gyro_bias_b, accel_bias_b):
        lo, hi = block.rows.start, block.rows.stop
        motions.append(block.ends)
        if block.travel is not None:
            travels.append(block.travel)
        per_interval = _interval_params(problem, t[lo : hi + 1], params)
        pims = inertial.preintegrations(block.increments, per_interval, gyro_bias_b[lo:hi], accel_bias_b[lo:hi])
        for i, pim in enumerate(pims, start=lo):
            imu_factors.append(gtsam.ImuFactor(X(i), V(i), X(i + 1), V(i + 1), B(int(problem.bias_epoch[i])), pim))
        if progress is not None:
            progress(hi, count)
    travel = joined_travel(travels) if travels else None
    return Preintegrated(gyro_bias_b, accel_bias_b, imu_factors, joined_motion(motions), travel)


def _interval_params(
    problem: Problem, bounds: Array, params: gtsam.PreintegrationParams
) -> gtsam.PreintegrationParams | list[gtsam.PreintegrationParams]:
    """Larger noise in intervals with bridged samples: there the signal is a guess."""
    noise = problem.noise
    gyro, accel = problem.imu.densities(bounds, noise.gyro_density, noise.accel_density)
    out = [params] * len(gyro)
    for k in np.flatnonzero(gyro != noise.gyro_density):
        larger = replace(noise, gyro_density=float(gyro[k]), accel_density=float(accel[k]))
        out[k] = inertial.preintegration_params(larger, problem.gravity_m_s2, problem.earth_rate_n)
    return out if any(each is not params for each in out) else params
