"""How far a trajectory is from the truth, and whether its covariances say so.

Errors are estimate less truth at the trajectory's keyframes. Truth is interpolated to the keyframe times
(position: cubic Hermite, attitude: slerp) inside its own span only: nothing is extrapolated, and no keyframe
in a gap of the truth is judged.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from graphnav import _metrics as metrics
from graphnav._metrics import RelativePoseError
from graphnav._schema import Array
from graphnav.errors import GraphnavError

if TYPE_CHECKING:
    from graphnav.log import Position, SensorLog
    from graphnav.trajectory import Trajectory

ATT, POS = slice(0, 3), slice(3, 6)  # blocks of the 9x9 covariance
RPE_TIME_S = 10.0


@dataclass(frozen=True)
class CycleError:
    """Position error in one cutting cycle: from its cut_start to its cut_end."""

    cycle: int
    start_s: float
    end_s: float
    sep_m: float
    max_m: tuple[float, ...]

    def to_dict(self) -> dict[str, Any]:
        """Keys of one row of `per_cycle`."""
        return {"cycle": self.cycle, "sep_m": self.sep_m, "max_m": list(self.max_m)}


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Errors of a trajectory against truth.

    Attributes
    ----------
    t_s : (N,) keyframes that truth covers.
    error_n_m : (N, 3) position error, east, north, up.
    att_error_b_rad : (N, 3) attitude error ``Log(R_true^T R_estimate)`` about the body's right, forward, up.
    keyframes_total : keyframes of the trajectory, judged or not.
    per_cycle : one entry per cutting cycle; empty where there are no cycles.
    nees_position, nees_attitude : mean of ``e' P^-1 e / 3``: 1 is consistent, above 1 too sure of itself.
        None without covariances.
    nees_axes : the same for each axis on its own: mean of ``e^2 / sigma^2`` in east, north, up.
    ate_m : rms of the position error's norm after the best rigid alignment (no scale).
    ate_unaligned_m : the same without alignment.
    rpe : relative pose errors by name, "distance" and "time".
    notes : what a reader of the figures must know, such as a cycle that truth covers in part.
    """

    t_s: Array
    error_n_m: Array
    att_error_b_rad: Array
    keyframes_total: int
    per_cycle: tuple[CycleError, ...]
    nees_position: float | None
    nees_axes: tuple[float, ...] | None
    nees_attitude: float | None
    ate_m: float
    ate_unaligned_m: float
    rpe: dict[str, RelativePoseError]
    notes: tuple[str, ...] = ()

    @property
    def rms_m(self) -> Array:
        """(3,) rms position error, east, north, up."""
        return metrics.rms(self.error_n_m)

    @property
    def max_m(self) -> Array:
        """(3,) largest absolute position error, east, north, up."""
        return metrics.largest(self.error_n_m)

    @property
    def rms_deg(self) -> Array:
        """(3,) rms attitude error about the body's right, forward and up axes."""
        return np.rad2deg(metrics.rms(self.att_error_b_rad))

    @property
    def max_deg(self) -> Array:
        """(3,) largest absolute attitude error about the body's right, forward and up axes."""
        return np.rad2deg(metrics.largest(self.att_error_b_rad))

    def to_dict(self) -> dict[str, Any]:
        """The object that ``graphnav evaluate --json`` prints; plain numbers and lists, None for unknown."""
        return {
            "rms_m": self.rms_m.tolist(),
            "max_m": self.max_m.tolist(),
            "per_cycle": [cycle.to_dict() for cycle in self.per_cycle],
            "nees_position": self.nees_position,
            "ate_m": self.ate_m,
            "rpe": {name: error.to_dict() for name, error in self.rpe.items()},
            "nees_axes": None if self.nees_axes is None else list(self.nees_axes),
            "rms_deg": self.rms_deg.tolist(),
            "max_deg": self.max_deg.tolist(),
            "nees_attitude": self.nees_attitude,
            "ate_unaligned_m": self.ate_unaligned_m,
            "keyframes": {"judged": len(self.t_s), "of": self.keyframes_total},
            "span_s": [float(self.t_s[0]), float(self.t_s[-1])],
            "notes": list(self.notes),
        }


