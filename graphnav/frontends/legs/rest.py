"""What of the tracks is a landmark at rest: spans without motion, seen often enough."""

from __future__ import annotations

import numpy as np

from graphnav._schema import Array
from graphnav.frontends import spans
from graphnav.frontends.legs.association import ENDS, Tracks
from graphnav.frontends.legs.circles import Circles
from graphnav.frontends.legs.motion import PlanarMotion
from graphnav.frontends.legs.segmentation import Bool, Int

#: A leg is compared with itself this much earlier and later, over means of this length.
_APART_S, _MEAN_S = 2.0, 0.5
#: Between the two it moves by less than this part of what makes a leg a moved one.
_STEADY = 5
#: Detections that make a leg, and the least share of the scans between its first and last that must show it.
FEWEST, _SHARE = 5, 0.2
#: Over this time the legs' common motion is compared with dead reckoning; alignment adds errors of this size.
_COMMON_S, _COMMON_M = 10.0, 0.05


def numbered(circles: Circles, tracks: Tracks, motion: PlanarMotion, moved_m: float, all_move: Array) -> Int:
    """Numbers from 1, 0 for a detection that belongs to no leg at rest.

    Parameters
    ----------
    circles, tracks, motion : what `track` was given and returned.
    moved_m : displacement that makes a leg a new one.
    all_move : (M, 2) spans from `common_motion`: what is seen in them is left out, what is seen after them is new.

    Returns
    -------
    array (K,)
        Left out are detections while a leg moves, and legs seen in fewer than 5 scans or in less than a fifth of the
        scans between their first and last.
    """
    t_s = motion.t_s[circles.scan]
    epoch = np.searchsorted(all_move[:, 0], t_s, side="right")
    inside = (epoch > 0) & (t_s <= np.concatenate([[-np.inf], all_move[:, 1]])[epoch])
    key = np.where(inside, -1, tracks.number * (len(all_move) + 1) + epoch)
    order = np.argsort(np.where(tracks.number < 0, -1, key), kind="stable")
    ordered = key[order]
    order = order[(ordered >= 0) & (tracks.number[order] >= 0)]
    number, count = np.zeros(len(circles), np.int64), 0
    for rows in np.split(order, np.flatnonzero(np.diff(key[order])) + 1):
        at_rest = _at_rest(rows, circles, tracks, t_s, moved_m)
        if len(at_rest):
            count += 1
            number[at_rest] = count
    return number


def _at_rest(rows: Int, circles: Circles, tracks: Tracks, t_s: Array, moved_m: float) -> Int:
    """Detections of one track that may stay; none if they are too few."""
    if len(rows) < FEWEST:
        return rows[:0]
    variance = float(np.mean(np.trace(circles.cov_s_m2[rows], axis1=1, axis2=2))) / 2
    ended = ENDS[tracks.end[tracks.number[rows[0]]]]
    rows = rows[_steady(t_s[rows], tracks.place_m[rows], variance, moved_m)]
    if ended == "moved":
        rows = rows[: _left(tracks.place_m[rows], moved_m)]
    if len(rows) < FEWEST or len(rows) < _SHARE * (circles.scan[rows[-1]] - circles.scan[rows[0]] + 1):
        return rows[:0]
    return rows


def _steady(t_s: Array, place_m: Array, variance: float, moved_m: float) -> Bool:
    """Detections around which the leg stays where it is."""
    total = np.concatenate([np.zeros((1, 2)), np.cumsum(place_m - place_m[0], axis=0)])
    # near the ends of the track its first and last half second stand for earlier and later
    early, late = np.maximum(t_s - _APART_S, t_s[0]), np.minimum(t_s + _APART_S, t_s[-1])
    low = np.searchsorted(t_s, [early, late - _MEAN_S])
    high = np.searchsorted(t_s, [early + _MEAN_S, late], side="right")
    count = np.maximum(high - low, 1)
    mean = (total[high] - total[low]) / count[..., None]
    change = mean[1] - mean[0]
    allowed = moved_m / _STEADY + 3.5 * np.sqrt(variance * (1 / count).sum(axis=0))
    moves = np.hypot(change[:, 0], change[:, 1]) >= allowed
    # what is beside a motion may belong to it: the means are as wide
    near = np.concatenate([[0], np.cumsum(moves)])
    low, high = np.searchsorted(t_s, t_s - _MEAN_S), np.searchsorted(t_s, t_s + _MEAN_S, side="right")
    steady: Bool = near[high] == near[low]
    return steady


def _left(place_m: Array, moved_m: float) -> int:
    """How many detections of a leg that moves in the end come before it does."""
    if len(place_m) < FEWEST:
        return 0
    home = np.median(place_m[: max(len(place_m) // 2, FEWEST)], axis=0)
    mean = np.cumsum(place_m - home, axis=0)
    mean[FEWEST:] = mean[FEWEST:] - mean[:-FEWEST]
    away = np.hypot(mean[:, 0], mean[:, 1]) / np.minimum(np.arange(len(mean)) + 1, FEWEST) > moved_m / 3
    here = np.flatnonzero(~away)
    return int(here[-1]) + 1 if len(here) else 0


def common_motion(tracks: Tracks, motion: PlanarMotion, seen: Bool) -> Array:
    """Spans in which all legs together leave dead reckoning: they moved, or the machine slipped.

    Parameters
    ----------
    tracks, motion : what `track` returned and was given.
    seen : (S,) scans with a detection.

    Returns
    -------
    array (M, 2)
        Starts and ends of spans of 10 s or more in which the motion aligned with the legs differs from the
        dead-reckoned one by more than 5 sigmas of the latter and 5 cm; overlapping ones united.
    """
    if len(motion.t_s) < 2:
        return spans.NONE
    step = np.diff(tracks.pose[:, :2], axis=0, prepend=tracks.pose[:1, :2])
    previous = tracks.pose[:, 2] - np.diff(tracks.pose[:, 2], prepend=tracks.pose[0, 2])
    c, s = np.cos(previous), np.sin(previous)
    own = motion.step_s_m
    dead = np.column_stack([c * own[:, 0] - s * own[:, 1], s * own[:, 0] + c * own[:, 1]])
    dead[0] = 0.0
    later = np.searchsorted(motion.t_s, motion.t_s + _COMMON_S, side="right") - 1
    differs = _between(np.cumsum(step - dead, axis=0), later)
    random = np.sqrt(np.maximum(_between(np.cumsum(motion.random_m**2), later), 0.0))
    allowed = 5 * (random + _between(np.cumsum(motion.systematic_m), later)) + _COMMON_M
    wrong = (np.hypot(differs[:, 0], differs[:, 1]) > allowed) & seen & seen[later]
    return spans.unite(np.column_stack([motion.t_s, motion.t_s[later]])[wrong], spans.NONE)


def _between(total: Array, later: Int) -> Array:
    """What a running total gains up to a later row."""
    return total[later] - total
