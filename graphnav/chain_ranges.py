"""UWB ranges in the graph of a log without an IMU: carried by its motions, and where the way begins.

States and priors beside the ranges are those of `graphnav.ranges`. A log that declares no place at the start is put
where its ranges fit the dead-reckoned way best, turned within its declared heading (`placed`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from factors import so3
from factors.carried_ranging import CarriedRanges
from factors.increments import npt_int
from factors.so3 import Array
from graphnav.errors import SolveError
from graphnav.frontends.range_epochs import is_unknown
from graphnav.log import Uwb
from graphnav.problem import A, X
from graphnav.ranges import MarkovParts, RangeReadings, index_of, slots, uses_ranges
from graphnav.run import Calibration
from graphnav.trajectory import Trajectory

if TYPE_CHECKING:
    import gtsam

    from graphnav.chain_graph import ChainProblem

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
    markov = MarkovParts.of(problem, uwb, t_s, before, anchor)
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

    first, last = problem.keyframe_s[0], problem.keyframe_s[-1]
    rows = np.flatnonzero((uwb.t_s >= first) & (uwb.t_s <= last))
    rows = rows[:: max(1, len(rows) // _FOR_PLACING)]
    turned, moved = problem.chain.at(uwb.t_s[rows])
    start = so3.from_quaternion(problem.initial.quat_nb_wxyz)
    tag = (moved + np.einsum("kij,kj->ki", turned, _lever_arms(uwb, rows))) @ start.T
    places = np.array([a.pos_n_m for a in uwb.anchor])
    anchor = index_of([a.id for a in uwb.anchor], np.asarray(uwb.anchor_id)[rows])
    sigma = float(np.hypot(uwb.sigma_m, uwb.markov_sigma_m or 0.0))
    heading = float(np.radians(problem.initial.att_sigma_deg[2]))

    def errors(x: Array) -> Array:
        at = x[:3] + tag @ so3.exp(np.array([0.0, 0.0, x[3]])).T
        off: Array = np.linalg.norm(at - places[anchor], axis=1) + x[4:][anchor] - uwb.range_m[rows]
        known: Array = np.r_[x[:3] / problem.initial.pos_sigma_m, x[3] / heading, x[4:] / (uwb.bias_sigma_m or 1e-3)]
        return np.concatenate([off / sigma, known])

    middle, spread = places.mean(axis=0), places.std(axis=0)
    corners = [middle + spread * np.array(c) for c in ((0, 0, 0), (1, 1, 0), (1, -1, 0), (-1, 1, 0), (-1, -1, 0))]
    found = [
        least_squares(errors, np.r_[corner - tag.mean(axis=0), np.zeros(1 + len(places))], loss="soft_l1",
                      f_scale=_LOSS_SIGMAS)
        for corner in corners
    ]  # fmt: skip
    best = min(found, key=lambda each: float(each.cost))
    return np.asarray(best.x[:3]), float(best.x[3])


def heard(problem: ChainProblem, values: gtsam.Values) -> list[int]:
    """The anchors that take part."""
    uwb = problem.log.uwb
    return [] if uwb is None else [a for a in range(len(uwb.anchor)) if values.exists(A(a))]


def anchor_calibration(
    problem: ChainProblem, values: gtsam.Values, blocks: dict[int, Array] | None
) -> dict[str, Calibration]:
    """The anchors' constant errors."""
    uwb, found = problem.log.uwb, {}
    for a in heard(problem, values):
        assert uwb is not None
        sigma = None if blocks is None else float(np.sqrt(blocks[A(a)][0, 0]))
        found[f"uwb_bias_{uwb.anchor[a].id}"] = Calibration(float(values.atVector(A(a))[0]), sigma, "m")
    return found
