"""IMU and odometer condensed between keyframes, block by block."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from factors.increments import Increments, Samples, compensated_increments
from factors.inertial import Motion, cumulate
from factors.odometry import Travel, preintegrate_speed
from factors.so3 import Array
from graphnav.log import Odometer

#: Keyframe intervals condensed at a time: bounds the memory of the increments.
_BLOCK = 500


@dataclass(frozen=True)
class Condensed:
    """Intervals ``rows`` between keyframes: increments, motion at the end of each interval, and odometer travel."""

    rows: slice
    increments: Increments
    ends: Motion
    travel: Travel | None


def condensed(
    samples: Samples,
    odometer: Odometer | None,
    keyframe_s: Array,
    minor_s: float,
    gyro_bias_b: Array,
    accel_bias_b: Array,
) -> Iterator[Condensed]:
    """Condense what was recorded between keyframes.

    Parameters
    ----------
    keyframe_s : (N,); minor_s : minor interval of the two-speed algorithm, s.
    gyro_bias_b, accel_bias_b : (N-1, 3) biases taken out, rad/s and m/s^2.
    """
    count = len(keyframe_s) - 1
    for lo in range(0, count, _BLOCK):
        rows = slice(lo, min(lo + _BLOCK, count))
        bounds = keyframe_s[lo : rows.stop + 1]
        block = samples.block(bounds[0], bounds[-1])
        increments = compensated_increments(block, bounds, minor_s, gyro_bias_b[rows], accel_bias_b[rows])
        motion = cumulate(increments)
        travel = None
        if odometer is not None:
            used = slice(np.searchsorted(odometer.t_s, bounds[0]), np.searchsorted(odometer.t_s, bounds[-1] + 1e-6))
            travel = preintegrate_speed(odometer.t_s[used], odometer.speed_m_s[used], bounds, motion)
        yield Condensed(rows, increments, _ends(motion), travel)


def joined_travel(parts: list[Travel]) -> Travel:
    """Travel over all intervals."""
    return Travel(*(np.concatenate(columns) for columns in zip(*(vars(x).values() for x in parts), strict=True)))


def joined_motion(parts: list[Motion]) -> Motion:
    """Motion over all intervals, one end each."""
    columns = [np.concatenate(c) for c in zip(*(list(vars(m).values())[1:] for m in parts), strict=True)]
    return Motion(np.arange(len(columns[0]) + 1), *columns)


def _ends(motion: Motion) -> Motion:
    last = motion.first[1:] - 1
    first = np.arange(len(last) + 1)
    return Motion(
        first, motion.elapsed_s[last], motion.rotation[last], motion.velocity_b[last], motion.position_b[last]
    )
