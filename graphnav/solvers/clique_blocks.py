"""Arithmetic of single cliques, compiled: tens of thousands of matrices of ten to a hundred rows.

In arrays of NumPy each product, selection and transposition costs as much as its arithmetic.
"""

from __future__ import annotations

import numpy as np

from factors.compilation import compiled
from factors.increments import npt_int
from factors.so3 import Array


@compiled
def squared_blocks(inverse: Array, s: Array, parent: Array, rows: npt_int, conditioned: float) -> tuple[Array, bool]:
    """``[[R^-1 R^-T + G P G', -G P], [., P]]`` with ``G = R^-1 S``, and whether it is well conditioned.

    Parameters
    ----------
    inverse, s : R^-1 (upper triangular) and S of the clique, rows contiguous.
    parent, rows : covariance of the parent, and the rows of the separator there.
    conditioned : least share that a sigma given the separator has of the sigma.
    """
    front, wide = s.shape
    cov = np.empty((front + wide, front + wide))
    separator = np.empty((wide, wide))
    for a in range(wide):
        of_parent, row = parent[rows[a]], separator[a]
        for b in range(wide):
            row[b] = of_parent[rows[b]]
    gain = np.dot(inverse, s)
    cross = -np.dot(gain, separator)
    given = np.dot(inverse, inverse.T)
    cov[:front, :front] = given - np.dot(cross, gain.T)
    cov[:front, front:] = cross
    good = True
    for i in range(front):
        good = good and given[i, i] > conditioned**2 * cov[i, i]
    for a in range(wide):
        for i in range(front):
            cov[front + a, i] = cross[i, a]
        cov[front + a, front:] = separator[a]
    return cov, good


@compiled
def add_squares(columns: Array, which: npt_int, start: npt_int, diagonal: Array, pivot: Array) -> int:
    """Add squares of a clique's columns to the diagonal of the information, note its pivots; number of its frontals.

    Parameters
    ----------
    columns : (n + 1, m) columns of ``[R S d]``, m those of R.
    which : number of each of its variables; start : where variable k begins in `diagonal` and `pivot`, and ends.
    """
    count, rows = len(which), columns.shape[1]
    column, frontals = 0, 0
    for k in range(count):
        for at in range(start[which[k]], start[which[k] + 1]):
            total = 0.0
            for row in range(rows):
                total += columns[column, row] ** 2
            diagonal[at] += total
            if column < rows:
                pivot[at] = columns[column, column]
            column += 1
        if column <= rows:
            frontals = k + 1
    return frontals
