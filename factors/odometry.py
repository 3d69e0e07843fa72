"""Odometer with motion constraint; scale factor, mounting angles and lever arm included.

Source: J. Zheng et al., "Research on the Shearer Positioning Method ...", Micromachines 12 (2021) 1527, equations 1-4
(measured velocity) and 10, 18-20 (mounting angles, scale factor); the interval form integrates them over a keyframe
interval with the gyro's attitude.

The calibration variable is the 4-vector ``[scale, alpha]``: ``measured = (1 + scale) v_m[y]`` and
``v_m = Exp(alpha) v_b``, alpha in rad about right, forward, up; the paper's delta-alpha is ``-alpha``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from factors import lookup, so3
from factors.increments import npt_int
from factors.inertial import Motion
from factors.noise import diagonal
from factors.so3 import Array

if TYPE_CHECKING:
    import gtsam


def velocity_residual(
    rotation_nb: Array, vel_n: Array, calibration: Array, speed_m_s: Array, rate_b: Array, lever_arm_b: Array
) -> tuple[Array, Array, Array, Array]:
    """Odometer speed and motion constraint at one instant (Zheng 2021, equations 1-4 and 18-19).

    ``e = (1 + scale) v_m - [0, y, 0]`` with ``v_m = Exp(alpha) (R_nb^T v_n + w x l)`` and y the measured speed.

    Parameters
    ----------
    rotation_nb : (..., 3, 3); vel_n : (..., 3), m/s; calibration : (..., 4) [scale, alpha rad].
    speed_m_s : (...,) measured; rate_b : (..., 3) angular rate, rad/s; lever_arm_b : (3,) odometer in b, m.

    Returns
    -------
    error (..., 3) m/s, and Jacobians with respect to pose (..., 3, 6), velocity (..., 3, 3), calibration (..., 3, 4).
    """
    in_b = np.einsum("...ji,...j->...i", rotation_nb, vel_n)
    error, by_b, jac_calibration = _scaled_error(in_b + np.cross(rate_b, lever_arm_b), calibration, speed_m_s)
    jac_pose = np.zeros((*error.shape, 6))
    jac_pose[..., :3] = by_b @ so3.skew(in_b)
    jac_velocity = by_b @ so3.transpose(rotation_nb)
    return error, jac_pose, jac_velocity, jac_calibration


def displacement_residual(
    rotation_i: Array,
    pos_i: Array,
    rotation_j: Array,
    pos_j: Array,
    calibration: Array,
    distance_m: Array,
    mean_b: Array,
    lever_arm_b: Array,
) -> tuple[Array, Array, Array, Array]:
    """Odometer preintegrated over an interval: displacement of the odometer between two keyframes.

    Zheng (2021), equations 1-4, integrated over the interval with the gyro's attitude:
    ``e = (1 + scale) m - [0, D, 0]`` with ``m = Exp(alpha) M^T (R_i^T (p_j + R_j l - p_i) - l)`` the displacement in
    the mean machine frame of the interval and D the measured distance.

    Parameters
    ----------
    rotation_i, rotation_j : (..., 3, 3) R_nb; pos_i, pos_j : (..., 3) in n, m.
    calibration : (..., 4) [scale, alpha rad].
    distance_m : (...,) D and mean_b : (..., 3, 3) M, from `preintegrate_speed`; lever_arm_b : (3,) odometer in b, m.

    Returns
    -------
    error (..., 3) m; Jacobians with respect to pose i, pose j (..., 3, 6) and calibration (..., 3, 4).
    """
    to_mean, to_i = so3.transpose(mean_b), so3.transpose(rotation_i)
    r_ij = to_i @ rotation_j
    carried = np.einsum("...ij,...j->...i", to_i, pos_j - pos_i) + r_ij @ lever_arm_b
    moved = np.einsum("...ij,...j->...i", to_mean, carried - lever_arm_b)
    error, by_moved, jac_calibration = _scaled_error(moved, calibration, distance_m)
    by_b = by_moved @ to_mean
    jac_i = np.concatenate([by_b @ so3.skew(carried), -by_b], axis=-1)
    by_j = by_b @ r_ij
    jac_j = np.concatenate([-by_j @ so3.skew(lever_arm_b), by_j], axis=-1)
    return error, jac_i, jac_j, jac_calibration


def _scaled_error(travelled_b: Array, calibration: Array, measured: Array) -> tuple[Array, Array, Array]:
    """``e = (1 + scale) Exp(alpha) x - [0, measured, 0]``, Jacobians by x (..., 3, 3) and calibration (..., 3, 4).

    The gain multiplies all three rows, as in Zheng (2021), equation 3. Leaving it off the lateral rows, or dividing the
    measurement by it, biases the scale factor by several sigma: slip that shrinks with the estimated path, and noise
    that shrinks with the estimated gain, both favour a short path (docs/decisions/0002).
    """
    alpha = calibration[..., 1:]
    to_m = so3.exp(alpha)
    in_m = np.einsum("...ij,...j->...i", to_m, travelled_b)
    gain = (1 + calibration[..., 0])[..., None]
    error = gain * in_m
    error[..., 1] -= measured
    by_b = gain[..., None] * to_m
    turned = by_b @ so3.skew(travelled_b) @ so3.right_jacobian(alpha)
    return error, by_b, np.concatenate([in_m[..., None], -turned], axis=-1)


@dataclass(frozen=True)
class Travel:
    """Odometer preintegrated over K intervals.

    Attributes
    ----------
    distance_m : (K,) measured distance along the mean direction; zero where an interval has no sample.
    mean_b : (K, 3, 3) mean attitude of the travel relative to the interval's start, a rotation.
    weight2_s2 : (K,) sum of squared quadrature weights, s^2: the variance of the distance is ``sigma^2 weight2_s2``.
    samples : (K,) samples used; every sample is used in one interval.
    """

    distance_m: Array
    mean_b: Array
    weight2_s2: Array
    samples: np.ndarray[tuple[int, ...], np.dtype[np.int64]]


def preintegrate_speed(t_s: Array, speed_m_s: Array, boundaries_s: Array, motion: Motion) -> Travel:
    """Integrate odometer samples over the intervals between boundaries with the gyro's attitude.

    A sample at time t belongs to the one interval with ``t_i < t <= t_j``. The quadrature weights are those of least
    variance that integrate constant and linear speeds exactly from the interval's own samples, whatever their spacing.

    Parameters
    ----------
    t_s, speed_m_s : (N,) samples, s and m/s.
    boundaries_s : (K+1,) interval bounds, s.
    motion : gyro attitude within the same intervals, from `cumulate`.
    """
    boundaries_s = np.asarray(boundaries_s, float)
    interval = np.searchsorted(boundaries_s, t_s - 1e-9, side="left") - 1
    inside = (interval >= 0) & (interval < len(boundaries_s) - 1)
    interval, t_s, speed_m_s = interval[inside], t_s[inside], speed_m_s[inside]
    count = len(boundaries_s) - 1
    start, length = boundaries_s[:-1], np.diff(boundaries_s)

    def total(values: Array) -> Array:
        return np.asarray(np.bincount(interval, values, minlength=count), dtype=float)

    tau = t_s - start[interval]
    samples = np.bincount(interval, minlength=count)
    centre = total(tau) / np.maximum(samples, 1)
    centred = tau - centre[interval]
    spread = total(centred**2)
    lever = np.where(spread > 1e-9, (length / 2 - centre) * length / np.where(spread > 1e-9, spread, 1), 0.0)
    weight = length[interval] / samples[interval] + lever[interval] * centred
    rotation = _rotation_at(motion, interval, tau)

    def total_matrix(values: Array) -> Array:
        return np.column_stack([total(entry) for entry in (values[:, None, None] * rotation).reshape(-1, 9).T]).reshape(
            -1, 3, 3
        )

    travel = total_matrix(weight * speed_m_s)
    length_sum, way = total(weight * speed_m_s), total(weight * np.abs(speed_m_s))
    # weighted by speed, so that turning while the speed changes leaves no sideways travel; by time where it reverses
    straight = np.abs(length_sum) > np.maximum(0.5 * way, 1e-6)
    by_time = total_matrix(weight) + np.where(samples > 0, 0.0, 1.0)[:, None, None] * np.eye(3)
    mean = _nearest_rotation(np.where(straight[:, None, None], travel * np.sign(length_sum)[:, None, None], by_time))
    distance = np.einsum("kj,kj->k", mean[:, :, 1], travel[:, :, 1])
    return Travel(distance, mean, total(weight**2), samples)


def _nearest_rotation(matrix: Array) -> Array:
    """The rotation nearest to a sum of rotations that differ little (polar decomposition)."""
    u, _, vt = np.linalg.svd(matrix)
    return np.asarray(u @ vt)


def _rotation_at(motion: Motion, interval: np.ndarray[tuple[int, ...], np.dtype[np.int64]], tau: Array) -> Array:
    """Attitude since the interval's start at `tau`: the enclosing minor interval turned at constant rate."""
    order = motion.first[interval]
    key = np.repeat(np.arange(len(motion.first) - 1), np.diff(motion.first)) * 1e6 + motion.elapsed_s
    minor = np.clip(np.searchsorted(key, interval * 1e6 + tau - 1e-7), order, motion.first[interval + 1] - 1)
    starts = minor == order
    before = np.where(starts[:, None, None], np.eye(3), motion.rotation[minor - 1])
    t0 = np.where(starts, 0.0, motion.elapsed_s[minor - 1])
    part = np.clip((tau - t0) / (motion.elapsed_s[minor] - t0), 0.0, 1.0)
    turn = so3.log(so3.transpose(before) @ motion.rotation[minor])
    return before @ so3.exp(turn * part[:, None])


