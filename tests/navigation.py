"""The compiled strapdown recursion as a function of a state, and the linear model of a filtered interval."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from strapdown import means

from factors import so3
from factors.earth import earth_rate_n
from factors.increments import Samples
from graphnav.baselines import strapdown

GRAVITY_M_S2 = 9.8
NONE = np.zeros(3)
HERTZ = 100.0
#: A thousand times the Earth's rate, 4 deg/s, so that every product with it shows.
FAST_EARTH = 1e3 * earth_rate_n(35.0)


@dataclass(frozen=True)
class Start:
    """Where a navigation starts, and what it takes out of the samples."""

    rotation_nb: np.ndarray
    vel_n: np.ndarray
    pos_n: np.ndarray
    gyro_bias_b: np.ndarray
    accel_bias_b: np.ndarray

    def moved(self, x: np.ndarray) -> Start:
        """After the first 15 error states: velocity, rotation of n, position, gyro and accelerometer bias."""
        parts = np.split(x[:15], 5)
        return Start(
            so3.exp(parts[1]) @ self.rotation_nb,
            self.vel_n + parts[0],
            self.pos_n + parts[2],
            self.gyro_bias_b + parts[3],
            self.accel_bias_b + parts[4],
        )


@dataclass(frozen=True)
class Navigated:
    """States at the epochs, with the blocks of the error transition over each epoch and the mean force."""

    rotation_nb: np.ndarray
    vel_n: np.ndarray
    pos_n: np.ndarray
    blocks: np.ndarray
    force_n: np.ndarray


AT_ORIGIN = Start(np.eye(3), NONE, NONE, NONE, NONE)


def start(**known: np.ndarray) -> Start:
    """A start at the origin, but for what is given."""
    return replace(AT_ORIGIN, **known)


def navigate(
    samples: Samples,
    epoch_s: np.ndarray | list[float],
    at: Start = AT_ORIGIN,
    *,
    start_s: float | None = None,
    gravity_m_s2: float = GRAVITY_M_S2,
    earth_n: np.ndarray = NONE,
    resting: bool = False,
) -> Navigated:
    """`strapdown.advance` through the epochs, from the first edge unless told otherwise."""
    epochs = np.asarray(epoch_s, float)
    count = len(epochs)
    out = Navigated(
        np.empty((count, 3, 3)),
        np.empty((count, 3)),
        np.empty((count, 3)),
        # what is not written would show
        np.full((count, strapdown.BLOCKS, 3, 3), np.nan),
        np.full((count, 3), np.nan),
    )
    begin = float(samples.edge_s[0]) if start_s is None else start_s
    strapdown.advance(
        samples.edge_s, samples.gyro_b, samples.accel_b, begin, epochs, at.rotation_nb, at.vel_n, at.pos_n,
        at.gyro_bias_b, at.accel_bias_b, gravity_m_s2, earth_n, resting,
        out.rotation_nb, out.vel_n, out.pos_n, out.blocks, out.force_n,
    )  # fmt: skip
    return out


def rate_b(t: np.ndarray) -> np.ndarray:
    """A rate (..., 3) of three swings of about 1 Hz and a turn, rad/s."""
    t = np.asarray(t)[..., None]
    return 0.5 * np.sin(2 * np.pi * t * [1.0, 1.3, 0.7] + [0.0, 1.0, 2.0]) + [0.0, 0.1, -0.2]


def force_b(t: np.ndarray) -> np.ndarray:
    """A specific force (..., 3) about g upward, m/s^2."""
    t = np.asarray(t)[..., None]
    return np.array([0.3, -0.2, 9.8]) + np.cos(2 * np.pi * t * [0.8, 1.1, 1.4])


def sampled(seconds: float, hertz: float = HERTZ) -> Samples:
    """Means of both over every sample."""
    edge = np.arange(round(seconds * hertz) + 1) / hertz
    return Samples(edge, means(rate_b, edge), means(force_b, edge))
