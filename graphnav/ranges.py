"""UWB ranges of a log as factors: carried from the keyframe before each by the IMU, their Markov errors as states.

Each anchor has one variable, its constant error and how far it stands from where it is declared. The Markov errors of
all anchors of a span are one vector at every keyframe of it, chained by the process's own transition.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from factors import ranging
from factors.increments import compensated_increments, npt_int
from factors.inertial import Motion, cumulate
from factors.noise import diagonal
from factors.so3 import Array
from graphnav.anchor_priors import anchor_priors
from graphnav.leg_means import npt_bool
from graphnav.markov_errors import SAME_S, MarkovParts, in_span, keyframe_before, slots
from graphnav.problem import A, B, M, Problem, T, V, X

if TYPE_CHECKING:
    import gtsam

    from graphnav.chain_problem import ChainProblem
    from graphnav.config import UwbConfig

#: Keyframe intervals worked on at a time.
_BLOCK = 500


@dataclass(frozen=True)
class RangeReadings:
    """Ranges that take part.

    Attributes
    ----------
    row : (K,) of the table uwb; anchor : (K,) index into its anchors.
    family : the same ranges as factors.
    """

    row: npt_int
    anchor: npt_int
    family: ranging.RangeFamily

    def only(self, rows: npt_int | npt_bool) -> RangeReadings:
        """Some of them."""
        return RangeReadings(self.row[rows], self.anchor[rows], self.family.only(rows))

    def factors(self, problem: Problem) -> list[tuple[int, gtsam.NonlinearFactor]]:
        """Those of the ranges and of what stands beside them, each with the last keyframe it needs.

        On its way an incremental solver cannot come back to a range; where outliers are looked for, Huber's loss, which
        has one minimum, holds them off.
        """
        config = problem.config.uwb
        family = self.family if config.loss == "none" else replace(self.family, loss="huber", scale=config.loss_sigmas)
        last = [int(self.family.pose_key[rows.start]) - X(0) + 1 for rows in family.groups()]
        beside = RangeStates.of(problem, self).factors(problem)
        return beside + list(zip(last, family.factors(), strict=True))


def uses_ranges(problem: Problem | ChainProblem) -> bool:
    """Whether ranges take part."""
    return bool(problem.frontend.ranging) and problem.config.uwb.use


def range_readings(problem: Problem, gyro_bias_b: Array, accel_bias_b: Array) -> RangeReadings | None:
    """The log's ranges within the record, carried to their times with the given biases (N-1, 3)."""
    uwb, keyframe_s = problem.log.uwb, problem.keyframe_s
    if uwb is None or not uses_ranges(problem):
        return None
    stamped_s = uwb.t_s - problem.clock.later_s
    rows = _within(problem, uwb.t_s, stamped_s)
    t_s = np.clip(uwb.t_s[rows], keyframe_s[0], keyframe_s[-1])
    before = keyframe_before(keyframe_s, t_s)
    ids, tags = [a.id for a in uwb.anchor], [t.id for t in uwb.tag]
    anchor = index_of(ids, np.asarray(uwb.anchor_id)[rows])
    tag = index_of(tags, np.asarray(uwb.tag_id)[rows])
    markov = MarkovParts.of(problem, uwb, stamped_s[rows], t_s, anchor)
    family = ranging.RangeFamily(
        pose_key=X(0) + before,
        velocity_key=V(0) + before,
        bias_key=B(0) + problem.bias_epoch[before],
        markov_key=markov.key,
        next_key=markov.next_key,
        slot=markov.slot,
        slots=np.full(len(rows), slots(problem)),
        anchor_key=A(0) + anchor,
        motion=_carried(problem, t_s, before, gyro_bias_b, accel_bias_b),
        accel_bias_b=accel_bias_b[before],
        gyro_bias_b=gyro_bias_b[before],
        lever_arm_b=np.array([t.lever_arm_b_m for t in uwb.tag])[tag],
        anchor_n=np.array([a.pos_n_m for a in uwb.anchor])[anchor],
        range_m=uwb.range_m[rows],
        sigma_m=markov.sigma_m,
        markov_m=markov.adds_m,
        gravity_m_s2=problem.gravity_m_s2,
        earth_rate_n=problem.earth_rate_n,
    )
    return RangeReadings(rows, anchor, family)


def _within(problem: Problem, t_s: Array, stamped_s: Array) -> npt_int:
    """Ranges within the record by their time, and within the spans by that of their own clock."""
    inside = (t_s >= problem.keyframe_s[0] - SAME_S) & (t_s <= problem.keyframe_s[-1] + SAME_S)
    heard = np.zeros(len(t_s), bool)
    for span in problem.frontend.ranging:
        heard |= in_span(span, stamped_s)
    return np.flatnonzero(inside & heard)


def index_of(known: list[str], names: Array) -> npt_int:
    """Places of `names` (K,) in a list that holds them all."""
    order = np.argsort(known)
    return np.asarray(order[np.searchsorted(np.array(known)[order], names)], np.int64)


