"""Covariances of all keyframes from the square-root information matrix.

GTSAM's marginals go through Cholesky and fail on sound problems. Here the Bayes tree that QR left is walked from its
roots: with ``R x_f + S x_p = d`` for the frontal variables f and the separator p of a clique, and ``P_pp = L_p L_p'``
known from the parent clique, ``P = L L'`` with ``L = [[R^-1, -R^-1 S L_p], [0, L_p]]`` (G. Golub and R. Plemmons,
Linear Algebra Appl. 34 (1980), in square-root form). Only orthogonal transformations and products: what comes out is
a covariance, whatever the ordering. The same recursion on P itself squares the condition number and was measured to
fail where closed-path factors tie cycles together (docs/decisions/0004).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.linalg.lapack import dgeqrf, dtrtri

from factors.so3 import Array
from graphnav.errors import SolveError

if TYPE_CHECKING:
    import gtsam


#: A sigma this large (rad, m, m/s) is round-off in place of information.
_NO_INFORMATION = 1e8


class _Clique:
    """Square root of the joint covariance of one clique: rows of each key, and how many children still need it."""

    __slots__ = ("root", "rows", "waiting")

    def __init__(self, root: Array, rows: dict[int, slice], waiting: int) -> None:
        self.root, self.rows, self.waiting = root, rows, waiting

    def part(self, keys: Iterable[int]) -> Array:
        """Rows of the square root that belong to `keys`."""
        return np.concatenate([self.root[self.rows[k]] for k in keys])


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
    wanted: dict[int, list[int]] = {}
    for name, keys in groups.items():
        for key in keys:
            wanted.setdefault(key, []).append(name)
    found: dict[int, Array] = {}
    open_cliques: dict[int, _Clique] = {}
    owner: dict[int, int] = {}
    order = list(elimination_order)
    for done, key in enumerate(reversed(order)):
        if key in owner:
            continue
        clique = _solve_clique(tree[key], open_cliques, owner, dims)
        for frontal in clique.rows:
            for name in wanted.get(frontal, ()):
                if name not in found and all(k in clique.rows for k in groups[name]):
                    part = clique.part(groups[name])
                    found[name] = part @ part.T
        if progress is not None and done % 4096 == 0:
            progress(done, len(order))
    missing = set(groups) - set(found)
    if missing:
        raise SolveError(f"no clique holds all variables of group {min(missing)}")
    return found


def _solve_clique(
    node: Any, open_cliques: dict[int, _Clique], owner: dict[int, int], dims: Callable[[int], int]
) -> _Clique:
    conditional = node.conditional()
    if conditional.isConstrained():
        raise SolveError(
            "a hard constraint (a sigma of zero, or below 1e-8 in GTSAM's eyes) has no square-root information"
        )
    r, s = conditional.R(), conditional.S()
    keys = conditional.keys()
    frontal_dim, rows, frontals, at = r.shape[0], {}, [], 0
    for key in keys:
        rows[key] = slice(at, at + dims(key))
        if at < frontal_dim:
            frontals.append(key)
        at += dims(key)
    inverse, status = dtrtri(np.asfortranarray(r))
    if status != 0:
        raise SolveError.singular(ValueError(_name(frontals, rows, status - 1)))
    loose = np.flatnonzero(~(np.abs(inverse).max(axis=1) < _NO_INFORMATION))
    if len(loose):
        raise SolveError.singular(ValueError(_name(frontals, rows, int(loose[0]))))
    root = np.zeros((at, at))
    root[:frontal_dim, :frontal_dim] = inverse
    if at > frontal_dim:
        separators = keys[len(frontals) :]
        # the parent holds the separator variable that was eliminated first, so it was opened last
        parent_id = max(owner[k] for k in separators)
        parent = open_cliques[parent_id]
        separator_root = _square(parent.part(separators))
        root[:frontal_dim, frontal_dim:] = -inverse @ (s @ separator_root)
        root[frontal_dim:, frontal_dim:] = separator_root
        parent.waiting -= 1
        if parent.waiting == 0:
            del open_cliques[parent_id]
    clique = _Clique(root, rows, node.nrChildren())
    identity = len(owner)
    for key in frontals:
        owner[key] = identity
    if clique.waiting:
        open_cliques[identity] = clique
    return clique


def _square(wide: Array) -> Array:
    """A square lower-triangular root of ``wide wide'``."""
    packed, _, _, _ = dgeqrf(wide.T)
    size = wide.shape[0]
    return np.asarray(np.triu(packed[:size]).T)


def _name(frontals: list[int], rows: dict[int, slice], row: int) -> str:
    key = next(k for k in frontals if rows[k].start <= row < rows[k].stop)
    return f"{chr(key >> 56)}{key & ((1 << 56) - 1)}"
