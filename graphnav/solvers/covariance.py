"""Covariances of all keyframes from the square-root information matrix.

GTSAM's marginals go through Cholesky and fail on sound problems. Here the Bayes tree that QR left is walked from its
roots: with ``R x_f + S x_p = d`` for the frontal variables f and the separator p of a clique, and ``P_pp = L_p L_p'``
known from the parent clique, ``P = L L'`` with ``L = [[R^-1, -R^-1 S L_p], [0, L_p]]`` (G. Golub and R. Plemmons,
Linear Algebra Appl. 34 (1980), in square-root form). Only orthogonal transformations and products: what comes out is
a covariance, whatever the ordering. The same recursion on P itself squares the condition number and was measured to
fail where closed-path factors tie cycles together (docs/decisions/0004); it is kept for the large separators of
landmarks, at a fifth of the cost, as long as every variable there is known to the others little better than to the
world.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache
from itertools import accumulate, islice
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.linalg.lapack import dgeqrf, dlange, dpotrf, dtrtri

from factors.increments import npt_int
from factors.so3 import Array
from graphnav.errors import SolveError
from graphnav.solvers.clique_blocks import squared_blocks

if TYPE_CHECKING:
    import gtsam


#: A sigma this large (rad, m, m/s) is round-off in place of information.
_NO_INFORMATION = 1e8
#: Cliques with a separator of at least this size keep P in place of its root ...
_LARGE = 80
#: ... unless a variable's sigma given the others is below this share of its own: P then loses eps / 1e-8 of itself.
_CONDITIONED = 1e-4


_ROWS = np.arange(1 << 16)
_LOWER = np.tri(_LARGE)


class _IllConditionedError(Exception):
    """P in place of its root would lose too much."""


class _Clique:
    """Joint covariance of one clique, as P or as a root of it: rows of each key, how many children still need it."""

    __slots__ = ("matrix", "rows", "squared", "waiting")

    def __init__(self, matrix: Array, rows: dict[int, slice], squared: bool, waiting: int) -> None:
        self.matrix, self.rows, self.squared, self.waiting = matrix, rows, squared, waiting

    def covariance(self, keys: Iterable[int]) -> Array:
        """Joint covariance of `keys`."""
        part = self._rows(keys)
        return part[:, self.columns(keys)] if self.squared else np.asarray(part @ part.T)

    def root(self, keys: Iterable[int], square: bool) -> Array:
        """A root of it, `square` or as wide as comes."""
        if self.squared:
            return _cholesky(self.covariance(keys))
        return _square(self._rows(keys)) if square else self._rows(keys)

    def _rows(self, keys: Iterable[int]) -> Array:
        return np.concatenate([self.matrix[self.rows[k]] for k in keys])

    def columns(self, keys: Iterable[int]) -> npt_int:
        return np.concatenate([_ROWS[self.rows[k]] for k in keys])


def joint_marginals(
    tree: gtsam.GaussianBayesTree,
    elimination_order: list[int],
    dims: Callable[[int], int],
    groups: dict[int, tuple[int, ...]],
    progress: Callable[[float, float], None] | None = None,
) -> dict[int, Array]:
    """Joint covariances of groups of variables.

    Parameters
    ----------
    tree : Bayes tree from QR elimination.
    elimination_order : keys in the order they were eliminated.
    dims : size of a variable by key.
    groups : name -> keys whose joint covariance is wanted; the keys of a group must share a factor, which guarantees
        that
        some clique holds them all.

    Returns
    -------
    name -> covariance, blocks in the order of the group's keys.

    Raises
    ------
    SolveError : a variable without information, by key.
    """
    try:
        return _marginals(tree, elimination_order, dims, groups, progress, _LARGE)
    except _IllConditionedError:
        return _marginals(tree, elimination_order, dims, groups, progress, None)


def _marginals(
    tree: gtsam.GaussianBayesTree,
    order: list[int],
    dims: Callable[[int], int],
    groups: dict[int, tuple[int, ...]],
    progress: Callable[[float, float], None] | None,
    large: int | None,
) -> dict[int, Array]:
    """As `joint_marginals`, with P for separators from `large` on, or roots throughout."""
    wanted: dict[int, list[int]] = {}
    for name, keys in groups.items():
        for key in keys:
            wanted.setdefault(key, []).append(name)
    found: dict[int, Array] = {}
    open_cliques: dict[int, _Clique] = {}
    owner: dict[int, int] = {}
    size = cache(dims)
    for done, key in enumerate(reversed(order)):
        if key in owner:
            continue
        before = len(owner)
        clique = _solve_clique(tree[key], open_cliques, owner, size, large)
        # a group that a factor holds is in the clique of whichever of it was eliminated first
        for frontal in islice(clique.rows, len(owner) - before):
            for name in wanted.get(frontal, ()):
                if name not in found and all(k in clique.rows for k in groups[name]):
                    found[name] = clique.covariance(groups[name])
        if progress is not None and done % 4096 == 0:
            progress(done, len(order))
    missing = set(groups) - set(found)
    if missing:
        raise SolveError(f"no clique holds all variables of group {min(missing)}")
    return found


def _solve_clique(
    node: Any, open_cliques: dict[int, _Clique], owner: dict[int, int], size: Callable[[int], int], large: int | None
) -> _Clique:
    conditional = node.conditional()
    if conditional.isConstrained():
        raise SolveError(
            "a hard constraint (a sigma of zero, or below 1e-8 in GTSAM's eyes) has no square-root information"
        )
    r, s = conditional.R(), conditional.S()
    keys = conditional.keys()
    ends = [*accumulate(map(size, keys), initial=0)]
    rows = dict(zip(keys, map(slice, ends, ends[1:]), strict=False))
    frontals = keys[: ends.index(len(r))]
    inverse, status = dtrtri(np.asfortranarray(r))
    if status != 0:
        raise SolveError.singular(ValueError(_name(frontals, rows, status - 1)))
    if not dlange("M", inverse) < _NO_INFORMATION:
        loose = np.flatnonzero(~(np.abs(inverse).max(axis=1) < _NO_INFORMATION))
        raise SolveError.singular(ValueError(_name(frontals, rows, int(loose[0]))))
    separators, squared, parent = keys[len(frontals) :], False, None
    if separators:
        # the parent holds the separator variable that was eliminated first, so it was opened last
        parent_id = max(map(owner.__getitem__, separators))
        parent = open_cliques[parent_id]
        squared = large is not None and s.shape[1] >= large
    children = node.nrChildren()
    if squared:
        matrix = _squared(inverse, s, parent, separators)
    else:
        # what is handed on stays square, lest it grow from child to child
        root = np.zeros((0, 0)) if parent is None else parent.root(separators, square=children > 0)
        matrix = _rooted(inverse, s, root)
    clique = _Clique(matrix, rows, squared, children)
    if parent is not None:
        parent.waiting -= 1
        if parent.waiting == 0:
            del open_cliques[parent_id]
    identity = len(owner)
    for key in frontals:
        owner[key] = identity
    if clique.waiting:
        open_cliques[identity] = clique
    return clique


def _rooted(inverse: Array, s: Array, separator_root: Array) -> Array:
    """A root of a clique's covariance from that of its separator: ``[[R^-1, -R^-1 S L_p], [0, L_p]]``."""
    front, (size, wide) = len(inverse), separator_root.shape
    root = np.zeros((front + size, front + wide))
    root[:front, :front] = inverse
    root[:front, front:] = -inverse @ (s @ separator_root)
    root[front:, front:] = separator_root
    return root


