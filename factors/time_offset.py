"""Ranges stamped by a clock that is off: where the tag was a little before or after the time it was carried to.

A range stamped t measured the tag at ``t + d``. Its motion is carried to ``t + d_0``, and from there on the tag goes
straight, by ``v (d - d_0)``: the range changes with d by the ray times v. With v the tag's mean velocity over as long
as d is uncertain (statistical linearization: A. Gelb, Applied Optimal Estimation, 1974, section 6.2), a vibration that
goes to and fro within it tells nothing of d; its velocity at one moment would.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from factors.increments import npt_int
from factors.so3 import Array

if TYPE_CHECKING:
    import gtsam


@dataclass(frozen=True)
class TimeOffset:
    """The time offset that K ranges share, a variable.

    Attributes
    ----------
    key : of the offset d (1-vector), s; carried_s : the one that the motions were carried with.
    velocity_n : (K, 3) of the tag about that time, lever arm and all, m/s.
    """

    key: int
    carried_s: float
    velocity_n: Array

    def only(self, rows: npt_int | np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> TimeOffset:
        """That of some of the ranges."""
        return TimeOffset(self.key, self.carried_s, self.velocity_n[rows])

    def moved_n(self, values: gtsam.Values) -> Array:
        """How far the tag went from where it is carried to, (K, 3) m."""
        return np.asarray((float(values.atVector(self.key)[0]) - self.carried_s) * self.velocity_n)

    def jacobian(self, ray_n: Array) -> Array:
        """Of the ranges with respect to the offset, (K, 1) m/s, for rays (K, 3) from anchor to tag."""
        return np.asarray(np.einsum("ki,ki->k", ray_n, self.velocity_n)[:, None])
