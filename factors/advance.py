"""Advance of a support: its leg in one cycle and in the next, apart by the measured push.

Not in the papers: they carry position from cycle to cycle by the conveyor alone (closed path, Zheng et al. 2021,
equation 6). Supports are drawn up to the conveyor by the same push, so their legs say it once more, support by support.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from factors import lookup
from factors.increments import npt_int
from factors.so3 import Array

if TYPE_CHECKING:
    import gtsam


@dataclass(frozen=True)
class AdvanceFamily:
    """Pairs of legs (`factors.landmark`) a push apart: ``e = r'(x_j - x_i) - push``, x the place, r across the face.

    Along the face the creep comes in, which the closed path holds far better at its ends, so that row is left out. The
    push moves the foot; what a lean makes of it at the height of the place is noise here. As a part of the error it
    was measured to pull the machine's height by two sigmas, through leans that are hardly known.

    Attributes
    ----------
    key_i, key_j : (A,) legs before and after the push.
    across_n : (2,) unit vector east, north to the right of the face's forward direction.
    push_m, sigma_m : (A,).
    """

    key_i: npt_int
    key_j: npt_int
    across_n: Array
    push_m: Array
    sigma_m: Array

    def residuals(self, values: gtsam.Values) -> Array:
        """Errors (A,), m."""
        apart = lookup.vectors(values, self.key_j) - lookup.vectors(values, self.key_i)
        return np.asarray(apart[:, :2] @ self.across_n - self.push_m)

    def linearize_into(self, linear: gtsam.GaussianFactorGraph, values: gtsam.Values) -> None:
        """Append the whitened Jacobian factors at `values`."""
        import gtsam

        unit = gtsam.noiseModel.Unit.Create(1)
        by_j = np.r_[self.across_n, 0.0, 0.0] / self.sigma_m[:, None, None]
        right = -(self.residuals(values) / self.sigma_m)[:, None]
        for i, j, by, b in zip(self.key_i.tolist(), self.key_j.tolist(), by_j, right, strict=True):
            linear.add(i, -by, j, by, b, unit)
