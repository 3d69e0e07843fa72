"""The configuration of a smoothing run: every choice that is not a property of the sensors.

Sensor errors belong to the log (log.toml); what is here are choices of method, with the reason for each default.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError

from graphnav._config_base import Section
from graphnav._config_errors import config_error, to_toml
from graphnav.camera_config import RelativePoseConfig, StereoConfig, StereoMotionsConfig, StereoTracksConfig
from graphnav.errors import ConfigError
from graphnav.filter_config import (
    DeadReckoningConfig,
    FilterConfig,
    LidarFilterConfig,
    UwbFilterConfig,
    VioFilterConfig,
)

__all__ = [
    "BatchConfig", "ClosedPathConfig", "Config", "DeadReckoningConfig", "FilterConfig", "ImuConfig", "Isam2Config",
    "KeyframesConfig", "LidarConfig", "LidarFilterConfig", "OdometerConfig", "PositionConfig", "RelativePoseConfig",
    "RestConfig", "StereoConfig", "StereoMotionsConfig", "StereoTracksConfig", "UwbConfig", "UwbFilterConfig",
    "VioFilterConfig",
]  # fmt: skip


class KeyframesConfig(Section):
    """When a keyframe is placed; measurements that need one at their own time get it besides."""

    interval_s: float = Field(1.0, gt=0, description="longest time between keyframes")
    distance_m: float | None = Field(None, gt=0, description="longest odometer distance between keyframes")
    events: bool = Field(True, description="keyframes at the starts and ends of cuts")


class ImuConfig(Section):
    """Preintegration and biases."""

    minor_interval_s: float = Field(0.2, gt=0, description="longest minor interval of the two-speed algorithm")
    minor_angle_rad: float = Field(0.05, gt=0, description="and largest usual rotation within it")
    bias_epoch_s: float = Field(60.0, gt=0, description="span of one bias variable")
    max_gap_s: float = Field(2.0, gt=0, description="longest hole in the IMU record that is bridged")


class OdometerConfig(Section):
    """How odometer samples enter."""

    form: Literal["displacement", "velocity"] = Field(
        "displacement", description="preintegrated over the interval (every sample), or the sample nearest a keyframe"
    )
    calibration_epoch_s: float = Field(60.0, gt=0, description="span of one scale-and-mounting variable")
    scale_walk_sqrt_h: float = Field(1e-5, gt=0, description="random walk of the scale factor")
    mounting_walk_deg_sqrt_h: float = Field(1e-3, gt=0, description="random walk of the mounting angles")
    max_gap_s: float = Field(60.0, gt=0, description="longest hole in the odometer record that the IMU bridges")


class RestConfig(Section):
    """Zero velocity and unchanged pose while at rest."""

    use: bool = True
    velocity_sigma_m_s: float = Field(1e-3, gt=0)
    attitude_sigma_deg: float = Field(5e-4, gt=0, description="change of attitude between keyframes of one rest")
    position_sigma_m: float = Field(1e-4, gt=0, description="change of position between keyframes of one rest")


class ClosedPathConfig(Section):
    """Closed-path position measurements."""

    form: Literal["relative", "absolute", "off"] = "relative"
    interval_m: float | None = Field(None, gt=0, description="spacing along the face; default the log's")
    along: Literal["ends", "all"] = Field(
        "ends", description="points whose prediction counts along the face: its ends, or all"
    )


class PositionConfig(Section):
    """Absolute positions."""

    use: bool = True


class BatchConfig(Section):
    """Gauss-Newton with Levenberg-Marquardt damping."""

    max_iterations: int = Field(25, ge=1)
    tolerance_sigma: float = Field(
        0.01, gt=0, description="converged when the whole step is this many joint sigmas; with J legs sqrt(1 + J) times"
    )
    bias_move_rounds: int = Field(3, ge=1, description="repetitions of preintegration at better biases")


class Isam2Config(Section):
    """Incremental smoothing."""

    keyframes_per_update: int = Field(1, ge=1)
    closed_path_block: int = Field(3, ge=1, description="closed-path points fed at a time, with the last of them")
    relinearize_skip: int = Field(100, ge=1, description="keyframes between checks for relinearization, at least")
    relinearize_growth: float = Field(0.25, ge=0, description="and as a share of the keyframes so far")
    wildfire_threshold: float = Field(1e-9, ge=0)
    threshold_attitude_rad: float = Field(0.001, gt=0)
    threshold_position_m: float = Field(0.01, gt=0)
    threshold_velocity_m_s: float = Field(0.01, gt=0)
    threshold_scale: float = Field(0.001, gt=0)
    threshold_mounting_rad: float = Field(0.001, gt=0)
    threshold_accel_bias_m_s2: float = Field(0.05, gt=0)
    threshold_gyro_bias_rad_s: float = Field(1e-3, gt=0)
    threshold_lean: float = Field(0.03, gt=0, description="lean of a leg, m per m")
    legs_followed: int = Field(4, ge=1, description="legs followed at a time, until the batch steps use all")
    leg_gap_s: float = Field(30.0, ge=0, description="one out of view for longer is new, until the batch steps")


class LidarConfig(Section):
    """Support legs as landmarks."""

    use: bool = True
    side: Literal["left", "right", "both"] = Field(
        "left", description="where legs are looked for in raw scans, which are used where there are no detections"
    )
    window_s: float = Field(5.0, gt=0, description="detections of a leg within this span become one")
    window_m: float = Field(0.5, gt=0, description="and no farther apart than the machine goes")
    together_m: float | None = Field(
        None, gt=0, description="error of bringing them together; default from the IMU's and odometer's declared noise"
    )
    lean_sigma_deg: float = Field(10.0, gt=0, description="how far from upright a leg may stand")
    advances: bool = Field(True, description="legs of successive cycles are tied by the push of their support")


class UwbConfig(Section):
    """UWB ranges."""

    use: bool = True
    loss: Literal["none", "huber", "cauchy", "geman-mcclure"] = Field(
        "geman-mcclure", description="how ranges that disagree are found; none: all count in full"
    )
    loss_sigmas: float = Field(3.0, gt=0, description="where it departs from least squares")
    reject_sigmas: float = Field(4.0, gt=0, description="ranges that are off by more are left out in the end")
    estimate_time_offset: bool = Field(
        False,
        description="a range at t measured the tag at t + d, d unknown (batch, isam2); uwb.time_offset_s is known",
    )
    time_offset_sigma_s: float = Field(0.2, gt=0, description="how far d may be from zero, 1 sigma")


class Config(Section):
    """Everything `graphnav smooth` can be told."""

    keyframes: KeyframesConfig = KeyframesConfig()
    imu: ImuConfig = ImuConfig()
    odometer: OdometerConfig = OdometerConfig()
    rest: RestConfig = RestConfig()
    closed_path: ClosedPathConfig = ClosedPathConfig()
    position: PositionConfig = PositionConfig()
    lidar: LidarConfig = LidarConfig()
    uwb: UwbConfig = UwbConfig()
    relative_pose: RelativePoseConfig = RelativePoseConfig()
    stereo: StereoConfig = StereoConfig()
    stereo_tracks: StereoTracksConfig = StereoTracksConfig()
    stereo_motions: StereoMotionsConfig = StereoMotionsConfig()
    batch: BatchConfig = BatchConfig()
    isam2: Isam2Config = Isam2Config()
    filter: FilterConfig = FilterConfig()
    lidar_filter: LidarFilterConfig = LidarFilterConfig()
    uwb_filter: UwbFilterConfig = UwbFilterConfig()
    vio_filter: VioFilterConfig = VioFilterConfig()
    dead_reckoning: DeadReckoningConfig = DeadReckoningConfig()
    covariance: bool = Field(True, description="covariances at all keyframes")

    @classmethod
    def given(cls, config: Config | None) -> Config:
        """What a caller gave for one; the defaults for None."""
        if config is None:
            return cls()
        if not isinstance(config, Config):
            raise ConfigError(
                f"config is of type {type(config).__name__}, expected a Config: Config.from_dict({{...}}) makes one of "
                "nested keys, Config.from_toml(path) of a file"
            )
        return config

    @classmethod
    def from_dict(cls, values: dict[str, Any], where: str = "configuration") -> Config:
        """A configuration from nested keys; unknown keys and wrong values raise `ConfigError`."""
        try:
            return cls.model_validate(values)
        except ValidationError as error:
            raise config_error(cls, error, where) from None

    @classmethod
    def from_toml(cls, path: str | Path) -> Config:
        """A configuration from a TOML file."""
        import tomllib

        path = Path(path)
        try:
            values = tomllib.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise ConfigError(f"{path}: no such file") from None
        except OSError as error:
            raise ConfigError(f"{path}: cannot be read ({error.strerror})") from None
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise ConfigError(f"{path}: not valid TOML ({error})") from None
        return cls.from_dict(values, str(path))

    def to_toml(self) -> str:
        """The effective configuration as TOML; keys without a value are left out."""
        lines = [f"covariance = {str(self.covariance).lower()}"]
        for name, section in self.model_dump(exclude_none=True).items():
            if isinstance(section, dict):
                lines += ["", f"[{name}]"] + [f"{key} = {to_toml(value)}" for key, value in section.items()]
        return "\n".join(lines) + "\n"
