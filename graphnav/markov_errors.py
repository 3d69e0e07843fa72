"""The Markov errors of UWB ranges as states: which keyframes' vectors each range has a part of, and how much.

All anchors that answer in a span share one vector at every keyframe of it; between keyframes the process is what a
joint normal says of the two ends, and the rest counts as white (decision 0012).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from factors import ranging
from factors.increments import npt_int
from factors.so3 import Array
from graphnav.frontends.ranging_spans import RangingSpan
from graphnav.leg_means import npt_bool
from graphnav.log import Uwb
from graphnav.problem import M, Problem

if TYPE_CHECKING:
    from graphnav.chain_problem import ChainProblem

#: Times closer than this are the same.
SAME_S = 1e-6


def slots(problem: Problem | ChainProblem) -> int:
    """Entries of a vector of Markov errors: as many as anchors answer in one span."""
    return max((len(span.anchors) for span in problem.frontend.ranging), default=0)


def in_span(span: RangingSpan, t_s: Array) -> npt_bool:
    """Whether times are within a span."""
    return np.asarray((t_s >= span.start_s - SAME_S) & (t_s <= span.end_s + SAME_S))


def keyframe_before(keyframe_s: Array, t_s: Array) -> npt_int:
    """The keyframe before each time that has one after it."""
    found = np.searchsorted(keyframe_s, t_s + SAME_S, side="right") - 1
    return np.asarray(np.clip(found, 0, len(keyframe_s) - 2), np.int64)


def _resting(problem: Problem | ChainProblem, t_s: Array) -> npt_bool:
    """Whether the machine is at rest then."""
    rest = problem.frontend.rest_s
    return np.asarray(((t_s[:, None] >= rest[:, 0]) & (t_s[:, None] <= rest[:, 1])).any(axis=1))


@dataclass(frozen=True)
class MarkovParts:
    """What the Markov errors have to do with each of K ranges, see `factors.ranging.RangeFamily`."""

    key: npt_int
    next_key: npt_int
    slot: npt_int
    adds_m: Array
    sigma_m: Array

    @classmethod
    def of(
        cls, problem: Problem | ChainProblem, uwb: Uwb, stamped_s: Array, t_s: Array, anchor: npt_int
    ) -> MarkovParts:
        """For ranges of `anchor` (K,).

        Parameters
        ----------
        stamped_s : (K,) times by the ranges' own clock, in which the Markov errors run; t_s : (K,) by the IMU's, which
            tells whether the machine was at rest.
        """
        keyframe_s = problem.keyframe_s
        stamped_s = np.clip(stamped_s, keyframe_s[0], keyframe_s[-1])
        before = keyframe_before(keyframe_s, stamped_s)
        calm = np.where(_resting(problem, t_s), uwb.rest_factor, 1.0)
        white, none = calm * uwb.sigma_m, np.full(len(t_s), -1, np.int64)
        if uwb.markov_time_s is None or uwb.markov_sigma_m is None:
            return cls(none, none, none, np.zeros((len(t_s), 2)), white)
        first_s, next_s = keyframe_s[before], keyframe_s[before + 1]
        first, second, left = ranging.markov_weights(
            (stamped_s - first_s) / uwb.markov_time_s, (next_s - first_s) / uwb.markov_time_s
        )
        sigma = calm * uwb.markov_sigma_m
        slot = np.zeros(len(t_s), np.int64)
        for span in problem.frontend.ranging:
            inside = in_span(span, stamped_s)
            names = np.array([uwb.anchor[a].id for a in anchor[inside]])
            slot[inside] = np.searchsorted(np.array(span.anchors), names)
        adds = sigma[:, None] * np.column_stack([first, second])
        return cls(M(0) + before, M(0) + before + 1, slot, adds, np.hypot(white, sigma * np.sqrt(left)))
