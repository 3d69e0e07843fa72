"""Covariance of one clique from that of its parent, compiled: tens of thousands of matrices of ten to a hundred rows.

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
