"""Withholding some of a log's positions from an estimator, to judge it by them where there is no truth."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from factors.so3 import Array
from graphnav.errors import LogError
from graphnav.log import Position, SensorLog

#: Positions at the start that always stay: importers make the initial state of them.
INITIAL_FIXES = 2

Rows = npt.NDArray[np.bool_]
Gaps = Sequence[tuple[float, float]]


def split(
    log: SensorLog, withhold: str | Gaps | None = "every-other", *, gap_s: float | None = None
) -> tuple[SensorLog, Position]:
    """Divide a log's positions into those an estimator is given and those it is judged by.

    Parameters
    ----------
    log : a log with positions.
    withhold : "every-other" position, or gaps ``[(start_s, end_s), ...]`` in the log's time, without their
        ends.
    gap_s : instead of `withhold`: positions for `gap_s`, none for `gap_s`, and so on.

    Returns
    -------
    kept : SensorLog
        The log with what is left of its positions. The first two (the initial state is made of them) and
        the last (what lies beyond it would be extrapolated) always stay; a gap of `gap_s` that would reach
        the end is not made.
    withheld : Position
        The others.

    Raises
    ------
    LogError
        The log has no positions, `withhold` is not understood, or none would be withheld.
    """
    if log.position is None:
        raise LogError("no positions to withhold", where=f"log {log.name}")
    t = log.position.t_s
    if gap_s is not None:
        withhold = _alternate(t, gap_s)
    if withhold is None:
        raise LogError("nothing to withhold", fix='pass withhold="every-other", gaps or gap_s')
    if isinstance(withhold, str):
        if withhold != "every-other":
            raise LogError(f'withhold "{withhold}", expected "every-other" or gaps (start_s, end_s)')
        out = np.arange(len(t)) % 2 == 1
    else:
        gaps = np.array([_gap(pair) for pair in withhold], float).reshape(-1, 2)
        out = in_spans(t, gaps)
    out[:INITIAL_FIXES] = False
    out[-1] = False
    if not out.any():
        raise LogError(f"none of the {len(t)} positions would be withheld", fix="choose gaps inside the log")
    return dataclasses.replace(log, position=_take(log.position, ~out)), _take(log.position, out)


def _gap(pair: tuple[float, float]) -> tuple[float, float]:
    if len(pair) != 2 or not pair[0] < pair[1]:
        raise LogError(f"gap {pair}, expected (start_s, end_s) with the start before the end")
    return pair


def in_spans(t_s: Array, spans: Array) -> Rows:
    """Which times (N,) lie strictly inside any of the spans (K, 2)."""
    inside = (t_s[:, None] > spans[:, 0]) & (t_s[:, None] < spans[:, 1])
    return np.asarray(inside.any(axis=1), bool)


def _alternate(t_s: Array, gap_s: float) -> Gaps:
    """Gaps of `gap_s` with as long a stretch of fixes before each and a fix behind it."""
    if not gap_s > 0:
        raise LogError(f"gap_s {gap_s:g}, expected a length in s above zero")
    starts = np.arange(t_s[0] + gap_s, t_s[-1] - gap_s, 2 * gap_s)
    return [(float(start), float(start + gap_s)) for start in starts]


def _take(position: Position, rows: Rows) -> Position:
    return Position(t_s=position.t_s[rows], pos_n_m=position.pos_n_m[rows], sigma_n_m=position.sigma_n_m[rows])
