"""A clock of ranges that is off: the time offset as a variable, and the log moved to where it has been found.

A range stamped t measured the tag at ``t + d``. Between linearizations d is linear; where it is large against what the
motion does in that time, the whole table is moved by what is known of it and the ranges are carried anew.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from factors.noise import diagonal
from graphnav.problem import Problem, T

if TYPE_CHECKING:
    import gtsam

    from graphnav.chain_problem import ChainProblem
    from graphnav.config import UwbConfig

#: A move of the ranges' times below this is linear to less than any range tells: 1 mm at 1 m/s.
SETTLED_S = 1e-3


def estimates_clock(problem: Problem | ChainProblem) -> bool:
    """Whether the time offset of the ranges is a variable."""
    return problem.config.uwb.estimate_time_offset


def clock_prior(config: UwbConfig) -> gtsam.NonlinearFactor:
    """How far the offset may be from zero."""
    import gtsam

    return gtsam.PriorFactorVector(T(0), np.zeros(1), diagonal(np.array([config.time_offset_sigma_s])))


def offset_s(values: gtsam.Values) -> float:
    """The time offset in `values`; zero where it is no variable."""
    return float(values.atVector(T(0))[0]) if values.exists(T(0)) else 0.0


def moved(problem: Problem, values: gtsam.Values) -> Problem:
    """The problem with its ranges and their spans at the times that the offset in `values` gives."""
    uwb, more = problem.log.uwb, offset_s(values) - problem.ranges_later_s
    if uwb is None or not more:
        return problem
    spans = tuple(
        replace(span, start_s=span.start_s + more, end_s=span.end_s + more) for span in problem.frontend.ranging
    )
    return replace(
        problem,
        log=replace(problem.log, uwb=replace(uwb, t_s=uwb.t_s + more)),
        frontend=replace(problem.frontend, ranging=spans),
        ranges_later_s=problem.ranges_later_s + more,
    )


def settled(problem: Problem, values: gtsam.Values) -> bool:
    """Whether the ranges stand where the offset in `values` puts them, near enough."""
    return abs(offset_s(values) - problem.ranges_later_s) <= SETTLED_S
