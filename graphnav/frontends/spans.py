"""Sets of time spans: ``(K, 2)`` arrays of [start_s, end_s], ascending and apart."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from graphnav._schema import Array

NONE: Array = np.zeros((0, 2))


def from_mask(mask: npt.NDArray[np.bool_], start_s: Array, end_s: Array) -> Array:
    """Spans of the runs of True in `mask` (N,), where item k lasts from `start_s[k]` to `end_s[k]`."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]])))
    return np.column_stack([start_s[edges[::2]], end_s[edges[1::2] - 1]])


def intersect(first: Array, second: Array) -> Array:
    """Times that lie in both sets."""
    both, i, j = [], 0, 0
    while i < len(first) and j < len(second):
        start, end = max(first[i, 0], second[j, 0]), min(first[i, 1], second[j, 1])
        if start < end:
            both.append((start, end))
        if first[i, 1] < second[j, 1]:
            i += 1
        else:
            j += 1
    return np.array(both, dtype=float).reshape(-1, 2)


def unite(first: Array, second: Array) -> Array:
    """Times that lie in either set; spans that touch become one."""
    spans: list[list[float]] = []
    for start, end in sorted(map(tuple, np.vstack([first, second]))):
        if spans and start <= spans[-1][1]:
            spans[-1][1] = max(spans[-1][1], end)
        else:
            spans.append([start, end])
    return np.array(spans, dtype=float).reshape(-1, 2)


def shrink(spans: Array, trim_s: float, min_length_s: float) -> Array:
    """Spans without `trim_s` at both ends, those then shorter than `min_length_s` dropped."""
    inner = spans + np.array([trim_s, -trim_s])
    kept: Array = inner[inner[:, 1] - inner[:, 0] >= min_length_s]
    return kept
