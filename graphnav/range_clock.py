"""A clock of ranges that is off: the time offset as a variable, and the ranges moved to where it has been found.

A range stamped t measured the tag at ``t + d``. Between linearizations the tag goes straight (`factors.time_offset`);
so the table is moved by what is known of d, the ranges are carried anew, and all is solved again, until d stays.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from factors.so3 import Array
from factors.time_offset import TimeOffset
from graphnav.graph import SmoothingGraph
from graphnav.problem import Problem, RangeClock, T
from graphnav.ranges import RangeReadings
from graphnav.solvers.elimination import eliminated_last

if TYPE_CHECKING:
    import gtsam

    from graphnav.trajectory import Trajectory

#: Half the time over which the tag's velocity is taken, in sigmas of the offset, and at least, s.
_WINDOW_SIGMAS, _WINDOW_S = 2.0, 0.01
#: A share of its sigma by which the offset may still move, or s.
_SETTLED_SIGMAS, _SETTLED_S = 0.1, 1e-3


def estimates_clock(problem: Problem) -> bool:
    """Whether the time offset of the ranges is a variable."""
    return problem.config.uwb.estimate_time_offset


def moved(problem: Problem, clock: RangeClock) -> Problem:
    """The problem with its ranges at the times that `clock` gives.

    Spans, and the keyframes of Markov errors in them, stay in the ranges' own time: these errors are the radio's.
    """
    uwb, more = problem.log.uwb, clock.later_s - problem.clock.later_s
    if uwb is None or not more:
        return replace(problem, clock=clock)
    return replace(problem, log=replace(problem.log, uwb=replace(uwb, t_s=uwb.t_s + more)), clock=clock)


def settled(before: RangeClock, after: RangeClock) -> bool:
    """Whether the second is near enough to the first, along which it was found."""
    return abs(after.later_s - before.later_s) <= max(_SETTLED_SIGMAS * (after.sigma_s or 0.0), _SETTLED_S)


def offset_in(values: gtsam.Values) -> float:
    """The time offset, s; zero where it is no variable."""
    return float(values.atVector(T(0))[0]) if values.exists(T(0)) else 0.0


def with_offset(problem: Problem, readings: RangeReadings, along: Trajectory | None) -> RangeReadings:
    """Ranges whose time offset is a variable.

    Parameters
    ----------
    along : a path near the solution; None where there is none yet, and the offset stays where it is.
    """
    assert problem.log.uwb is not None
    clock, family = problem.clock, readings.family
    velocity = np.zeros((len(readings.row), 3))
    if along is not None:
        window_s = max(_WINDOW_SIGMAS * (clock.sigma_s or 0.0), _WINDOW_S)
        velocity = _velocity(along, problem.log.uwb.t_s[readings.row], family.lever_arm_b, window_s)
    return replace(readings, family=replace(family, clock=TimeOffset(T(0), clock.later_s, velocity)))


@dataclass(frozen=True)
class ClockScore:
    """What ranges whose clock is taken for right say of it: offset and its sigma, s, to first order."""

    offset_s: float
    sigma_s: float


def clock_score(
    problem: Problem, graph: SmoothingGraph, ranges: RangeReadings, along: Trajectory, values: gtsam.Values
) -> ClockScore | None:
    """The score of a time offset at a solution without one; None where the ranges tell nothing of it.

    One Gauss-Newton step with the offset as a further variable, of which nothing is known before (C. R. Rao, Proc.
    Cambridge Phil. Soc. 44 (1948)): without an offset its step over its sigma is standard normal.

    Parameters
    ----------
    graph, ranges, values : as solved; along : the path that was found.
    """
    import gtsam

    wide = replace(problem, clock=RangeClock(0.0, problem.config.uwb.time_offset_sigma_s / 2))
    family, moved_values = with_offset(wide, ranges, along).family, gtsam.Values(values)
    moved_values.insert(T(0), np.zeros(1))
    linear = replace(graph, ranges=family).linearize(moved_values)
    # what holds it where the machine stands, and is taken out again
    unit = gtsam.noiseModel.Unit.Create(1)
    linear.push_back(gtsam.JacobianFactor(T(0), np.eye(1), np.zeros(1), unit))
    root, right = eliminated_last(linear, T(0))
    information = root**2 - 1.0
    if information < 1.0:
        return None
    return ClockScore(root * right / information, information**-0.5)


def _velocity(along: Trajectory, t_s: Array, lever_arm_b: Array, window_s: float) -> Array:
    """Mean velocities (K, 3) of tags from `window_s` before to as long after, within the path's span."""
    first, last = (np.clip(t_s + side * window_s, along.t_s[0], along.t_s[-1]) for side in (-1, 1))
    gone = _tags(along, last, lever_arm_b) - _tags(along, first, lever_arm_b)
    return np.asarray(gone / (last - first)[:, None])


def _tags(along: Trajectory, t_s: Array, lever_arm_b: Array) -> Array:
    times, which = np.unique(t_s, return_inverse=True)
    at = along.at(times)
    return np.asarray(at.pos_n[which] + np.einsum("kij,kj->ki", at.rotation_nb[which], lever_arm_b))