def _squared(inverse: Array, s: Array, parent: _Clique | None, separators: list[int]) -> Array:
    """A clique's covariance from that of its separator: with ``G = R^-1 S``, ``[[R^-1 R^-T + G P G', -G P], [., P]]``.

    Raises
    ------
    _IllConditionedError : a variable known to its separator far better than to the world.
    """
    assert parent is not None
    known, rows = parent.matrix, parent.columns(separators)
    if not parent.squared:
        known, rows = parent.covariance(separators), _ROWS[: len(rows)]
    cov, good = squared_blocks(np.ascontiguousarray(inverse), np.ascontiguousarray(s), known, rows, _CONDITIONED)
    if not good:
        raise _IllConditionedError
    return cov


def _square(wide: Array) -> Array:
    """A square lower-triangular root of ``wide wide'``, by orthogonal transformations; overwrites `wide`."""
    size = len(wide)
    packed, _, _, _ = dgeqrf(wide.T, overwrite_a=1)
    return np.asarray(packed[:size].T * (_LOWER[:size, :size] if size <= len(_LOWER) else np.tri(size)))


def _cholesky(cov: Array) -> Array:
    """A lower-triangular root of a covariance.

    Raises
    ------
    _IllConditionedError : as `_squared`.
    """
    sigma = np.sqrt(cov.diagonal())
    root, status = dpotrf(cov / np.outer(sigma, sigma), lower=1, clean=1)
    if status != 0 or not root.diagonal().min() > _CONDITIONED:
        raise _IllConditionedError
    return np.asarray(sigma[:, None] * root)


def _name(frontals: list[int], rows: dict[int, slice], row: int) -> str:
    key = next(k for k in frontals if rows[k].start <= row < rows[k].stop)
    return f"{chr(key >> 56)}{key & ((1 << 56) - 1)}"
