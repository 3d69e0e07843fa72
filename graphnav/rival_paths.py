"""Whether ranges whose constants are hardly known fit more than one path.

A few anchors near a plane, each with a constant of its own, may have two solutions: metres apart, as likely as each
other, and each sure of itself to centimetres. What is known of the constants does not tell them apart, so they are
looked for, from where the ranges less the constant of one anchor or another put the machine.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from factors.so3 import Array
from graphnav._stages import Stages
from graphnav.anchor_doubt import LEAD, Trial, solved_from, started
from graphnav.frontends.range_epochs import is_unknown
from graphnav.frontends.range_faults import Fault, faults
from graphnav.log import Uwb
from graphnav.preintegration import Preintegrated
from graphnav.problem import A, Problem, X

if TYPE_CHECKING:
    import gtsam

#: Constants this many times less sure than a range are hardly known, and more anchors than this have ranges to spare.
_LOOSE, _MOST_ANCHORS = 10.0, 5
#: Starts that are tried, and how far apart two paths are two: one solution is found to a small part of that.
_STARTS, _APART_M = 6, 0.3


@dataclass(frozen=True)
class Rival:
    """A path that ranges fit as well, or better.

    Attributes
    ----------
    apart_m : rms distance from the solution; better : by how much the logarithm of its likelihood is higher.
    values : its.
    """

    apart_m: float
    better: float
    values: gtsam.Values


def rival_path(
    problem: Problem, stages: Stages, data: Preintegrated, began: gtsam.Values, values: gtsam.Values
) -> Rival | None:
    """The likeliest path apart from the solution, if it is about as likely; None where there is none.

    Parameters
    ----------
    began : values from before ranges were looked at; values : the solution.
    """
    uwb = problem.log.uwb
    if uwb is None or not _loose(uwb):
        return None
    near = None if is_unknown(problem.initial) else problem.initial.pos_n_m
    with stages.stage("solve"):
        found = faults(problem.log, near)[:_STARTS]
        if not found:
            return None
        own = _trial(problem, data, values, Fault(found[0].anchor, _constant(values, found[0].anchor), 0.0))
        trials = [_trial(problem, data, started(problem, data, began, each), each) for each in found]
    if own is None:
        return None
    path = _path(problem, own.values)
    others = []
    for each in trials:
        if each is not None and each.half_square - own.half_square < LEAD:
            apart_m = float(np.sqrt(np.square(_path(problem, each.values) - path).sum(axis=1).mean()))
            others.append(Rival(apart_m, own.half_square - each.half_square, each.values))
    return max((each for each in others if each.apart_m > _APART_M), key=lambda each: each.better, default=None)


def rival_warning(rival: Rival, uwb: Uwb) -> str:
    """What the user should know of it."""
    loosest = uwb.constant_sigma_m.max()
    return (
        f"UWB ranges fit another path as well, {rival.apart_m:.1f} m away (rms): constants of {loosest:.2g} m leave"
        " both open, and sigmas are those of one; declare a smaller bias_sigma_m or the initial position, or survey"
        " another anchor"
    )


def _loose(uwb: Uwb) -> bool:
    """Whether constants are hardly known, and anchors too few to find them."""
    heard = len(set(uwb.anchor_id))
    return heard <= _MOST_ANCHORS and bool(uwb.constant_sigma_m.max() > _LOOSE * uwb.sigma_m)


def _trial(problem: Problem, data: Preintegrated, values: gtsam.Values, fault: Fault) -> Trial | None:
    import gtsam

    return solved_from(problem, data, gtsam.Values(values), fault)


def _constant(values: gtsam.Values, a: int) -> float:
    return float(values.atVector(A(a))[0]) if values.exists(A(a)) else 0.0


def _path(problem: Problem, values: gtsam.Values) -> Array:
    return np.array([values.atPose3(X(i)).translation() for i in range(len(problem.keyframe_s))])
