"""Eliminating a linear graph: in which order, by Cholesky where that is sound, by QR otherwise (decision 0010)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from graphnav.errors import SolveError

if TYPE_CHECKING:
    import gtsam

#: Cholesky squares the condition number: with pivots smaller than the diagonal by less than this it keeps covariances
#: to a thousandth (measured: 3e-4 at 8e10, 7e-6 at 8e8).
_SOUND = 1e11
#: Diagonal entries of R this much smaller than their clique's largest are round-off.
_RANK = 1e-12
#: Step in which factors are looked through for what ties variables together.
_STRIDE = 7


def elimination(
    linear: gtsam.GaussianFactorGraph, first: list[int] | None = None
) -> tuple[gtsam.GaussianBayesTree, list[int]]:
    """Bayes tree for covariances at one linearization, and its keys in elimination order.

    Parameters
    ----------
    first : as in `graphnav.solvers.batch.solve`: with it by Cholesky where its pivots are sound, by QR otherwise.

    Raises
    ------
    SolveError : a singular system (names a variable).
    """
    ordering = ordering_of(linear, first)
    order = [ordering.at(k) for k in range(ordering.size())]
    if first is not None:
        try:
            tree = linear.eliminateMultifrontal(ordering)
            if sound(tree, order, tree.optimize()):
                return tree, order
        except RuntimeError:
            pass  # indeterminate to Cholesky
    tree = eliminate(linear, ordering)
    check_determined(tree, order)
    return tree, order


def eliminate(linear: gtsam.GaussianFactorGraph, ordering: gtsam.Ordering) -> gtsam.GaussianBayesTree:
    """Multifrontal QR."""
    import gtsam

    try:
        return linear.eliminateMultifrontal(ordering, gtsam.EliminateQR)
    except RuntimeError as error:
        raise SolveError.singular(error) from None


def eliminated_last(linear: gtsam.GaussianFactorGraph, key: int) -> tuple[float, float]:
    """What all factors together say of one variable of size 1: r > 0 and d of ``(r x - d)^2``.

    By Cholesky where that does not fail: a sigma 1 / r and a step d / r need not be exact.

    Raises
    ------
    SolveError : a singular system.
    """
    import gtsam

    ordering = gtsam.Ordering.ColamdConstrainedLastGaussianFactorGraph(linear, [key])
    try:
        tree = linear.eliminateMultifrontal(ordering)
    except RuntimeError:  # indeterminate to Cholesky, as sound long chains may be
        tree = eliminate(linear, ordering)
    conditional = tree[key].conditional()
    root, right = float(conditional.R()[-1, -1]), float(conditional.d()[-1])
    return abs(root), right * float(np.sign(root))


def ordering_of(linear: gtsam.GaussianFactorGraph, first: list[int] | None) -> gtsam.Ordering:
    """Fill-reducing order; with landmarks nested dissection of what is left after `first`."""
    import gtsam

    if first is None:
        return gtsam.Ordering.ColamdGaussianFactorGraph(linear)
    ordering, rest = gtsam.Ordering(), linear
    for key in first:
        ordering.push_back(key)
    try:
        if first:
            _, rest = linear.eliminatePartialMultifrontal(ordering)
        alone = _alone(rest)
        if alone:
            for key in alone:
                ordering.push_back(key)
            _, rest = linear.eliminatePartialMultifrontal(ordering)
    except RuntimeError:  # indeterminate to Cholesky
        return gtsam.Ordering.ColamdGaussianFactorGraph(linear)
    last = gtsam.Ordering.MetisGaussianFactorGraph(rest)
    for k in range(last.size()):
        ordering.push_back(last.at(k))
    return ordering


def _alone(linear: gtsam.GaussianFactorGraph) -> list[int]:
    """Variables that share no factor with another: METIS does not survive them.

    Most variables have many factors, one after the other: looked through in strides, nearly all turn out tied early.
    """
    keys = set(linear.keyVector())
    for k in (k for start in range(_STRIDE) for k in range(start, linear.size(), _STRIDE)):
        factor = linear.at(k)
        found = factor.keys() if factor is not None else []
        if len(found) > 1:
            keys.difference_update(found)
            if not keys:
                break
    return sorted(keys)


def sound(tree: gtsam.GaussianBayesTree, order: list[int], delta: gtsam.VectorValues) -> bool:
    """Whether Cholesky's pivots are large enough beside the diagonal of the information, see `_SOUND`.

    If so, nothing is undetermined: round-off is smaller than that by far. With ``R'R`` the information, its diagonal is
    the sum of squares of each column of R, over all cliques.
    """
    from graphnav.solvers.clique_blocks import add_squares

    start = np.cumsum([0, *(len(delta.at(key)) for key in order)])
    place = {key: index for index, key in enumerate(order)}
    diagonal, pivot = np.zeros(start[-1]), np.zeros(start[-1])
    done: set[int] = set()
    for key in order:
        if key not in done:
            conditional = tree[key].conditional()
            keys = conditional.keys()
            which = np.array([*map(place.__getitem__, keys)])
            frontals = add_squares(conditional.augmentedJacobian().T, which, start, diagonal, pivot)
            done.update(keys[:frontals])
    return bool((diagonal <= _SOUND * np.square(pivot)).all())


def check_determined(tree: gtsam.GaussianBayesTree, order: list[int]) -> None:
    """Refuse a solution with an undetermined variable: behind loops QR leaves a diagonal of round-off, and no error."""
    for key in order:
        conditional = tree[key].conditional()
        if conditional.firstFrontalKey() == key:
            diagonal = np.abs(np.diagonal(conditional.R()))
            if diagonal.min() <= _RANK * diagonal.max():
                raise SolveError.undetermined(key)
