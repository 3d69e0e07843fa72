"""Spans at rest: where zero velocity and zero rotation may be taken as measured.

A span wrongly called rest breaks the solution, a missed one costs little: every test here errs to motion.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from factors.earth import EARTH_RATE_RAD_S
from graphnav._schema import Array
from graphnav.errors import LogError
from graphnav.frontends import quiet, spans
from graphnav.frontends.still import still
from graphnav.log import Imu, Odometer, SensorLog

_WINDOW_S = 1.0
_SLOW_WINDOW_S, _SLOW_MEAN_S = 3.0, 0.5
#: Odometer: a mean speed this many of its sigmas from zero is motion (one window in two million at rest).
_SPEED_SIGMAS = 5.0
#: IMU: a level this many times the level at rest is motion.
_LEVEL_RATIO = 2.0
#: And motion whose median level is this many times that is told from rest beyond doubt.
_CLEAR = 3.0
#: Levels above these are never rest, however shaken the machine is while its odometer stands.
_MAX_GYRO_RAD_S, _MAX_ACCEL_M_S2 = 0.05, 0.5
#: Without an odometer a machine that starts smoothly is as quiet as one at rest while it is slow: for up to 1.7 s where
#: speeding up to 4 m/min takes 3 s, which put positions off by 4 sigmas. So much is taken off both ends.
_STARTING_S = 3.0


def rest_spans(log: SensorLog, *, min_length_s: float = 2.0, trim_s: float = 0.3) -> Array:
    """Spans in which the machine is at rest.

    With an odometer, its mean speed over windows of at least 1 s decides, and where there is an IMU its gyro
    and accelerometer must be as quiet there as they are in the odometer's standstills at large. From the IMU
    alone rest must last 3 s, show nothing but the declared noise, and stand out clearly against the motion in
    the log; smooth travel at constant speed cannot otherwise be told from it. Where a rest is declared and there are
    UWB ranges, it need only be as quiet as that one, if the ranges stay the same. The span declared by
    `initial.static_until_s` is always included.

    Parameters
    ----------
    log : the log.
    min_length_s : shortest span returned (3 s at least from the IMU alone).
    trim_s : taken off both ends of detected spans, so that braking and starting are not in.

    Returns
    -------
    array (K, 2)
        [start_s, end_s] of each span, ascending; K may be 0.

    Raises
    ------
    LogError
        The odometer moves within the span declared as static.
    """
    if log.odometer is not None:
        found = odometer_rest(log.odometer)
        if log.imu is not None:
            found = spans.intersect(found, _quiet_within(log.imu, found))
        found = spans.shrink(found, trim_s, min_length_s)
        found = found[[_mean_is_zero(log.odometer, span) for span in found]] if len(found) else found
    elif log.imu is not None:
        found = _imu_rest(log.imu, trim_s, max(min_length_s, 3.0))
        declared = _declared(log)
        if log.uwb is not None and len(declared):
            calm = spans.shrink(_quiet_within(log.imu, declared), max(trim_s, _STARTING_S), max(min_length_s, 3.0))
            found = spans.unite(found, still(log.uwb, calm))
    else:
        found = spans.NONE
    return spans.unite(_declared(log), found)


def odometer_rest(odometer: Odometer) -> Array:
    """Spans (K, 2) in which the odometer alone sees no motion, ends not trimmed."""
    t_s, speed, sigma = odometer.t_s, odometer.speed_m_s, odometer.sigma_m_s
    mean, count, lasted = _centred_means(t_s, speed)
    dt_s = float(np.median(np.diff(t_s))) if len(t_s) > 1 else _WINDOW_S
    still = (
        (np.abs(mean) < _SPEED_SIGMAS * sigma / np.sqrt(count))
        & (np.abs(speed) < _SPEED_SIGMAS * sigma)
        & (lasted < 1.5 * count * dt_s)
        & (count > 1)
    )
    return spans.from_mask(still, t_s, t_s)


def _centred_means(t_s: Array, values: Array) -> tuple[Array, npt.NDArray[np.int_], Array]:
    """Mean, number and duration of the samples in windows of 1 s or more about each one, cut at the ends."""
    steps = np.diff(t_s)
    half = max(1, int(np.ceil(_WINDOW_S / 2 / np.median(steps)))) if len(steps) else 1
    index = np.arange(len(t_s))
    low, high = np.maximum(index - half, 0), np.minimum(index + half + 1, len(t_s))
    total = np.concatenate([[0.0], np.cumsum(values)])
    count = high - low
    return (total[high] - total[low]) / count, count, t_s[high - 1] - t_s[low]


def _mean_is_zero(odometer: Odometer, span: Array) -> bool:
    """Whether the mean over the whole span is zero too: the longer it is, the slower the creep that shows."""
    first, last = np.searchsorted(odometer.t_s, span)
    speed = odometer.speed_m_s[first:last]
    if len(speed) == 0:
        return False
    return bool(abs(speed.mean()) < _SPEED_SIGMAS * odometer.sigma_m_s / np.sqrt(len(speed)))


def _quiet_within(imu: Imu, standstills: Array) -> Array:
    """Spans where the IMU is about as quiet as it typically is in the odometer's standstills."""
    gyro, accel = quiet.blocks(imu, imu.gyro_b_rad_s), quiet.blocks(imu, imu.accel_b_m_s2)
    root_dt = np.sqrt(imu.dt_s)
    calm = _calm(gyro, quiet.gyro_density(imu) / root_dt, _MAX_GYRO_RAD_S, standstills)
    calm &= _calm(accel, quiet.accel_density(imu) / root_dt, _MAX_ACCEL_M_S2, standstills)
    return spans.from_mask(gyro.covered(calm, _WINDOW_S), gyro.start_s, gyro.end_s)


