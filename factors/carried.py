"""Poses a moment after those of keyframes: what a camera sees is stamped by a clock of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors import so3
from factors.increments import npt_int
from factors.so3 import Array

#: A camera's errors: angles (3) and place (3) of its mounting, what disparities are too large by, how late it is.
CAMERA_ERRORS = 8


@dataclass(frozen=True)
class Moments:
    """How a body went on from poses T_nb for a while, and how it moves then.

    Attributes
    ----------
    turn_b, shift_b : (K, 3, 3) and (K, 3) m, from the pose to that `later_s` after it, in b at the pose.
    twist_b : (K, 6) rate (rad/s) and velocity (m/s) then, in b.
    """

    later_s: float
    turn_b: Array
    shift_b: Array
    twist_b: Array

    def only(self, rows: npt_int | np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> Moments:
        """Some of them, or some several times."""
        return Moments(self.later_s, self.turn_b[rows], self.shift_b[rows], self.twist_b[rows])


@dataclass(frozen=True)
class Carried:
    """Poses (K, 4, 4) a moment later; by_pose (K, 6, 6), by_time (K, 6): of their perturbation on the right."""

    pose: Array
    by_pose: Array
    by_time: Array

    @classmethod
    def by(cls, pose: Array, moments: Moments | None, later_s: float) -> Carried:
        """Carried on along the known motion, and from its end by rate w and velocity v: ``(Exp(w d), v d)``.

        Exact where the body neither accelerates nor turns other than about w in the time d that is left; what it does
        grows with the square of that.

        Parameters
        ----------
        pose : (K, 4, 4) T_nb; moments : None where nothing is known of a motion: then the time makes no difference.
        """
        count = len(pose)
        if moments is None:
            return cls(pose, np.broadcast_to(np.eye(6), (count, 6, 6)), np.zeros((count, 6)))
        rate, velocity = moments.twist_b[:, :3], moments.twist_b[:, 3:]
        left_s = later_s - moments.later_s
        on = so3.exp(rate * left_s)
        turn, shift = moments.turn_b @ on, moments.shift_b + _times(moments.turn_b, velocity * left_s)
        back = so3.transpose(turn)
        moved, by_pose = pose.copy(), np.zeros((count, 6, 6))
        moved[:, :3, :3] = pose[:, :3, :3] @ turn
        moved[:, :3, 3] += _times(pose[:, :3, :3], shift)
        by_pose[:, :3, :3] = by_pose[:, 3:, 3:] = back
        by_pose[:, 3:, :3] = -back @ so3.skew(shift)
        return cls(moved, by_pose, np.column_stack([rate, _times(so3.transpose(on), velocity)]))


def _times(matrix: Array, vectors: Array) -> Array:
    out: Array = (matrix @ vectors[..., None])[..., 0]
    return out
