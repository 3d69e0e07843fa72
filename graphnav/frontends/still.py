"""Whether ranges to anchors say that a machine stands: what a quiet IMU alone cannot tell from smooth travel."""

from __future__ import annotations

import numpy as np

from factors.so3 import Array
from graphnav.log import Uwb

#: A range that changes by more sigmas than this, or whose change is less sure than this, is no sign of rest.
_SIGMAS, _SURE_M_S = 4.0, 0.01
#: Ranges of an anchor in a span that tell a change.
_FEWEST = 20


def still(uwb: Uwb, spans: Array) -> Array:
    """Those of the spans (K, 2) in which the ranges stay the same.

    The slope of each anchor's ranges over the span is compared with what their errors at rest make of it: white noise,
    and a Markov process of time tau, whose slope over T has the variance ``12 * 2 tau sigma^2 / T^3`` (long spans;
    that of a range that only goes its own way within short ones). At 4 sigma one of 4,000 rests with four anchors is
    missed. Ranges to three anchors at least must be sure to a centimetre a second.
    """
    return np.array([span for span in spans if _stays(uwb, span[0], span[1])], float).reshape(-1, 2)


def _stays(uwb: Uwb, start_s: float, end_s: float) -> bool:
    inside = np.flatnonzero((uwb.t_s >= start_s) & (uwb.t_s <= end_s))
    names, sure = np.asarray(uwb.anchor_id)[inside], 0
    for anchor in np.unique(names):
        rows = inside[names == anchor]
        if len(rows) < _FEWEST:
            continue
        slope, sigma = _slope(uwb, uwb.t_s[rows], uwb.range_m[rows])
        if abs(slope) > _SIGMAS * sigma:
            return False
        sure += sigma < _SURE_M_S
    return sure >= 3


def _slope(uwb: Uwb, t_s: Array, range_m: Array) -> tuple[float, float]:
    """Slope of ranges over time, m/s, from those near their median, and its sigma at rest."""
    off = np.abs(range_m - np.median(range_m))
    near = off <= 5 * 1.4826 * np.median(off)
    t, r = t_s[near] - t_s[near].mean(), range_m[near]
    span = float(np.ptp(t_s))
    slope = float(t @ (r - r.mean()) / (t @ t))
    white = (uwb.rest_factor * uwb.sigma_m) ** 2 / float(t @ t)
    markov = 0.0
    if uwb.markov_sigma_m is not None and uwb.markov_time_s is not None:
        variance = (uwb.rest_factor * uwb.markov_sigma_m) ** 2
        markov = min(24 * uwb.markov_time_s * variance / span**3, 6 * variance / span**2)
    return slope, float(np.sqrt(white + markov))
