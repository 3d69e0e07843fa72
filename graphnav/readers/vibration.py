"""The random walk of an IMU in use, from its own samples: in motion, vibration outweighs the datasheet."""

from __future__ import annotations

import numpy as np

from factors.so3 import Array
from graphnav.errors import LogError


def noise_density(samples: Array, dt_s: float, band_hz: tuple[float, float]) -> float:
    """Density of the samples' random walk, from the power in a band above the motion of the machine.

    Vibration is sampled with frequencies folded into the whole band, so its power between the machine's
    motion and the resonances stands for what it adds at low frequencies, where motion hides it.

    Parameters
    ----------
    samples : (N, k) axes, in any unit; about regular in time.
    dt_s : sampling interval.
    band_hz : lower and upper frequency.

    Returns
    -------
    float
        Unit of the samples per sqrt(Hz), two-sided (what a random walk collects in one sqrt(s)): root mean
        square of the axes.

    Raises
    ------
    LogError
        No frequency of the record lies in the band.
    """
    count = len(samples)
    window = np.hanning(count)  # keeps the motion's power out of the band
    power = np.abs(np.fft.rfft((samples - samples.mean(axis=0)) * window[:, None], axis=0)) ** 2
    power *= dt_s / np.sum(window**2)
    frequency = np.fft.rfftfreq(count, dt_s)
    inside = (frequency >= band_hz[0]) & (frequency <= band_hz[1])
    if not inside.any():
        raise LogError(
            f"no frequencies of {band_hz[0]:g}-{band_hz[1]:g} Hz in {count} samples at {1 / dt_s:.4g} Hz",
            where="imu",
            fix="expected a longer or faster record",
        )
    return float(np.sqrt(power[inside].mean()))
