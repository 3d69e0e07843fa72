"""Rest: zero velocity, and zero rotation rate but for the Earth's.

In a graph with preintegrated gyro samples rest is two native factors: zero velocity at a keyframe, and an unchanged
pose between two keyframes; the latter makes the IMU factor between them measure the gyro bias (zero rate less Earth
rate) without using a gyro sample twice. `zero_rate_residual` is the same statement for estimators that hold the mean
rate itself (a filter, or a graph without IMU factors over the rest).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from factors import so3
from factors.noise import diagonal
from factors.so3 import Array

if TYPE_CHECKING:
    import gtsam


def zero_rate_residual(
    rotation_nb: Array, gyro_bias_b: Array, rate_b: Array, earth_rate_n: Array
) -> tuple[Array, Array, Array]:
    """Mean gyro rate at rest, less bias and Earth rate: ``e = w - b_g - R_nb^T Omega_n``, rad/s.

    Source: the gyro error model of Zheng et al. (2021), equation 13, at rest (``w_nb = 0``).

    Parameters
    ----------
    rotation_nb : (..., 3, 3); gyro_bias_b, rate_b : (..., 3) rad/s; earth_rate_n : (3,) rad/s.

    Returns
    -------
    error (..., 3); Jacobians with respect to attitude (body, right perturbation) and gyro bias, (..., 3, 3).
    """
    earth_b = np.einsum("...ji,j->...i", rotation_nb, earth_rate_n)
    jac_bias = np.broadcast_to(-np.eye(3), rotation_nb.shape).copy()
    return rate_b - gyro_bias_b - earth_b, -so3.skew(earth_b), jac_bias


def zero_rate_factor(
    pose_key: int, bias_key: int, rate_b: Array, earth_rate_n: Array, noise: gtsam.noiseModel.Base
) -> gtsam.CustomFactor:
    """`zero_rate_residual` as a factor on a Pose3 and an imuBias.ConstantBias."""
    import gtsam

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        rotation = values.atPose3(pose_key).rotation().matrix()
        residual, jac_attitude, jac_bias = zero_rate_residual(
            rotation, values.atConstantBias(bias_key).gyroscope(), rate_b, earth_rate_n
        )
        if jacobians is not None:
            jacobians[0] = np.hstack([jac_attitude, np.zeros((3, 3))])
            jacobians[1] = np.hstack([np.zeros((3, 3)), jac_bias])
        return residual

    return gtsam.CustomFactor(noise, [pose_key, bias_key], error)


def zero_velocity_factor(velocity_key: int, sigma_m_s: float) -> gtsam.NonlinearFactor:
    """Zero velocity at a keyframe: a native prior on the velocity Vector3."""
    import gtsam

    return gtsam.PriorFactorVector(velocity_key, np.zeros(3), gtsam.noiseModel.Isotropic.Sigma(3, sigma_m_s))


def unmoved_factor(key_i: int, key_j: int, attitude_sigma_rad: float, position_sigma_m: float) -> gtsam.NonlinearFactor:
    """An unchanged pose between two keyframes of one rest: a native between-factor at identity."""
    import gtsam

    noise = diagonal(np.r_[np.full(3, attitude_sigma_rad), np.full(3, position_sigma_m)])
    return gtsam.BetweenFactorPose3(key_i, key_j, gtsam.Pose3(), noise)
