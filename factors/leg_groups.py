"""Readings of legs in few factors: those of one pose side by side, as a factor costs more than what is in it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from factors.compilation import compiled
from factors.increments import npt_int
from factors.so3 import Array

#: Columns of the pose and of the calibration, which stand before those of the legs.
_POSE, _CALIBRATION, _LEG = 6, 8, 4
#: Readings in one factor at most; twice as many save no more time, and make the columns of each longer.
_TOGETHER = 8


@dataclass(frozen=True)
class LegGroups:
    """Which readings make one factor: successive ones of one pose and calibration.

    Attributes
    ----------
    first : (G + 1,) first reading of each, and the number of readings.
    keys, sizes : of the variables of each: pose, calibration, and each leg once.
    column : (K,) where the columns of a reading's leg start.
    """

    first: npt_int
    keys: list[list[int]]
    sizes: list[list[int]]
    column: npt_int

    def side_by_side(self, group: slice, error: Array, by_pose: Array, by_leg: Array, by_cal: Array) -> list[Array]:
        """Of each of some groups all blocks and minus the error, by columns, from those of its readings (K, 2, ...)."""
        first = self.first[group.start : group.stop + 1]
        columns = np.array([sum(sizes) + 1 for sizes in self.sizes[group]])
        rows = 2 * np.diff(first)
        at = np.r_[0, np.cumsum(rows * columns)]
        flat = np.zeros(at[-1])
        _place(first - first[0], at, rows, self.column[first[0] : first[-1]], error, by_pose, by_leg, by_cal, flat)
        shapes = zip(pairwise(at.tolist()), columns.tolist(), rows.tolist(), strict=True)
        return [flat[lo:hi].reshape(wide, high).T for (lo, hi), wide, high in shapes]


def grouped(pose_key: npt_int, calibration_key: npt_int, leg_key: npt_int) -> LegGroups:
    """Successive readings of one pose and calibration, not too many together."""
    changed = (np.diff(pose_key) != 0) | (np.diff(calibration_key) != 0)
    start = np.r_[0, np.flatnonzero(changed) + 1]
    position = np.arange(len(pose_key)) - np.repeat(start, np.diff(np.r_[start, len(pose_key)]))
    first = np.r_[np.flatnonzero(position % _TOGETHER == 0), len(pose_key)]
    poses, calibrations, legs = pose_key.tolist(), calibration_key.tolist(), leg_key.tolist()
    keys, sizes, column = [], [], []
    for lo, hi in pairwise(first.tolist()):
        place = {leg: _POSE + _CALIBRATION + _LEG * k for k, leg in enumerate(dict.fromkeys(legs[lo:hi]))}
        column += [place[leg] for leg in legs[lo:hi]]
        keys.append([poses[lo], calibrations[lo], *place])
        sizes.append([_POSE, _CALIBRATION] + [_LEG] * len(place))
    return LegGroups(first, keys, sizes, np.array(column, np.int64))


@compiled
def _place(
    first: npt_int,
    at: npt_int,
    rows: npt_int,
    column: npt_int,
    error: Array,
    by_pose: Array,
    by_leg: Array,
    by_calibration: Array,
    flat: Array,
) -> None:
    """Blocks of each group's readings into `flat` from `at` on, by columns."""
    for g in range(len(rows)):
        high, end = rows[g], at[g + 1]
        for k in range(first[g], first[g + 1]):
            for i in range(2):
                row = at[g] + 2 * (k - first[g]) + i
                for j in range(_POSE):
                    flat[row + j * high] = by_pose[k, i, j]
                for j in range(_CALIBRATION):
                    flat[row + (_POSE + j) * high] = by_calibration[k, i, j]
                for j in range(_LEG):
                    flat[row + (column[k] + j) * high] = by_leg[k, i, j]
                flat[end - high + 2 * (k - first[g]) + i] = -error[k, i]
