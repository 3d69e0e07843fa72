"""Which UWB ranges agree with all else: ranges by reflection are metres long, and must not move the machine.

The graph is solved roughly with all ranges, then with a loss under which those that are off count ever less, narrowed
in steps so that the first compromise is left behind (graduated non-convexity: A. Blake and A. Zisserman, Visual
Reconstruction, 1987; for Geman-McClure's loss H. Yang et al., IEEE RA-L 5 (2020)). What is then still off is left out,
and least squares have the last word.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from graphnav.config import UwbConfig
from graphnav.graph import SmoothingGraph
from graphnav.leg_means import npt_bool
from graphnav.solvers import batch

if TYPE_CHECKING:
    import gtsam

#: Where the narrowing starts below the worst range, and each step of it.
_START, _NARROWER = 0.25, 4.0
#: Joint sigmas at which a step of the narrowing is done, at which the last one is, and iterations at most.
_ON_THE_WAY, _ROUGH_SIGMAS, _ITERATIONS = 30.0, 3.0, 10


def agreeing_ranges(graph: SmoothingGraph, config: UwbConfig, values: gtsam.Values) -> tuple[gtsam.Values, npt_bool]:
    """Values near the solution, and the ranges (K,) that agree with it.

    Parameters
    ----------
    graph : the problem with all ranges; values : to start from.
    """
    family = graph.ranges
    assert family is not None
    values = _roughly(graph, values, _ON_THE_WAY)
    off = np.abs(family.residuals(values)[0])
    scale = max(_START * float(off.max(initial=0.0)), config.loss_sigmas)
    while off.max(initial=0.0) > config.reject_sigmas and scale >= config.loss_sigmas:
        last = scale == config.loss_sigmas
        robust = replace(graph, ranges=replace(family, loss=config.loss, scale=scale))
        values = _roughly(robust, values, _ROUGH_SIGMAS if last else _ON_THE_WAY)
        off = np.abs(family.residuals(values)[0])
        if last:
            break
        scale = max(scale / _NARROWER, config.loss_sigmas)
    return values, np.asarray(off <= config.reject_sigmas)


def _roughly(graph: SmoothingGraph, values: gtsam.Values, sigmas: float) -> gtsam.Values:
    return batch.solve(
        graph, values, max_iterations=_ITERATIONS, tolerance_sigma=sigmas, first=graph.chain, exact=False
    ).values
