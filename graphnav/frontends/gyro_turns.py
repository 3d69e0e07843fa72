"""How the gyro turned a camera between two times: what a rotation from images is held against."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from factors import so3
from graphnav._schema import Array
from graphnav.frontends.motion_chain import camera_mounting
from graphnav.frontends.quiet import gyro_density
from graphnav.frontends.stereo_bundle import RotationPrior
from graphnav.log import Imu, Stereo

#: Earth rate: what a gyro shows of it depends on the attitude, which is not asked for here.
_EARTH_RAD_S = 7.3e-5
#: Rates are means over so much before and after a time, s.
_AROUND_S = 0.02


def gyro_turns(imu: Imu, stereo: Stereo, rest_s: Array) -> Callable[[float, float], RotationPrior | None]:
    """A function of two times (s): ``R_c_from_c_to`` with its covariance, None outside the record.

    Parameters
    ----------
    rest_s : (K, 2) spans at rest, the longest of which tells the bias.
    """
    rotation_bc, _ = camera_mounting(stereo)
    bias, sigma = _bias(imu, rest_s)
    mounting = float(np.radians(stereo.mounting_sigma_deg).max())
    edge_s = np.concatenate([[imu.start_s], imu.t_s])

    def between(start_s: float, end_s: float) -> RotationPrior | None:
        if start_s < edge_s[0] - 1e-6 or end_s > edge_s[-1] + 1e-6 or end_s <= start_s:
            return None
        rows = slice(int(np.searchsorted(imu.t_s, start_s, side="right")), int(np.searchsorted(edge_s, end_s)))
        first, last = np.maximum(edge_s[:-1][rows], start_s), np.minimum(edge_s[1:][rows], end_s)
        turn_b = _product(so3.exp((imu.gyro_b_rad_s[rows] - bias) * (last - first)[:, None]))
        span = end_s - start_s
        angle = float(np.linalg.norm(so3.log(turn_b)))
        variance = (sigma * span) ** 2 + gyro_density(imu) ** 2 * span + (mounting * angle) ** 2
        # a time later by d is a turn that is another by d times what the rate gained on the way
        gained = rotation_bc.T @ (_rate(imu, edge_s, end_s) - _rate(imu, edge_s, start_s)) * stereo.time_sigma_s
        cov = variance * np.eye(3) + np.outer(gained, gained)
        return RotationPrior(rotation_bc.T @ turn_b @ rotation_bc, cov)

    return between


def _bias(imu: Imu, rest_s: Array) -> tuple[Array, float]:
    """Bias (3,) and what is not known of it, rad/s: by the longest rest, or as declared."""
    declared = float(np.hypot(np.radians(imu.gyro_bias_deg_h) / 3600, _EARTH_RAD_S))
    if not len(rest_s):
        return np.zeros(3), declared
    start, end = rest_s[np.argmax(np.diff(rest_s, axis=1))]
    inside = (imu.t_s > start) & (imu.t_s <= end)
    known = float(np.hypot(gyro_density(imu) / np.sqrt(max(end - start, 1.0)), _EARTH_RAD_S))
    if not inside.any() or known > declared:
        return np.zeros(3), declared
    return np.asarray(imu.gyro_b_rad_s[inside].mean(axis=0)), known


def _rate(imu: Imu, edge_s: Array, t_s: float) -> Array:
    """Mean rate (3,) around a time, rad/s."""
    first = int(np.searchsorted(edge_s, t_s - _AROUND_S, side="right")) - 1
    rows = slice(max(first, 0), max(int(np.searchsorted(edge_s, t_s + _AROUND_S)), 1))
    return np.asarray(imu.gyro_b_rad_s[rows].mean(axis=0))


def _product(turns: Array) -> Array:
    """The product (3, 3) of rotations (K, 3, 3) in their order, by halves."""
    while len(turns) > 1:
        if len(turns) % 2:
            turns = np.concatenate([turns, np.eye(3)[None]])
        turns = turns[0::2] @ turns[1::2]
    out: Array = turns[0] if len(turns) else np.eye(3)
    return out
