"""Spans in which ranges come in, and the keyframes that their correlated errors need."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from factors.so3 import Array
from graphnav.log import Uwb

#: Correlation times without a range after which the Markov errors start anew (what is left of them is 5e-5).
_FORGOTTEN = 10.0
#: Without a declared correlation time, s.
_APART_S = 2.0
#: Keyframes in one correlation time: halfway between two the Markov error is known to a fifth of its sigma, and what is
#: left counts as white noise.
_PER_TIME = 10.0


@dataclass(frozen=True)
class RangingSpan:
    """A span of ranges without a long break: its times, and the anchors that answer in it."""

    start_s: float
    end_s: float
    anchors: tuple[str, ...]


def ranging_spans(uwb: Uwb, start_s: float, end_s: float) -> tuple[RangingSpan, ...]:
    """Those within the record, which is from `start_s` to `end_s`."""
    inside = np.flatnonzero((uwb.t_s >= start_s) & (uwb.t_s <= end_s))
    if not len(inside):
        return ()
    t_s, anchor = uwb.t_s[inside], np.asarray(uwb.anchor_id)[inside]
    apart = _APART_S if uwb.markov_time_s is None else _FORGOTTEN * uwb.markov_time_s
    edges = [0, *(np.flatnonzero(np.diff(t_s) > apart) + 1).tolist(), len(t_s)]
    return tuple(
        RangingSpan(float(t_s[lo]), float(t_s[hi - 1]), tuple(np.unique(anchor[lo:hi]).tolist()))
        for lo, hi in pairwise(edges)
    )


def ranging_keyframes(uwb: Uwb, spans: tuple[RangingSpan, ...], interval_s: float) -> Array:
    """Times (N,) at which the Markov errors need a keyframe; none where none are declared."""
    step = interval_s if uwb.markov_time_s is None else min(uwb.markov_time_s / _PER_TIME, interval_s)
    if step >= interval_s:
        return np.zeros(0)
    return np.concatenate([np.arange(s.start_s, s.end_s + step, step) for s in spans] or [np.zeros(0)])
