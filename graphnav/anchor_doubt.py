"""Ranges that contradict each other: whether it is one anchor's, off by a constant, and which.

A path bent to a compromise does not tell which anchor bent it. So every anchor in turn is given a constant of which
nothing is known, and all is solved again from where the ranges put the machine then, and from that path's mirror image:
the likelihoods are compared. A wrong anchor's exceeds the right one's by a factor ``exp(L)`` with a probability of
``exp(-L)`` at most (Markov's inequality: under the right hypothesis the likelihood ratio has mean one), so that a lead
of `LEAD` blames a wrong one in less than 3 of a million logs of four anchors in which one is off.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from factors.so3 import Array
from graphnav._stages import Stages
from graphnav.agreement import agreeing_ranges
from graphnav.errors import SolveError
from graphnav.frontends.range_epochs import is_unknown
from graphnav.frontends.range_faults import Fault, faults, lessened
from graphnav.graph import SmoothingGraph, build_graph
from graphnav.initial import initial_values, start_state
from graphnav.leg_means import npt_bool
from graphnav.preintegration import Preintegrated
from graphnav.problem import A, Problem, V, X
from graphnav.range_outcome import anchor_counts, contradictory, range_warnings
from graphnav.range_rounds import posed_ranges
from graphnav.ranges import RangeReadings
from graphnav.run import Calibration
from graphnav.solvers import batch

if TYPE_CHECKING:
    import gtsam

#: Logarithm of the likelihood ratio by which one anchor must lead: see above.
LEAD = 14.0
#: Sigma of a constant of which nothing is known.
_FREE_M = 10.0
#: Sigmas by which a chi-square may exceed its degrees of freedom: by chance that of one log in three million does.
_MISFIT_SIGMAS = 5.0
#: Starts of two paths nearer than this are those of one.
_SAME_M = 0.1
#: Joint sigmas to which an anchor's own solution is found, for its likelihood to be right to a twentieth; iterations.
_SIGMAS, _ITERATIONS = 0.3, 15


class ContradictionError(Exception):
    """Ranges contradict each other; it does not leave the solver."""


@dataclass(frozen=True)
class Doubt:
    """What became of ranges that contradict each other.

    Attributes
    ----------
    anchors : ids of those that may be the wrong one; none where no single one explains the ranges.
    problem, values : with the constant of the only one free, and to start from; None where another explains them as
        well, or another path does.
    """

    anchors: tuple[str, ...] = ()
    problem: Problem | None = None
    values: gtsam.Values | None = None


@dataclass(frozen=True)
class Trial:
    """One anchor's hypothesis solved.

    Attributes
    ----------
    half_square : half its chi-square, each range left out at the value of one just not.
    consistent : whether all then fits: nothing more is to be said of the anchors.
    """

    anchor: int
    half_square: float
    consistent: bool
    problem: Problem
    values: gtsam.Values

    def same_as(self, other: Trial) -> bool:
        """Whether both are one and the same solution."""
        apart = self.values.atPose3(X(0)).translation() - other.values.atPose3(X(0)).translation()
        return self.anchor == other.anchor and bool(np.linalg.norm(apart) < _SAME_M)


def contradicting(
    problem: Problem, graph: SmoothingGraph, ranges: RangeReadings, fit: npt_bool, values: gtsam.Values
) -> bool:
    """Whether ranges contradict each other at their common solution, by the rule of the warning that says so.

    Rough values may say so of sound ranges, where a fifth is reflected: better ones are asked again.
    """
    if not contradictory(_warned(problem, ranges, fit, values)):
        return False
    only = replace(graph, ranges=ranges.family.only(fit))
    try:
        values = batch.solve(only, values, max_iterations=_ITERATIONS, tolerance_sigma=_SIGMAS, exact=False).values
    except SolveError:
        return True
    return contradictory(_warned(problem, ranges, fit, values))


def _warned(problem: Problem, ranges: RangeReadings, fit: npt_bool, values: gtsam.Values) -> list[str]:
    """What the user would be told of the anchors."""
    uwb = problem.log.uwb
    assert uwb is not None
    counts = anchor_counts(uwb, ranges.only(fit), ranges.only(~fit), values)
    found = {
        f"uwb_bias_{uwb.anchor[a].id}": Calibration(float(values.atVector(A(a))[0]), None, "m")
        for a in np.unique(ranges.anchor).tolist()
    }
    return range_warnings(uwb, counts, found)


def doubted(problem: Problem, stages: Stages, data: Preintegrated, values: gtsam.Values) -> Doubt:
    """Which anchor is off by a constant, or which may be.

    Parameters
    ----------
    values : from before ranges were looked at.
    """
    near = None if is_unknown(problem.initial) else problem.initial.pos_n_m
    with stages.stage("solve"):
        found = faults(problem.log, near)
        likely = [each for each in found if each.cost - found[0].cost < 2 * LEAD]
        trials = _trials(problem, data, values, likely)
        if not any(trial.consistent for trial in trials):
            tried = {each.anchor for each in likely}
            firsts = {each.anchor: each for each in reversed(found) if each.anchor not in tried}
            trials += _trials(problem, data, values, list(firsts.values()))
    trials.sort(key=lambda each: each.half_square)
    if not trials or not trials[0].consistent:
        return Doubt()
    best, *others = trials
    rivals = [each for each in others if each.half_square - best.half_square < LEAD and not each.same_as(best)]
    uwb = problem.log.uwb
    assert uwb is not None
    ids = tuple(uwb.anchor[a].id for a in sorted({each.anchor for each in (best, *rivals)}))
    return Doubt(ids) if rivals else Doubt(ids, best.problem, best.values)


def _trials(problem: Problem, data: Preintegrated, values: gtsam.Values, found: list[Fault]) -> list[Trial]:
    """Those of them that have a solution, and the best one's mirror image."""
    trials = [trial for each in found if (trial := _tried(problem, data, values, each)) is not None]
    return trials + _mirrored(data, min(trials, key=lambda each: each.half_square)) if trials else []


