"""Many seeds: run in worker processes, and their rows made one per method."""

from __future__ import annotations

import os
import statistics
from collections.abc import Callable, Sequence

import numpy as np

from graphnav._consistency import OverRuns, band
from graphnav._cycles import CycleError
from graphnav._pool import in_order
from graphnav._stages import ProgressHook
from graphnav.comparison import TRUTH, Comparison, Curve, MethodRow, NisBand, OverSeeds

#: Step of the common time axis of error curves, s.
_STEP_S = 1.0
Rows = tuple[MethodRow, ...]


def in_workers(run: Callable[[int], Rows], seeds: int, progress: ProgressHook | None) -> list[Rows]:
    """What `run` returns for the seeds 0, 1, ..., in their order; one worker process per core.

    Parameters
    ----------
    run : can be pickled, as can what it returns.
    """
    found: list[Rows] = []
    for rows in in_order(run, range(seeds), min(os.cpu_count() or 1, seeds), batch=1):
        found.append(rows)
        if progress is not None:
            progress("seeds", len(found), seeds)
    return found


def over_seeds(name: str, found: Sequence[Rows], seeds: int) -> Comparison:
    """One comparison from the rows of every seed, methods in the same order in each.

    Simulated logs have truth, so errors are against that.
    """
    return Comparison(name, TRUTH, seeds, tuple(_merged(of_method) for of_method in zip(*found, strict=True)))


def _merged(rows: Sequence[MethodRow]) -> MethodRow:
    """One method's rows of all seeds as one."""
    good = [row for row in rows if row.error is None]
    errors = [f"seed {seed}: {row.error}" for seed, row in enumerate(rows) if row.error is not None]
    error = f"{len(errors)} of {len(rows)} runs; {errors[0]}" if errors else None
    position = OverRuns.of([row.nees_position for row in good if row.nees_position is not None])
    attitude = OverRuns.of([row.nees_attitude for row in good if row.nees_attitude is not None])
    over = OverSeeds(len(good), len(errors), position, attitude)
    if not good:
        return MethodRow(rows[0].method, error=error, over_seeds=over)
    squares = np.mean(np.square([row.rms_m or () for row in good]), axis=0)
    largest = np.max([row.max_m or () for row in good], axis=0)
    return MethodRow(
        method=rows[0].method,
        seconds=statistics.median(row.seconds for row in good if row.seconds is not None),
        rms_m=tuple(np.sqrt(squares).tolist()),
        max_m=tuple(largest.tolist()),
        per_cycle=_cycles(good),
        nees_position=None if position is None else position.mean,
        nees_attitude=None if attitude is None else attitude.mean,
        nis=_nis([row.nis for row in good if row.nis is not None]),
        converged=all(row.converged for row in good),
        warnings=tuple(f"seed {seed}: {warning}" for seed, row in enumerate(rows) for warning in row.warnings),
        error=error,
        curve=_curve([row.curve for row in good if row.curve is not None]),
        over_seeds=over,
    )


def _cycles(rows: Sequence[MethodRow]) -> tuple[CycleError, ...]:
    """Median SEP and largest maximum of each cycle; its span is the first run's."""
    by_number: dict[int, list[CycleError]] = {}
    for row in rows:
        for cycle in row.per_cycle:
            by_number.setdefault(cycle.cycle, []).append(cycle)
    return tuple(
        CycleError(
            number,
            same[0].start_s,
            same[0].end_s,
            statistics.median(cycle.sep_m for cycle in same),
            tuple(np.max([cycle.max_m for cycle in same], axis=0).tolist()),
        )
        for number, same in sorted(by_number.items())
    )


def _nis(found: Sequence[NisBand]) -> NisBand | None:
    """NIS of all measurements of all seeds together."""
    rows = sum(nis.rows for nis in found)
    if not rows:
        return None
    return NisBand(sum(nis.mean * nis.rows for nis in found) / rows, *band(rows), rows)


def _curve(curves: Sequence[Curve]) -> Curve | None:
    """Root mean square error over the runs on a common time axis, within what all of them cover."""
    if not curves:
        return None
    start, end = max(c.t_s[0] for c in curves), min(c.t_s[-1] for c in curves)
    t_s = np.arange(np.ceil(start / _STEP_S), np.floor(end / _STEP_S) + 1) * _STEP_S
    squares = np.zeros((len(t_s), 3))
    for curve in curves:
        squares += np.column_stack([np.interp(t_s, curve.t_s, axis) for axis in curve.error_n_m.T]) ** 2
    return Curve(t_s, np.sqrt(squares / len(curves)))
