"""Batch smoothing: Gauss-Newton with Levenberg-Marquardt damping, driven from Python, its result by QR.

GTSAM's own optimizers copy all values at every call of a Python factor, and its Cholesky fails on sound long chains;
a loop over ``graph.linearize`` and multifrontal QR does neither.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from graphnav.errors import SolveError
from graphnav.solvers.elimination import check_determined, eliminate, ordering_of, sound
from graphnav.solvers.linearized import Linear, Linearizable, linearized

if TYPE_CHECKING:
    from collections.abc import Callable

    import gtsam

#: Damping tried when a full step does not lower the error, as a share of one whitened unit.
_FIRST_DAMPING = 1e-3
_MAX_DAMPING = 1e8
#: From a step this short on, elimination is by QR: the next one is probably the last.
_NEAR_SIGMAS = 30.0
#: With landmarks, steps that have shrunk to this share of the one before go on shrinking to about it or less.
_SHRINKS = 0.25
#: Steps that lower the error (half a chi-square) by less than this, in a row, are enough.
_FLAT, _FLAT_ITERATIONS = 0.2, 5


class StuckError(SolveError):
    """No step lowers the error at some values: who knows the measurements can say which stand out there."""

    def __init__(self, values: gtsam.Values) -> None:
        super().__init__(str(SolveError.stuck()))
        self.values = values


@dataclass(frozen=True)
class Iteration:
    """One linearization: the error before the step, the step's length in joint sigmas, its damping."""

    error: float
    step_sigmas: float
    damping: float
    seconds: float


@dataclass(frozen=True)
class BatchResult:
    """Estimates with the square-root information they were solved from.

    Attributes
    ----------
    values : estimates.
    bayes_tree : elimination of the last linearization: the input of the covariances.
    iterations : what each one did; converged : whether the rule was met; order : keys in elimination order.
    """

    values: gtsam.Values
    bayes_tree: gtsam.GaussianBayesTree | None
    iterations: tuple[Iteration, ...]
    converged: bool
    order: list[int]


def solve(
    graph: Linearizable,
    values: gtsam.Values,
    *,
    max_iterations: int = 25,
    tolerance_sigma: float = 0.01,
    first: list[int] | None = None,
    exact: bool = True,
    least_gain: float = 0.0,
    progress: Callable[[float, float], None] | None = None,
) -> BatchResult:
    """Minimise the graph's error from the given values.

    Landmarks tie many keyframes together: QR then takes ten times as long as Cholesky, which in turn is sound there. So
    with `first`, the keys of what no landmark is tied to in the order to eliminate them, all is by Cholesky as long as
    its pivots are sound. Values that only another solve starts from need no exact elimination: not `exact` leaves it
    out, and the Bayes tree.

    Convergence rule: stop after a step whose joint Mahalanobis length, ``sqrt(delta' H delta)`` over all variables,
    is at most `tolerance_sigma`: what is left is that small a part of one standard deviation. With `first` what is left
    is told from how steps shrink (`_enough`), and five steps in a row that each lower the error by next to nothing
    (`_FLAT`) are enough too: the lean of a leg times an error of height is bilinear, so that the last steps shrink by
    a like share each, and where neither is known, steps of half a sigma creep along a valley. A step that raises the
    error is shortened, and where that does not help damped, until it lowers it. Not `exact`, also after a step that
    lowers the error by less than the share `least_gain`, but not by how steps shrink.

    Raises
    ------
    SolveError : a singular system (names a variable), or no descent.
    """
    iterations: list[Iteration] = []
    linear = linearized(graph, values)
    ordering = ordering_of(linear.factors, first)
    order = [ordering.at(k) for k in range(ordering.size())]
    error = linear.error
    if not np.isfinite(error):
        raise SolveError("the error is not finite at the start: check the log for impossible values")
    near, flat, pivots = False, 0, False
    while True:
        began = time.perf_counter()
        tree, delta, step = _step(linear, ordering, error, exact=near)
        before = iterations[-1].step_sigmas if iterations and exact and first is not None else 0.0
        converged = _enough(step, before, tolerance_sigma)
        if exact and not near and (converged or (first is None and step <= _NEAR_SIGMAS)):
            near = True
            pivots = converged and first is not None and sound(tree, order, delta)
            if converged and not pivots:
                tree, delta, step = _step(linear, ordering, error, exact=True)
                converged = _enough(step, before, tolerance_sigma)
        moved = values.retract(delta)
        damping, next_error = 0.0, error
        if not converged:
            # linear and tree are large: at no time hold two of either
            del tree, linear
            linear = linearized(graph, moved)
            next_error = linear.error
            if not next_error <= error * (1 + 1e-9):
                del linear
                shorter = _shorter_step(graph, values, error, delta, step)
                found = shorter or _damped_step(graph, values, first, error)
                moved, linear, next_error, damping = found
        iterations.append(Iteration(error, step, damping, time.perf_counter() - began))
        flat = flat + 1 if error - next_error < _FLAT else 0
        values, error = moved, next_error
        if progress is not None:
            progress(len(iterations), max_iterations)
        if converged or (not exact and iterations[-1].error - error < least_gain * iterations[-1].error):
            break
        converged = bool(first) and flat == _FLAT_ITERATIONS
        if converged or len(iterations) == max_iterations:
            if exact:
                tree, delta, _ = _step(linear, ordering, error, exact=first is None)
                pivots = first is not None and sound(tree, order, delta)
                if first is not None and not pivots:
                    tree = eliminate(linear.factors, ordering)
            break
    if not exact:
        return BatchResult(values, None, tuple(iterations), converged, order)
    if not pivots:
        check_determined(tree, order)
    return BatchResult(values, tree, tuple(iterations), converged, order)