def _calm(blocks: quiet.Blocks, noise: float, limit: float, standstills: Array) -> npt.NDArray[np.bool_]:
    """Windows near the noise or near what is typical within the standstills, whichever is higher."""
    level, gapless = blocks.level(_WINDOW_S), blocks.gapless(_WINDOW_S)
    start_s, end_s = _window_times(blocks, _WINDOW_S)
    row = np.searchsorted(standstills[:, 0], start_s, side="right") - 1
    inside = gapless & (row >= 0)
    inside[inside] &= end_s[inside] <= standstills[row[inside], 1]
    typical = min(float(np.median(level[inside])), limit) if inside.any() else 0.0
    calm: npt.NDArray[np.bool_] = gapless & (level < _LEVEL_RATIO * max(noise, typical))
    return calm


def _window_times(blocks: quiet.Blocks, length_s: float) -> tuple[Array, Array]:
    n = blocks.windows(length_s)
    return blocks.start_s[: len(blocks.start_s) - n + 1], blocks.end_s[n - 1 :]


def _imu_rest(imu: Imu, trim_s: float, min_length_s: float) -> Array:
    """Rest from the IMU alone: its noise only, at both time scales, and far below the motion in this log."""
    gyro, accel = quiet.blocks(imu, imu.gyro_b_rad_s), quiet.blocks(imu, imu.accel_b_m_s2)
    if imu.dt_s > quiet.BLOCK_S or len(gyro.mean) * gyro.length_s < _SLOW_WINDOW_S:
        return spans.NONE
    densities = quiet.gyro_density(imu), quiet.accel_density(imu)
    clear = _clear(gyro, accel, densities, imu.dt_s)
    if not clear:
        return spans.NONE
    calm = gyro.covered(_calm_windows(gyro), _WINDOW_S) & accel.covered(_calm_windows(accel), _WINDOW_S)
    constant = gyro.gapless(_SLOW_WINDOW_S) & _plausible(imu, gyro, accel)
    for blocks, density, wander in (
        (gyro, densities[0], quiet.WANDER_RAD_S),
        (accel, densities[1], quiet.WANDER_M_S2),
    ):
        allowed = np.hypot(density / np.sqrt(_SLOW_MEAN_S), wander)
        constant &= blocks.slow_level(_SLOW_WINDOW_S, _SLOW_MEAN_S) < _LEVEL_RATIO * allowed
    found = spans.from_mask(calm & gyro.covered(constant, _SLOW_WINDOW_S), gyro.start_s, gyro.end_s)
    return spans.shrink(found, trim_s if clear == 2 else max(trim_s, _STARTING_S), min_length_s)


