"""comma2k19: one recorded minute of a car, converted to a `SensorLog`.

- **IMU** (``IMU/gyro``, ``IMU/accelerometer``, 104 Hz): device axes forward, right, down become right,
  forward, up. Samples are points in time: one at t stands for the interval around t, while a row of the log
  is the mean over the interval before its stamp. Stamps therefore move by half a sample, +4.8 ms. Nothing
  is resampled; accelerometer samples that have times of their own are interpolated at the gyro's.
- **Odometer** (``CAN/wheel_speed``, 83 Hz): mean of the two rear wheels, which is the speed of the rear
  axle's centre in a turn as well.
- **Noise and slip** are what the record itself shows (`graphnav.readers.car`); the reference has no part in them.
- **Truth** (``global_pose``, 20 Hz): ECEF becomes east, north, up at its first position; its quaternions
  take device axes to ECEF. Where the camera that it describes sits relative to the IMU is not stated: one
  point is assumed. The initial state is the reference's at the start of the IMU record; nothing else of it
  is used.

Time zero is the first frame of the reference. In every table rows that are not finite, or do not come later
than all rows before them, are dropped; gaps stay gaps.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from factors import so3
from factors.inertial import M_S2_PER_MG, RAD_PER_DEG_SQRT_H
from factors.so3 import Array
from graphnav.errors import LogError
from graphnav.log import Frames, Imu, InitialState, Odometer, SensorLog, Truth
from graphnav.readers.car import noise_floor, slip_sigma
from graphnav.readers.ecef import enu_from_ecef, geodetic
from graphnav.trajectory import Trajectory

#: Vectors in forward, right, down -> right, forward, up.
_RFU_FROM_FRD = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])

#: Biases are chosen. Gyro 0.1 deg/s: what a gyro of this kind (steps of 0.07 deg/s) drifts when it is some 2 deg C
#: warmer than when the phone last corrected it, at the usual 0.05 deg/s per deg C. Accelerometer 40 mg: offsets of
#: consumer parts. Walks stay small beside them within a minute.
_BIASES = {
    "gyro_bias_deg_h": 360.0,
    "gyro_bias_walk_deg_h_sqrt_h": 60.0,
    "accel_bias_mg": 40.0,
    "accel_bias_walk_mg_sqrt_h": 1.0,
}
#: An uncorrected gyro of a phone: several deg/s (chosen).
_UNCORRECTED_BIAS_DEG_H = 5.0 * 3600

#: From sample to sample the wheels' noise is 0.012 m/s; the jitter of their stamps, some 5 ms, adds as much
#: when braking at 2.6 m/s^2. Doubled, because neighbouring errors are not independent.
_SPEED_SIGMA_M_S = 0.03
#: The point that does not slip, seen from the device: the centre of the rear axle. A RAV4 has a wheelbase
#: of 2.66 m; a device under the mirror is some 1.6 m ahead of the rear axle and 1.0 m above it (chosen, the
#: recording does not say). An error of 0.3 m counts 0.3 m times the yaw rate: 0.03 m/s in a turn of
#: 6 deg/s.
_REAR_AXLE_B_M = (0.0, -1.6, -1.0)
_SCALE_SIGMA = 0.01
_KNOWN_SCALE_SIGMA = 0.001
_MOUNTING_SIGMA_DEG = (5.0, 5.0, 5.0)
#: What a combination of satellites, IMU and camera is usually good to (chosen; the reference states no
#: accuracy).
_INITIAL_SIGMAS = {"pos_sigma_m": 0.5, "att_sigma_deg": 0.3, "vel_sigma_m_s": 0.05}


def convert(
    source: str | Path | None,
    *,
    wheel_scale: float | None = None,
    uncalibrated_gyro: bool = False,
    lever_arm_b_m: Sequence[float] = _REAR_AXLE_B_M,
) -> SensorLog:
    """Convert one segment of comma2k19.

    Parameters
    ----------
    source : folder that holds ``processed_log`` and ``global_pose``.
    wheel_scale : known scale error of the wheel speeds, ``measured = (1 + scale) * true``: they are divided
        by 1 + scale, and the log declares a scale sigma of 0.001 for what is left. None: recorded speeds,
        sigma 0.01.
    uncalibrated_gyro : take the gyro without Android's bias correction; declares a bias of 5 deg/s.
    lever_arm_b_m : (3,) centre of the rear axle seen from the device, right-forward-up, m.

    Returns
    -------
    SensorLog
        IMU, odometer and truth; initial state known to 0.5 m, 0.05 m/s and 0.3 deg.

    Raises
    ------
    LogError
        A file is missing or damaged, or the reference does not cover the start of the IMU record.
    """
    if source is None:
        raise LogError("comma2k19 needs a source folder", fix="pass the folder that holds processed_log")
    folder = Path(source)
    truth, frames = _reference(folder)
    zero = truth.t_s[0]
    truth = truth.replace(t_s=truth.t_s - zero)
    imu = _imu(folder, zero, "gyro_uncalibrated" if uncalibrated_gyro else "gyro")
    return SensorLog(
        name=folder.resolve().name,
        frames=frames,
        initial=_initial(truth, imu.start_s, folder),
        imu=imu,
        odometer=_odometer(folder, zero, wheel_scale, lever_arm_b_m),
        truth=truth,
    )


def _load(path: Path, columns: int) -> Array:
    """One numpy file without ending, (N, columns) or (N,) for one column."""
    try:
        array: Array = np.asarray(np.load(path, allow_pickle=False), float)
    except FileNotFoundError:
        raise LogError("no such file", where=str(path), fix="pass the folder of one comma2k19 segment") from None
    except (OSError, ValueError, EOFError) as error:
        raise LogError(f"not a whole numpy file ({error})", where=str(path), fix="fetch it again") from None
    if array.shape[1:] != ((columns,) if columns > 1 else ()):
        raise LogError(f"shape {array.shape}, expected (N, {columns})", where=str(path))
    return array


def _table(folder: Path, columns: int) -> tuple[Array, Array]:
    """Times (N,) and values (N, columns) of a sensor; rows that are not finite or not later are dropped."""
    times, values = _load(folder / "t", 1), _load(folder / "value", columns)
    if len(times) != len(values):
        raise LogError(f"{len(times)} times for {len(values)} values", where=str(folder), fix="fetch both again")
    keep = _sound(times, values)
    return times[keep], values[keep]


def _sound(times: Array, *values: Array) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    finite = np.isfinite(times)
    for value in values:
        finite &= np.isfinite(value).all(axis=1)
    latest = np.maximum.accumulate(np.where(finite, times, -np.inf))
    return finite & (times > np.concatenate([[-np.inf], latest[:-1]]))


def _imu(folder: Path, zero: float, gyro_name: str) -> Imu:
    sensors = folder / "processed_log" / "IMU"
    t, gyro = _table(sensors / gyro_name, 3)
    t_accel, accel = _table(sensors / "accelerometer", 3)
    if len(t) != len(t_accel) or (t != t_accel).any():
        inside = (t >= t_accel[0]) & (t <= t_accel[-1])
        t, gyro = t[inside], gyro[inside]
        accel = np.column_stack([np.interp(t, t_accel, axis) for axis in accel.T])
    interval = float(np.median(np.diff(t)))
    half_sample = interval / 2
    late_enough = t - half_sample >= zero
    errors: dict[str, Any] = dict(_BIASES)
    if gyro_name != "gyro":
        errors["gyro_bias_deg_h"] = _UNCORRECTED_BIAS_DEG_H
    return Imu(
        t_s=(t + half_sample - zero)[late_enough],
        gyro_b_rad_s=(gyro @ _RFU_FROM_FRD.T)[late_enough],
        accel_b_m_s2=(accel @ _RFU_FROM_FRD.T)[late_enough],
        gyro_random_walk_deg_sqrt_h=noise_floor(gyro, interval) / RAD_PER_DEG_SQRT_H,
        accel_random_walk_mg_sqrt_hz=noise_floor(accel, interval) / M_S2_PER_MG,
        **errors,
    )


def _odometer(folder: Path, zero: float, wheel_scale: float | None, lever_arm_b_m: Sequence[float]) -> Odometer:
    t, wheels = _table(folder / "processed_log" / "CAN" / "wheel_speed", 4)
    speed = wheels[:, 2:].mean(axis=1)  # columns: front left, front right, rear left, rear right
    if wheel_scale is not None:
        if not -0.5 < wheel_scale < 0.5:
            raise LogError(f"wheel_scale {wheel_scale:g}, expected -0.5 to 0.5", fix="pass measured / true - 1")
        speed = speed / (1 + wheel_scale)
    t_gyro, gyro = _table(folder / "processed_log" / "IMU" / "gyro", 3)  # the corrected one in any case
    return Odometer(
        t_s=t - zero,
        speed_m_s=speed,
        sigma_m_s=_SPEED_SIGMA_M_S,
        slip_sigma_m_s=slip_sigma(t, speed, t_gyro, -gyro[:, 2]),
        scale_sigma=_SCALE_SIGMA if wheel_scale is None else _KNOWN_SCALE_SIGMA,
        mounting_sigma_deg=np.array(_MOUNTING_SIGMA_DEG),
        lever_arm_b_m=np.asarray(lever_arm_b_m, float),
    )


def _reference(folder: Path) -> tuple[Truth, Frames]:
    """The reference in n (times still boot seconds), and the place where n is tangent."""
    poses = folder / "global_pose"
    t, pos_e = _load(poses / "frame_times", 1), _load(poses / "frame_positions", 3)
    quat_eb, vel_e = _load(poses / "frame_orientations", 4), _load(poses / "frame_velocities", 3)
    if not len(t) == len(pos_e) == len(quat_eb) == len(vel_e):
        raise LogError("files of different lengths", where=str(poses), fix="fetch the segment again")
    keep = _sound(t, pos_e, quat_eb, vel_e)
    if keep.sum() < 2:
        raise LogError(f"{keep.sum()} usable poses, expected at least 2", where=str(poses))
    t, pos_e, quat_eb, vel_e = t[keep], pos_e[keep], quat_eb[keep], vel_e[keep]
    latitude, longitude, height = geodetic(pos_e[0])
    r_ne = enu_from_ecef(latitude, longitude)
    rotation_nb = r_ne @ so3.from_quaternion(quat_eb) @ _RFU_FROM_FRD.T
    truth = Truth(
        t_s=t,
        pos_n_m=(pos_e - pos_e[0]) @ r_ne.T,
        quat_nb=so3.to_quaternion(rotation_nb),
        vel_n_m_s=vel_e @ r_ne.T,
    )
    place = Frames(
        latitude_deg=float(np.degrees(latitude)), longitude_deg=float(np.degrees(longitude)), height_m=height
    )
    return truth, place


def _initial(truth: Truth, start_s: float, folder: Path) -> InitialState:
    if not truth.t_s[0] <= start_s <= truth.t_s[-1]:
        raise LogError(
            f"the IMU record starts at {start_s:.3f} s, the reference covers 0 to {truth.t_s[-1]:.3f} s",
            where=str(folder),
            fix="take a segment whose reference covers its start",
        )
    assert truth.vel_n_m_s is not None
    start = Trajectory(truth.t_s, truth.pos_n_m, truth.quat_nb, truth.vel_n_m_s).at(start_s)
    sigmas: dict[str, Any] = {name: np.full(3, value) for name, value in _INITIAL_SIGMAS.items()}
    return InitialState(pos_n_m=start.pos_n[0], quat_nb_wxyz=start.quat_nb[0], vel_n_m_s=start.vel_n[0], **sigmas)
