"""Motions that a camera (or anything fixed to the machine) measured, beside other sensors: its mounting may be unknown.

`residual` is the one measurement model; `MotionFamily` linearizes all motions of a log at once, with a loss against
those that are wrong. Where nothing is unknown of the mounting, `factors.relative_pose.between_factor` of the motions
`seen_from` the body is the same to first order, and native.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from factors import lookup, so3
from factors.carried import CAMERA_ERRORS, Carried, Moments
from factors.increments import npt_int
from factors.relative_pose import Motions
from factors.robust import Loss, reweighted
from factors.so3 import Array

if TYPE_CHECKING:
    import gtsam

#: Rows of an error: rotation, position.
_ROWS = 6


def residual(
    pose_i: Array, pose_j: Array, mounting: Array, rotation_bc: Array, pos_bc: Array, measured: Motions
) -> tuple[Array, Array, Array, Array]:
    """Error of measured motions of c, which is fixed to b.

    With ``T_bc = (R(rotation_bc) Exp(delta), pos_bc + d)`` the motion of c is ``T = T_bc^-1 T_i^-1 T_j T_bc`` (the
    roadheader paper's equations 12 and 16 for a camera off the machine's centre); the error is ``Log(R_m^T R)`` and
    ``R_m^T (p - p_m)``, which to first order is that of ``T = measured Exp(e)``.

    Parameters
    ----------
    pose_i, pose_j : (K, 4, 4) poses T_nb at both ends.
    mounting : (K, 6) errors of the mounting: angles delta about c's axes (rad), place d in b (m).
    rotation_bc, pos_bc : (3, 3), (3,) the mounting as declared.
    measured : K motions ``T_from_to`` of c.

    Returns
    -------
    error (K, 6) rad and m, and its Jacobians (K, 6, 6) by both poses (right perturbation) and by the mounting.
    """
    turn_bc, place = rotation_bc @ so3.exp(mounting[:, :3]), pos_bc + mounting[:, 3:]
    back, back_i = so3.transpose(turn_bc), so3.transpose(pose_i[:, :3, :3])
    turn_ij = back_i @ pose_j[:, :3, :3]
    end_b = _times(back_i, pose_j[:, :3, 3] - pose_i[:, :3, 3]) + _times(turn_ij, place)
    turn_c, pos_c = back @ turn_ij @ turn_bc, _times(back, end_b - place)
    to_measured = so3.transpose(measured.rotation)
    angle = so3.log(to_measured @ turn_c)
    error = np.concatenate([angle, _times(to_measured, pos_c - measured.pos)], axis=1)
    by_angle, moved = np.linalg.inv(so3.right_jacobian(angle)), to_measured @ back
    by_i, by_j, by_mounting = np.zeros((3, len(error), _ROWS, 6))
    by_i[:, :3, :3] = -by_angle @ so3.transpose(turn_c) @ back
    by_j[:, :3, :3] = by_angle @ back
    as_vector = so3.right_jacobian(mounting[:, :3])  # delta is a vector, not a perturbation
    by_mounting[:, :3, :3] = by_angle @ (np.eye(3) - so3.transpose(turn_c)) @ as_vector
    by_i[:, 3:, :3], by_i[:, 3:, 3:] = moved @ so3.skew(end_b), -moved
    by_j[:, 3:, :3], by_j[:, 3:, 3:] = -moved @ turn_ij @ so3.skew(place), moved @ turn_ij
    by_mounting[:, 3:, :3] = to_measured @ so3.skew(pos_c) @ as_vector
    by_mounting[:, 3:, 3:] = moved @ (turn_ij - np.eye(3))
    return error, by_i, by_j, by_mounting


@dataclass(frozen=True)
class MotionFamily:
    """All measured motions of a log as arrays: linearized at once.

    Attributes
    ----------
    key_i, key_j : (K,) keys of the poses at both ends.
    camera_key : of the 8-vector of the camera's errors (mounting; disparity, which is none of a motion's; how much
        later than stamped its images are, s), or None.
    measured : K motions of c, with their covariances.
    rotation_bc, pos_bc : (3, 3), (3,) the mounting as declared.
    loss, scale : of an error's length in sigmas, see `factors.robust`.
    moments_i, moments_j : of the poses, where the clock may be off; None: it is right.
    """

    key_i: npt_int
    key_j: npt_int
    camera_key: int | None
    measured: Motions
    rotation_bc: Array
    pos_bc: Array
    loss: Loss = "none"
    scale: float = 3.0
    moments_i: Moments | None = None
    moments_j: Moments | None = None

    @property
    def size(self) -> int:
        """Rows of one error."""
        return _ROWS

    def only(self, rows: npt_int | np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> MotionFamily:
        """Some of the motions."""
        m = self.measured
        some = Motions(m.rotation[rows], m.pos[rows], m.cov[rows])
        i, j = (None if each is None else each.only(rows) for each in (self.moments_i, self.moments_j))
        return replace(
            self, key_i=self.key_i[rows], key_j=self.key_j[rows], measured=some, moments_i=i, moments_j=j
        )  # fmt: skip

    def residuals(self, values: gtsam.Values) -> tuple[Array, list[Array]]:
        """Whitened errors (K, 6) and Jacobians by both poses (K, 6, 6) and the camera's errors (K, 6, 8)."""
        unknown = np.zeros(CAMERA_ERRORS) if self.camera_key is None else values.atVector(self.camera_key)
        i, j = (
            Carried.by(lookup.poses(values, keys), moments, float(unknown[7]))
            for keys, moments in ((self.key_i, self.moments_i), (self.key_j, self.moments_j))
        )
        mounting = np.broadcast_to(unknown[:6], (len(i.pose), 6))
        error, *by = residual(i.pose, j.pose, mounting, self.rotation_bc, self.pos_bc, self.measured)
        by_time = by[0] @ i.by_time[..., None] + by[1] @ j.by_time[..., None]
        by = [by[0] @ i.by_pose, by[1] @ j.by_pose, np.concatenate([by[2], np.zeros_like(by_time), by_time], axis=2)]
        root = np.linalg.inv(np.linalg.cholesky(self.measured.cov))
        return _times(root, error), [root @ each for each in by[: 2 if self.camera_key is None else 3]]

    def off(self, values: gtsam.Values) -> Array:
        """Length (K,) of each whitened error."""
        return np.asarray(np.linalg.norm(self.residuals(values)[0], axis=1))

    def weighted(self, values: gtsam.Values) -> tuple[Array, list[Array], float]:
        """Whitened errors and Jacobians with the loss's weights, and what the loss has beyond half their squares."""
        return reweighted(*self.residuals(values), self.loss, self.scale)

    def linearize_into(self, linear: gtsam.GaussianFactorGraph, values: gtsam.Values) -> None:
        """Append the whitened Jacobian factors at `values`."""
        import gtsam

        if not len(self.key_i):
            return
        error, by, excess = self.weighted(values)
        unit = gtsam.noiseModel.Unit.Create(_ROWS)
        e = self.camera_key
        for k, (i, j) in enumerate(zip(self.key_i.tolist(), self.key_j.tolist(), strict=True)):
            if e is None:
                linear.push_back(gtsam.JacobianFactor(i, by[0][k], j, by[1][k], -error[k], unit))
            else:
                linear.push_back(gtsam.JacobianFactor(i, by[0][k], j, by[1][k], e, by[2][k], -error[k], unit))
        # a row of no variable's makes the linear graph's error that of the loss
        rest = np.array([np.sqrt(max(excess, 0.0))])
        linear.push_back(
            gtsam.JacobianFactor(int(self.key_i[0]), np.zeros((1, 6)), rest, gtsam.noiseModel.Unit.Create(1))
        )

    def factor(self, k: int) -> gtsam.CustomFactor:
        """The k-th motion alone, evaluated anew wherever it is linearized, for an incremental solver."""
        import gtsam

        alone = self.only(np.array([k]))
        keys = [int(self.key_i[k]), int(self.key_j[k])] + ([] if self.camera_key is None else [self.camera_key])

        def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
            whitened, by, _ = alone.weighted(values)
            if jacobians is not None:
                for row, jacobian in enumerate(by):
                    jacobians[row] = jacobian[0]
            return np.asarray(whitened[0])

        return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(_ROWS), keys, error)


def _times(matrix: Array, vectors: Array) -> Array:
    out: Array = (matrix @ vectors[..., None])[..., 0]
    return out
