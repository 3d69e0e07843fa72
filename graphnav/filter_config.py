"""Sections of the configuration for the Kalman filters and dead reckoning, which the graph is compared with."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from graphnav._config_base import Section


class FilterConfig(Section):
    """The error-state Kalman filter of the methods ekf, rts and rts-online."""

    preset: Literal["matched", "paper"] = Field(
        "matched", description="the log's declared sigmas, or the published tuning (P0 x 3, Q x 5)"
    )


class LidarFilterConfig(Section):
    """The INS/LiDAR paper's filter, the method lidar-ekf."""

    features: int = Field(1, ge=1, le=8, description="legs used at a time (the paper's N)")
    mode: int | None = Field(
        None, ge=1, le=9, description="row of the paper's table 1; left out: 2 or 7, as the first arrival tells"
    )
    distance_m: float | None = Field(
        None, ge=0, description="least distance of a leg along the face (the paper's d); left out: as far as they rest"
    )
    picm: bool = Field(True, description="correct the scanner's mounting by the first arrival at the far end")
    leg: Literal["line", "point"] = Field(
        "line",
        description="the point seen slides on an upright leg as the scan plane turns, or is fixed as in the paper",
    )
    independent_s: float = Field(
        1.0, ge=0, description="scans within this share an error (wobble of a leaning leg) and count as one; 0: white"
    )
    height_sigma_m: float = Field(0.01, gt=0, description="a leg is seen in the scan plane within this")
    height_walk_m_sqrt_s: float = Field(1e-3, gt=0, description="random walk of the height at which it is seen")


class UwbFilterConfig(Section):
    """The IMU/UWB paper's filters: the methods imu-uwb, and those that end in vbukf."""

    bias_time_s: float | None = Field(
        None, gt=0, description="time constant of the Gauss-Markov biases; left out: as their declared walk tells"
    )
    gate_sigmas: float | None = Field(None, gt=0, description="ranges farther off are left out; the paper has no gate")
    inflate: bool = Field(
        False, description="ranges with Markov errors count as seldom as these renew; the paper takes them for white"
    )
    accel_density_m_s2_sqrt_hz: float = Field(0.01, gt=0, description="what drives the velocity in the VB-UKF")
    noise_memory_s: float = Field(10.0, gt=0, description="span over which the VB-UKF learns the noise")


class VioFilterConfig(Section):
    """The stereo paper's filter, the method vio-kf.

    The paper states no measurement noise. The defaults are what a camera's maker would state for a short way, 0.3 % of
    20 m and a few tenths of a degree; no recording was looked at for them.
    """

    position_sigma_m: float = Field(0.05, gt=0, description="white error of a chained position (the paper's D_k)")
    attitude_sigma_deg: float = Field(0.3, gt=0, description="and of a chained attitude, about each axis")
    relative: bool = Field(
        False,
        description="each motion measures how the pose changed, with its own covariance; the paper chains them first",
    )


class DeadReckoningConfig(Section):
    """What dead reckoning is told of the sensors' errors."""

    compensation: Literal["none", "rest", "rts"] = Field(
        "rest",
        description="gyro biases, scale and mounting: none; the gyro bias of the first rest; or all from an RTS run",
    )
