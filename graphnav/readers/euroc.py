"""EuRoC MAV (ASL folder ``mav0``): IMU and reference of a drone, converted to a `SensorLog`.

The recorded body frame is the IMU's: x up, y right, z forward while the drone stands. The log's
right-forward-up axes are the same three in the order y, z, x. The reference is the IMU's pose in the
tracking room, z up. The room's heading is unknown: n's "north" is the room's y axis, and the level part of
the Earth's rate (10 deg/h) has an unknown direction. Its error, 20 deg/h at most, is well inside the
declared gyro bias.

The IMU's samples are points in time: one at t stands for the interval around t, while a row of the log is
the mean over the interval before its stamp. Stamps therefore move by half a sample, +2.5 ms at 200 Hz; the
rates then agree with the reference's two to four times better. Nothing is resampled. Epoch and time zero
are the first IMU sample; nanosecond stamps are subtracted as integers.

The gyro reads 4.4 deg/s while the drone stands. As an autopilot does before take-off, the mean rate of the
first four seconds is removed from the record; what is left is declared as 0.1 deg/s, because the drone is
touched and its motors start within that time (it moves by 0.1 deg and 2 mm, so it is not declared to be at
rest either). The densities in ``sensor.yaml`` are those of a sensor at rest, and in flight vibration is
five to twenty times as much: declared is what the record itself shows between 30 and 80 Hz, above the
motion of the drone. The bias walks are the yaml's.

There is no odometer. Positions of the reference at 1 Hz play the part of an external tracker, the whole
reference (20 Hz) is the truth, and the pose at which the drone is set down is known from it within 2 deg of
tilt and 5 deg of heading.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import numpy.typing as npt

from factors import so3
from factors.inertial import M_S2_PER_MG, RAD_PER_DEG_SQRT_H, RAD_S_PER_DEG_H
from factors.so3 import Array
from graphnav.errors import LogError
from graphnav.log import Frames, Imu, InitialState, Position, SensorLog, Truth
from graphnav.readers.vibration import noise_density

Stamps = npt.NDArray[np.int64]

#: Vectors in the IMU's axes (up, right, forward) -> right, forward, up.
RFU_FROM_IMU = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
#: The tracking room is at ETH Zurich.
_PLACE = Frames(latitude_deg=47.4, longitude_deg=8.5, height_m=460.0)
#: Bias of the gyro (chosen): as recorded, and after its rate while standing was removed.
_RECORDED_GYRO_BIAS_DEG_H, _ZEROED_GYRO_BIAS_DEG_H = 5.0 * 3600, 0.1 * 3600
#: While standing the mean rate of every half second stays this close to the mean of all, rad/s.
_STANDING_RAD_S = 0.01
#: Accelerometer bias (chosen: consumer grade).
_ACCEL_BIAS_MG = 20.0
#: Above the motion of the drone, below the blades' frequency folded about half the sampling rate.
_NOISE_BAND_HZ = (30.0, 80.0)
_YAML_KEYS = {
    "gyro": "gyroscope_noise_density",
    "gyro_bias": "gyroscope_random_walk",
    "accel": "accelerometer_noise_density",
    "accel_bias": "accelerometer_random_walk",
}


def convert(
    source: str | Path | None,
    *,
    position_rate_hz: float = 1.0,
    position_sigma_m: float = 0.01,
    zero_gyro_s: float = 4.0,
) -> SensorLog:
    """Convert one EuRoC sequence.

    Parameters
    ----------
    source : folder ``mav0`` or the one that holds it.
    position_rate_hz : rate of the positions taken from the reference; 0 for none.
    position_sigma_m : their declared sigma per axis. The tracker is good to millimetres; 1 cm leaves room
        for the few milliseconds by which clocks may differ.
    zero_gyro_s : length of the start during which the drone stands, and whose mean rate is removed from the
        gyro; 0 leaves the gyro as recorded.

    Returns
    -------
    SensorLog
        IMU, positions and truth.

    Raises
    ------
    LogError
        A file is missing, a row or key is not as the ASL format has it, or the drone moves within
        `zero_gyro_s`.
    """
    if source is None:
        raise LogError("euroc needs a source folder", fix="pass the folder that holds mav0")
    folder = Path(source)
    mav = folder / "mav0" if (folder / "mav0").is_dir() else folder
    stamps_ns, samples = _table(mav / "imu0" / "data.csv", 7)
    reference_file = _reference_file(mav)
    reference_ns, reference = _table(reference_file, 11)
    zero = stamps_ns[0]
    truth = _truth(_seconds(reference_ns, zero), reference)
    named = folder if folder.resolve().name != "mav0" else folder.resolve().parent
    return SensorLog(
        name=named.resolve().name,
        epoch=f"{np.datetime64(int(zero), 'ns')}Z",
        frames=_PLACE,
        initial=_initial(truth),
        imu=_imu(_seconds(stamps_ns, zero), samples, _noise(mav / "imu0" / "sensor.yaml"), zero_gyro_s),
        position=_positions(truth, position_rate_hz, position_sigma_m),
        truth=truth,
    )


def _table(path: Path, columns: int) -> tuple[Stamps, Array]:
    """Stamps (N,) in ns and the other columns (N, columns - 1) of a csv with one header row."""
    try:
        stamps = np.loadtxt(path, dtype=np.int64, delimiter=",", skiprows=1, usecols=0, ndmin=1)
        values = np.loadtxt(path, delimiter=",", skiprows=1, usecols=range(1, columns), ndmin=2)
    except FileNotFoundError:
        raise LogError("no such file", where=str(path), fix="pass the folder that holds mav0") from None
    except (ValueError, UnicodeDecodeError) as error:
        raise LogError(f"not an ASL table of {columns} columns ({error})", where=str(path)) from None
    return stamps, values


def _seconds(stamps_ns: Stamps, zero_ns: np.int64) -> Array:
    return np.asarray((stamps_ns - zero_ns) * 1e-9, float)


def _reference_file(mav: Path) -> Path:
    """The reference; a corrected one is preferred (the published attitude of V1_01 is off by degrees)."""
    found = sorted((mav / "state_groundtruth_estimate0").glob("*.csv"))
    if not found:
        raise LogError(
            "no csv file", where=str(mav / "state_groundtruth_estimate0"), fix="add the sequence's reference"
        )
    corrected = [path for path in found if "corrected" in path.name]
    return (corrected or found)[0]


def _noise(path: Path) -> dict[str, float]:
    """The yaml's densities, SI per sqrt(Hz) (bias walks: per sqrt(s)); the sensor must be the body frame."""
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise LogError("no such file", where=str(path), fix="restore imu0/sensor.yaml") from None
    found = {}
    for name, key in _YAML_KEYS.items():
        match = re.search(rf"^\s*{key}\s*:\s*([-+.\deE]+)", text, re.MULTILINE)
        if match is None:
            raise LogError("missing", where=str(path), column=key, fix="restore imu0/sensor.yaml")
        found[name] = float(match.group(1))
    pose = re.search(r"T_BS:.*?data:\s*\[([^\]]*)\]", text, re.DOTALL)
    if pose is not None and [float(v) for v in pose.group(1).split(",")] != np.eye(4).ravel().tolist():
        raise LogError("the IMU is not the body frame", where=str(path), column="T_BS", fix="expected the identity")
    return found


