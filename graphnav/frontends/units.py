"""Samples recorded in the wrong unit, found from what a sensor must show at rest.

The log format demands SI units. A factor of 9.8, 57.3 or 1000 gives a trajectory that may look plausible, so
it is refused before anything is estimated.
"""

from __future__ import annotations

import numpy as np

from factors.earth import EARTH_RATE_RAD_S
from graphnav._coverage import span
from graphnav._schema import Array
from graphnav.errors import LogError
from graphnav.frontends import quiet
from graphnav.frontends.camera_check import camera_findings
from graphnav.frontends.rest import odometer_rest
from graphnav.log import Imu, InitialState, Odometer, SensorLog, Uwb

#: How many of the unit make one SI unit.
_ACCEL_UNITS = {"g": 1 / 9.80665, "mg": 1e3 / 9.80665, "cm/s^2": 100.0, "ft/s^2": 3.28084, "mm/s^2": 1e3}
_GYRO_UNITS = {"deg/s": np.rad2deg(1.0), "deg/h": np.rad2deg(3600.0), "mrad/s": 1e3}
_TIME_UNITS = {"ms": 1e3, "us": 1e6, "ns": 1e9}
_MAX_RATE_RAD_S, _MAX_SPEED_M_S = 10.0, 100.0
#: Times by which ranges of neighbouring rows break the triangle inequality when they are in another unit: a tag abeam
#: of two anchors shows a tenth of the scale at least in half of the rows, an anchor declared metres off some times one.
_BROKEN, _NEIGHBOURS_S, _FEWEST_RANGES = 5.0, 0.5, 20
_GYRO_COLUMNS, _ACCEL_COLUMNS = "gyro_*_rad_s", "accel_*_m_s2"


def check_units(log: SensorLog, spans: Array) -> list[str]:
    """What in this log seems to be in a wrong unit or about wrong axes.

    Parameters
    ----------
    log : the log.
    spans : (K, 2), spans at rest as from `rest_spans`; K may be 0, then only what shows in motion is checked.

    Returns
    -------
    list of str
        One line each, naming table, column, value, expectation and fix; empty for a sound log.
    """
    return [str(error) for error in _findings(log, spans)]


def refuse_wrong_units(log: SensorLog, spans: Array) -> None:
    """Raise the first finding of `check_units`.

    Raises
    ------
    LogError
        Something in the log is in a wrong unit.
    """
    for error in _findings(log, spans):
        raise error


def _findings(log: SensorLog, spans: Array) -> list[LogError]:
    findings = _clock(log)
    if log.imu is not None and not findings:
        if len(spans) == 0 and log.odometer is not None:
            spans = odometer_rest(log.odometer)
        rest = _rows_at_rest(log.imu, spans)
        findings += _accel(log.imu, rest) or _upright(log.imu, log.initial, rest)
        findings += _gyro(log.imu, rest)
    if log.odometer is not None:
        findings += _speed(log.odometer)
    if log.uwb is not None:
        findings += _ranges(log.uwb)
    return findings + camera_findings(log)


def _rows_at_rest(imu: Imu, spans: Array) -> slice | None:
    """Up to a minute of rows at rest: of the first span of 5 s, else of the longest; None below 20 rows."""
    if len(spans) == 0:
        return None
    start_s, end_s = spans[np.argmax(np.minimum(spans[:, 1] - spans[:, 0], 5.0))]
    first, last = np.searchsorted(imu.t_s, [start_s + imu.dt_s, min(end_s, start_s + 60.0)])
    return slice(int(first), int(last)) if last - first >= 20 else None