def _clear(gyro: quiet.Blocks, accel: quiet.Blocks, densities: tuple[float, float], dt_s: float) -> int:
    """How many of the two sensors tell motion in this log from rest beyond doubt; 0 where it is not told.

    A log's own floor has to be the sensors' noise, and motion well above it in both; or in one, if most of what is loud
    there is louder than rest in the other too. Shaking shows in both. A turn shows in the gyro alone, and says nothing
    of straight travel.
    """
    loud = []
    for blocks, density in zip((gyro, accel), densities, strict=True):
        gapless, threshold = blocks.gapless(_WINDOW_S), _threshold(blocks)
        if not 0 < threshold <= _LEVEL_RATIO * 3 * density / np.sqrt(dt_s):
            return 0
        loud.append(blocks.level(_WINDOW_S)[gapless] / threshold)
    if not all((values > 1).any() for values in loud):
        return 0
    clear = [np.median(values[values > 1]) >= _CLEAR for values in loud]
    both = [np.median(other[one > 1]) > 1 for one, other in (loud, loud[::-1])]
    return 2 if all(clear) else int((clear[0] and both[0]) or (clear[1] and both[1]))


def _threshold(blocks: quiet.Blocks) -> float:
    """Level of motion: the lowest hundredth of the windows are taken for rest."""
    level, gapless = blocks.level(_WINDOW_S), blocks.gapless(_WINDOW_S)
    return _LEVEL_RATIO * float(np.percentile(level[gapless], 1)) if gapless.any() else 0.0


def _calm_windows(blocks: quiet.Blocks) -> npt.NDArray[np.bool_]:
    """Windows without holes whose level is not that of motion."""
    calm: npt.NDArray[np.bool_] = blocks.gapless(_WINDOW_S) & (blocks.level(_WINDOW_S) < _threshold(blocks))
    return calm


def _plausible(imu: Imu, gyro: quiet.Blocks, accel: quiet.Blocks) -> npt.NDArray[np.bool_]:
    """Windows whose mean rate is bias and Earth rate, and whose mean specific force is gravity."""
    rate = np.abs(gyro.window_mean(_SLOW_WINDOW_S)).max(axis=1)
    force = np.linalg.norm(accel.window_mean(_SLOW_WINDOW_S), axis=1)
    bias = 5 * np.deg2rad(imu.gyro_bias_deg_h) / 3600
    accel_bias = 5 * imu.accel_bias_mg * 1e-3 * quiet.GRAVITY_M_S2
    plausible: npt.NDArray[np.bool_] = (rate < bias + EARTH_RATE_RAD_S + quiet.WANDER_RAD_S) & (
        np.abs(force - quiet.GRAVITY_M_S2) < accel_bias + 0.05
    )
    return plausible


def _declared(log: SensorLog) -> Array:
    """The span of `initial.static_until_s`, checked against the odometer."""
    if log.initial is None or log.initial.static_until_s is None:
        return spans.NONE
    sensor = log.odometer if log.imu is None else log.imu
    if sensor is None:
        return spans.NONE
    start_s = log.imu.start_s if log.imu is not None else float(sensor.t_s[0])
    end_s = min(log.initial.static_until_s, float(sensor.t_s[-1]))
    if end_s <= start_s:
        return spans.NONE
    if log.odometer is not None:
        _refuse_motion(log.odometer, end_s)
    return np.array([[start_s, end_s]])


def _refuse_motion(odometer: Odometer, end_s: float) -> None:
    mean, count, _ = _centred_means(odometer.t_s, odometer.speed_m_s)
    moves = (odometer.t_s < end_s - _WINDOW_S) & (
        np.abs(mean) > 2 * _SPEED_SIGMAS * odometer.sigma_m_s / np.sqrt(count)
    )
    if moves.any():
        row = int(np.argmax(moves))
        raise LogError(
            f"{end_s} s, but the odometer moves at {mean[row]:.3f} m/s at {odometer.t_s[row]:.3f} s",
            where="[initial]",
            column="static_until_s",
            fix="shorten it to the true standstill",
        )