def _imu(t_s: Array, samples: Array, noise: dict[str, float], zero_gyro_s: float) -> Imu:
    """Rows of the log; each random walk is the larger of the yaml's and the one seen in flight."""
    interval = float(np.median(np.diff(t_s)))
    gyro, accel = samples[:, :3] @ RFU_FROM_IMU.T, samples[:, 3:] @ RFU_FROM_IMU.T
    gyro_walk, accel_walk = (noise_density(axes, interval, _NOISE_BAND_HZ) for axes in (gyro, accel))
    bias = _RECORDED_GYRO_BIAS_DEG_H
    if zero_gyro_s > 0:
        gyro, bias = gyro - _standing_rate(t_s, gyro, zero_gyro_s), _ZEROED_GYRO_BIAS_DEG_H
    return Imu(
        t_s=t_s + interval / 2,
        gyro_b_rad_s=gyro,
        accel_b_m_s2=accel,
        gyro_bias_deg_h=bias,
        accel_bias_mg=_ACCEL_BIAS_MG,
        gyro_random_walk_deg_sqrt_h=max(noise["gyro"], gyro_walk) / RAD_PER_DEG_SQRT_H,
        accel_random_walk_mg_sqrt_hz=max(noise["accel"], accel_walk) / M_S2_PER_MG,
        gyro_bias_walk_deg_h_sqrt_h=noise["gyro_bias"] / RAD_S_PER_DEG_H * 60,  # 60 sqrt(s) in one sqrt(h)
        accel_bias_walk_mg_sqrt_h=noise["accel_bias"] / M_S2_PER_MG * 60,
    )


