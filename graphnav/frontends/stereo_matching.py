"""Matches between features of two images by their descriptors, and between the sides of a rectified pair.

Only pairs of features whose places allow it are compared. A match is the best one for both features of it (mutual), and
near enough: by the Hamming distance (ORB), or by the ratio to the second best (SIFT; Lowe 2004).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from graphnav.frontends.stereo_features import Features, Places, Whole

#: Largest number of differing bits of 256, and largest ratio of distances to the best and the second best.
MOST_BITS = 60
_RATIO = 0.8
#: Rows by which the sides of a rectified pair may differ, in pixels of the image in which the feature was found.
_ROW_GATE_PX = 1.5
#: Scales of the two sides' pixels differ by at most this factor.
_SCALE_GATE = 1.5

Pairs = tuple[Whole, Whole]


@dataclass(frozen=True)
class Window:
    """Where a match may lie relative to a feature: from `low` to `high`, (u, v) in px."""

    low_px: tuple[float, float]
    high_px: tuple[float, float]


def matches(one: Features, other: Features, window: Window) -> Pairs:
    """Rows of matching features of `one` and of `other`.

    Parameters
    ----------
    one, other : features of the same kind.
    window : difference of places, other less one.
    """
    return _mutual(one, other, *_near(one, other, window))


def rectified_matches(left: Features, right: Features, most_px: float) -> Pairs:
    """Matches along the rows of a rectified pair, disparities above zero and up to `most_px`."""
    gate = _ROW_GATE_PX * float(max(left.scale.max(initial=1.0), 1.0))
    rows, others = _near(left, right, Window((-most_px, -gate), (0.0, gate)))
    apart = np.abs(left.uv_px[rows, 1] - right.uv_px[others, 1])
    allowed = apart <= _ROW_GATE_PX * np.maximum(1.0, np.minimum(left.scale[rows], right.scale[others]))
    return _mutual(left, right, rows[allowed], others[allowed])


def _near(one: Features, other: Features, window: Window) -> Pairs:
    """Pairs of rows whose places differ as the window allows, found among those sorted by their image row."""
    order = np.argsort(other.uv_px[:, 1], kind="stable")
    v = other.uv_px[order, 1]
    first = np.searchsorted(v, one.uv_px[:, 1] + window.low_px[1], side="left")
    last = np.searchsorted(v, one.uv_px[:, 1] + window.high_px[1], side="right")
    count = np.maximum(last - first, 0)
    rows = np.repeat(np.arange(len(one)), count)
    others = order[np.arange(len(rows)) - np.repeat(np.cumsum(count) - count, count) + np.repeat(first, count)]
    shift = other.uv_px[others, 0] - one.uv_px[rows, 0]
    ratio = other.scale[others] / one.scale[rows]
    allowed = (shift >= window.low_px[0]) & (shift <= window.high_px[0])
    allowed &= (ratio < _SCALE_GATE) & (ratio > 1 / _SCALE_GATE)
    return rows[allowed], others[allowed]


def _mutual(one: Features, other: Features, rows: Whole, others: Whole) -> Pairs:
    """Of the pairs, those that are best for both and near enough."""
    if not len(rows):
        return rows, others
    distance = _distance(one.descriptor[rows], other.descriptor[others])
    best, second = _best_two(rows, distance, len(one))
    best_of_other, _ = _best_two(others, distance, len(other))
    pair = np.arange(len(rows))
    good = (best[rows] == pair) & (best_of_other[others] == pair)
    if one.descriptor.dtype == np.uint64:
        good &= distance <= MOST_BITS
    else:
        good &= distance <= _RATIO * second[rows]
    return rows[good], others[good]


def _distance(one: npt.NDArray[Any], other: npt.NDArray[Any]) -> Places:
    """Distance of descriptors row by row: differing bits, or Euclid's."""
    if one.dtype == np.uint64:
        return np.asarray(np.bitwise_count(one ^ other).sum(axis=1), float)
    return np.asarray(np.sqrt(np.square(one - other).sum(axis=1)), float)


def _best_two(group: Whole, distance: Places, groups: int) -> tuple[Whole, Places]:
    """The best pair of every group (-1: none), and the distance of its second best (inf: none)."""
    order = np.lexsort([distance, group])
    sorted_group = group[order]
    first = np.searchsorted(sorted_group, np.arange(groups))
    count = np.bincount(group, minlength=groups)
    best = np.full(groups, -1)
    best[count > 0] = order[first[count > 0]]
    second = np.full(groups, np.inf)
    second[count > 1] = distance[order[first[count > 1] + 1]]
    return best, second
