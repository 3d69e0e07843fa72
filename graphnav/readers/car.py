"""What a car's own records say about its sensors and its slip, without a reference."""

from __future__ import annotations

import numpy as np

from factors.so3 import Array
from graphnav.errors import LogError

#: Width of the bands compared by `noise_floor`; in a short record they are wider, because a band needs so many
#: frequencies: with 40 the mean power of pure noise scatters by 16 %, and the lowest of 25 such bands lies about 30 %
#: low, which is 16 % in density.
_BAND_HZ = 2.0
_FEWEST = 40

_GRAVITY_M_S2 = 9.81
#: Usual figures of passenger cars: the rear tyres slip sideways by some 3 deg per g of sideways acceleration, and the
#: body pitches on its springs by some 2.5 deg per g of forward acceleration.
_SLIP_RAD_S2_M = np.radians(3.0) / _GRAVITY_M_S2
_PITCH_RAD_S2_M = np.radians(2.5) / _GRAVITY_M_S2
#: No road is so even that a car runs truer than this (chosen).
_LEAST_SLIP_M_S = 0.01


def noise_floor(samples: Array, dt_s: float) -> float:
    """An upper bound of the white noise of samples taken in motion.

    White noise has the same power at all frequencies. Motion and vibration add to it and never take away, so in each
    axis the band with the least power bounds it. Vibration is motion: integrated it stays small, and it is not noise of
    the sensor, as long as the sensor's own low-pass keeps what is above half its rate from folding down.

    Parameters
    ----------
    samples : (N, k) axes, in any unit; about regular in time.
    dt_s : sampling interval.

    Returns
    -------
    float
        Unit of the samples per sqrt(Hz), two-sided (what a random walk collects in one sqrt(s)): root mean square of
        the axes.

    Raises
    ------
    LogError
        Fewer than 80 samples.
    """
    count = len(samples)
    if count < 2 * _FEWEST:
        raise LogError(
            f"{count} samples are too few to tell noise from motion",
            where="imu",
            fix=f"expected at least {2 * _FEWEST}",
        )
    per_band = max(int(_BAND_HZ * count * dt_s), _FEWEST)
    window = np.hanning(count)
    power = np.abs(np.fft.rfft((samples - samples.mean(axis=0)) * window[:, None], axis=0)) ** 2
    power *= dt_s / np.sum(window**2)
    bands = max(len(power) // per_band, 1)
    level = power[: bands * per_band].reshape(bands, per_band, -1).mean(axis=1)
    return float(np.sqrt(level.min(axis=0).mean()))


def slip_sigma(t_s: Array, speed_m_s: Array, gyro_t_s: Array, yaw_rate_rad_s: Array) -> float:
    """Sideways and vertical speed of the rear axle in the body's axes, root mean square of both, from means over 1 s.

    Parameters
    ----------
    t_s, speed_m_s : (N,) speed of the rear axle.
    gyro_t_s, yaw_rate_rad_s : (M,) rate about up.

    Returns
    -------
    float
        m/s. Both come from accelerations: sideways ``v times rate`` makes the tyres slip, forward ``dv/dt`` pitches
        the body.
    """
    edges = np.arange(max(t_s[0], gyro_t_s[0]), min(t_s[-1], gyro_t_s[-1]), 1.0)
    if len(edges) < 2:
        return _LEAST_SLIP_M_S
    speed = _means(edges, t_s, speed_m_s)
    sideways = speed * _means(edges, gyro_t_s, yaw_rate_rad_s)
    forward = np.diff(np.interp(edges, t_s, speed_m_s))
    slip = np.mean((speed * _SLIP_RAD_S2_M * sideways) ** 2)
    pitch = np.mean((speed * _PITCH_RAD_S2_M * forward) ** 2)
    return float(max(np.sqrt((slip + pitch) / 2), _LEAST_SLIP_M_S))


def _means(edges: Array, t_s: Array, values: Array) -> Array:
    """Means between edges 1 s apart of values joined by straight lines."""
    area = np.concatenate([[0.0], np.cumsum((values[1:] + values[:-1]) / 2 * np.diff(t_s))])
    total: Array = np.diff(np.interp(edges, t_s, area))
    return total
