"""What is kept of one run: errors, consistency, and for drawing their course over time."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Judged:
    """One trajectory against truth.

    Attributes
    ----------
    rms_m : (3,) east, north, up; rms_3d_m : of the norm; sep_m : median 3-D error per cycle.
    nees_position : mean of ``e' P^-1 e / 3``, or None.
    t_s, error_n_m : (N,), (N, 3), where the course is kept.
    """

    rms_m: tuple[float, ...]
    rms_3d_m: float
    sep_m: tuple[float, ...]
    nees_position: float | None
    t_s: Array | None = None
    error_n_m: Array | None = None


@dataclass(frozen=True, eq=False)
class Calibrated:
    """Estimates of biases, scale and mounting angles against what was drawn, K of them, in datasheet units.

    Attributes
    ----------
    final : (K,) last estimate less truth; course_rms : (K,) rms of that over all keyframes from the first cut on.
    t_s, value : (N,), (N, K), where the course is kept.
    """

    final: Array
    course_rms: Array
    t_s: Array | None = None
    value: Array | None = None


@dataclass(frozen=True, eq=False)
class Found:
    """All that one log gave.

    Attributes
    ----------
    log : "interval 2", "par 3", ...; seed.
    judged, calibrated : by estimator.
    inertial : error of the pure inertial solution, (T, 3) at every second, by whose biases it was told.
    known : (K,) drawn biases and calibration; names, units : theirs.
    cycles : (start, end) in s.
    """

    log: str
    seed: int
    judged: dict[str, Judged]
    cycles: tuple[tuple[float, float], ...]
    calibrated: dict[str, Calibrated] = field(default_factory=dict)
    inertial: dict[str, Array] = field(default_factory=dict)
    known: Array | None = None
    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()


def judge(trajectory: Any, log: Any, keep: bool) -> Judged:
    """Error and consistency of one trajectory against its log's truth."""
    from graphnav.evaluation import evaluate

    found = evaluate(trajectory, log)
    return Judged(
        rms_m=tuple(found.rms_m.tolist()),
        rms_3d_m=found.ate_unaligned_m,
        sep_m=tuple(cycle.sep_m for cycle in found.per_cycle),
        nees_position=found.nees_position,
        t_s=found.t_s if keep else None,
        error_n_m=found.error_n_m if keep else None,
    )


def calibrated(history: Any, known: Array, first_cut_s: float, keep: bool) -> Calibrated:
    """Error of a `CalibrationHistory` against what was drawn."""
    error = history.value - known
    moving = history.t_s >= first_cut_s
    return Calibrated(
        final=error[-1],
        course_rms=np.asarray(np.sqrt(np.mean(error[moving] ** 2, axis=0))),
        t_s=history.t_s if keep else None,
        value=history.value if keep else None,
    )