def velocity_factor(
    pose_key: int,
    velocity_key: int,
    calibration_key: int,
    speed_m_s: float,
    rate_b: Array,
    noise: gtsam.noiseModel.Base,
    lever_arm_b: Array,
) -> gtsam.CustomFactor:
    """`velocity_residual` as a factor on a Pose3, a velocity Vector3 and a calibration Vector4."""
    import gtsam

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        rotation = values.atPose3(pose_key).rotation().matrix()
        out = velocity_residual(
            rotation,
            values.atVector(velocity_key),
            values.atVector(calibration_key),
            np.asarray(speed_m_s),
            rate_b,
            lever_arm_b,
        )
        if jacobians is not None:
            for row, jacobian in enumerate(out[1:]):
                jacobians[row] = jacobian
        return out[0]

    return gtsam.CustomFactor(noise, [pose_key, velocity_key, calibration_key], error)


def displacement_factor(
    key_i: int,
    key_j: int,
    calibration_key: int,
    distance_m: float,
    mean_b: Array,
    noise: gtsam.noiseModel.Base,
    lever_arm_b: Array,
) -> gtsam.CustomFactor:
    """`displacement_residual` as a factor on two Pose3 and a calibration Vector4."""
    import gtsam

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        pose_i, pose_j = values.atPose3(key_i).matrix(), values.atPose3(key_j).matrix()
        out = displacement_residual(
            pose_i[:3, :3],
            pose_i[:3, 3],
            pose_j[:3, :3],
            pose_j[:3, 3],
            values.atVector(calibration_key),
            np.asarray(distance_m),
            mean_b,
            lever_arm_b,
        )
        if jacobians is not None:
            for row, jacobian in enumerate(out[1:]):
                jacobians[row] = jacobian
        return out[0]

    return gtsam.CustomFactor(noise, [key_i, key_j, calibration_key], error)


