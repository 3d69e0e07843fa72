"""LiDAR range and bearing to a support leg, with the scanner's systematic errors and mounting.

Source: "Research on the shearer positioning method based on INS and LiDAR" (the INS/LiDAR shearer paper), equations 1-7
and 19-23. A leg is a line, upright within about 10 degrees, that the scan plane cuts wherever the machine's height and
tilt take it; so the landmark is its place at a given height and its lean, four numbers (`leg_residual`). The paper's
landmark is a point in three dimensions whose height in the scanner's frame is measured as zero (`point_residual`).

The calibration variable is the 8-vector ``[dK, db, a3, a2 - 1, a1, delta]``: range scale and bias (m), angle bias
(rad), scale and quadratic term (1/rad), and the mounting angles delta of s about its own axes (rad),
``R_bs = Exp(delta) R(T_bs)``. The angle bias and the mounting angle about up do almost the same: judge their sum.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from factors import so3
from factors.increments import npt_int
from factors.so3 import Array

if TYPE_CHECKING:
    import gtsam

#: Entries of the calibration variable.
RANGE_SCALE, RANGE_BIAS, ANGLE_BIAS, ANGLE_SCALE, ANGLE_SQUARE, MOUNTING = 0, 1, 2, 3, 4, slice(5, 8)


def true_angle(measured_rad: Array, calibration: Array) -> tuple[Array, Array]:
    """The angle behind a measured one: ``theta = a1 t^2 + a2 t + a3`` (equation 4 solved for theta).

    Parameters
    ----------
    measured_rad : (...,); calibration : (..., 8).

    Returns
    -------
    theta (...,) rad, and its Jacobian with respect to the calibration (..., 8).
    """
    jacobian = np.zeros((*np.broadcast(measured_rad, calibration[..., 0]).shape, 8))
    jacobian[..., ANGLE_BIAS] = 1.0
    jacobian[..., ANGLE_SCALE] = measured_rad
    jacobian[..., ANGLE_SQUARE] = measured_rad**2
    theta = measured_rad + np.einsum("...i,...i->...", jacobian, calibration)
    return theta, jacobian


def leg_residual(
    rotation_nb: Array,
    pos_n: Array,
    leg_n: Array,
    calibration: Array,
    range_m: Array,
    angle_rad: Array,
    height_m: Array,
    rotation_bs: Array,
    lever_arm_b: Array,
    off_plane_m: Array | float = 0.0,
) -> tuple[Array, Array, Array, Array]:
    """Range and bearing to a leaning line, where the scan plane cuts it.

    ``e = [(1 + dK) rho + db - range, theta - (a1 t^2 + a2 t + a3)]`` with rho and theta those of the point of the line
    ``(x + lx (h - h0), y + ly (h - h0), h)`` whose height h puts it into the scan plane.

    Parameters
    ----------
    rotation_nb, pos_n : (..., 3, 3) and (..., 3) pose.
    leg_n : (..., 4) east and north of the leg at the height h0, m, and its lean to east and north, m per m.
    calibration : (..., 8), see the module.
    range_m, angle_rad : (...,) measured; the angle from s's forward axis, counter-clockwise.
    height_m : (...,) h0, any height near the scanner's, the same for all readings of a leg.
    rotation_bs, lever_arm_b : (3, 3) and (3,) declared mounting of the scanner.
    off_plane_m : (...,) height above the scan plane at which the line is cut, for a mean of several scans.

    Returns
    -------
    error (..., 2) m and rad; Jacobians with respect to pose (..., 2, 6), leg (..., 2, 4), calibration (..., 2, 8).
    """
    reading = np.stack(np.broadcast_arrays(range_m, angle_rad, height_m, off_plane_m), axis=-1)
    places = (rotation_nb.shape[:-2], pos_n.shape[:-1], leg_n.shape[:-1], calibration.shape[:-1], reading.shape[:-1])
    shape = np.broadcast_shapes(*places)

    def rows(values: Array, *size: int) -> Array:
        return np.broadcast_to(values, shape + size).reshape(-1, *size)

    found = leg_rows(
        rows(rotation_nb, 3, 3), rows(pos_n, 3), rows(np.eye(3), 3, 3), rows(np.zeros(3), 3), rows(leg_n, 4),
        rows(reading, 4), rows(np.zeros((3, 8)), 3, 8), np.arange(np.prod(shape, dtype=int)), rows(calibration, 8),
        rotation_bs, lever_arm_b,
    )  # fmt: skip
    error, by_pose, by_leg, by_calibration = (part.reshape(shape + part.shape[1:]) for part in found)
    return error, by_pose, by_leg, by_calibration


def leg_rows(
    pose_nb: Array,
    pose_n: Array,
    turn_b: Array,
    shift_n: Array,
    leg_n: Array,
    reading: Array,
    spread: Array,
    which: npt_int,
    calibration: Array,
    rotation_bs: Array,
    lever_arm_b: Array,
) -> tuple[Array, Array, Array, Array]:
    """`leg_residual` of K readings, each taken a known motion away from its pose.

    Parameters
    ----------
    pose_nb, pose_n : (K, 3, 3) and (K, 3) pose; turn_b, shift_n : (K, 3, 3) and (K, 3) from it to that of the reading,
        the turn in b, the shift in n.
    leg_n : (K, 4); reading : (K, 4) range, angle, height and height above the plane.
    spread : (K, 3, 8) added to the error, and taken from the height above the plane, per unit of the calibration.
    which : (K,) row of calibration (C, 8).
    rotation_bs, lever_arm_b : (3, 3) and (3,) declared mounting.

    Returns
    -------
    error (K, 2) m and rad; Jacobians with respect to pose (K, 2, 6), leg (K, 2, 4), calibration (K, 2, 8).
    """
    from factors.leg_loops import cut_legs

    delta = calibration[:, MOUNTING]
    to_s, by_delta = so3.transpose(so3.exp(delta) @ rotation_bs), so3.right_jacobian(delta)
    # other layouts would be compiled for anew
    own = np.ascontiguousarray
    return cut_legs(
        own(pose_nb), own(pose_n), own(turn_b), own(shift_n), own(leg_n), own(reading), own(spread),
        which, own(calibration), own(to_s), own(by_delta), own(rotation_bs), own(lever_arm_b),
    )  # fmt: skip


def point_residual(
    rotation_nb: Array,
    pos_n: Array,
    point_n: Array,
    calibration: Array,
    range_m: Array,
    angle_rad: Array,
    rotation_bs: Array,
    lever_arm_b: Array,
) -> tuple[Array, Array, Array, Array]:
    """The paper's measurement: range and bearing to a point, and its height in the scan plane, measured as zero.

    Equations 1-7 and 20, in range, bearing and height instead of the scanner's axes. Parameters as in `leg_residual`,
    with point_n : (..., 3) in n.

    Returns
    -------
    error (..., 3) m, rad, m; Jacobians with respect to pose (..., 3, 6), point (..., 3, 3), calibration (..., 3, 8).
    """
    to_s = so3.transpose(so3.exp(calibration[..., MOUNTING]) @ rotation_bs)
    away_b = np.einsum("...ji,...j->...i", rotation_nb, point_n - pos_n) - lever_arm_b
    away_s = np.einsum("...ij,...j->...i", to_s, away_b)
    planar, by_away, by_calibration = _range_bearing(away_s, calibration, range_m, angle_rad)
    error = np.concatenate([planar, away_s[..., 2:]], axis=-1)
    height = np.broadcast_to([0.0, 0.0, 1.0], (*away_s.shape[:-1], 1, 3))
    by_away = np.concatenate([by_away, height], axis=-2)
    by_b = by_away @ to_s
    jac_pose = np.concatenate([by_b @ so3.skew(away_b + lever_arm_b), -by_b], axis=-1)
    jac_calibration = np.concatenate([by_calibration, np.zeros((*away_s.shape[:-1], 1, 8))], axis=-2)
    jac_calibration[..., MOUNTING] = by_away @ _by_mounting(calibration, rotation_bs, away_b)
    return error, jac_pose, by_b @ so3.transpose(rotation_nb), jac_calibration


def seen_leg(
    rotation_nb: Array, pos_n: Array, range_m: Array, angle_rad: Array, rotation_bs: Array, lever_arm_b: Array
) -> Array:
    """Where a leg stands that is seen at a range and angle (equation 11, without systematic errors): (..., 3) in n."""
    in_s = np.stack([-range_m * np.sin(angle_rad), range_m * np.cos(angle_rad), np.zeros_like(range_m)], axis=-1)
    in_b = in_s @ rotation_bs.T + lever_arm_b
    return np.asarray(pos_n + np.einsum("...ij,...j->...i", rotation_nb, in_b))


def _range_bearing(away_s: Array, calibration: Array, range_m: Array, angle_rad: Array) -> tuple[Array, Array, Array]:
    """Planar error (..., 2) of a vector in s, with Jacobians by it (..., 2, 3) and by the calibration (..., 2, 8).

    In range and angle, as the noise is: along and across the measured ray would be closer to linear, but the noise of
    the angle then stands in the Jacobian too, and pulls every range by sigma^2 / rho (measured: 0.002 of the scale).
    """
    x, y = away_s[..., 0], away_s[..., 1]
    rho = np.hypot(x, y)
    theta, by_angle = true_angle(angle_rad, calibration)
    turn = np.arctan2(-x, y) - theta
    error = np.stack(
        [(1 + calibration[..., RANGE_SCALE]) * rho + calibration[..., RANGE_BIAS] - range_m,
         (turn + np.pi) % (2 * np.pi) - np.pi], axis=-1
    )  # fmt: skip
    gain, zero = 1 + calibration[..., RANGE_SCALE], np.zeros_like(rho)
    by_away = np.stack(
        [np.stack([gain * x / rho, gain * y / rho, zero], axis=-1), np.stack([-y / rho**2, x / rho**2, zero], axis=-1)],
        axis=-2,
    )
    by_calibration = np.zeros((*rho.shape, 2, 8))
    by_calibration[..., 0, RANGE_SCALE] = rho
    by_calibration[..., 0, RANGE_BIAS] = 1.0
    by_calibration[..., 1, :] = -by_angle
    return error, by_away, by_calibration


def _by_mounting(calibration: Array, rotation_bs: Array, away_b: Array) -> Array:
    """Change of ``R(T_bs)^T Exp(-delta) x`` with delta (..., 3, 3)."""
    delta = calibration[..., MOUNTING]
    turned = np.einsum("...ji,...j->...i", so3.exp(delta), away_b)
    return rotation_bs.T @ so3.skew(turned) @ so3.right_jacobian(delta)


def leg_factor(
    pose_key: int,
    leg_key: int,
    calibration_key: int,
    range_m: float,
    angle_rad: float,
    height_m: float,
    noise: gtsam.noiseModel.Base,
    rotation_bs: Array,
    lever_arm_b: Array,
) -> gtsam.CustomFactor:
    """`leg_residual` as a factor on a Pose3, a leg Vector4 and a calibration Vector8."""
    import gtsam

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        pose = values.atPose3(pose_key).matrix()
        out = leg_residual(
            pose[:3, :3], pose[:3, 3], values.atVector(leg_key), values.atVector(calibration_key),
            np.asarray(range_m), np.asarray(angle_rad), np.asarray(height_m), rotation_bs, lever_arm_b,
        )  # fmt: skip
        if jacobians is not None:
            for row, jacobian in enumerate(out[1:]):
                jacobians[row] = jacobian
        return out[0]

    return gtsam.CustomFactor(noise, [pose_key, leg_key, calibration_key], error)
