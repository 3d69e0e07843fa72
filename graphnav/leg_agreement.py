"""Which readings of legs agree with all else: a leg that moved and keeps its number must not move the machine.

Least squares spread one wrong reading over all others. So where some are off by more than chance allows, the graph is
solved again with a loss under which they count ever less (Cauchy's), narrowed in steps so that the first compromise is
left behind (graduated non-convexity: A. Blake and A. Zisserman, Visual Reconstruction, 1987); what is then still off is
left out, and least squares have the last word.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from factors.so3 import Array
from graphnav.graph import SmoothingGraph
from graphnav.leg_means import npt_bool
from graphnav.legs import LegReadings
from graphnav.log import Lidar
from graphnav.solvers import batch

if TYPE_CHECKING:
    import gtsam

#: Sigmas off, range and angle together, at which a reading disagrees. False-alarm rate with normal errors: 1e-14 each;
#: wider than chance needs, for what averaging leaves of the scanner's errors.
DISAGREES = 8.0
#: Sigmas from which on a reading counts less, at last; each step of the narrowing, and where it starts below the worst.
_LOSS, _NARROWER, _START = 3.0, 4.0, 0.1
#: Share of a leg's readings that may disagree before all of them are left out.
_SHARE = 0.2
#: Joint sigmas at which one step of the narrowing is done, and its iterations at most.
_ROUGH_SIGMAS, _ITERATIONS = 3.0, 8


def agreeing(graph: SmoothingGraph, readings: LegReadings, lidar: Lidar, values: gtsam.Values) -> npt_bool | None:
    """Readings (K,) that agree; None where all do.

    Parameters
    ----------
    graph : the problem with all readings; values : its least-squares solution.
    """
    worst = float(readings.disagreement(lidar, values).max(initial=0.0))
    if worst <= DISAGREES:
        return None
    loss = max(worst * _START, _LOSS)
    while True:
        robust = replace(graph, legs=readings.family(lidar, loss))
        values = batch.solve(
            robust, values, max_iterations=_ITERATIONS, tolerance_sigma=_ROUGH_SIGMAS, first=graph.chain, exact=False
        ).values
        if loss == _LOSS:
            return _trusted(readings, readings.disagreement(lidar, values))
        loss = max(loss / _NARROWER, _LOSS)


def _trusted(readings: LegReadings, sigmas: Array) -> npt_bool:
    """Readings (K,) that agree, of legs most of whose readings do: one that fits neither way leans to fit both."""
    off = sigmas > DISAGREES
    share = np.bincount(readings.leg, off) / np.maximum(np.bincount(readings.leg), 1)
    return np.asarray(~off & (share[readings.leg] < _SHARE))
