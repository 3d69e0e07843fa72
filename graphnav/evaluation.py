"""How far a trajectory is from the truth, and whether its covariances say so.

Errors are estimate less truth at the trajectory's keyframes. Truth is interpolated to the keyframe times
(position: cubic Hermite, attitude: slerp) inside its own span only: nothing is extrapolated, and no keyframe
in a gap of the truth is judged.

SEP, the spherical error probable, is the median of the 3-D error's norm: the radius of the sphere about the truth that
holds half of the keyframes' estimates.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from graphnav import _metrics as metrics
from graphnav._consistency import one_run_band
from graphnav._coverage import notes_of_another_log, notes_of_coverage, span
from graphnav._cycles import CycleError, cycle_errors, sep
from graphnav._metrics import RelativePoseError
from graphnav._schema import Array
from graphnav._statistics import PERCENT, AbsolutePoseError, AxisStatistics, absolute_error, quantiles
from graphnav.errors import GraphnavError

if TYPE_CHECKING:
    from graphnav.baselines.innovations import Innovations
    from graphnav.log import Position, SensorLog
    from graphnav.trajectory import Trajectory

ATT, POS = slice(0, 3), slice(3, 6)  # blocks of the 9x9 covariance
RPE_TIME_S = 10.0
_ON_ROW_S = 1e-3
#: Note where positions leave the alignment open.
STRAIGHT = "a straight path, or none, does not say how it is turned about its line: APE aligned has no rotation"


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
    nees_position, nees_attitude : mean of ``e' P^-1 e / 3``: 1 is consistent, above 1 too sure of itself. Attitude is
        judged at keyframes that fall on rows of truth, where most do.
        None without covariances.
        Errors at the keyframes of one run hang together, so their mean is taken for one draw: see `nees_band`.
    nees_axes : the same for each axis on its own: mean of ``e^2 / sigma^2`` in east, north, up.
    ape : absolute pose errors by name: "aligned" by the best rigid motion (no scale), "unaligned" as they stand.
    rpe : relative pose errors by name, "distance" and "time"; a rigid motion of the estimate does not change them, so
        they are the same aligned or not.
    nis : normalized innovations squared of all measurements and of each kind, with their bands: see
        `graphnav.baselines.innovations.Nis`. None for what is no Kalman filter.
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
    ape: dict[str, AbsolutePoseError]
    rpe: dict[str, RelativePoseError]
    nis: dict[str, Any] | None = None
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

    @property
    def sep_m(self) -> float:
        """Median of the 3-D position error's norm over all keyframes."""
        return sep(self.error_n_m)

    @property
    def quantiles_m(self) -> tuple[float, ...]:
        """3-D error that 10, 20, ... 100 % of the keyframes do not exceed."""
        return quantiles(self.error_n_m)

    @property
    def ate_m(self) -> float:
        """Root mean square of the position error's norm after the best rigid alignment (no scale)."""
        return self.ape["aligned"].translation_rms_m

    @property
    def ate_unaligned_m(self) -> float:
        """The same without alignment."""
        return self.ape["unaligned"].translation_rms_m

    @property
    def nees_band(self) -> dict[str, tuple[float, float]] | None:
        """95 % bands of the NEES, the run taken for one draw of its axes; None without covariances.

        Keyframes of one run are correlated, how far one run does not tell: at worst they are one draw. Independent
        runs (seeds) tell more: `graphnav._consistency.OverRuns`.
        """
        if self.nees_position is None and self.nees_attitude is None:
            return None
        return {"position": one_run_band(3), "axis": one_run_band(1), "attitude": one_run_band(3)}

    def to_dict(self) -> dict[str, Any]:
        """The object that ``graphnav evaluate --json`` prints; plain numbers and lists, None for unknown."""
        band = self.nees_band
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
            "nees_band": None if band is None else {name: list(bounds) for name, bounds in band.items()},
            "nis": self.nis,
            "ate_unaligned_m": self.ate_unaligned_m,
            "ape": {name: error.to_dict() for name, error in self.ape.items()},
            "sep_m": self.sep_m,
            "cdf": {"percent": list(PERCENT), "error_3d_m": list(self.quantiles_m)},
            "statistics": {
                "position_m": AxisStatistics.of(self.error_n_m).to_dict(),
                "attitude_deg": AxisStatistics.of(np.rad2deg(self.att_error_b_rad)).to_dict(),
            },
            "keyframes": {"judged": len(self.t_s), "of": self.keyframes_total},
            # to the nanosecond: a first time of 2e-16 is what is left of 0.01 less a sampling interval
            "span_s": [round(float(t), 9) for t in (self.t_s[0], self.t_s[-1])],
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