def _tried(problem: Problem, data: Preintegrated, values: gtsam.Values, fault: Fault) -> Trial | None:
    """Solved with that anchor's constant free, from where ranges without it put the machine."""
    return solved_from(_freed(problem, fault.anchor), data, started(problem, data, values, fault), fault)


def started(problem: Problem, data: Preintegrated, values: gtsam.Values, fault: Fault) -> gtsam.Values:
    """Values to start from where ranges without that fault put the machine; `values` where an odometer leads anyhow."""
    import gtsam

    if problem.has_calibration:
        return gtsam.Values(values)
    nearly = replace(problem, log=lessened(problem.log, fault))
    return initial_values(nearly, data, start_state(nearly)[0])


def _mirrored(data: Preintegrated, trial: Trial) -> list[Trial]:
    """The same hypothesis solved from the mirror image of its path in the plane of the other anchors."""
    import gtsam

    uwb, count = trial.problem.log.uwb, len(trial.problem.keyframe_s)
    assert uwb is not None
    others = np.array([each.pos_n_m for k, each in enumerate(uwb.anchor) if k != trial.anchor])
    middle = others.mean(axis=0)
    normal = np.linalg.svd(others - middle)[2][2]
    flip = np.eye(3) - 2 * np.outer(normal, normal)
    values = gtsam.Values(trial.values)
    for i in range(count):
        pose = values.atPose3(X(i))
        values.update(X(i), gtsam.Pose3(pose.rotation(), middle + flip @ (pose.translation() - middle)))
        values.update(V(i), flip @ values.atVector(V(i)))
    ranges = posed_ranges(trial.problem, data, values)
    assert ranges is not None
    its = ranges.only(ranges.anchor == trial.anchor).family
    known = float(values.atVector(A(trial.anchor))[0])
    longer = known - float(np.median(its.residuals(values)[0] * its.sigma_m))
    found = solved_from(trial.problem, data, values, Fault(trial.anchor, longer, 0.0))
    return [] if found is None else [found]


def solved_from(problem: Problem, data: Preintegrated, values: gtsam.Values, fault: Fault) -> Trial | None:
    """Solved from these values and that constant; None where no solution is found."""
    config = problem.config.uwb
    ranges = posed_ranges(problem, data, values)
    assert ranges is not None
    values.update(A(fault.anchor), np.array([fault.bias_m, 0.0, 0.0, 0.0]))
    graph = build_graph(problem, data, ranges=ranges)
    try:
        values, fit = agreeing_ranges(graph, config, values)
        only = replace(graph, ranges=ranges.family.only(fit))
        values = batch.solve(only, values, max_iterations=_ITERATIONS, tolerance_sigma=_SIGMAS, exact=False).values
    except SolveError:
        return None
    off = ranges.family.off(values)
    fit = np.asarray(off <= config.reject_sigmas)
    rest = replace(graph, ranges=None).linearize(values).error(values.zeroVectors())
    half_square = float(rest + np.square(np.minimum(off, config.reject_sigmas)).sum() / 2)
    consistent = _fits(2 * rest, off, config.reject_sigmas) and not _warned(problem, ranges, fit, values)
    return Trial(fault.anchor, half_square, consistent, problem, values)


def _fits(rest: float, off: Array, reject_sigmas: float) -> bool:
    """Whether the chi-square of all that is used is one, `rest` that of all but ranges: see `_MISFIT_SIGMAS`.

    Every other variable has measurements of its own, so that there is a degree of freedom for each range. Of reflected
    ranges about as many as are left out are amiss by less, and stay: half the square of the gate each.
    """
    used = off[off <= reject_sigmas]
    small = (len(off) - len(used)) * reject_sigmas**2 / 2
    return bool(rest + np.square(used).sum() < len(used) + small + _MISFIT_SIGMAS * np.sqrt(2 * len(used)))


def _freed(problem: Problem, a: int) -> Problem:
    """With nothing known of one anchor's constant."""
    uwb = problem.log.uwb
    assert uwb is not None
    anchors = tuple(replace(each, bias_sigma_m=_FREE_M) if k == a else each for k, each in enumerate(uwb.anchor))
    return replace(problem, log=replace(problem.log, uwb=replace(uwb, anchor=anchors)))
