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

from dataclasses import dataclass, fields, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from factors import lookup, so3
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
    to_s = so3.transpose(so3.exp(calibration[..., MOUNTING]) @ rotation_bs)
    away_n, above = _cut(rotation_nb, pos_n, leg_n, height_m, off_plane_m, to_s, lever_arm_b)
    away_b = np.einsum("...ji,...j->...i", rotation_nb, away_n)
    away_s = np.einsum("...ij,...j->...i", to_s, away_b)
    error, by_away, jac_calibration = _range_bearing(away_s, calibration, range_m, angle_rad)
    # any change is followed along the line until the point lies in the scan plane again
    line_n = np.concatenate([leg_n[..., 2:], np.ones((*leg_n.shape[:-1], 1))], axis=-1)
    line_s = np.einsum("...ij,...j->...i", to_s, np.einsum("...ji,...j->...i", rotation_nb, line_n))
    slid = by_away - (by_away @ line_s[..., None]) * np.array([0.0, 0.0, 1.0]) / line_s[..., 2, None, None]
    by_b = slid @ to_s
    jac_pose = np.concatenate([by_b @ so3.skew(away_b + lever_arm_b), -by_b], axis=-1)
    by_place = (by_b @ so3.transpose(rotation_nb))[..., :2]
    jac_leg = np.concatenate([by_place, by_place * above[..., None, None]], axis=-1)
    jac_calibration[..., MOUNTING] = slid @ _by_mounting(calibration, rotation_bs, away_b)
    return error, jac_pose, jac_leg, jac_calibration


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


def _cut(
    rotation_nb: Array,
    pos_n: Array,
    leg_n: Array,
    height_m: Array,
    off_plane_m: Array | float,
    to_s: Array,
    lever_arm_b: Array,
) -> tuple[Array, Array]:
    """From the scanner to where its plane cuts the line, (..., 3) in n, and the cut's height above h0 (...,)."""
    axis_n = np.einsum("...ij,...j->...i", rotation_nb, to_s[..., 2, :])
    scanner_n = pos_n + np.einsum("...ij,j->...i", rotation_nb, lever_arm_b)
    start, lean = leg_n[..., :2] - scanner_n[..., :2], leg_n[..., 2:]
    rise = height_m - scanner_n[..., 2]
    tilt = np.einsum("...i,...i->...", axis_n[..., :2], lean) + axis_n[..., 2]
    level = np.einsum("...i,...i->...", axis_n[..., :2], start) + axis_n[..., 2] * rise
    above = (off_plane_m - level) / tilt
    return np.concatenate([start + lean * above[..., None], (rise + above)[..., None]], axis=-1), above


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


def _cauchy(error: Array, loss: float) -> tuple[Array, float]:
    """Square roots (K,) of the weights of whitened errors (K, 2), and what the losses exceed the weighted squares by.

    ``rho = c^2 / 2 log(1 + m^2 / c^2)`` with m the length of the error, weight ``1 / (1 + m^2 / c^2)``; the excess is
    given as the residual of a row.
    """
    squared = (error**2).sum(axis=1)
    weight = 1 / (1 + squared / loss**2)
    excess = (loss**2 * np.log1p(squared / loss**2) - weight * squared).sum()
    return np.sqrt(weight), float(np.sqrt(max(excess, 0.0)))


def _unit(size: int) -> gtsam.noiseModel.Unit:
    import gtsam

    return gtsam.noiseModel.Unit.Create(size)


