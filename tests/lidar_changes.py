"""Ways to spoil a log with LiDAR; each takes a `SensorLog` and returns a changed one. Truth stays as it is."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from graphnav.log import Lidar, LidarPoints, SensorLog


def false_circles(log: SensorLog, share: float, seed: int) -> SensorLog:
    """A share of the detections lies anywhere in view, under the number of the leg that it was taken for."""
    points, rng = _points(log), np.random.default_rng(seed)
    wrong = rng.random(len(points)) < share
    range_m, angle_rad = points.range_m.copy(), points.angle_rad.copy()
    range_m[wrong] = rng.uniform(1.0, range_m.max(), wrong.sum())
    angle_rad[wrong] = rng.uniform(angle_rad.min(), angle_rad.max(), wrong.sum())
    return dataclasses.replace(log, lidar_points=points.replace(range_m=range_m, angle_rad=angle_rad))


def wrong_numbers(log: SensorLog, share: float, seed: int) -> SensorLog:
    """A share of the detections carries the number of the next leg in the same scan."""
    points, rng = _points(log), np.random.default_rng(seed)
    feature = points.feature.copy()
    wrong = np.flatnonzero((rng.random(len(points)) < share)[:-1] & (np.diff(points.t_s) == 0))
    feature[wrong] = points.feature[wrong + 1]
    return dataclasses.replace(log, lidar_points=points.replace(feature=feature))


def lidar_gap(log: SensorLog, start_s: float, end_s: float) -> SensorLog:
    """No LiDAR at all between two times: neither detections nor scans."""
    points, scans = log.lidar_points, log.lidar_scans
    if points is not None:
        points = _rows(points, _outside(points.t_s, start_s, end_s))
    if scans is not None:
        scans = _rows(scans, _outside(scans.t_s, start_s, end_s))
    return dataclasses.replace(log, lidar_points=points, lidar_scans=scans)


def no_legs(log: SensorLog, start_s: float, end_s: float) -> SensorLog:
    """The scanner runs on, but no beam returns between two times: no detections, scans of zeros."""
    points, scans = log.lidar_points, log.lidar_scans
    if points is not None:
        points = _rows(points, _outside(points.t_s, start_s, end_s))
    if scans is not None:
        seen = _outside(scans.t_s, start_s, end_s)
        empty = [ranges if here else np.zeros(len(ranges)) for ranges, here in zip(scans.ranges_m, seen, strict=True)]
        scans = scans.replace(ranges_m=empty)
    return dataclasses.replace(log, lidar_points=points, lidar_scans=scans)


def mounting_off(log: SensorLog, deg: float) -> SensorLog:
    """The declared mounting is turned about up: the scanner truly sits `deg` clockwise of what log.toml says."""
    lidar = _lidar(log)
    declared = Rotation.from_quat(lidar.T_bs_quat_wxyz, scalar_first=True)
    turned = Rotation.from_rotvec([0.0, 0.0, np.deg2rad(deg)]) * declared
    return dataclasses.replace(log, lidar=lidar.replace(T_bs_quat_wxyz=turned.as_quat(scalar_first=True)))


def all_legs_moved(log: SensorLog, at_s: float, by_m: float | tuple[float, float]) -> SensorLog:
    """From a time on every leg stands elsewhere and keeps its number: association did not notice.

    Parameters
    ----------
    by_m : to the machine's right at that time, or (right, forward); the same length in n for all legs.

    Notes
    -----
    The scanner's systematic errors are taken to be those at the old place: wrong by up to 1 % of `by_m`.
    """
    points, lidar, truth = _points(log), _lidar(log), log.truth
    assert truth is not None
    rotation_nb = Rotation.from_quat(truth.quat_nb, scalar_first=True)
    right, forward = by_m if isinstance(by_m, tuple) else (by_m, 0.0)
    by_n = rotation_nb[_nearest(truth.t_s, np.array([at_s]))].apply([right, forward, 0.0])
    later = points.t_s >= at_s
    rotation_ns = rotation_nb[_nearest(truth.t_s, points.t_s[later])]
    rotation_ns = rotation_ns * Rotation.from_quat(lidar.T_bs_quat_wxyz, scalar_first=True)
    by_s = rotation_ns.apply(np.tile(by_n, (int(later.sum()), 1)), inverse=True)[:, :2]
    range_m, angle_rad = points.range_m.copy(), points.angle_rad.copy()
    place_s = range_m[later, None] * np.column_stack([-np.sin(angle_rad[later]), np.cos(angle_rad[later])]) + by_s
    range_m[later], angle_rad[later] = np.hypot(*place_s.T), np.arctan2(-place_s[:, 0], place_s[:, 1])
    return dataclasses.replace(log, lidar_points=points.replace(range_m=range_m, angle_rad=angle_rad))


def wrong_spacing(log: SensorLog, spacing_m: float) -> SensorLog:
    """log.toml declares another distance between the legs."""
    return dataclasses.replace(log, lidar=_lidar(log).replace(feature_spacing_m=spacing_m))


def _points(log: SensorLog) -> LidarPoints:
    assert log.lidar_points is not None
    return log.lidar_points


def _lidar(log: SensorLog) -> Lidar:
    assert log.lidar is not None
    return log.lidar


def _outside(t_s: np.ndarray, start_s: float, end_s: float) -> np.ndarray:
    return (t_s < start_s) | (t_s >= end_s)


def _rows(table: Any, keep: np.ndarray) -> Any:
    """Some rows of a table; None for none, as a log has no empty tables."""
    if not keep.any():
        return None
    columns = [f.name for f in table.column_fields() if getattr(table, f.name) is not None]
    return table.replace(**{name: getattr(table, name)[keep] for name in columns})


def _nearest(grid: np.ndarray, t_s: np.ndarray) -> np.ndarray:
    right = np.clip(np.searchsorted(grid, t_s), 1, len(grid) - 1)
    return np.where(t_s - grid[right - 1] < grid[right] - t_s, right - 1, right)
