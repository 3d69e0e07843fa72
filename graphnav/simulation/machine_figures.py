"""The figures that every scenario has: inertial sensors, declared start, place on Earth."""

from __future__ import annotations

import math
from dataclasses import dataclass

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class ImuGrade:
    """1-sigma datasheet figures: turn-on biases and white noise."""

    gyro_bias_deg_h: float
    gyro_random_walk_deg_sqrt_h: float
    accel_bias_mg: float
    accel_random_walk_mg_sqrt_hz: float

    def with_added(self, other: ImuGrade) -> ImuGrade:
        """The grade of two independent errors added: root sum square of each figure."""
        return ImuGrade(*(math.hypot(getattr(self, n), getattr(other, n)) for n in self.__dataclass_fields__))


MEMS_IMU = ImuGrade(720.0, 0.6, 3.0, 0.08)


@dataclass(frozen=True, kw_only=True)
class MachineSpec:
    """A machine with an IMU. Lengths m, times s; sigmas are those drawn from and declared."""

    imu: ImuGrade
    speed_m_s: float
    att_sigma_deg: Triple
    pos_sigma_m: float | None = None  # None: the position at the start is unknown
    vel_sigma_m_s: float = 0.01
    accel_m_s2: float = 0.1
    static_s: float = 60.0
    tail_s: float = 10.0
    imu_rate_hz: int = 100
    latitude_deg: float = 35.0
    longitude_deg: float = 116.8
    gravity_m_s2: float = 9.7973
