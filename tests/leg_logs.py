"""Short logs beside upright legs on a smooth track, where the model of the paper's LiDAR filter is right."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np

from graphnav.log import LidarPoints, SensorLog
from graphnav.simulation.lidar import LidarErrors
from graphnav.simulation.lidar_figures import LidarSpec, SupportSpec
from graphnav.simulation.scenarios import LIDAR, ShearerSpec
from graphnav.simulation.shearer import simulate_shearer

#: Nothing wrong with the scanner but noise; the log still has to declare sigmas above zero.
NONE = 1e-9
FAULTLESS = LidarSpec(
    range_scale=NONE, range_bias_m=NONE, angle_quadratic_per_deg=NONE, angle_scale=NONE, angle_bias_deg=NONE,
    mounting_deg=(0.0, 0.0, 0.0), supports=SupportSpec(lean_deg=(0.0, 0.0), lean_azimuth_deg=0.0),
)  # fmt: skip
#: Two cuts of 24 m at 0.3 m/s, errors of the start drawn: 5 minutes.
SMOOTH = dataclasses.replace(
    LIDAR, length_m=24.0, cycles=2, speed_m_s=0.3, static_s=10.0, tail_s=5.0, retreat_m=6.0, crossing_m=4.0,
    end_work_s=None, duration_s=None, bend_m=0.01, push_sigma_m=1e-4, along_sigma_m=1e-4, slip_sigma_m_s=1e-6,
    roll_sigma_deg=0.0, mounting_deg=(0.0, 0.0, 0.0), att_error_deg=None, creep_m=(-0.1,), lidar=FAULTLESS,
)  # fmt: skip
ONE_CUT = dataclasses.replace(SMOOTH, cycles=1, creep_m=())


@cache
def beside_legs(spec: ShearerSpec = SMOOTH, seed: int = 0, noise: bool = True) -> SensorLog:
    return simulate_shearer("legs", spec, seed, noise=noise)


def blind(log: SensorLog) -> SensorLog:
    return dataclasses.replace(log, truth=None)


def misread(log: SensorLog, **errors: float) -> SensorLog:
    """The log as a scanner with systematic errors (those of `LidarErrors`) would have recorded it."""
    names = ("range_scale", "range_bias_m", "angle_quadratic_per_deg", "angle_scale", "angle_bias_deg")
    wrong = LidarErrors(np.zeros(3), **{name: errors.get(name, 0.0) for name in names})
    points = log.lidar_points
    assert points is not None
    read = points.replace(
        range_m=wrong.measured_range(points.range_m), angle_rad=wrong.measured_angle(points.angle_rad)
    )
    return dataclasses.replace(log, lidar_points=read)


def scans(along_m: np.ndarray, feature: np.ndarray, moved_m: np.ndarray, rate_hz: float = 10.0) -> LidarPoints:
    """Detections of legs at places along a face, 4 m to the left of a scanner that stands at `moved_m` scan by scan."""
    rows = [(k / rate_hz, f, y - s) for k, s in enumerate(moved_m) for f, y in zip(feature, along_m, strict=True)]
    t_s, number, ahead = (np.array(part) for part in zip(*rows, strict=True))
    return LidarPoints(t_s, number.astype(np.int64), np.hypot(4.0, ahead), np.arctan2(4.0, ahead))