def _standing_rate(t_s: Array, gyro_b: Array, until_s: float) -> Array:
    """Mean rate (3,) of the first `until_s`, which must be the same in all of it."""
    rows = int(np.searchsorted(t_s, until_s))
    mean = gyro_b[:rows].mean(axis=0)
    count = max(1, int(2 * until_s))
    parts = np.array([part.mean(axis=0) for part in np.array_split(gyro_b[:rows], count)])
    apart = np.abs(parts - mean).max()
    if apart > _STANDING_RAD_S:
        raise LogError(
            f"the drone turns at {apart:.3f} rad/s within the first {until_s:g} s",
            where="imu0/data.csv",
            fix="pass a shorter zero_gyro_s, or 0 to keep the gyro as recorded",
        )
    return np.asarray(mean, float)


def _truth(t_s: Array, reference: Array) -> Truth:
    rotation_nb = so3.from_quaternion(reference[:, 3:7]) @ RFU_FROM_IMU.T
    return Truth(
        t_s=t_s,
        pos_n_m=reference[:, :3],
        quat_nb=so3.to_quaternion(rotation_nb),
        vel_n_m_s=reference[:, 7:10],
    )


def _initial(truth: Truth) -> InitialState:
    assert truth.vel_n_m_s is not None
    return InitialState(
        pos_n_m=truth.pos_n_m[0],
        pos_sigma_m=np.full(3, 0.01),
        quat_nb_wxyz=truth.quat_nb[0],
        att_sigma_deg=np.array([2.0, 2.0, 5.0]),
        vel_n_m_s=truth.vel_n_m_s[0],
        vel_sigma_m_s=np.full(3, 0.05),
    )


def _positions(truth: Truth, rate_hz: float, sigma_m: float) -> Position | None:
    """Rows of the truth nearest to a regular grid, from one period after the start (the initial state)."""
    if rate_hz < 0 or not np.isfinite(rate_hz):
        raise LogError(f"position_rate_hz {rate_hz:g}, expected 0 or more", fix="pass a rate in Hz")
    if rate_hz == 0:
        return None
    wanted = np.arange(truth.t_s[0] + 1 / rate_hz, truth.t_s[-1] + 1e-6, 1 / rate_hz)
    right = np.clip(np.searchsorted(truth.t_s, wanted), 1, len(truth.t_s) - 1)
    rows = np.unique(right - (wanted - truth.t_s[right - 1] < truth.t_s[right] - wanted))
    if len(rows) == 0:
        return None
    sigma = np.full((len(rows), 3), sigma_m)
    return Position(t_s=truth.t_s[rows], pos_n_m=truth.pos_n_m[rows], sigma_n_m=sigma)
