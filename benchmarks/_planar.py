"""Robots on a floor: errors and consistency in the axes in which they can err, and what their residuals repeat."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.landmark import leg_residual, seen_leg
from factors.so3 import Array, from_quaternion
from graphnav._metrics import truth_at
from graphnav.log import SensorLog
from graphnav.run import LIDAR_NAMES, Run


@dataclass(frozen=True)
class Judged:
    """Position error in the first n axes of n; nees : mean of ``e' P^-1 e / n``, 1 is consistent."""

    rms_m: float
    max_m: float
    nees: float | None


def judge(run: Run, log: SensorLog, axes: int = 2, after_s: float = -np.inf) -> Judged:
    """A run against the truth at its keyframes, from some time on; nothing is aligned.

    On a floor height and its error are zero by construction: they are no degree of freedom. On a line (one axis)
    north is none either.
    """
    assert log.truth is not None
    states = run.trajectory
    known, pos, _ = truth_at(log.truth, states.t_s)
    late = states.t_s[known] > after_s
    error = (states.pos_n[known] - pos)[late, :axes]
    norm = np.linalg.norm(error, axis=1)
    nees = None
    if states.cov is not None:
        cov = states.cov[known][late, 3 : 3 + axes, 3 : 3 + axes]
        nees = float(np.einsum("ki,kij,kj->k", error, np.linalg.inv(cov), error).mean() / axes)
    return Judged(float(np.sqrt((norm**2).mean())), float(norm.max()), nees)


def seen_places(run: Run, log: SensorLog) -> dict[int, Array]:
    """Place (2,) of every leg by the smoothed path: the median of where its readings put it."""
    feature, range_m, angle_rad, at = _readings(run, log)
    place = seen_leg(*at, range_m, angle_rad, *_mounting(log))
    return {int(j): np.median(place[feature == j, :2], axis=0) for j in np.unique(feature)}


def residuals(run: Run, log: SensorLog) -> tuple[Array, Array, Array]:
    """Times (K,), leg numbers (K,) and what is left of range (m) and bearing (rad) of surveyed legs (K, 2)."""
    assert log.lidar is not None and log.lidar_points is not None
    places = {mark.feature: mark.pos_n_m for mark in log.lidar.landmark}
    feature, range_m, angle_rad, (rotation, pos) = _readings(run, log)
    known = np.isin(feature, list(places))
    place = np.array([places[int(j)] for j in feature[known]])
    scanner = np.array([run.calibration[name].value * size for name, size, _ in LIDAR_NAMES])
    line = np.column_stack([place[:, :2], np.zeros((len(place), 2))])
    left = leg_residual(
        rotation[known], pos[known], line, np.broadcast_to(scanner, (len(line), 8)), range_m[known], angle_rad[known],
        place[:, 2], *_mounting(log),
    )  # fmt: skip
    return log.lidar_points.t_s[_inside(run, log)][known], feature[known], left[0]


def repeated(t_s: Array, feature: Array, left: Array, lag_s: float, near_s: float = 2e-3) -> float:
    """Correlation of what is left (K,) with what is left of the same leg `lag_s` later, give or take `near_s`."""
    product = power = 0.0
    for j in np.unique(feature):
        own = feature == j
        t, x = t_s[own], left[own] - left[own].mean()
        later = np.clip(np.searchsorted(t, t + lag_s - near_s), 0, len(t) - 1)
        pair = np.abs(t[later] - t - lag_s) <= near_s
        product += float((x[pair] * x[later[pair]]).sum())
        power += float((x[pair] ** 2 + x[later[pair]] ** 2).sum()) / 2
    return product / power


def _inside(run: Run, log: SensorLog) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    assert log.lidar_points is not None
    t_s = log.lidar_points.t_s
    return (t_s >= run.trajectory.t_s[0]) & (t_s <= run.trajectory.t_s[-1])


def _readings(run: Run, log: SensorLog) -> tuple[Array, Array, Array, tuple[Array, Array]]:
    """Leg number, range and bearing of every reading within the run, and the pose (K, 3, 3), (K, 3) it was taken at."""
    points = log.lidar_points
    assert points is not None
    inside = _inside(run, log)
    times, row = np.unique(points.t_s[inside], return_inverse=True)
    at = run.trajectory.at(times)
    poses = at.rotation_nb[row], at.pos_n[row]
    return points.feature[inside], points.range_m[inside], points.angle_rad[inside], poses


def _mounting(log: SensorLog) -> tuple[Array, Array]:
    assert log.lidar is not None
    return from_quaternion(log.lidar.T_bs_quat_wxyz), log.lidar.T_bs_pos_m
