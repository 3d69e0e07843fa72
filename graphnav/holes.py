"""Long times in which a sensor that was heard before and after says nothing, and the machine moved within its view."""

from __future__ import annotations

import numpy as np

from factors.so3 import Array
from graphnav.legs import LegReadings
from graphnav.log import Uwb
from graphnav.trajectory import Trajectory

#: The longest such time that is passed over, s: the IMU and the odometer bridge a minute.
_HOLE_S = 90.0
#: Share of the longest usual range to an anchor within which it is certainly heard, and what is usual.
_WITHIN, _USUAL = 0.8, 0.95


def leg_hole(used: LegReadings, left_out: LegReadings | None, t_s: Array, rest_s: Array) -> list[str]:
    """A line for the longest time between legs, if it is long; none for what the machine stood still of it.

    Parameters
    ----------
    used, left_out : readings of legs; t_s : (N,) keyframes; rest_s : (K, 2) spans at rest.
    """
    seen = np.concatenate([part.keyframe for part in (used, left_out) if part is not None])
    start_s, end_s = _longest(np.unique(t_s[seen]))
    at_rest = np.clip(np.minimum(rest_s[:, 1], end_s) - np.maximum(rest_s[:, 0], start_s), 0.0, None).sum()
    if end_s - start_s - at_rest <= _HOLE_S:
        return []
    return [f"no leg is seen from {start_s:.0f} to {end_s:.0f} s, where errors grow: check the LiDAR's record"]


def range_hole(uwb: Uwb, trajectory: Trajectory) -> list[str]:
    """A line for the longest time between ranges, if the machine was for long where it is heard else.

    At a face end ranges come in for a while and then none for a cycle, as the machine is away: nothing is amiss. Heard
    it is within most of the longest usual range to an anchor.
    """
    start_s, end_s = _longest(uwb.t_s)
    inside = np.flatnonzero((trajectory.t_s > start_s) & (trajectory.t_s < end_s))
    if end_s - start_s <= _HOLE_S or not len(inside):
        return []
    pos_n, heard = trajectory.pos_n[inside], np.zeros(len(inside), bool)
    for anchor in uwb.anchor:
        range_m = uwb.range_m[np.asarray(uwb.anchor_id) == anchor.id]
        if len(range_m):
            reach_m = _WITHIN * np.quantile(range_m, _USUAL)
            heard |= np.linalg.norm(pos_n - anchor.pos_n_m, axis=1) < reach_m
    if heard.mean() * (end_s - start_s) <= _HOLE_S:
        return []
    when = f"from {start_s:.0f} to {end_s:.0f} s"
    return [f"no UWB range {when}, where the machine is as near to anchors as when it hears them: check the record"]


def _longest(t_s: Array) -> tuple[float, float]:
    """Start and end of the longest step of ascending times."""
    if len(t_s) < 2:
        return 0.0, 0.0
    k = int(np.argmax(np.diff(t_s)))
    return float(t_s[k]), float(t_s[k + 1])