def _thinned(imu: Imu) -> slice:
    """About 100,000 rows over the whole log."""
    return slice(None, None, max(1, len(imu) // 100_000))


def _clock(log: SensorLog) -> list[LogError]:
    """Sampling intervals that no IMU or odometer has, and tables on another clock than the IMU."""
    for sensor, slowest_s in ((log.imu, 0.5), (log.odometer, 5.0)):
        dt_s = float(np.median(np.diff(sensor.t_s))) if sensor is not None and len(sensor) > 1 else 0.0
        for unit, factor in _TIME_UNITS.items():
            if sensor is not None and dt_s >= slowest_s and 5e-5 <= dt_s / factor < slowest_s:
                problem = f"median time step {dt_s:.6g} s, expected below {slowest_s} s; the times seem in {unit}"
                return [sensor.error(problem, column="t_s", fix=f"divide t_s by {factor:g}")]
    return [] if log.imu is None else _other_clocks(log, log.imu)


def _other_clocks(log: SensorLog, imu: Imu) -> list[LogError]:
    findings = []
    for record in log.tables().values():
        times = getattr(record, record.TIME)
        if times[-1] < imu.start_s or times[0] > imu.t_s[-1]:
            problem = f"times {span(times)} lie outside the IMU's {span([imu.start_s, imu.t_s[-1]])}"
            fix = "give all tables in seconds of one clock, or declare time_offset_s"
            findings.append(record.error(problem, column=record.TIME, fix=fix))
    return findings


def _accel(imu: Imu, rest: slice | None) -> list[LogError]:
    """The specific force must have the size of gravity: at rest, or in the median of the whole log."""
    tolerance = 0.3 + 5e-3 * imu.accel_bias_mg * quiet.GRAVITY_M_S2
    if rest is not None:
        size, when = float(np.linalg.norm(imu.accel_b_m_s2[rest].mean(axis=0))), "mean specific force at rest"
    else:
        size = float(np.median(np.linalg.norm(imu.accel_b_m_s2[_thinned(imu)], axis=1)))
        when, tolerance = "median specific force", tolerance + 2.0
    if abs(size - quiet.GRAVITY_M_S2) < tolerance:
        return []
    ratio = size / quiet.GRAVITY_M_S2
    unit = min(_ACCEL_UNITS, key=lambda u: abs(np.log(max(ratio, 1e-12) / _ACCEL_UNITS[u])))
    known = abs(ratio / _ACCEL_UNITS[unit] - 1) < tolerance / quiet.GRAVITY_M_S2 + 0.005
    seems = f"; the samples seem to be in {unit}" if known else ""
    fix = f"multiply them by {1 / _ACCEL_UNITS[unit]:.6g}" if known else "convert to m/s^2, gravity not removed"
    problem = f"{when} {size:.6g}, expected about 9.81 m/s^2{seems}"
    return [imu.error(problem, column=_ACCEL_COLUMNS, fix=fix)]


def _upright(imu: Imu, initial: InitialState | None, rest: slice | None) -> list[LogError]:
    """The specific force must point up: by the initial attitude near the start, along body z elsewhere."""
    rows = slice(0, max(2, round(5.0 / imu.dt_s))) if rest is None else rest
    force_b = imu.accel_b_m_s2[rows].mean(axis=0)
    near_start = imu.t_s[rows.start] - imu.t_s[0] < 10.0
    limit_deg = 120.0
    up = force_b[2]
    if initial is not None and near_start:
        w, x, y, z = initial.quat_nb_wxyz
        up = float(np.dot([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], force_b))
        if rest is not None:
            limit_deg = 30.0 + 3 * float(initial.att_sigma_deg[:2].max())
    angle_deg = float(np.degrees(np.arccos(np.clip(up / np.linalg.norm(force_b), -1, 1))))
    if angle_deg < limit_deg:
        return []
    if angle_deg > 150:
        problem = f"specific force {up:.4g} m/s^2 along up, expected about +9.8 (+g upward at rest)"
        return [imu.error(problem, column="accel_z_m_s2", fix="change the sign of the accelerometer samples")]
    problem = f"specific force at rest {angle_deg:.0f} deg away from up with the initial attitude, expected about 0"
    fix = "order the axes right, forward, up and check initial.quat_nb_wxyz (n<-b, w first)"
    return [imu.error(problem, column=_ACCEL_COLUMNS, fix=fix)]


def _gyro(imu: Imu, rest: slice | None) -> list[LogError]:
    """At rest the gyro shows its bias, Earth rate and white noise; no machine turns at 10 rad/s for long."""
    unit, found = None, ""
    if rest is not None:
        unit, found = _gyro_unit_at_rest(imu, rest)
    if unit is None:
        rate = float(np.percentile(np.linalg.norm(imu.gyro_b_rad_s[_thinned(imu)], axis=1), 99))
        if rate > _MAX_RATE_RAD_S:
            unit, found = "deg/s", f"1 % of the rates are above {rate:.4g} rad/s"
    if unit is None:
        return []
    problem = f"{found}; the samples seem to be in {unit}, expected rad/s"
    fix = f"multiply them by {1 / _GYRO_UNITS[unit]:.6g}"
    return [imu.error(problem, column=_GYRO_COLUMNS, fix=fix)]


def _gyro_unit_at_rest(imu: Imu, rest: slice) -> tuple[str | None, str]:
    """The unit that explains both noise and mean rate; vibration explains the first but not the second.

    Where the mean is too small to tell, a noise that fits closely beside a quiet accelerometer tells.
    """
    rate = float(np.abs(imu.gyro_b_rad_s[rest].mean(axis=0)).max())
    limit = 5 * np.deg2rad(imu.gyro_bias_deg_h) / 3600 + EARTH_RATE_RAD_S
    noise = _noise(imu.gyro_b_rad_s[rest])
    ratio = noise * np.sqrt(imu.dt_s) / quiet.gyro_density(imu)
    accel_ratio = _noise(imu.accel_b_m_s2[rest]) * np.sqrt(imu.dt_s) / quiet.accel_density(imu)
    found = f"at rest a mean rate of {rate:.3g} and noise of {noise:.3g}, {ratio:.3g} times the declared"
    for unit, factor in _GYRO_UNITS.items():
        by_mean = factor / 4 < ratio < 4 * factor and rate / factor < limit < rate
        by_noise = factor / 1.5 < ratio < 1.5 * factor and accel_ratio < 5
        if by_mean or by_noise:
            return unit, found
    return None, ""


def _noise(samples: Array) -> float:
    """White noise of one sample (rms over axes), from first differences, so that drift does not count."""
    return float(np.sqrt(np.diff(samples, axis=0).var(axis=0).mean() / 2))


def _speed(odometer: Odometer) -> list[LogError]:
    fastest = float(np.percentile(np.abs(odometer.speed_m_s), 99))
    if fastest < _MAX_SPEED_M_S:
        return []
    problem = f"1 % of the speeds are above {fastest:.4g} m/s; the samples seem to be in mm/s, expected m/s"
    return [odometer.error(problem, column="speed_m_s", fix="multiply them by 0.001")]


def _ranges(uwb: Uwb) -> list[LogError]:
    """Ranges of one tag to two anchors differ by the anchors' distance at most: metres, not centimetres."""
    place = {anchor.id: anchor.pos_n_m for anchor in uwb.anchor}
    anchor_n = np.array([place[name] for name in uwb.anchor_id])
    apart_m = np.linalg.norm(np.diff(anchor_n, axis=0), axis=1)
    known_m = sum(size or 0.0 for size in (uwb.sigma_m, uwb.bias_sigma_m, uwb.markov_sigma_m, uwb.group_sigma_m))
    same = np.asarray(uwb.tag_id)[1:] == np.asarray(uwb.tag_id)[:-1]
    rows = np.flatnonzero(same & (apart_m > 0) & (np.diff(uwb.t_s) < _NEIGHBOURS_S))
    if len(rows) < _FEWEST_RANGES:
        return []
    differ_m = np.abs(np.diff(uwb.range_m))[rows]
    ratio = differ_m / (apart_m[rows] + known_m + max(anchor.sigma_m for anchor in uwb.anchor))
    if np.median(ratio) < _BROKEN:
        return []
    k = rows[int(np.argsort(ratio)[len(ratio) // 2])]
    problem = (
        f"ranges of {uwb.range_m[k]:.6g} and {uwb.range_m[k + 1]:.6g} to anchors {uwb.anchor_id[k]} and"
        f" {uwb.anchor_id[k + 1]}, which stand {apart_m[k]:.3g} m apart, as in half of the rows; expected metres"
    )
    fix = "divide ranges in cm by 100, in mm by 1000; else check the anchors' pos_n_m"
    return [uwb.error(problem, row=int(k), column="range_m", fix=fix)]
