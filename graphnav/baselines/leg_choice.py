"""Which legs take part, and when: number, direction and distance (Zheng et al., INS/LiDAR, section 3.2 and table 1).

The scanner's right axis divides the legs at rest into zone A, forward of it, and zone B, behind it. A mode says from
which zone legs are taken while the machine goes forward and while it goes backward; of those at least `nearest_m` away
along the face the nearest `count` are used. The choice looks at readings alone, never at an estimate.

Figure 5, which shows where A and B lie, is not in words anywhere in the paper. That B is behind follows from its text:
mode 2 takes legs that the machine leaves behind in the first cut, or "has not moved in the current cutting cycle" would
not limit d, and `leg_budget` gives 0.12 m of error along the face there for its mode 2, and 0.67 m in front.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from factors.increments import npt_int
from factors.so3 import Array
from graphnav.baselines._compiled import compiled
from graphnav.frontends.cutting_cycles import Cycle
from graphnav.log import LidarPoints

#: Table 1: zones in forward and in backward motion, +1 for A (in front), -1 for B (behind), 0 for both.
A, B, BOTH = 1, -1, 0
MODES = {
    1: (B, A),
    2: (B, B),
    3: (B, BOTH),
    4: (BOTH, A),
    5: (BOTH, B),
    6: (BOTH, BOTH),
    7: (A, A),
    8: (A, B),
    9: (A, BOTH),
}
#: A leg that is in use and not seen keeps its place so long.
_HOLD_S = 1.0
#: What a leg is in a scan: not used, seen for the first time since it came into use, or measured.
UNUSED, FRESH, MEASURED = 0, 1, 2
#: The distance that is chosen is a whole number of these, as the paper's are.
_STEP_M = 0.5


@dataclass(frozen=True)
class Selection:
    """Legs that take part.

    Attributes
    ----------
    count : the paper's N; mode : 1 to 9, see `MODES`; nearest_m : the paper's d, least distance along the face, m.
    """

    count: int
    mode: int
    nearest_m: float


class Chosen(NamedTuple):
    """The legs in use by scan.

    Attributes
    ----------
    t_s : (S,) times of the scans; row : (S, N) rows of the table of detections, -1 where none;
    status : (S, N) `UNUSED`, `FRESH` or `MEASURED`. A leg keeps its column while it is in use.
    """

    t_s: Array
    row: npt_int
    status: npt_int


def choose(points: LidarPoints, cycles: tuple[Cycle, ...], selection: Selection, margin_m: float) -> Chosen:
    """The legs in use in every scan.

    Parameters
    ----------
    cycles : cuts, whose direction holds until the next one starts.
    margin_m : how much nearer than `nearest_m` a leg may seem before it is given up: noise must not make it come
        and go.
    """
    first = np.flatnonzero(np.diff(points.t_s, prepend=-np.inf) > 0)
    t_s = points.t_s[first]
    zone = np.where(goes_forward(t_s, cycles), *MODES[selection.mode])
    along = points.range_m * np.cos(points.angle_rad)
    row = np.full((len(t_s), selection.count), -1)
    status = np.zeros((len(t_s), selection.count), np.int64)
    _track(
        np.append(first, len(along)), t_s, zone, np.unique(points.feature, return_inverse=True)[1], along,
        selection.nearest_m, margin_m, _HOLD_S, row, status,
    )  # fmt: skip
    return Chosen(t_s, row, status)


def goes_forward(t_s: Array, cycles: tuple[Cycle, ...]) -> npt.NDArray[np.bool_]:
    """(S,) whether the cut that is on, or was on last, leads to the far end; before the first cut, that one."""
    if not cycles:
        return np.ones(len(t_s), bool)
    begun = np.searchsorted([c.start_s for c in cycles], t_s, side="right") - 1
    return np.array([c.forward for c in cycles])[np.maximum(begun, 0)]


def largest_distance(points: LidarPoints, cut: Cycle, count: int, spacing_m: float | None) -> float:
    """The largest d for which the chosen legs are in view and have not moved in the cut (the paper's step 2), m.

    Supports behind the machine move and get new numbers, so the last sight of a leg behind tells how far away that
    is; how far in front legs come into view limits the other zone. A leg is used over one spacing.
    """
    assert cut.end_s is not None
    inside = (points.t_s >= cut.start_s) & (points.t_s <= cut.end_s)
    t_s, feature = points.t_s[inside], np.asarray(points.feature)[inside]
    along = (points.range_m * np.cos(points.angle_rad))[inside] * (1 if cut.forward else -1)
    order = np.argsort(feature, kind="stable")
    bounds = np.flatnonzero(np.diff(feature[order], prepend=-1))
    first, last = order[bounds], order[np.append(bounds[1:], len(order)) - 1]
    passed = (along[last] < 0) & (t_s[last] < cut.end_s - _HOLD_S)
    came = (along[first] > 0) & (t_s[first] > cut.start_s + _HOLD_S)
    if not passed.any() or not came.any():
        return 0.0
    # a tenth may have been lost from sight early
    reach = min(float(np.quantile(-along[last[passed]], 0.1)), float(np.quantile(along[first[came]], 0.1)))
    spacing = spacing_m if spacing_m is not None else _spacing(points.t_s[inside], along)
    return max(0.0, float(np.floor((reach - count * spacing) / _STEP_M)) * _STEP_M)


def _spacing(t_s: Array, along: Array) -> float:
    """Usual distance between neighbours in a scan, m."""
    order = np.lexsort((along, t_s))
    step = np.diff(along[order])[np.diff(t_s[order]) == 0]
    return float(np.median(step)) if len(step) else 0.0


@compiled
def _track(
    bound: npt_int, t_s: Array, zone: npt_int, feature: npt_int, along: Array, nearest_m: float, margin_m: float,
    hold_s: float, row: npt_int, status: npt_int,
) -> None:  # fmt: skip
    """Fill `row` and `status` scan by scan; scan k has the detections ``bound[k]:bound[k + 1]``."""
    count = row.shape[1]
    held, seen_s = np.full(count, -1), np.zeros(count)
    for k in range(len(t_s)):
        low, high = bound[k], bound[k + 1]
        column = np.full(high - low, -1)
        for j in range(count):
            here = False
            for i in range(low, high):
                if held[j] >= 0 and feature[i] == held[j]:
                    column[i - low], here, seen_s[j] = j, True, t_s[k]
            if not here and t_s[k] - seen_s[j] > hold_s:
                held[j] = -1
        distance = np.full(high - low, np.inf)
        for i in range(low, high):
            least = nearest_m - margin_m if column[i - low] >= 0 else nearest_m
            if abs(along[i]) >= least and (zone[k] == 0 or along[i] * zone[k] > 0):
                distance[i - low] = abs(along[i])
        hidden = 0
        for j in range(count):
            hidden += held[j] >= 0 and seen_s[j] < t_s[k]
        order = np.argsort(distance)
        used = min(count - hidden, int(np.sum(np.isfinite(distance))))
        for n in range(used, high - low):
            if column[order[n]] >= 0:
                held[column[order[n]]] = -1
        for n in range(used):
            i = order[n]
            j = column[i]
            fresh = j < 0
            if fresh:
                j = int(np.argmin(held))
                held[j], seen_s[j] = feature[low + i], t_s[k]
            row[k, j] = low + i
            status[k, j] = 1 if fresh else 2