def evaluate(
    trajectory: Trajectory,
    log: SensorLog,
    rpe_distance_m: float | None = None,
    innovations: Innovations | None = None,
    run_of: str | None = None,
) -> Evaluation:
    """Judge a trajectory by the truth in its log.

    Parameters
    ----------
    trajectory : the estimate; covariances may be missing, or NaN where they are unknown.
    log : the log that holds the truth, and the events or the odometer that tell the cycles.
    rpe_distance_m : distance travelled between the two poses of a relative pose error. By default the first
        of 10, 100 and 1000 m that the spacing of the keyframes resolves to 10 %.
    innovations : of a Kalman filter (`Run.innovations`), for the NIS.
    run_of : name of the log that the trajectory was estimated from (`Run.log_name`), None where it is not known.

    Raises
    ------
    GraphnavError
        No truth, no keyframe that it covers, a covariance that is no covariance, or the log is not the run's own.
    LogError
        Events that do not pair up.
    """
    if log.truth is None:
        raise GraphnavError(f"log {log.name} has no truth table to judge by; add truth.parquet or truth.csv")
    foreign = notes_of_another_log(trajectory.t_s, log, run_of)
    judged, pos_true, quat_true = metrics.truth_at(log.truth, trajectory.t_s)
    if not judged.any():
        raise GraphnavError(
            f"log {log.name}: truth covers {span(log.truth.t_s)} and no keyframe of the run, "
            f"{span(trajectory.t_s)}; evaluate the run against its own log"
        )
    t_s, pos, quat = trajectory.t_s[judged], trajectory.pos_n[judged], trajectory.quat_nb[judged]
    error, att_error = pos - pos_true, metrics.attitude_error(quat, quat_true)
    cov = None if trajectory.cov is None else trajectory.cov[judged]
    cycles, notes = cycle_errors(t_s, error, log)
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(pos_true, axis=0), axis=1))])
    distance = rpe_distance_m or metrics.resolved_distance(travelled)
    poses = (pos, quat, pos_true, quat_true)
    aligned = absolute_error(*poses, aligned=True)
    straight = (STRAIGHT,) if aligned.rotation_rms_deg is None else ()
    return Evaluation(
        t_s=t_s,
        error_n_m=error,
        att_error_b_rad=att_error,
        keyframes_total=len(trajectory.t_s),
        per_cycle=cycles,
        nees_position=None if cov is None else metrics.nees(error, cov[:, POS, POS], t_s),
        nees_axes=None if cov is None else metrics.nees_axes(error, cov[:, POS, POS]),
        nees_attitude=None if cov is None else _attitude_nees(log, t_s, att_error, cov[:, ATT, ATT]),
        ape={
            "aligned": aligned,
            "unaligned": absolute_error(*poses, aligned=False),
        },
        rpe={
            "distance": metrics.relative_error(travelled, distance, "m", *poses),
            "time": metrics.relative_error(t_s, RPE_TIME_S, "s", *poses),
        },
        nis=None if innovations is None else innovations.to_dict(),
        notes=(*foreign, *notes_of_coverage(judged), *notes, *straight),
    )


def _attitude_nees(log: SensorLog, t_s: Array, error: Array, cov: Array) -> float | None:
    """NEES at the keyframes that fall on rows of truth, where most do; else at all.

    A machine that wobbles turns between rows 0.1 s apart by more than a good gyro's error: interpolated truth is none.
    """
    assert log.truth is not None
    rows = log.truth.t_s
    after = np.clip(np.searchsorted(rows, t_s), 1, len(rows) - 1)
    on_row = np.minimum(np.abs(t_s - rows[after]), np.abs(t_s - rows[after - 1])) < _ON_ROW_S
    chosen = on_row if on_row.mean() > 0.5 else np.ones(len(t_s), bool)
    return metrics.nees(error[chosen], cov[chosen], t_s[chosen])


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
        raise GraphnavError(f"no withheld position in the trajectory's span, {span(trajectory.t_s)}")
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
