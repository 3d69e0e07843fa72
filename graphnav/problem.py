"""The smoothing problem: what stays fixed while solving, and the keys of its variables.

Variables: ``X(i)`` pose T_nb and ``V(i)`` velocity at keyframe i, ``B(e)`` IMU bias and ``C(e)`` odometer calibration
[scale, mounting angles] in epochs, ``K(c)`` creep after cycle c, ``L(j)`` and ``D(e)`` the LiDAR's legs and
calibration, ``E(e)`` the camera's errors and ``P(j)`` the features that it tracked, ``A(a)`` and ``M(i)`` errors of
UWB anchors and of their ranges, ``T(0)`` their time offset. Epochs keep every variable's number of factors bounded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.earth import earth_rate_n, normal_gravity
from factors.increments import npt_int
from factors.inertial import ImuNoise
from factors.so3 import Array
from graphnav.config import Config
from graphnav.errors import LogError
from graphnav.frontends.imu_samples import ImuSamples, imu_samples
from graphnav.keyframes import Frontend
from graphnav.log import InitialState, SensorLog


def X(i: int) -> int:
    """Key of the pose at keyframe i."""
    return _symbol("x", i)


def V(i: int) -> int:
    """Key of the velocity at keyframe i."""
    return _symbol("v", i)


def B(e: int) -> int:
    """Key of the IMU bias in epoch e."""
    return _symbol("b", e)


def C(e: int) -> int:
    """Key of the odometer calibration in epoch e."""
    return _symbol("c", e)


def K(c: int) -> int:
    """Key of the creep after cycle c."""
    return _symbol("k", c)


def L(j: int) -> int:
    """Key of the place of leg j."""
    return _symbol("l", j)


def A(a: int) -> int:
    """Key of the errors of UWB anchor a: of its ranges, and of where it stands."""
    return _symbol("a", a)


def M(i: int) -> int:
    """Key of the Markov errors of ranges at keyframe i."""
    return _symbol("m", i)


def T(k: int) -> int:
    """Key of the time offset of ranges; there is one, T(0)."""
    return _symbol("t", k)


def D(e: int) -> int:
    """Key of the LiDAR calibration in epoch e."""
    return _symbol("d", e)


def E(e: int) -> int:
    """Key of the camera's errors in epoch e: its mounting, and what disparities are too large by."""
    return _symbol("e", e)


def P(j: int) -> int:
    """Key of the place of tracked feature j."""
    return _symbol("p", j)


#: Sizes of the variables by the letter of their key; the Markov errors of ranges, M, have one of the problem's own.
SIZES = {ord(letter): size for letter, size in zip("xvbckldaept", (6, 3, 6, 4, 1, 4, 8, 4, 8, 3, 1), strict=True)}


def _symbol(letter: str, index: int) -> int:
    # gtsam.symbol without its call overhead: a letter in the top byte
    return (ord(letter) << 56) | index


@dataclass(frozen=True)
class RangeClock:
    """A time offset of ranges, found so far: `later_s` is added to their times; its sigma, or None before any."""

    later_s: float = 0.0
    sigma_s: float | None = None


@dataclass(frozen=True)
class Problem:
    """What stays fixed while solving.

    Attributes
    ----------
    log, config, frontend : inputs.
    imu : contiguous samples; noise, gravity_m_s2, earth_rate_n : their model.
    minor_s : minor interval of the two-speed algorithm, s.
    bias_epoch, calibration_epoch : (N-1,) epoch of each interval between keyframes.
    notes : what the user should know of how the log was prepared, one line each.
    clock : what has been found of the ranges' clock, to which their times in `log` have been moved.
    """

    log: SensorLog
    config: Config
    frontend: Frontend
    imu: ImuSamples
    noise: ImuNoise
    gravity_m_s2: float
    earth_rate_n: Array
    minor_s: float
    bias_epoch: npt_int
    calibration_epoch: npt_int
    notes: tuple[str, ...] = ()
    clock: RangeClock = RangeClock()

    @property
    def keyframe_s(self) -> Array:
        """(N,) keyframe times."""
        return self.frontend.keyframe_s

    @property
    def initial(self) -> InitialState:
        """The declared initial state (its presence is checked when the problem is posed)."""
        assert self.log.initial is not None
        return self.log.initial

    @property
    def has_calibration(self) -> bool:
        """Whether the odometer and its calibration take part."""
        return self.log.odometer is not None


