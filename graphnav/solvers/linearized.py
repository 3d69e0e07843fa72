"""A problem linearized at some values, as solvers use it: without points that a camera sees, where there are any."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

if TYPE_CHECKING:
    import gtsam

    from factors.condensed_points import Condensed


class Linearizable(Protocol):
    """A nonlinear least-squares problem: a GTSAM graph, or one beside families of factors linearized as arrays."""

    def linearize(self, values: gtsam.Values) -> gtsam.GaussianFactorGraph:
        """Whitened linear factors at the given values."""


@runtime_checkable
class Condensable(Protocol):
    """A problem that can eliminate its points itself."""

    def condensed(self, values: gtsam.Values) -> tuple[gtsam.GaussianFactorGraph, Condensed | None]:
        """Whitened linear factors without points, and the points."""


@dataclass(frozen=True)
class Linear:
    """Linear factors on all but the points; error : at the values (half the sum of squares)."""

    factors: gtsam.GaussianFactorGraph
    points: Condensed | None
    error: float

    def step(self, tree: gtsam.GaussianBayesTree) -> gtsam.VectorValues:
        """The step of all variables, points too, from the elimination of the factors."""
        delta = tree.optimize()
        if self.points is not None:
            self.points.complete(delta)
        return delta


def linearized(graph: Linearizable, values: gtsam.Values) -> Linear:
    """The problem at some values."""
    if isinstance(graph, Condensable):
        factors, points = graph.condensed(values)
    else:
        factors, points = graph.linearize(values), None
    error = factors.error(values.zeroVectors())
    return Linear(factors, points, error if points is None else error + points.gain)
