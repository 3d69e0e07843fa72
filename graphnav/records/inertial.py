"""IMU and odometer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from graphnav._schema import Array, Record, column, param


@dataclass(frozen=True, eq=False)
class Imu(Record):
    """Gyro and accelerometer; row k is the mean over (t_k - dt, t_k], specific force +g upward at rest."""

    SECTION: ClassVar[str] = "imu"
    TABLE: ClassVar[str] = "imu"
    t_s: Array = column("t_s")
    gyro_b_rad_s: Array = column("gyro_x_rad_s", "gyro_y_rad_s", "gyro_z_rad_s")
    accel_b_m_s2: Array = column("accel_x_m_s2", "accel_y_m_s2", "accel_z_m_s2")
    gyro_bias_deg_h: float = param(positive=True)
    gyro_random_walk_deg_sqrt_h: float = param(positive=True)
    accel_bias_mg: float = param(positive=True)
    accel_random_walk_mg_sqrt_hz: float = param(positive=True)
    gyro_bias_walk_deg_h_sqrt_h: float = param(0.0, nonnegative=True)
    accel_bias_walk_mg_sqrt_h: float = param(0.0, nonnegative=True)
    gyro_matrix: Array | None = param(None, shape=(3, 3))
    accel_matrix: Array | None = param(None, shape=(3, 3))
    time_offset_s: float = param(0.0)

    @property
    def dt_s(self) -> float:
        """Nominal sampling interval: the median time step."""
        return float(np.median(np.diff(self.t_s)))

    @property
    def start_s(self) -> float:
        """Start of the first row's interval."""
        return float(self.t_s[0]) - self.dt_s

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.t_s) < 2:
            raise self.error("1 row, expected at least 2")


@dataclass(frozen=True, eq=False)
class Odometer(Record):
    """Signed forward speed along the machine's y axis: ``measured = (1 + scale) * v_m[y] + noise``."""

    SECTION: ClassVar[str] = "odometer"
    TABLE: ClassVar[str] = "odometer"
    t_s: Array = column("t_s")
    speed_m_s: Array = column("speed_m_s")
    sigma_m_s: float = param(positive=True)
    slip_sigma_m_s: float = param(positive=True)
    scale_sigma: float = param(positive=True)
    mounting_sigma_deg: Array = param(shape=(3,), positive=True)
    lever_arm_b_m: Array = param((0.0, 0.0, 0.0), shape=(3,))
    time_offset_s: float = param(0.0)
