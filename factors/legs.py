"""All readings of legs in a log as arrays: linearized at once, several times faster than one by one.

The residual of each is that of `factors.landmark.leg_residual`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np

from factors import lookup
from factors.increments import npt_int
from factors.known import block_factor
from factors.landmark import ANGLE_BIAS, MOUNTING, leg_rows
from factors.leg_groups import LegGroups, grouped
from factors.so3 import Array

if TYPE_CHECKING:
    import gtsam

#: Groups of readings linearized at once, which bounds the memory.
_BLOCK = 512


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

    @cached_property
    def _spread(self) -> Array:
        """(K, 3, 8) `spread` by the calibration's own numbers."""
        acts = np.eye(7, 8)
        acts[[5, 6, ANGLE_BIAS], MOUNTING] = self.rotation_bs.T
        return self.spread @ acts

    @cached_property
    def _groups(self) -> LegGroups:
        return grouped(self.pose_key, self.calibration_key, self.leg_key)

    @cached_property
    def _reading(self) -> Array:
        """(K, 4) range, angle, height and height above the plane."""
        return np.column_stack([self.range_m, self.angle_rad, self.height_m, self.off_plane_m])

    def residuals(self, values: gtsam.Values, rows: slice = slice(None)) -> tuple[Array, Array, Array, Array]:
        """`leg_residual` of some of the readings, whitened, with Jacobians by pose, leg and calibration."""
        pose = lookup.poses(values, self.pose_key[rows])
        different, which = np.unique(self.calibration_key[rows], return_inverse=True)
        error, by_pose, by_leg, by_calibration = leg_rows(
            pose[:, :3, :3], pose[:, :3, 3], self.turn_b[rows], self.shift_n[rows],
            lookup.vectors(values, self.leg_key[rows]), self._reading[rows], self._spread[rows],
            which, lookup.vectors(values, different), self.rotation_bs, self.lever_arm_b,
        )  # fmt: skip
        sigma = self.sigma[rows]
        return error / sigma, by_pose / sigma[..., None], by_leg / sigma[..., None], by_calibration / sigma[..., None]

    def linearize_into(self, linear: gtsam.GaussianFactorGraph, values: gtsam.Values) -> None:
        """Append whitened Jacobian factors at `values`, each of the readings of one pose and calibration."""
        import gtsam

        groups = self._groups
        for lo in range(0, len(groups.keys), _BLOCK):
            some = slice(lo, min(lo + _BLOCK, len(groups.keys)))
            rows = slice(groups.first[some.start], groups.first[some.stop])
            error, by_pose, by_leg, by_calibration = self.residuals(values, rows)
            if self.loss is not None:
                weight, more = _cauchy(error, self.loss)
                error = weight[:, None] * error
                by_pose, by_leg, by_calibration = (
                    weight[:, None, None] * by for by in (by_pose, by_leg, by_calibration)
                )
                # a row of no variable's makes the linear graph's error that of the loss
                held = int(self.calibration_key[rows.start])
                linear.push_back(gtsam.JacobianFactor(held, np.zeros((1, 8)), np.array([more]), _unit(1)))
            matrices = groups.side_by_side(some, error, by_pose, by_leg, by_calibration)
            for keys, sizes, augmented in zip(groups.keys[some], groups.sizes[some], matrices, strict=True):
                linear.push_back(block_factor(keys, sizes, augmented))

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
