"""UWB ranges in the graph of a log without an IMU: carried by its motions, and where the way begins.

States and priors beside the ranges are those of `graphnav.ranges`. A log that declares no place at the start is put
where its ranges fit the dead-reckoned way best, turned within its declared heading (`placed`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from factors import so3
from factors.carried_ranging import CarriedRanges
from factors.increments import npt_int
from factors.noise import diagonal
from factors.so3 import Array
from graphnav.errors import SolveError
from graphnav.frontends.range_epochs import is_unknown
from graphnav.log import Uwb
from graphnav.markov_errors import MarkovParts, slots
from graphnav.problem import A, X
from graphnav.ranges import RangeReadings, index_of, uses_ranges
from graphnav.run import Calibration
from graphnav.trajectory import Trajectory

if TYPE_CHECKING:
    import gtsam

    from graphnav.chain_problem import ChainProblem

#: Sigmas of a scale error and of a constant that are declared to be none.
_NO_SCALE, _NO_BIAS_M = 1e-6, 1e-3
#: Where the middle of the way is looked for, in standard deviations of the anchors; and headings looked for, too, where
#: the declared one is no better than this.
_CORNERS = ((0, 0, 0), (1, 1, 0), (1, -1, 0), (-1, 1, 0), (-1, -1, 0))
_KNOWN_RAD = 0.5
#: Key of the scale error that all ranges share.
SCALE = ord("s") << 56
_SAME_S = 1e-6
#: Ranges used to place the way: it is bent by its own errors, and the graph has the last word.
_FOR_PLACING = 400
#: A range off by more than this many of its sigmas counts for less in placing the way.
_LOSS_SIGMAS = 2.0


def chain_readings(problem: ChainProblem) -> RangeReadings | None:
    """The log's ranges within the record, each carried to its time by the chain."""
    uwb, keyframe_s = problem.log.uwb, problem.keyframe_s
    if uwb is None or not uses_ranges(problem):
        return None
    rows = np.flatnonzero((uwb.t_s >= keyframe_s[0] - _SAME_S) & (uwb.t_s <= keyframe_s[-1] + _SAME_S))
    rows = rows[np.argsort(uwb.t_s[rows], kind="stable")]
    t_s = np.clip(uwb.t_s[rows], keyframe_s[0], keyframe_s[-1])
    before = np.clip(np.searchsorted(keyframe_s, t_s + _SAME_S, side="right") - 1, 0, len(keyframe_s) - 2)
    anchor = index_of([a.id for a in uwb.anchor], np.asarray(uwb.anchor_id)[rows])
    markov = MarkovParts.of(problem, uwb, t_s, t_s, anchor)
    family = CarriedRanges.of(
        pose_key=X(0) + before,
        anchor_key=A(0) + anchor,
        lever_arm_b=_tags_from(problem, t_s, keyframe_s[before], _lever_arms(uwb, rows)),
        anchor_n=np.array([a.pos_n_m for a in uwb.anchor])[anchor],
        range_m=uwb.range_m[rows],
        sigma_m=markov.sigma_m,
        markov_key=markov.key,
        next_key=markov.next_key,
        slot=markov.slot,
        slots=np.full(len(rows), slots(problem)),
        markov_m=markov.adds_m,
        scale_key=-1 if uwb.scale_sigma is None else SCALE,
    )
    return RangeReadings(rows, anchor, family)


def _lever_arms(uwb: Uwb, rows: npt_int) -> Array:
    """(K, 3) of the tags of rows."""
    tag = index_of([t.id for t in uwb.tag], np.asarray(uwb.tag_id)[rows])
    return np.array([t.lever_arm_b_m for t in uwb.tag])[tag]


def _tags_from(problem: ChainProblem, t_s: Array, keyframe_s: Array, lever_arm_b: Array) -> Array:
    """Tags (K, 3) at times t_s in the axes of the body at their keyframes."""
    (turned, moved), (from_turned, from_moved) = problem.chain.at(t_s), problem.chain.at(keyframe_s)
    tag = moved + np.einsum("kij,kj->ki", turned, lever_arm_b)
    return np.asarray(np.einsum("kji,kj->ki", from_turned, tag - from_moved))


def placed(problem: ChainProblem, way: Trajectory) -> Trajectory:
    """The dead-reckoned way where ranges put it, if the log declares no place at its start."""
    uwb, initial = problem.log.uwb, problem.initial
    if not is_unknown(initial):
        return way
    if uwb is None or not uses_ranges(problem):
        raise SolveError("the place at the start is not declared, and no ranges tell it: give initial.pos_n_m")
    shift, yaw = _place(problem, uwb, way)
    turn = so3.exp(np.array([0.0, 0.0, yaw]))
    pos = shift + (way.pos_n - way.pos_n[0]) @ turn.T
    return replace(way, pos_n=pos, quat_nb=so3.to_quaternion(turn @ way.rotation_nb), vel_n=way.vel_n @ turn.T)


