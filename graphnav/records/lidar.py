"""LiDAR: declared errors, detections, raw scans."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from graphnav._schema import Array, Record, column, param
from graphnav.records.rotation import unit_quaternion

#: A turn, and a little for an offset taken off the angles; a scan covers two turns at most. More is degrees.
_TURN_RAD = 2 * np.pi + 0.1
_IN_DEGREES = "in degrees? multiply them by 0.0174533"


@dataclass(frozen=True, eq=False)
class LidarPoints(Record):
    """Detected point features with data association; angle from s's forward axis, counter-clockwise."""

    TABLE: ClassVar[str] = "lidar_points"
    STRICT: ClassVar[bool] = False
    t_s: Array = column("t_s")
    feature: Any = column("feature", kind="int")
    range_m: Array = column("range_m", positive=True)
    angle_rad: Array = column("angle_rad")

    def __post_init__(self) -> None:
        super().__post_init__()
        _refuse_degrees(self, "angle_rad")


@dataclass(frozen=True, eq=False)
class LidarScans(Record):
    """Raw planar scans."""

    TABLE: ClassVar[str] = "lidar_scans"
    t_s: Array = column("t_s")
    angle_min_rad: Array = column("angle_min_rad")
    angle_step_rad: Array = column("angle_step_rad")
    ranges_m: Any = column("ranges_m", kind="list")

    def __post_init__(self) -> None:
        super().__post_init__()
        _refuse_degrees(self, "angle_min_rad")
        _refuse_degrees(self, "angle_step_rad")
        beams = np.array([len(ranges) for ranges in self.ranges_m])
        wide = np.abs(self.angle_step_rad) * beams > 2 * _TURN_RAD
        if wide.any():
            row = int(np.argmax(wide))
            step = self.angle_step_rad[row]
            problem = f"value {step:.6g}, by which {beams[row]} beams cover {abs(step) * beams[row]:.4g} rad"
            raise self.error(f"{problem}, expected a turn or less", row=row, column="angle_step_rad", fix=_IN_DEGREES)


def _refuse_degrees(record: Record, name: str) -> None:
    """Refuse angles that are beyond a turn."""
    angle = getattr(record, name)
    beyond = np.abs(angle) > _TURN_RAD
    if beyond.any():
        row = int(np.argmax(beyond))
        problem = f"value {angle[row]:.6g}, expected an angle within a turn, 6.283 rad"
        raise record.error(problem, row=row, column=name, fix=_IN_DEGREES)


@dataclass(frozen=True, eq=False)
class Landmark(Record):
    """A surveyed point of the leg that `feature` stands for; the sigma is that of east and of north."""

    SECTION: ClassVar[str] = "lidar.landmark"
    feature: int = param(kind="int")
    pos_n_m: Array = param(shape=(3,))
    sigma_m: float = param(positive=True)


@dataclass(frozen=True, eq=False)
class Lidar(Record):
    """Declared geometry and errors of the LiDAR."""

    SECTION: ClassVar[str] = "lidar"
    range_sigma_m: float = param(positive=True)
    angle_sigma_deg: float = param(positive=True)
    T_bs_pos_m: Array = param((0.0, 0.0, 0.0), shape=(3,))
    T_bs_quat_wxyz: Array = param((1.0, 0.0, 0.0, 0.0), shape=(4,))
    mounting_sigma_deg: Array | None = param(None, shape=(3,), positive=True)
    range_scale_sigma: float | None = param(None, positive=True)
    range_bias_sigma_m: float | None = param(None, positive=True)
    angle_bias_sigma_deg: float | None = param(None, positive=True)
    angle_scale_sigma: float | None = param(None, positive=True)
    angle_quadratic_sigma_per_deg: float | None = param(None, positive=True)
    feature_spacing_m: float | None = param(None, positive=True)
    leg_diameter_m: float | None = param(None, positive=True)
    landmark: tuple[Landmark, ...] = param((), items=Landmark)
    time_offset_s: float = param(0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        unit_quaternion(self, "T_bs_quat_wxyz")
        seen: set[int] = set()
        for mark in self.landmark:
            if mark.feature in seen:
                raise self.error(f"feature {mark.feature} is there twice", column="landmark", fix="keep one of them")
            seen.add(mark.feature)