@dataclass(frozen=True)
class WithheldError:
    """Errors at positions that the estimator was not given, each axis east, north, up."""

    count: int
    rms_m: tuple[float, ...]
    max_m: tuple[float, ...]
    rms_3d_m: float
    median_3d_m: float
    nees_position: float | None

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and lists."""
        return {**vars(self), "rms_m": list(self.rms_m), "max_m": list(self.max_m)}


def evaluate(trajectory: Trajectory, log: SensorLog, rpe_distance_m: float | None = None) -> Evaluation:
    """Judge a trajectory by the truth in its log.

    Parameters
    ----------
    trajectory : the estimate; covariances may be missing, or NaN where they are unknown.
    log : the log that holds the truth, and the events or the odometer that tell the cycles.
    rpe_distance_m : distance travelled between the two poses of a relative pose error. By default the first
        of 10, 100 and 1000 m that the spacing of the keyframes resolves to 10 %.

    Raises
    ------
    GraphnavError
        No truth, no keyframe that it covers, or a covariance that is no covariance.
    LogError
        Events that do not pair up.
    """
    if log.truth is None:
        raise GraphnavError(f"log {log.name} has no truth table to judge by; add truth.parquet or truth.csv")
    judged, pos_true, quat_true = metrics.truth_at(log.truth, trajectory.t_s)
    if not judged.any():
        raise GraphnavError(
            f"log {log.name}: truth covers {_span(log.truth.t_s)} and no keyframe of the run, "
            f"{_span(trajectory.t_s)}; evaluate the run against its own log"
        )
    t_s, pos, quat = trajectory.t_s[judged], trajectory.pos_n[judged], trajectory.quat_nb[judged]
    error, att_error = pos - pos_true, metrics.attitude_error(quat, quat_true)
    cov = None if trajectory.cov is None else trajectory.cov[judged]
    cycles, notes = _cycle_errors(t_s, error, log)
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(pos_true, axis=0), axis=1))])
    distance = rpe_distance_m or metrics.resolved_distance(travelled)
    poses = (pos, quat, pos_true, quat_true)
    return Evaluation(
        t_s=t_s,
        error_n_m=error,
        att_error_b_rad=att_error,
        keyframes_total=len(trajectory.t_s),
        per_cycle=cycles,
        nees_position=None if cov is None else metrics.nees(error, cov[:, POS, POS], t_s),
        nees_axes=None if cov is None else metrics.nees_axes(error, cov[:, POS, POS]),
        nees_attitude=None if cov is None else metrics.nees(att_error, cov[:, ATT, ATT], t_s),
        ate_m=metrics.rms_norm(metrics.align(pos, pos_true) - pos_true),
        ate_unaligned_m=metrics.rms_norm(error),
        rpe={
            "distance": metrics.relative_error(travelled, distance, "m", *poses),
            "time": metrics.relative_error(t_s, RPE_TIME_S, "s", *poses),
        },
        notes=notes,
    )


def withheld_error(trajectory: Trajectory, position: Position) -> WithheldError:
    """Judge a trajectory by positions that its estimator was not given.

    Their own error is part of the figures; the NEES allows for it by adding their variance.

    Raises
    ------
    GraphnavError
        None of the positions lies in the trajectory's span.
    """
    inside = (position.t_s >= trajectory.t_s[0]) & (position.t_s <= trajectory.t_s[-1])
    if not inside.any():
        raise GraphnavError(f"no withheld position in the trajectory's span, {_span(trajectory.t_s)}")
    t_s = position.t_s[inside]
    estimate = trajectory.at(t_s)
    error = estimate.pos_n - position.pos_n_m[inside]
    consistency = None
    if estimate.cov is not None:
        own = np.eye(3) * position.sigma_n_m[inside][:, None, :] ** 2
        consistency = metrics.nees(error, estimate.cov[:, POS, POS] + own, t_s)
    norm = np.linalg.norm(error, axis=1)
    return WithheldError(
        count=len(t_s),
        rms_m=tuple(metrics.rms(error).tolist()),
        max_m=tuple(metrics.largest(error).tolist()),
        rms_3d_m=metrics.rms_norm(error),
        median_3d_m=float(np.median(norm)),
        nees_position=consistency,
    )


def cycle_spans(log: SensorLog) -> tuple[tuple[int, float, float], ...]:
    """Cutting cycles as (number, start, end): from the events, or found in the odometer without them.

    A cut that the end of the log breaks off is no cycle.
    """
    from graphnav.frontends.cutting_cycles import find_cycles

    return tuple((c.number, c.start_s, c.end_s) for c in find_cycles(log) if c.end_s is not None)


def _cycle_errors(t_s: Array, error: Array, log: SensorLog) -> tuple[tuple[CycleError, ...], tuple[str, ...]]:
    errors, notes = [], []
    for cycle, start, end in cycle_spans(log):
        inside = (t_s >= start) & (t_s <= end)
        covered = float(np.ptp(t_s[inside])) if inside.any() else 0.0
        if covered < 0.9 * (end - start):
            notes.append(f"cycle {cycle}: judged over {covered:.0f} s of {end - start:.0f} s")
        if inside.any():
            sep = float(np.median(np.linalg.norm(error[inside], axis=1)))
            errors.append(CycleError(cycle, start, end, sep, tuple(metrics.largest(error[inside]).tolist())))
    return tuple(errors), tuple(notes)


def _span(t_s: Array) -> str:
    return f"{t_s[0]:.3f} to {t_s[-1]:.3f} s"
