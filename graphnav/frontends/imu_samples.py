"""IMU rows as contiguous samples: holes found, bridged up to a limit, and remembered."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.increments import Samples
from graphnav._memory import allocate, release
from graphnav._schema import Array
from graphnav.log import Imu

#: A step longer than this many nominal steps is a hole.
_HOLE = 1.5


@dataclass(frozen=True)
class ImuSamples:
    """Contiguous samples of a whole log.

    Attributes
    ----------
    samples : bridged samples hold the mean of their neighbours.
    bridged_s : (K, 2) start and end of every bridged hole, s.
    gyro_spread, accel_spread : usual size of the signals' changes, rad/s and m/s^2: the error of a bridged sample.
    """

    samples: Samples
    bridged_s: Array
    gyro_spread: float
    accel_spread: float

    def release(self) -> None:
        """Let go of the samples' memory (see `graphnav._memory`); their values stay."""
        release(self.samples.edge_s, self.samples.gyro_b, self.samples.accel_b)

    def densities(self, bounds_s: Array, gyro_density: float, accel_density: float) -> tuple[Array, Array]:
        """Noise densities over intervals, (K,) each: larger where bridged samples make the signal a guess.

        Parameters
        ----------
        bounds_s : (K+1,) ascending; gyro_density, accel_density : of the sensor itself, rad/sqrt(s), m/s/sqrt(s).
        """
        count = len(bounds_s) - 1
        bridged = self.bridged_s
        touching = bridged[(bridged[:, 1] > bounds_s[0]) & (bridged[:, 0] < bounds_s[-1])]
        # independent holes add up in variance; one hole's error is a constant over all of it, however it is divided
        guessed = np.zeros(count)
        for a, b in touching:
            length = np.minimum(b, bounds_s[1:]) - np.maximum(a, bounds_s[:-1])
            guessed += np.maximum(length, 0.0) * (b - a)
        share = np.sqrt(guessed / np.diff(bounds_s))
        return np.hypot(gyro_density, self.gyro_spread * share), np.hypot(accel_density, self.accel_spread * share)


def imu_samples(imu: Imu, max_gap_s: float) -> ImuSamples:
    """Row k covers ``(t_k - dt, t_k]``; a hole before it is bridged by the mean of rows k-1 and k.

    Raises
    ------
    LogError : a hole longer than `max_gap_s`, named by its row, time and length.
    """
    dt, t = imu.dt_s, imu.t_s
    if dt <= 0:
        raise imu.error(f"sampling interval {dt} s")
    holes = np.flatnonzero(np.diff(t) > _HOLE * dt)
    lengths = np.diff(t)[holes] - dt
    if len(holes) and lengths.max() > max_gap_s:
        worst = int(np.argmax(lengths))
        raise imu.error(
            f"no samples for {lengths[worst]:.3f} s after t = {t[holes[worst]]:.3f} s,"
            f" bridged are at most {max_gap_s:g} s",
            row=int(holes[worst]) + 1,
            column="t_s",
            fix="smooth the parts before and after it as two logs, or raise imu.max_gap_s",
        )
    stride = max(1, len(t) // 20_000)
    spreads = [float(np.sqrt(np.mean(np.var(x[::stride], axis=0)))) for x in (imu.gyro_b_rad_s, imu.accel_b_m_s2)]
    start = np.array([imu.start_s])
    if not len(holes):
        edges = allocate((len(t) + 1,), float)
        edges[0], edges[1:] = start[0], t
        samples = Samples(edges, imu.gyro_b_rad_s, imu.accel_b_m_s2)
        return ImuSamples(samples, np.zeros((0, 2)), *spreads)
    edges = np.insert(np.concatenate([start, t]), holes + 2, t[holes + 1] - dt)
    filled = [
        np.insert(x, holes + 1, (x[holes] + x[holes + 1]) / 2, axis=0) for x in (imu.gyro_b_rad_s, imu.accel_b_m_s2)
    ]
    bridged = np.column_stack([t[holes], t[holes + 1] - dt])
    return ImuSamples(Samples(edges, *filled), bridged, *spreads)
