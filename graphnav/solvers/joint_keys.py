"""Joint covariance of variables that share no factor, such as poses hours apart, from the square-root information.

With ``R'R = Lambda`` in the cliques of a Bayes tree, columns of the covariance are ``R^-1 (R'^-1 e)``: up the tree from
the cliques of the chosen variables to the root, and down the same way. The rest of the tree is not touched.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from factors.so3 import Array

if TYPE_CHECKING:
    import gtsam


class _Clique(NamedTuple):
    frontal: list[int]
    separator: list[int]
    r: Array
    s: Array


def joint_covariance(
    tree: gtsam.GaussianBayesTree, elimination_order: list[int], dims: Callable[[int], int], keys: list[int]
) -> Array:
    """Joint covariance of some variables, its blocks in the order of `keys`.

    Parameters
    ----------
    tree, elimination_order : Bayes tree from QR elimination, and its order.
    dims : size of a variable by key.
    """
    from scipy.linalg import solve_triangular

    place = {key: index for index, key in enumerate(elimination_order)}
    cliques = _path(tree, place, dims, keys)
    ends = np.cumsum([0, *(dims(key) for key in keys)])
    held = {key: np.zeros((dims(key), ends[-1])) for clique in cliques for key in clique.frontal}
    for key, low, high in zip(keys, ends[:-1], ends[1:], strict=True):
        held[key][:, low:high] = np.eye(high - low)
    for clique in cliques:
        up = solve_triangular(clique.r, _stacked(held, clique.frontal), trans=1)
        _put(held, clique.frontal, up)
        if clique.separator:
            _put(held, clique.separator, _stacked(held, clique.separator) - clique.s.T @ up)
    for clique in reversed(cliques):
        known = _stacked(held, clique.frontal)
        if clique.separator:
            known = known - clique.s @ _stacked(held, clique.separator)
        _put(held, clique.frontal, solve_triangular(clique.r, known))
    cov = _stacked(held, keys)
    return np.asarray((cov + cov.T) / 2)


def _path(
    tree: gtsam.GaussianBayesTree, place: dict[int, int], dims: Callable[[int], int], keys: list[int]
) -> list[_Clique]:
    """The cliques of `keys` and all above them, children before parents."""
    found: dict[int, _Clique] = {}
    for key in keys:
        at: int | None = key
        while at is not None:
            clique = _clique(tree, at, dims)
            # the last, since cliques are merged into their parents, early variables and all
            last = max(place[k] for k in clique.frontal)
            if last in found:
                break
            found[last] = clique
            # the parent holds the separator variable that is eliminated first
            at = min(clique.separator, key=place.__getitem__, default=None)
    return [found[last] for last in sorted(found)]


def _clique(tree: gtsam.GaussianBayesTree, key: int, dims: Callable[[int], int]) -> _Clique:
    conditional = tree[key].conditional()
    r, keys = np.asarray(conditional.R()), list(conditional.keys())
    count = int(np.searchsorted(np.cumsum([dims(k) for k in keys]), r.shape[0])) + 1
    return _Clique(keys[:count], keys[count:], r, np.asarray(conditional.S()))


def _stacked(held: dict[int, Array], keys: list[int]) -> Array:
    return np.concatenate([held[key] for key in keys])


def _put(held: dict[int, Array], keys: list[int], rows: Array) -> None:
    low = 0
    for key in keys:
        high = low + len(held[key])
        held[key] = rows[low:high]
        low = high
