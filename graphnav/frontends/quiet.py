"""How quiet the IMU is over time: sliding levels of gyro and accelerometer against the sensor's own noise.

A shift holds millions of samples, so they are first gathered into blocks of about 0.1 s (mean and mean
square); every window is a run of blocks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graphnav._schema import Array
from graphnav.log import Imu

GRAVITY_M_S2 = 9.80665
BLOCK_S = 0.1
#: What a bias may wander within seconds at rest, beyond white noise (flicker, temperature).
WANDER_RAD_S, WANDER_M_S2 = 1e-4, 2e-3


def gyro_density(imu: Imu) -> float:
    """Declared white noise of the gyro, rad/s/sqrt(Hz)."""
    return float(np.deg2rad(imu.gyro_random_walk_deg_sqrt_h) / 60)


def accel_density(imu: Imu) -> float:
    """Declared white noise of the accelerometer, m/s^2/sqrt(Hz)."""
    return imu.accel_random_walk_mg_sqrt_hz * 1e-3 * GRAVITY_M_S2


@dataclass(frozen=True)
class Blocks:
    """Block statistics of a gyro or accelerometer, M blocks.

    Attributes
    ----------
    start_s, end_s : (M,), span of each block.
    mean : (M, 3), less `offset`.
    square : (M, 3), mean square less `offset`.
    offset : (3,), typical value, taken off before squaring to keep the digits.
    length_s : nominal length of a block.
    """

    start_s: Array
    end_s: Array
    mean: Array
    square: Array
    offset: Array
    length_s: float

    def windows(self, length_s: float) -> int:
        """Blocks in a window of about `length_s`."""
        return max(1, min(round(length_s / self.length_s), len(self.mean)))

    def level(self, length_s: float) -> Array:
        """Standard deviation of the samples in each sliding window (rms over axes), (windows,)."""
        n = self.windows(length_s)
        variance = _sliding_mean(self.square, n) - _sliding_mean(self.mean, n) ** 2
        level: Array = np.sqrt(np.maximum(variance, 0.0).mean(axis=1))
        return level

    def slow_level(self, length_s: float, mean_s: float) -> Array:
        """Spread of means over `mean_s` in each window, of the worst axis: motion too slow for `level`."""
        step, n = self.windows(mean_s), self.windows(length_s)
        means = _sliding_mean(self.mean, step)
        view = np.lib.stride_tricks.sliding_window_view(means, n - step + 1, axis=0)[..., ::step]
        level: Array = view.std(axis=-1, ddof=1).max(axis=1)
        return level

    def window_mean(self, length_s: float) -> Array:
        """Mean of the samples in each sliding window, (windows, 3)."""
        return _sliding_mean(self.mean, self.windows(length_s)) + self.offset

    def gapless(self, length_s: float) -> npt.NDArray[np.bool_]:
        """Windows without missing samples."""
        n = self.windows(length_s)
        lasted = self.end_s[n - 1 :] - self.start_s[: len(self.start_s) - n + 1]
        gapless: npt.NDArray[np.bool_] = lasted < (n + 0.9) * self.length_s
        return gapless

    def covered(self, mask: npt.NDArray[np.bool_], length_s: float) -> npt.NDArray[np.bool_]:
        """Blocks (M,) that lie in at least one of the windows marked in `mask`."""
        n = self.windows(length_s)
        count = np.zeros(len(self.mean) + 1, dtype=int)
        count[: len(mask)] += mask
        count[n : n + len(mask)] -= mask
        return np.cumsum(count)[:-1] > 0


def blocks(imu: Imu, samples: Array) -> Blocks:
    """Gather `samples` (N, 3) of the IMU into blocks; rows left over at the end make no block."""
    dt_s = imu.dt_s
    n = max(1, min(round(BLOCK_S / dt_s), len(samples)))
    m = len(samples) // n
    offset = np.median(samples[:: max(1, len(samples) // 1000)], axis=0)
    mean, square = np.empty((m, 3)), np.empty((m, 3))
    for axis in range(3):
        values = samples[: m * n, axis].reshape(m, n) - offset[axis]
        mean[:, axis] = values.mean(axis=1)
        square[:, axis] = np.einsum("ij,ij->i", values, values) / n
    start_s, end_s = imu.t_s[: m * n : n] - dt_s, imu.t_s[n - 1 : m * n : n]
    return Blocks(start_s, end_s, mean, square, offset, n * dt_s)


def _sliding_mean(values: Array, n: int) -> Array:
    """Mean over n successive rows, (M - n + 1, 3)."""
    total = np.zeros((len(values) - n + 1, values.shape[1]))
    for shift in range(n):
        total += values[shift : shift + len(total)]
    return total / n
