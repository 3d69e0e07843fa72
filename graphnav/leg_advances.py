"""Which leg was which in the cycle before: supports stand a push farther and, along the face, where they stood.

Numbers of features say nothing of supports, so pairs are found by place: of the legs last seen before a leg was first
seen, the one nearest to where the push has it come from, within half the spacing along the face (creep and the drift of
the path together are less) and `_ACROSS_M` across. All legs lean alike, so a pair read at different heights would see
the push wrong, and always to the same side: only pairs read within `_RISE_M` of each other count.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from factors.advance import AdvanceFamily
from factors.increments import npt_int
from factors.so3 import Array
from graphnav.frontends.cutting_cycles import push_at
from graphnav.legs import LegReadings
from graphnav.problem import L, Problem, X

if TYPE_CHECKING:
    import gtsam

#: How far a leg may stand across the face from where the push has it: sigmas of the push, and metres of the path's.
_SIGMAS, _ACROSS_M = 4.0, 0.15
#: Largest difference of the heights at which the two legs of a pair are placed.
_RISE_M = 0.1


def leg_advances(problem: Problem, readings: LegReadings, values: gtsam.Values) -> AdvanceFamily | None:
    """Pairs of legs one advance apart, or None where there is no face, no whole cut, or none that fits.

    Parameters
    ----------
    values : the path that the readings were brought together along.
    """
    face, config = problem.log.face, problem.config.lidar
    whole = [c for c in problem.frontend.cycles if c.end_s is not None]
    if face is None or not config.advances or not whole or not len(readings.leg):
        return None
    start, end = (
        values.atPose3(X(problem.frontend.index(t))).translation()[:2]
        for t in (whole[0].start_s, whole[0].end_s)
        if t is not None
    )
    forward = (end - start) * (1.0 if whole[0].forward else -1.0)
    forward /= np.linalg.norm(forward)
    across = np.array([forward[1], -forward[0]])
    near = start if whole[0].forward else end
    place = (readings.place_n[:, :2] - near) @ np.column_stack([forward, across])
    first, last = _seen(readings, problem.keyframe_s)
    cycle = np.searchsorted([c.start_s for c in problem.frontend.cycles], last, side="right")
    push = np.array([push_at(problem.log, int(c), float(s)) for c, s in zip(cycle, place[:, 0], strict=True)])
    reach = np.array([min(_spacing(readings, place[:, 0]) / 2, face.length_m), _SIGMAS * face.push_sigma_m + _ACROSS_M])
    before, after = _pairs(place, push, first, last, reach)
    rise = np.abs(readings.place_n[after, 2] - readings.place_n[before, 2])
    level = rise < _RISE_M
    if not level.any():
        return None
    before, after = before[level], after[level]
    sigma = np.hypot(face.push_sigma_m, np.tan(np.radians(config.lean_sigma_deg)) * rise[level])
    return AdvanceFamily(L(0) + before, L(0) + after, across, push[before], sigma)


def _seen(readings: LegReadings, keyframe_s: Array) -> tuple[Array, Array]:
    """Times (J,) at which each leg was first and last seen; infinite for one that is in no reading."""
    first = np.full(len(readings.feature), np.inf)
    last = np.full(len(readings.feature), -np.inf)
    np.minimum.at(first, readings.leg, keyframe_s[readings.keyframe])
    np.maximum.at(last, readings.leg, keyframe_s[readings.keyframe])
    return first, last


def _spacing(readings: LegReadings, along_m: Array) -> float:
    """Usual distance along the face of legs that are seen side by side, m."""
    order = np.lexsort((along_m[readings.leg], readings.keyframe))
    together = np.diff(readings.keyframe[order]) == 0
    steps = np.diff(along_m[readings.leg[order]])[together]
    return float(np.median(steps)) if len(steps) else np.inf


def _pairs(place: Array, push: Array, first: Array, last: Array, reach: Array) -> tuple[npt_int, npt_int]:
    """Legs before and after an advance, each in one pair at most on either side.

    Parameters
    ----------
    place : (J, 2) along and across the face; push : (J,) expected; first, last : (J,) times seen; reach : (2,).
    """
    from scipy.spatial import cKDTree

    pushed = (place + np.column_stack([np.zeros_like(push), push])) / reach
    found = cKDTree(pushed).query_ball_point(place / reach, 1.0)
    pairs = [(i, j) for j, near in enumerate(found) for i in near if last[i] < first[j]]
    if not pairs:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    before, after = np.array(pairs).T
    distance = np.linalg.norm(pushed[before] - place[after] / reach, axis=1)
    order = np.argsort(distance, kind="stable")
    # nearest first: a leg that is in a pair already is not in a second one
    _, of_before = np.unique(before[order], return_index=True)
    _, of_after = np.unique(after[order], return_index=True)
    rows = order[np.intersect1d(of_before, of_after)]
    return before[rows], after[rows]