def _place(problem: ChainProblem, uwb: Uwb, way: Trajectory) -> tuple[Array, float]:
    """Place of the start (3,) and turn about up, the best of several starts (least squares with soft L1 loss)."""
    from scipy.optimize import least_squares

    fit = _Fit.of(problem, uwb)
    middle, spread = fit.places.mean(axis=0), fit.places.std(axis=0)
    turns = [0.0] if fit.heading_rad < _KNOWN_RAD else [0.0, np.pi / 2, np.pi, -np.pi / 2]
    found = []
    for corner, yaw in product(_CORNERS, turns):
        start = middle + spread * np.array(corner) - so3.exp(np.array([0.0, 0.0, yaw])) @ fit.tag.mean(axis=0)
        begin = np.concatenate([start, [yaw], np.zeros(1 + len(fit.places))])
        found.append(least_squares(fit.errors, begin, loss="soft_l1", f_scale=_LOSS_SIGMAS))
    best = min(found, key=lambda each: float(each.cost))
    return np.asarray(best.x[:3]), float(best.x[3])


@dataclass(frozen=True)
class _Fit:
    """Ranges against the dead-reckoned way: unknown are the start (3), its turn about up, scale and constants.

    Attributes
    ----------
    tag : (K, 3) tags as dead-reckoned from the start; places (J, 3) of the anchors; anchor (K,) of them; range_m (K,).
    sigma_m, heading_rad, scale, bias_m (J,) : sigmas; start_n, start_m : declared place of the start with its sigmas.
    """

    tag: Array
    places: Array
    anchor: npt_int
    range_m: Array
    sigma_m: float
    heading_rad: float
    scale: float
    bias_m: Array
    start_n: Array
    start_m: Array

    @classmethod
    def of(cls, problem: ChainProblem, uwb: Uwb) -> _Fit:
        """Of some of the log's ranges."""
        rows = np.flatnonzero((uwb.t_s >= problem.keyframe_s[0]) & (uwb.t_s <= problem.keyframe_s[-1]))
        rows = rows[:: max(1, len(rows) // _FOR_PLACING)]
        turned, moved = problem.chain.at(uwb.t_s[rows])
        initial = problem.initial
        return cls(
            (moved + np.einsum("kij,kj->ki", turned, _lever_arms(uwb, rows)))
            @ so3.from_quaternion(initial.quat_nb_wxyz).T,
            np.array([a.pos_n_m for a in uwb.anchor]),
            index_of([a.id for a in uwb.anchor], np.asarray(uwb.anchor_id)[rows]),
            uwb.range_m[rows],
            float(np.hypot(uwb.sigma_m, uwb.markov_sigma_m or 0.0)),
            float(np.radians(initial.att_sigma_deg[2])),
            uwb.scale_sigma or _NO_SCALE,
            np.maximum(uwb.constant_sigma_m, _NO_BIAS_M),
            initial.pos_n_m,
            initial.pos_sigma_m,
        )

    def errors(self, x: Array) -> Array:
        """Whitened ranges, then what is declared."""
        at = x[:3] + self.tag @ so3.exp(np.array([0.0, 0.0, x[3]])).T
        distance: Array = np.linalg.norm(at - self.places[self.anchor], axis=1)
        off = (1 + x[4]) * distance + x[5:][self.anchor] - self.range_m
        start = (x[:3] - self.start_n) / self.start_m
        rest = [[x[3] / self.heading_rad, x[4] / self.scale], x[5:] / self.bias_m]
        return np.concatenate([off / self.sigma_m, start, *rest])


def scale_prior(problem: ChainProblem) -> gtsam.NonlinearFactor | None:
    """What is declared of the scale error, where one is."""
    import gtsam

    uwb = problem.log.uwb
    if uwb is None or uwb.scale_sigma is None:
        return None
    return gtsam.PriorFactorVector(SCALE, np.zeros(1), diagonal(np.array([uwb.scale_sigma])))


def rejected_by_anchor(problem: ChainProblem, left_out: RangeReadings) -> dict[str, int]:
    """Number of ranges left out, of all anchors ("uwb") and of each ("uwb anchor ID")."""
    assert problem.log.uwb is not None
    counts = np.bincount(left_out.anchor, minlength=len(problem.log.uwb.anchor)).tolist()
    by_anchor = {f"uwb anchor {a.id}": n for a, n in zip(problem.log.uwb.anchor, counts, strict=True)}
    return {"uwb": sum(counts), **by_anchor}


def heard(problem: ChainProblem, values: gtsam.Values) -> list[int]:
    """The anchors that take part."""
    uwb = problem.log.uwb
    return [] if uwb is None else [a for a in range(len(uwb.anchor)) if values.exists(A(a))]


def anchor_calibration(
    problem: ChainProblem, values: gtsam.Values, blocks: dict[int, Array] | None
) -> dict[str, Calibration]:
    """The anchors' constant errors and the ranges' scale error."""
    uwb, found = problem.log.uwb, {}
    for a in heard(problem, values):
        assert uwb is not None
        sigma = None if blocks is None else float(np.sqrt(blocks[A(a)][0, 0]))
        found[f"uwb_bias_{uwb.anchor[a].id}"] = Calibration(float(values.atVector(A(a))[0]), sigma, "m")
    if values.exists(SCALE):
        sigma = None if blocks is None else float(np.sqrt(blocks[SCALE][0, 0]))
        found["uwb_scale"] = Calibration(float(values.atVector(SCALE)[0]), sigma, "1")
    return found