@dataclass(frozen=True)
class LegFamily:
    """All readings of legs in a log as arrays: linearized at once, several times faster than one by one.

    Attributes
    ----------
    pose_key, leg_key, calibration_key : (K,) keys.
    turn_b, shift_n : (K, 3, 3) and (K, 3) from the pose to that in which the reading was taken: a turn in the body's
        frame, as gyros measure it, and a displacement in n. In the body's frame it would tell the heading: where a
        path leads is known far better than where the machine points.
    range_m, angle_rad, height_m, off_plane_m : (K,); sigma : (K, 2) in m and rad.
    spread : (K, 3, 7) added to the error, and to `off_plane_m` as measured, per unit of the calibration's first five
        and per radian about the scanner's right and forward axes: a mean of detections is not displaced by them quite
        as a detection at the mean would be. A turn about the plane's normal acts as a bias of the angle.
    rotation_bs, lever_arm_b : (3, 3) and (3,) declared mounting of the scanner.
    loss : sigmas from which on a reading counts ever less (Cauchy's loss, on range and angle together), or None.
    """

    pose_key: npt_int
    leg_key: npt_int
    calibration_key: npt_int
    turn_b: Array
    shift_n: Array
    range_m: Array
    angle_rad: Array
    height_m: Array
    off_plane_m: Array
    spread: Array
    sigma: Array
    rotation_bs: Array
    lever_arm_b: Array
    loss: float | None = None

    @property
    def _acts(self) -> Array:
        """(7, 8) what the calibration's numbers are in those of `spread`."""
        found = np.eye(7, 8)
        found[[5, 6, ANGLE_BIAS], MOUNTING] = self.rotation_bs.T
        return found

    def residuals(self, values: gtsam.Values, rows: slice = slice(None)) -> tuple[Array, Array, Array, Array]:
        """`leg_residual` of some of the readings, whitened."""
        pose, turn = lookup.poses(values, self.pose_key[rows]), self.turn_b[rows]
        rotation, back = pose[:, :3, :3], so3.transpose(turn)
        calibration, more = lookup.vectors(values, self.calibration_key[rows]), self.spread[rows] @ self._acts
        moved = np.einsum("kij,kj->ki", more, calibration)
        error, by_moved, by_leg, by_calibration = leg_residual(
            rotation @ turn, pose[:, :3, 3] + self.shift_n[rows],
            lookup.vectors(values, self.leg_key[rows]), calibration,
            self.range_m[rows], self.angle_rad[rows], self.height_m[rows],
            self.rotation_bs, self.lever_arm_b, self.off_plane_m[rows] - moved[:, 2],
        )  # fmt: skip
        error += moved[:, :2]
        # a plane that is cut higher is as a scanner that stands higher
        axis_b = np.einsum("kij,j->ki", so3.exp(calibration[:, MOUNTING]), self.rotation_bs[:, 2])
        by_off = np.einsum("kij,kj->ki", by_moved[..., 3:], axis_b)
        by_calibration += more[:, :2] - by_off[..., None] * more[:, 2:]
        by_turn, by_shift = by_moved[..., :3] @ back, by_moved[..., 3:] @ back
        by_pose = np.concatenate([by_turn, by_shift], axis=-1)
        sigma = self.sigma[rows]
        return error / sigma, by_pose / sigma[..., None], by_leg / sigma[..., None], by_calibration / sigma[..., None]

    def linearize_into(self, linear: gtsam.GaussianFactorGraph, values: gtsam.Values, block: int = 4096) -> None:
        """Append the whitened Jacobian factors at `values`."""
        import gtsam

        unit = _unit(2)
        for lo in range(0, len(self.pose_key), block):
            rows = slice(lo, lo + block)
            error, by_pose, by_leg, by_calibration = self.residuals(values, rows)
            if self.loss is not None:
                weight, more = _cauchy(error, self.loss)
                error = weight[:, None] * error
                by_pose, by_leg, by_calibration = (
                    weight[:, None, None] * by for by in (by_pose, by_leg, by_calibration)
                )
                # a row of no variable's makes the linear graph's error that of the loss
                held = int(self.calibration_key[lo])
                linear.push_back(gtsam.JacobianFactor(held, np.zeros((1, 8)), np.array([more]), _unit(1)))
            parts = (
                self.pose_key[rows].tolist(), by_pose, self.leg_key[rows].tolist(), by_leg,
                self.calibration_key[rows].tolist(), by_calibration, -error,
            )  # fmt: skip
            for x, by_x, leg, by_l, d, by_d, b in zip(*parts, strict=True):
                linear.push_back(gtsam.JacobianFactor(x, by_x, leg, by_l, d, by_d, b, unit))

    def only(self, rows: npt_int) -> LegFamily:
        """Some of the readings."""
        of_reading = [f.name for f in fields(self) if f.name not in ("rotation_bs", "lever_arm_b", "loss")]
        return replace(self, **{name: getattr(self, name)[rows] for name in of_reading})

    def factors(self) -> list[gtsam.CustomFactor]:
        """One by one, whitened, for an incremental solver; the loss plays no part in them.

        They are evaluated together, at the first that is asked for at new values: those must hold the variables of all.
        """
        import gtsam

        shared = _Shared(self)
        keys = np.column_stack([self.pose_key, self.leg_key, self.calibration_key]).tolist()
        return [gtsam.CustomFactor(_unit(2), key, partial(shared.error, k, *key)) for k, key in enumerate(keys)]


class _Shared:
    """Residuals of a few readings at the values that were last asked for."""

    def __init__(self, family: LegFamily) -> None:
        self.family = family
        self.at: list[tuple[Array, Array, Array]] = []
        self.found: tuple[Array, Array, Array, Array] | None = None

    def error(
        self,
        k: int,
        pose_key: int,
        leg_key: int,
        calibration_key: int,
        factor: gtsam.CustomFactor,
        values: gtsam.Values,
        jacobians: list[Array] | None,
    ) -> Array:
        """Whitened error (2,) of reading k, and its Jacobians."""
        at = self._inputs(values, pose_key, leg_key, calibration_key)
        if self.found is None or any((a != b).any() for a, b in zip(at, self.at[k], strict=True)):
            keys = (self.family.pose_key, self.family.leg_key, self.family.calibration_key)
            self.at = [self._inputs(values, *key) for key in zip(*(each.tolist() for each in keys), strict=True)]
            self.found = self.family.residuals(values)
        if jacobians is not None:
            for row, jacobian in enumerate(self.found[1:]):
                jacobians[row] = jacobian[k]
        return np.asarray(self.found[0][k])

    @staticmethod
    def _inputs(values: gtsam.Values, pose_key: int, leg_key: int, calibration_key: int) -> tuple[Array, Array, Array]:
        return values.atPose3(pose_key).matrix(), values.atVector(leg_key), values.atVector(calibration_key)
