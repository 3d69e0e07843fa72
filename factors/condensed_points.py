"""Points seen from poses, eliminated before a solver sees them: what is left ties the poses alone.

With whitened rows ``A x + B p + r`` of one point p and ``L L' = B'B``, the point at its best given x takes
``|L^-1 B' (A x + r)|^2`` off the square of its rows (the Schur complement: B. Triggs et al., Bundle adjustment - a
modern synthesis, 1999, section 6.1). All points at once as arrays; what is left of points seen from the same stretch of
poses becomes one factor, by a pivoted Cholesky decomposition of its information.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg.lapack import dpstrf

from factors.increments import npt_int
from factors.known import block_factor
from factors.so3 import Array, transpose

if TYPE_CHECKING:
    import gtsam

#: Points whose first poses are this near to each other, counted in poses, are condensed into one factor.
_NEAR = 8
#: Eigenvalues below this share of the diagonal are round-off.
_ROUND_OFF = 1e-14


@dataclass(frozen=True)
class PointRows:
    """Whitened rows of points, those of one point behind each other.

    Attributes
    ----------
    pose_key, point_key : (K,) what each reading ties; common_key : what all of them are tied to, or None.
    by_pose, by_point, beside : (K, R, 6), (K, R, 3), (K, R, C) Jacobians and, as the last column of `beside`, errors.
    """

    pose_key: npt_int
    point_key: npt_int
    common_key: int | None
    by_pose: Array
    by_point: Array
    beside: Array

    @classmethod
    def sorted(
        cls, pose_key: npt_int, point_key: npt_int, common_key: int | None, error: Array, by: list[Array]
    ) -> PointRows:
        """From errors (K, R) and Jacobians by pose, point and, where there is one, the common variable."""
        order = np.lexsort((pose_key, point_key))
        beside = np.concatenate([*by[2:], error[..., None]], axis=2)
        return cls(pose_key[order], point_key[order], common_key, by[0][order], by[1][order], beside[order])


@dataclass(frozen=True)
class Condensed:
    """Points that were eliminated.

    Attributes
    ----------
    rows : of theirs; start : (J,) the first of each point; inverse_root : (J, 3, 3) ``L^-1``.
    by_pose : (K, 3, 6) ``L^-1 B' A`` of each reading; beside : (J, 3, C) the same of `PointRows.beside`, summed.
    """

    rows: PointRows
    start: npt_int
    inverse_root: Array
    by_pose: Array
    beside: Array

    @classmethod
    def of(cls, rows: PointRows, hold: float) -> Condensed:
        """Eliminate; `hold` is the information that holds each point to where it is."""
        start = np.unique(rows.point_key, return_index=True)[1]
        information = np.add.reduceat(transpose(rows.by_point) @ rows.by_point, start) + hold * np.eye(3)
        inverse_root = np.linalg.inv(np.linalg.cholesky(information))
        which = np.repeat(np.arange(len(start)), np.diff(start, append=len(rows.point_key)))
        left = inverse_root[which] @ transpose(rows.by_point)
        beside = np.add.reduceat(left @ rows.beside, start)
        return cls(rows, start, inverse_root, left @ rows.by_pose, beside)

    @property
    def gain(self) -> float:
        """What the points' own steps take off the error (half the sum of squares) where nothing else moves."""
        return float(0.5 * np.square(self.beside[..., -1]).sum())

    def complete(self, delta: gtsam.VectorValues) -> None:
        """Add the points' steps to that of all else."""
        keys, which = np.unique(self.rows.pose_key, return_inverse=True)
        steps = np.array([delta.at(key) for key in keys.tolist()])
        moved = np.add.reduceat((self.by_pose @ steps[which][..., None])[..., 0], self.start) + self.beside[..., -1]
        if self.rows.common_key is not None:
            moved += self.beside[..., :-1] @ delta.at(self.rows.common_key)
        found = -(transpose(self.inverse_root) @ moved[..., None])[..., 0]
        for key, step in zip(self.rows.point_key[self.start].tolist(), found, strict=True):
            delta.insert(key, step)

    def linearize_into(self, linear: gtsam.GaussianFactorGraph) -> None:
        """Append what is left: a whitened Jacobian factor for each group of points."""
        common = [] if self.rows.common_key is None else [self.rows.common_key]
        for keys, information in self._groups():
            root = _root(information)
            root[:, -1] *= -1
            sizes = [6] * len(keys) + [self.beside.shape[2] - 1] * len(common)
            linear.push_back(block_factor(keys + common, sizes, root))

    def _groups(self) -> Iterator[tuple[list[int], Array]]:
        """Keys of the poses that a group of points was seen from, and the information on them and on `beside`."""
        rows, width = self.rows, self.beside.shape[2]
        keys, pose = np.unique(rows.pose_key, return_inverse=True)
        own = transpose(rows.by_pose) @ np.concatenate([rows.by_pose, rows.beside], axis=2)
        for points, readings, point in self._alike(pose):
            order = np.argsort(pose[readings], kind="stable")
            used, first, column = np.unique(pose[readings][order], return_index=True, return_inverse=True)
            seen = np.zeros((len(points), len(used), 3, 6))
            seen[point[order], column] = self.by_pose[readings[order]]
            taken = seen.transpose(0, 2, 1, 3).reshape(3 * len(points), -1)
            taken = np.concatenate([taken, self.beside[points].reshape(len(taken), width)], axis=1)
            information = -taken.T @ taken
            end, sums = 6 * len(used), np.add.reduceat(own[readings[order]], first)
            for k, block in enumerate(sums):
                here = slice(6 * k, 6 * k + 6)
                information[here, here] += block[:, :6]
                information[here, end:] += block[:, 6:]
            information[end:, :end] = information[:end, end:].T
            beside = rows.beside[readings].reshape(-1, width)
            information[end:, end:] += beside.T @ beside
            yield keys[used].tolist(), information

    def _alike(self, pose: npt_int) -> Iterator[tuple[npt_int, npt_int, npt_int]]:
        """Points of one group, their readings, and which of the points each reading is of.

        Points are alike that are first seen from poses near to each other, and for about as long.
        """
        count = np.diff(self.start, append=len(pose))
        first, last = pose[self.start], pose[self.start + count - 1]
        label = (first // _NEAR) * 64 + np.ceil(np.log2(last - first + 1)).astype(int)
        order = np.argsort(label, kind="stable")
        for points in np.split(order, np.flatnonzero(np.diff(label[order])) + 1):
            of = np.repeat(np.arange(len(points)), count[points])
            within = np.arange(len(of)) - np.repeat(np.cumsum(count[points]) - count[points], count[points])
            yield points, self.start[points][of] + within, of


def _root(information: Array) -> Array:
    """S (rank, n) with ``S'S`` the information."""
    scale = np.sqrt(np.maximum(information.diagonal(), np.finfo(float).tiny))
    upper, pivots, rank, _ = dpstrf(information / np.outer(scale, scale), tol=_ROUND_OFF * len(scale))
    root = np.zeros((rank, len(scale)))
    root[:, pivots - 1] = np.triu(upper)[:rank]
    return np.asarray(root * scale)
