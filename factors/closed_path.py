"""Closed path (CPOEM): the conveyor of the next cycle is that of this cycle, pushed.

Source: J. Zheng et al., Micromachines 12 (2021) 1527, equations 5-6:
``p_{i,j+1} = p_{i,j} + R_nb Exp(-alpha) D_m``, ``D_m = [push, 0, 0]`` along the machine's right axis.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from factors import so3
from factors.noise import diagonal
from factors.so3 import Array

if TYPE_CHECKING:
    import gtsam


def relative_residual(
    rotation_i: Array, pos_i: Array, pos_j: Array, calibration: Array, advance_m: Array
) -> tuple[Array, Array, Array, Array]:
    """The advance between two passes over one point of the face, in the machine frame of the first pass.

    ``e = Exp(alpha) R_i^T (p_j - p_i) - D_m`` (Zheng 2021, equation 6).

    Parameters
    ----------
    rotation_i : (..., 3, 3) R_nb at the first pass; pos_i, pos_j : (..., 3) in n, m.
    calibration : (..., 4) odometer calibration [scale, alpha rad], of which the mounting angles are used.
    advance_m : (..., 3) expected advance D_m in m (right, forward, up), m.

    Returns
    -------
    error (..., 3) m; Jacobians with respect to pose i (..., 3, 6), the position of pose j in n (..., 3, 3) and the
    calibration (..., 3, 4).
    """
    alpha = calibration[..., 1:]
    to_m = so3.exp(alpha)
    in_b = np.einsum("...ji,...j->...i", rotation_i, pos_j - pos_i)
    error = np.einsum("...ij,...j->...i", to_m, in_b) - advance_m
    jac_i = np.empty((*error.shape, 6))
    jac_i[..., :3] = to_m @ so3.skew(in_b)
    jac_i[..., 3:] = -to_m
    jac_j_n = to_m @ so3.transpose(rotation_i)
    jac_calibration = np.zeros((*error.shape, 4))
    jac_calibration[..., 1:] = -to_m @ so3.skew(in_b) @ so3.right_jacobian(alpha)
    return error, jac_i, jac_j_n, jac_calibration


def relative_factor(
    key_i: int, key_j: int, calibration_key: int, advance_m: Array, noise: gtsam.noiseModel.Base
) -> gtsam.CustomFactor:
    """`relative_residual` as a factor on two Pose3 and the odometer calibration Vector4."""
    import gtsam

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        pose_i, pose_j = values.atPose3(key_i).matrix(), values.atPose3(key_j).matrix()
        out = relative_residual(
            pose_i[:3, :3], pose_i[:3, 3], pose_j[:3, 3], values.atVector(calibration_key), advance_m
        )
        if jacobians is not None:
            jac_j = np.zeros((3, 6))
            jac_j[:, 3:] = out[2] @ pose_j[:3, :3]
            for row, jacobian in enumerate([out[1], jac_j, out[3]]):
                jacobians[row] = jacobian
        return out[0]

    return gtsam.CustomFactor(noise, [key_i, key_j, calibration_key], error)


def advance_noise(push_sigma_m: float, along_sigma_m: float) -> gtsam.noiseModel.Base:
    """Noise of one prediction in m (right, forward, up): the push to the right and up, the matching along the face."""
    return diagonal([push_sigma_m, along_sigma_m, push_sigma_m])


def creeping_factor(
    key_i: int, key_j: int, calibration_key: int, creep_key: int, advance_m: Array, noise: gtsam.noiseModel.Base
) -> gtsam.CustomFactor:
    """`relative_factor` with an unknown creep (Vector1, m), a shift of the line along the face: ``D_m[y] + creep``."""
    import gtsam

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        pose_i, pose_j = values.atPose3(key_i).matrix(), values.atPose3(key_j).matrix()
        shifted = advance_m + np.array([0.0, values.atVector(creep_key)[0], 0.0])
        calibration = values.atVector(calibration_key)
        out = relative_residual(pose_i[:3, :3], pose_i[:3, 3], pose_j[:3, 3], calibration, shifted)
        if jacobians is not None:
            jac_j = np.zeros((3, 6))
            jac_j[:, 3:] = out[2] @ pose_j[:3, :3]
            for row, jacobian in enumerate([out[1], jac_j, out[3], np.array([[0.0], [-1.0], [0.0]])]):
                jacobians[row] = jacobian
        return out[0]

    return gtsam.CustomFactor(noise, [key_i, key_j, calibration_key, creep_key], error)


def absolute_factor(key_j: int, predicted_n: Array, noise: gtsam.noiseModel.Base) -> gtsam.NonlinearFactor:
    """The papers' form: a prior at the position predicted from the last cycle's *estimate* (Zheng 2021, equation 21).

    It counts the information of the last cycle a second time; the relative factor does not. A native factor.

    Parameters
    ----------
    key_j : Pose3 of the second pass; predicted_n : (3,) predicted position, m; noise : in n (east, north, up), m.
    """
    import gtsam

    return gtsam.PoseTranslationPrior3D(key_j, gtsam.Pose3(gtsam.Rot3(), np.asarray(predicted_n, float)), noise)
