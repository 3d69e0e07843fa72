"""The KITTI-derived drive in GTSAM's example data (IMU 100 Hz, positions 1 Hz), converted to a `SensorLog`.

470 s and 3.7 km through Karlsruhe, read where GTSAM finds it: nothing is copied. Body axes forward, left,
up become right, forward, up; a row of the file is the mean over its ``dt``, as in the log. Positions are
east, north, up. Time zero is the first IMU row of the log. There is no reference, so no truth: `split`
withholds positions to judge by.

What is wrong in the files, and what becomes of it:

- The first row's ``dt`` is its time, and 1.92 s without samples follow. The log starts after that hole.
- Eight stretches of 1.5-1.65 s were not measured: all six channels run along straight lines between the
  samples at their ends. A car that turns in one of them comes out of it with up to 11 deg of wrong heading.
  Their 1,257 rows are dropped, which leaves holes for the estimator to bridge (`imu.max_gap_s` of its
  configuration: `HOLE_S` or more).
- The 13 positions with stamps inside those stretches were filled in the same way: they lie on the chord to
  0.1-0.3 m where turns bend the path by 0.5 m and more. They are dropped too.

Declared: noise as in the metadata; position sigma 0.07 m, the figure of GTSAM's example, to which positions
and IMU agree (sum of squares 1.13 per degree of freedom; 35 if the filled stretches are taken as measured).
The Earth's rate is in the gyro's readings. What else the data show (stamps, lever arm) is in
docs/real-data.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from factors import so3
from factors.inertial import M_S2_PER_MG, RAD_PER_DEG_SQRT_H, RAD_S_PER_DEG_H
from factors.so3 import Array
from graphnav.errors import LogError
from graphnav.log import Frames, Imu, InitialState, Position, SensorLog
from graphnav.readers.withhold import INITIAL_FIXES, Gaps, in_spans, split

__all__ = ["HOLE_S", "convert", "filled_rows", "split"]

IMU_FILE = "KittiEquivBiasedImu.txt"
NOISE_FILE = "KittiEquivBiasedImu_metadata.txt"
POSITION_FILE = "KittiGps_converted.txt"

#: Vectors in forward, left, up -> right, forward, up.
_RFU_FROM_FLU = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_PLACE = Frames(latitude_deg=49.0, longitude_deg=8.4, height_m=115.0)
#: Not in the metadata, chosen for a unit of this class: the positions show 23 deg/h and 2 mg.
_GYRO_BIAS_DEG_H = 36.0
_ACCEL_BIAS_MG = 5.0
_POSITION_SIGMA_M = 0.07
_NOISE_KEYS = ("GyroscopeSigma", "GyroscopeBiasSigma", "AccelerometerSigma", "AccelerometerBiasSigma")
#: A `dt` longer than this in the first rows is no sampling interval, s.
_LONG_DT_S = 0.1
#: The longest hole that a dropped stretch leaves is shorter than this, s.
HOLE_S = 1.7
#: Change of slope times sample interval below which all channels run straight, in their units (SI). Of
#: 45,700 measured rows none comes below a thousand times this.
_STRAIGHT = 1e-6

Rows = npt.NDArray[np.bool_]


def convert(
    source: str | Path | None = None,
    *,
    withhold: str | Gaps | None = None,
    gap_s: float | None = None,
    filled: str = "drop",
    position_offset_s: float = 0.0,
) -> SensorLog:
    """Convert the drive.

    Parameters
    ----------
    source : folder with the three files; None finds them with ``gtsam.findExampleDataFile``.
    withhold, gap_s : positions to leave out, as in `split`; None leaves all in.
    filled : "drop" the stretches that were filled by straight lines, or "keep" them as if measured.
    position_offset_s : added to the positions' stamps (``t_common = t_file + offset``).

    Returns
    -------
    SensorLog
        IMU and positions. Initial state: position, velocity and course of the parabola through the last fix
        before the start and the first two after it (0.3 m, 0.5 m/s, 5 deg), level within 3 deg.

    Raises
    ------
    LogError
        A file is missing or not as expected.
    """
    if filled not in ("drop", "keep"):
        raise LogError(f'filled "{filled}", expected "drop" or "keep"')
    paths = {name: _find(source, name) for name in (IMU_FILE, NOISE_FILE, POSITION_FILE)}
    t, dt, accel, gyro = _imu_rows(paths[IMU_FILE])
    start = _first_whole(dt, paths[IMU_FILE])
    t, accel, gyro = t[start:], accel[start:], gyro[start:]
    zero = t[0]
    t = t - zero
    fix_t, fix_pos = _fixes(paths[POSITION_FILE])
    fix_t = fix_t - zero + position_offset_s
    if filled == "drop":
        inside = filled_rows(t, np.column_stack([accel, gyro]))
        fix_in_hole = in_spans(fix_t, _spans(t, inside))
        t, accel, gyro = t[~inside], accel[~inside], gyro[~inside]
        fix_t, fix_pos = fix_t[~fix_in_hole], fix_pos[~fix_in_hole]
    imu = Imu(
        t_s=t,
        gyro_b_rad_s=gyro @ _RFU_FROM_FLU.T,
        accel_b_m_s2=accel @ _RFU_FROM_FLU.T,
        gyro_bias_deg_h=_GYRO_BIAS_DEG_H,
        accel_bias_mg=_ACCEL_BIAS_MG,
        **_noise(paths[NOISE_FILE]),
    )
    within = (fix_t > imu.start_s) & (fix_t <= t[-1])
    position = Position(
        t_s=fix_t[within],
        pos_n_m=fix_pos[within],
        sigma_n_m=np.full((int(within.sum()), 3), _POSITION_SIGMA_M),
    )
    log = SensorLog(
        name="kitti-gtsam",
        frames=_PLACE,
        initial=_initial(fix_t, fix_pos, imu.start_s),
        imu=imu,
        position=position,
    )
    if withhold is None and gap_s is None:
        return log
    return split(log, withhold, gap_s=gap_s)[0]


def filled_rows(t_s: Array, values: Array) -> Rows:
    """Rows that lie on a straight line between their neighbours in every channel: filled in, not measured.

    Parameters
    ----------
    t_s : (N,) times, s.
    values : (N, k) channels.

    Returns
    -------
    (N,) bool; the measured samples at both ends of a filled stretch are not among them.
    """
    slope = np.diff(values, axis=0) / np.diff(t_s)[:, None]
    bend = np.abs(np.diff(slope, axis=0)).max(axis=1) * np.median(np.diff(t_s))
    return np.concatenate([[False], bend < _STRAIGHT, [False]])


def _spans(t_s: Array, inside: Rows) -> Array:
    """Times (K, 2) of the measured samples on either side of every filled stretch."""
    edge = np.diff(inside.astype(np.int8))
    return np.column_stack([t_s[np.flatnonzero(edge == 1)], t_s[np.flatnonzero(edge == -1) + 1]])


def _find(source: str | Path | None, name: str) -> Path:
    if source is not None:
        path = Path(source) / name
        if not path.is_file():
            raise LogError("no such file", where=str(path), fix="pass no source to use the files in the gtsam package")
        return path
    import gtsam

    try:
        return Path(gtsam.findExampleDataFile(name))  # type: ignore[no-untyped-call]
    except (RuntimeError, FileNotFoundError, ValueError) as error:
        raise LogError(f"the gtsam package does not hold {name}", fix="install gtsam 4.3.0 or newer") from error


def _columns(path: Path, expected: Sequence[str], delimiter: str | None) -> Array:
    """A table (N, k) whose header starts with the expected names."""
    with path.open(encoding="utf-8") as file:
        header = file.readline().split(delimiter)
    names = [name.strip() for name in header if name.strip()]
    if names[: len(expected)] != list(expected):
        raise LogError(f"columns {names}, expected {list(expected)}", where=str(path))
    try:
        return np.loadtxt(path, delimiter=delimiter, skiprows=1, ndmin=2)
    except ValueError as error:
        raise LogError(f"not a table of numbers ({error})", where=str(path)) from None


def _imu_rows(path: Path) -> tuple[Array, Array, Array, Array]:
    names = ("Time", "dt", "accelX", "accelY", "accelZ", "omegaX", "omegaY", "omegaZ")
    table = _columns(path, names, None)
    return table[:, 0], table[:, 1], table[:, 2:5], table[:, 5:8]


def _first_whole(dt_s: Array, path: Path) -> int:
    """First row after the rows at the start whose interval is no sampling interval."""
    whole = np.flatnonzero(dt_s <= _LONG_DT_S)
    if len(whole) == 0:
        raise LogError(f"no dt of at most {_LONG_DT_S} s", where=str(path), column="dt", fix="expected seconds")
    return int(whole[0])


def _fixes(path: Path) -> tuple[Array, Array]:
    table = _columns(path, ("Time", "X", "Y", "Z"), ",")
    return table[:, 0], table[:, 1:4]


def _noise(path: Path) -> dict[str, Any]:
    """The metadata's densities (per sqrt(Hz), SI) in the units of log.toml."""
    lines = path.read_text(encoding="utf-8").splitlines()
    values = dict(zip(lines[0].split(), lines[1].split(), strict=False)) if len(lines) > 1 else {}
    missing = [key for key in _NOISE_KEYS if key not in values]
    if missing:
        raise LogError("missing", where=str(path), column=missing[0], fix="restore the file")
    gyro, gyro_walk, accel, accel_walk = (float(values[key]) for key in _NOISE_KEYS)
    return {
        "gyro_random_walk_deg_sqrt_h": gyro / RAD_PER_DEG_SQRT_H,
        "gyro_bias_walk_deg_h_sqrt_h": gyro_walk / RAD_S_PER_DEG_H * 60,  # 60 sqrt(s) in one sqrt(h)
        "accel_random_walk_mg_sqrt_hz": accel / M_S2_PER_MG,
        "accel_bias_walk_mg_sqrt_h": accel_walk / M_S2_PER_MG * 60,
    }


def _initial(fix_t: Array, fix_pos: Array, start_s: float) -> InitialState:
    """State at the start of the IMU record from the parabola through three fixes around it."""
    after = int(np.searchsorted(fix_t, start_s, side="right"))
    first = max(after - 1, 0)
    rows = slice(first, first + 1 + INITIAL_FIXES)
    curve = np.polynomial.polynomial.polyfit(fix_t[rows] - start_s, fix_pos[rows], 2)
    pos_n, vel_n = curve[0], curve[1]
    yaw = np.arctan2(-vel_n[0], vel_n[1])
    return InitialState(
        pos_n_m=pos_n,
        pos_sigma_m=np.full(3, 0.3),
        quat_nb_wxyz=so3.to_quaternion(so3.exp(np.array([0.0, 0.0, yaw]))),
        att_sigma_deg=np.array([3.0, 3.0, 5.0]),
        vel_n_m_s=vel_n,
        vel_sigma_m_s=np.full(3, 0.5),
    )