def pose_problem(log: SensorLog, config: Config, frontend: Frontend, notes: tuple[str, ...] = ()) -> Problem:
    """Check what smoothing needs and fix the models.

    Raises
    ------
    LogError : no IMU, no initial state, a hole in a record.
    """
    if log.imu is None:
        fix = "without one, a table relative_pose can be smoothed by batch"
        raise LogError("no imu table, which this needs", where=f"log {log.name}", fix=fix)
    if log.initial is None:
        raise LogError("missing", where="log.toml, [initial]", fix="give the initial pose with its sigmas")
    imu = log.imu
    noise = ImuNoise.from_datasheet(
        gyro_random_walk_deg_sqrt_h=imu.gyro_random_walk_deg_sqrt_h,
        accel_random_walk_mg_sqrt_hz=imu.accel_random_walk_mg_sqrt_hz,
        gyro_bias_deg_h=imu.gyro_bias_deg_h,
        accel_bias_mg=imu.accel_bias_mg,
        gyro_bias_walk_deg_h_sqrt_h=imu.gyro_bias_walk_deg_h_sqrt_h,
        accel_bias_walk_mg_sqrt_h=imu.accel_bias_walk_mg_sqrt_h,
    )
    gravity = log.frames.gravity_m_s2 or normal_gravity(log.frames.latitude_deg, log.frames.height_m)
    samples = imu_samples(imu, config.imu.max_gap_s)
    rate = np.linalg.norm(imu.gyro_b_rad_s[:: max(1, len(imu) // 50_000)], axis=1)
    usual_rate = max(float(np.quantile(rate, 0.95)), 1e-6)
    minor_s = max(imu.dt_s, min(config.imu.minor_interval_s, config.imu.minor_angle_rad / usual_rate))
    _check_odometer_gaps(log, config)
    t = frontend.keyframe_s
    return Problem(
        log, config, frontend, samples, noise, float(gravity), earth_rate_n(log.frames.latitude_deg), minor_s,
        _epochs(t, config.imu.bias_epoch_s), _epochs(t, config.odometer.calibration_epoch_s), notes,
    )  # fmt: skip


def _epochs(t: Array, span_s: float) -> npt_int:
    return np.asarray(np.floor((t[:-1] - t[0]) / span_s + 1e-9), dtype=np.int64)


def _check_odometer_gaps(log: SensorLog, config: Config) -> None:
    if log.odometer is None or log.imu is None or log.position is not None:
        return
    t = np.concatenate([[log.imu.start_s], log.odometer.t_s, [log.imu.t_s[-1]]])
    row = int(np.argmax(np.diff(t)))
    if np.diff(t)[row] > config.odometer.max_gap_s:
        raise log.odometer.error(
            f"no samples for {np.diff(t)[row]:.1f} s after t = {t[row]:.1f} s, the IMU bridges at most"
            f" {config.odometer.max_gap_s:g} s",
            row=min(row, len(log.odometer) - 1),
            column="t_s",
            fix="smooth the parts before and after it as two logs, or raise odometer.max_gap_s",
        )


def creep_cycles(problem: Problem) -> list[int]:
    """Cycles after which an unknown creep is estimated: all with closed-path points, where creep is declared."""
    face = problem.log.face
    if face is None or face.creep_sigma_m == 0 or problem.config.closed_path.form != "relative":
        return []
    return sorted({p.cycle for p in problem.frontend.closed_path})
