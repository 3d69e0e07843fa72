"""Ranges stamped by a clock that is off: where the tag was a little before or after the time it was carried to.

A range stamped t measured the tag at ``t + d``. The motion is carried to ``t + d_0`` by the samples, and from there on
with that moment's rate and specific force held constant, so for ``d`` near ``d_0``
``R <- R Exp(w e), v <- v + R f e, p <- p + v e + R f e^2 / 2`` with ``e = d - d_0`` (one step of the kinematics of C.
Forster et al., IEEE T-RO 33 (2017), section V). The range changes with d by the ray times the tag's velocity,
``v_n + R (w x l)``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from factors import so3
from factors.increments import Samples, npt_int
from factors.inertial import Motion
from factors.so3 import Array

if TYPE_CHECKING:
    import gtsam


@dataclass(frozen=True)
class TimeOffset:
    """The time offset that K ranges share, a variable.

    Attributes
    ----------
    key : of the offset d (1-vector), s; carried_s : the one that the motions were carried with.
    rate_b, force_b : (K, 3) at those times, less the biases carried with, rad/s and m/s^2.
    """

    key: int
    carried_s: float
    rate_b: Array
    force_b: Array

    @classmethod
    def at(cls, key: int, carried_s: float, samples: Samples, t_s: Array, gyro_b: Array, accel_b: Array) -> TimeOffset:
        """With the samples at t_s (K,), which are shifted already, less biases (K, 3)."""
        sample = np.clip(np.searchsorted(samples.edge_s, t_s) - 1, 0, len(samples.gyro_b) - 1)
        return cls(key, carried_s, samples.gyro_b[sample] - gyro_b, samples.accel_b[sample] - accel_b)

    def only(self, rows: npt_int | np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> TimeOffset:
        """That of some of the ranges."""
        return TimeOffset(self.key, self.carried_s, self.rate_b[rows], self.force_b[rows])

    def moved(self, motion: Motion, values: gtsam.Values) -> Motion:
        """The motions up to where the tag was by the offset in `values`."""
        more = float(values.atVector(self.key)[0]) - self.carried_s
        force = np.einsum("kij,kj->ki", motion.rotation, self.force_b)
        return Motion(
            motion.first,
            motion.elapsed_s + more,
            motion.rotation @ so3.exp(more * self.rate_b),
            motion.velocity_b + more * force,
            motion.position_b + more * motion.velocity_b + more**2 / 2 * force,
        )

    def tag_velocity(self, rotation_nb: Array, vel_n: Array, gyro_b: Array, lever_arm_b: Array) -> Array:
        """Of the tag in n (K, 3), with the body's attitude and velocity there; gyro_b (K, 3) : change of bias."""
        turning = np.cross(self.rate_b - gyro_b, lever_arm_b)
        return np.asarray(vel_n + np.einsum("kij,kj->ki", rotation_nb, turning))