def _enough(step: float, before: float, tolerance_sigma: float) -> bool:
    """Whether at most `tolerance_sigma` is left: of a step that short, or of steps that shrink.

    After one that is at most the share q = `_SHRINKS` of the one before, steps of q, q^2, ... of it follow at most:
    together q / (1 - q).

    Parameters
    ----------
    before : length of the step before, 0 where its shrinking tells nothing.
    """
    shrinks = step <= _SHRINKS * before
    return step <= tolerance_sigma or (shrinks and step * _SHRINKS / (1 - _SHRINKS) <= tolerance_sigma)


def _step(
    linear: Linear, ordering: gtsam.Ordering, error: float, exact: bool
) -> tuple[gtsam.GaussianBayesTree, gtsam.VectorValues, float]:
    """Bayes tree, Gauss-Newton step and its length in joint sigmas.

    Far from the minimum Cholesky will do, at a third of the cost of QR: where it fails, or its step does not lower
    the linear error, QR takes over. What the result and its covariances rest on is always QR (`exact`).
    """
    if not exact:
        try:
            tree = linear.factors.eliminateMultifrontal(ordering)
            delta = linear.step(tree)
            gain = error - linear.factors.error(delta)
            if np.isfinite(gain) and gain > 0:
                return tree, delta, float(np.sqrt(2 * gain))
        except RuntimeError:
            pass  # indeterminate to Cholesky, as sound long chains may be
    tree = eliminate(linear.factors, ordering)
    delta = linear.step(tree)
    return tree, delta, float(np.sqrt(max(2 * (error - linear.factors.error(delta)), 0.0)))


def _shorter_step(
    graph: Linearizable, values: gtsam.Values, error: float, delta: gtsam.VectorValues, step: float
) -> tuple[gtsam.Values, Linear, float, float] | None:
    """A half, a quarter, ... of the Gauss-Newton step, whichever first lowers the error; None where none does.

    The step points downhill however far it overshoots. Damping, which holds every variable alike, takes a hundred steps
    where positions are loose (a free-inertial half hour, a start with the wrong heading).
    """
    share = 0.5
    while share > 0.02:
        moved = values.retract(delta.scale(share))
        again = linearized(graph, moved)
        moved_error = again.error
        if moved_error < error - 0.05 * share * step**2:
            return moved, again, moved_error, 0.0
        share /= 2
    return None


def _damped_step(
    graph: Linearizable, values: gtsam.Values, first: list[int] | None, error: float
) -> tuple[gtsam.Values, Linear, float, float]:
    """Raise the damping until a step lowers the error: the new values, their linearization and error, the damping.

    Points are damped like everything else, so here they are not eliminated beforehand.
    """
    linear = graph.linearize(values)
    ordering = ordering_of(linear, first)
    # a step that fails for want of information is no matter of damping
    check_determined(eliminate(linear, ordering), [ordering.at(k) for k in range(ordering.size())])
    damping = _FIRST_DAMPING
    while damping <= _MAX_DAMPING:
        step = eliminate(_damped(linear, values, damping), ordering).optimize()
        moved = values.retract(step)
        again = linearized(graph, moved)
        moved_error = again.error
        if moved_error < error:
            return moved, again, moved_error, damping
        damping *= 10
    raise StuckError(values)


def _damped(linear: gtsam.GaussianFactorGraph, values: gtsam.Values, damping: float) -> gtsam.GaussianFactorGraph:
    """Levenberg's damping: every variable held with ``sqrt(damping)``."""
    import gtsam

    out = linear.clone()
    zero = values.zeroVectors()
    weight = np.sqrt(damping)
    for key in values.keys():
        size = len(zero.at(key))
        noise = gtsam.noiseModel.Unit.Create(size)
        out.push_back(gtsam.JacobianFactor(key, weight * np.eye(size), np.zeros(size), noise))
    return out
