"""Cutting cycles and the errors in them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from graphnav import _metrics as metrics
from graphnav._schema import Array

if TYPE_CHECKING:
    from graphnav.log import SensorLog


@dataclass(frozen=True)
class CycleError:
    """Position error in one cutting cycle: from its cut_start to its cut_end.

    Attributes
    ----------
    sep_m : spherical error probable: the median over the cycle's keyframes of the 3-D error's norm, the radius of the
        sphere about the truth that holds half of them.
    max_m : (3,) largest absolute error, east, north, up.
    """

    cycle: int
    start_s: float
    end_s: float
    sep_m: float
    max_m: tuple[float, ...]

    def to_dict(self) -> dict[str, Any]:
        """Keys of one row of `per_cycle`."""
        return {"cycle": self.cycle, "sep_m": self.sep_m, "max_m": list(self.max_m)}


def cycle_spans(log: SensorLog) -> tuple[tuple[int, float, float], ...]:
    """Cutting cycles as (number, start, end): from the events, or found in the odometer without them.

    A cut that the end of the log breaks off is no cycle.
    """
    from graphnav.frontends.cutting_cycles import find_cycles

    return tuple((c.number, c.start_s, c.end_s) for c in find_cycles(log) if c.end_s is not None)


def sep(error: Array) -> float:
    """Spherical error probable of errors (N, 3): the median of their norms."""
    return float(np.median(np.linalg.norm(error, axis=1)))


def cycle_errors(t_s: Array, error: Array, log: SensorLog) -> tuple[tuple[CycleError, ...], tuple[str, ...]]:
    """Errors (N, 3) at times (N,) in each cycle, and notes of cycles that are judged in part."""
    errors, notes = [], []
    for cycle, start, end in cycle_spans(log):
        inside = (t_s >= start) & (t_s <= end)
        covered = float(np.ptp(t_s[inside])) if inside.any() else 0.0
        if covered < 0.9 * (end - start):
            notes.append(f"cycle {cycle}: judged over {covered:.0f} s of {end - start:.0f} s")
        if inside.any():
            largest = tuple(metrics.largest(error[inside]).tolist())
            errors.append(CycleError(cycle, start, end, sep(error[inside]), largest))
    return tuple(errors), tuple(notes)