@dataclass(frozen=True)
class DisplacementFamily:
    """All displacement factors of a log as arrays: linearized at once, several times faster than one by one.

    Attributes
    ----------
    key_i, key_j, calibration_key : (K,) keys.
    distance_m : (K,); mean_b : (K, 3, 3); sigma_m : (K, 3) noise in the mean machine frame; lever_arm_b : (3,).
    """

    key_i: npt_int
    key_j: npt_int
    calibration_key: npt_int
    distance_m: Array
    mean_b: Array
    sigma_m: Array
    lever_arm_b: Array

    def linearize_into(self, linear: gtsam.GaussianFactorGraph, values: gtsam.Values, block: int = 4096) -> None:
        """Append the whitened Jacobian factors at `values`."""
        import gtsam

        unit = gtsam.noiseModel.Unit.Create(3)
        for lo in range(0, len(self.key_i), block):
            rows = slice(lo, lo + block)
            keys = [k[rows] for k in (self.key_i, self.key_j, self.calibration_key)]
            pose_i, pose_j = np.split(lookup.poses(values, np.concatenate(keys[:2])), 2)
            error, *jacobians = displacement_residual(
                pose_i[:, :3, :3], pose_i[:, :3, 3], pose_j[:, :3, :3], pose_j[:, :3, 3],
                lookup.vectors(values, keys[2]), self.distance_m[rows], self.mean_b[rows], self.lever_arm_b,
            )  # fmt: skip
            b = -error / self.sigma_m[rows]
            a_i, a_j, a_c = (jacobian / self.sigma_m[rows, :, None] for jacobian in jacobians)
            first, second, calibration = (k.tolist() for k in keys)
            for i, by_i, j, by_j, c, by_c, e in zip(first, a_i, second, a_j, calibration, a_c, b, strict=True):
                linear.add(i, by_i, j, by_j, c, by_c, e, unit)

    def factor(self, k: int) -> gtsam.CustomFactor:
        """The k-th one alone, for an incremental solver."""
        return displacement_factor(
            int(self.key_i[k]), int(self.key_j[k]), int(self.calibration_key[k]), float(self.distance_m[k]),
            self.mean_b[k], diagonal(self.sigma_m[k]), self.lever_arm_b,
        )  # fmt: skip