def _carried(problem: Problem, t_s: Array, before: npt_int, gyro_bias_b: Array, accel_bias_b: Array) -> Motion:
    """Motion from the keyframe before each range to the range's own time."""
    keyframe_s, parts = problem.keyframe_s, []
    edges = np.searchsorted(before, np.arange(0, len(keyframe_s) - 1 + _BLOCK, _BLOCK))
    for lo, hi in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        if lo < hi:
            first, last = int(before[lo]), int(before[hi - 1]) + 1
            span = keyframe_s[first : last + 1]
            grid = np.unique(np.concatenate([span, t_s[lo:hi]]))
            owner = np.searchsorted(span, grid[:-1], side="right") - 1 + first
            fine = compensated_increments(
                problem.imu.samples.block(span[0], span[-1]), grid, problem.minor_s, gyro_bias_b[owner],
                accel_bias_b[owner],
            )  # fmt: skip
            motion = cumulate(replace(fine, first=fine.first[np.searchsorted(grid, span)]))
            parts.append(
                _at(motion, fine.first[np.searchsorted(grid, t_s[lo:hi])] - 1, t_s[lo:hi] > span[before[lo:hi] - first])
            )
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    return Motion(np.arange(len(t_s) + 1), *columns)


def _at(motion: Motion, minor: npt_int, moved: npt_bool) -> tuple[Array, Array, Array, Array]:
    """Motion up to the ends of minor intervals; none for ranges at their keyframe."""
    k = np.maximum(minor, 0)
    share = moved.astype(float)
    rotation = np.where(moved[:, None, None], motion.rotation[k], np.eye(3))
    return (
        share * motion.elapsed_s[k], rotation, share[:, None] * motion.velocity_b[k],
        share[:, None] * motion.position_b[k],
    )  # fmt: skip


# What stands beside the ranges ------------------------------------------------------------------------------


@dataclass(frozen=True)
class RangeStates:
    """Keys of the variables that ranges add.

    Attributes
    ----------
    anchors : indices of the anchors heard; markov : (S, 2) first and last keyframe of each span's Markov errors.
    clock : whether the time offset is one of them.
    """

    anchors: list[int]
    markov: list[tuple[int, int]]
    clock: bool = False

    @classmethod
    def of(cls, problem: Problem | ChainProblem, readings: RangeReadings) -> RangeStates:
        """Those of the ranges of a log."""
        keys = readings.family.markov_key
        used = np.unique(keys[keys >= 0]) - M(0)
        edges = np.flatnonzero(np.diff(used, prepend=-2, append=used[-1:] + 2 if len(used) else []) > 1)
        t = problem.keyframe_s
        first = [int(np.searchsorted(t, span.start_s + SAME_S, side="right") - 1) for span in problem.frontend.ranging]
        last = [int(np.searchsorted(t, span.end_s + SAME_S, side="right")) for span in problem.frontend.ranging]
        spans = [(max(lo, 0), min(hi, len(t) - 1)) for lo, hi in zip(first, last, strict=True)] if len(edges) else []
        return cls(np.unique(readings.anchor).tolist(), spans, readings.family.clock is not None)

    def insert(self, problem: Problem | ChainProblem, values: gtsam.Values) -> None:
        """Zeros for what is not there yet."""
        if self.clock and not values.exists(T(0)):
            values.insert(T(0), np.zeros(1))
        for a in self.anchors:
            if not values.exists(A(a)):
                values.insert(A(a), np.zeros(4))
        for first, last in self.markov:
            for i in range(first, last + 1):
                if not values.exists(M(i)):
                    values.insert(M(i), np.zeros(slots(problem)))

    def factors(self, problem: Problem | ChainProblem) -> list[tuple[int, gtsam.NonlinearFactor]]:
        """Priors and transitions, each with the last keyframe it needs."""
        import gtsam

        uwb, size = problem.log.uwb, slots(problem)
        assert uwb is not None
        found: list[tuple[int, gtsam.NonlinearFactor]] = []
        found += [(0, factor) for factor in anchor_priors(uwb, self.anchors)]
        found += [(0, _clock_prior(problem.config.uwb))] if self.clock else []
        for first, last in self.markov:
            assert uwb.markov_time_s is not None
            found.append((first, gtsam.PriorFactorVector(M(first), np.zeros(size), diagonal(np.ones(size)))))
            for i in range(first, last):
                span = (problem.keyframe_s[i + 1] - problem.keyframe_s[i]) / uwb.markov_time_s
                found.append((i + 1, ranging.markov_factor(M(i), M(i + 1), float(span), size)))
        return found


def _clock_prior(config: UwbConfig) -> gtsam.NonlinearFactor:
    """How far the time offset may be from zero."""
    import gtsam

    return gtsam.PriorFactorVector(T(0), np.zeros(1), diagonal(np.array([config.time_offset_sigma_s])))
