"""`Run`: what a smoothing returns."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from graphnav._schema import Array
from graphnav.baselines.innovations import Innovations
from graphnav.trajectory import Trajectory

if TYPE_CHECKING:
    from graphnav.config import Config


DEGREE = np.pi / 180
DEG_H, MG = DEGREE / 3600, 9.80665e-3
#: Name, size of the unit in SI and unit of every calibration value, in the order of GTSAM's bias and of the odometer's.
ACCEL_NAMES = [(f"accel_bias_{axis}", MG, "mg") for axis in "xyz"]
GYRO_NAMES = [(f"gyro_bias_{axis}", DEG_H, "deg/h") for axis in "xyz"]
ODOMETER_NAMES = [
    ("odometer_scale", 1.0, "1"),
    *((f"odometer_mounting_{axis}", DEGREE, "deg") for axis in ("right", "forward", "up")),
]

#: The LiDAR's, in the order of `factors.landmark`.
LIDAR_NAMES = [
    ("lidar_range_scale", 1.0, "1"),
    ("lidar_range_bias", 1.0, "m"),
    ("lidar_angle_bias", DEGREE, "deg"),
    ("lidar_angle_scale", 1.0, "1"),
    ("lidar_angle_quadratic", 1 / DEGREE, "1/deg"),
    *((f"lidar_mounting_{axis}", DEGREE, "deg") for axis in ("right", "forward", "up")),
]
#: The camera: its mounting (angles about its own axes, place in the body), and what disparities are too large by.
CAMERA_NAMES = [
    *((f"camera_angle_{axis}", DEGREE, "deg") for axis in ("right", "down", "forward")),
    *((f"camera_place_{axis}", 1.0, "m") for axis in ("right", "forward", "up")),
    ("camera_disparity", 1.0, "px"),
    ("camera_time", 1.0, "s"),
]


@dataclass(frozen=True)
class Calibration:
    """One estimated sensor parameter: value, 1-sigma and unit (sigma is None without covariances)."""

    value: float
    sigma: float | None
    unit: str


@dataclass(frozen=True)
class Diagnostics:
    """How the smoothing went.

    Attributes
    ----------
    method, converged, iterations, keyframes : what was solved, and how.
    seconds : per stage: read, frontend, assemble, solve, covariance, total.
    peak_rss_mb : peak memory of the process, MB.
    rejected : measurements rejected, per sensor.
    warnings : one line each.
    history : per iteration: error, step in joint sigmas, damping, seconds; with lidar-ekf, the choice of legs.
    nis : with a Kalman filter, `Innovations.to_dict`: the consistency of its innovations.
    """

    method: str
    converged: bool
    iterations: int
    keyframes: int
    seconds: dict[str, float]
    peak_rss_mb: float
    rejected: dict[str, int] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    history: list[dict[str, float]] = field(default_factory=list)
    nis: dict[str, Any] | None = None


@dataclass(frozen=True, eq=False)
class CalibrationHistory:
    """Estimated sensor parameters over time, at the trajectory's keyframes.

    Attributes
    ----------
    t_s : (N,); names, units : as in `Run.calibration`, K of them.
    value : (N, K); sigma : (N, K) or None.
    """

    t_s: Array
    names: tuple[str, ...]
    units: tuple[str, ...]
    value: Array
    sigma: Array | None = None


@dataclass(frozen=True, eq=False)
class Stops:
    """Where the machine stood at both ends of every cut, with the covariance of all these states together.

    The trajectory's covariances are those of one keyframe each; what is said of the difference of two places, hours
    apart, needs what they have in common: the survey, the first position, the heading.

    Attributes
    ----------
    t_s : ``(S,)`` ascending.
    pos_n, rot_nb : ``(S, 3)`` m and ``(S, 3, 3)``.
    scanner : ``(8,)`` the LiDAR's calibration, as in `factors.landmark`; ``(0,)`` where it was not estimated.
    cov : ``(6 S + 8, 6 S + 8)`` or ``(6 S, 6 S)``: for each stop attitude (body, right perturbation, rad) and position
        (n, m), then the scanner.
    """

    t_s: Array
    pos_n: Array
    rot_nb: Array
    scanner: Array
    cov: Array


@dataclass(frozen=True, eq=False)
class RangeResiduals:
    """What the solution leaves of every UWB range.

    Attributes
    ----------
    t_s : (K,) ascending; anchor : (K,) ids.
    residual_m : (K,) measured less what pose, anchor, constant and Markov error make of it; used : (K,) or left out.
    """

    t_s: Array
    anchor: Any
    residual_m: Array
    used: Any


@dataclass(frozen=True)
class Run:
    """A smoothed trajectory with calibration and diagnostics.

    Attributes
    ----------
    trajectory : states and covariances at keyframes, `.at(t)` in between.
    calibration : name -> estimate with sigma.
    diagnostics : iterations, seconds per stage, warnings.
    config : the effective configuration.
    causal : with iSAM2, the trajectory of causal estimates (each keyframe from the past alone); else None.
    history : the calibration over time.
    innovations : with a Kalman filter, those of its forward pass; else None.
    stops : from a graph with covariances, the ends of the cuts and their joint covariance; else None.
    ranges : from a graph with UWB ranges, what it leaves of each; else None.
    log_name : name of the log that it was made of.
    """

    trajectory: Trajectory
    calibration: dict[str, Calibration]
    diagnostics: Diagnostics
    config: Config
    causal: Trajectory | None = None
    history: CalibrationHistory | None = None
    innovations: Innovations | None = None
    stops: Stops | None = None
    ranges: RangeResiduals | None = None
    log_name: str = ""

    def save(self, folder: str | Path, **options: Any) -> None:
        """Write the result files to a folder, whole or not at all."""
        from graphnav.report.results import save

        save(self, folder, **options)
