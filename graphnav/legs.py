"""LiDAR detections of legs condensed: all readings of one leg within a few seconds become one, at a keyframe.

Every detection is carried into n by the attitude and position that gyro and odometer give at its own time; those of
one leg around a keyframe are averaged there, and the mean is read back from the keyframe's pose. What the dead
reckoning had wrong is common to both and drops out; what it gains in error within the few seconds is added to the
noise. The mean lies off the keyframe's scan plane where the machine pitches, and is kept with its height above it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from factors import landmark, so3
from factors.increments import npt_int
from factors.landmark import seen_leg
from factors.so3 import Array, from_quaternion, to_quaternion
from graphnav.config import Config, LidarConfig
from graphnav.errors import ConfigError
from graphnav.log import Lidar, LidarPoints, SensorLog
from graphnav.problem import D, L, Problem, X
from graphnav.trajectory import ImuBridge, Trajectory

if TYPE_CHECKING:
    import gtsam

#: Detections carried to the ground at a time.
_BLOCK = 200_000


@dataclass(frozen=True)
class LegReadings:
    """Condensed readings: one per leg and window.

    Attributes
    ----------
    keyframe : (K,) index; leg : (K,) index into `feature`; count : (K,) detections in each.
    range_m, angle_rad, off_plane_m : (K,); sigma : (K, 2) m and rad.
    feature : (J,) feature numbers of the legs; place_n : (J, 3) where each was first seen, for the initial value.
    """

    keyframe: npt_int
    leg: npt_int
    count: npt_int
    range_m: Array
    angle_rad: Array
    off_plane_m: Array
    sigma: Array
    feature: npt_int
    place_n: Array

    def family(self, lidar: Lidar) -> landmark.LegFamily:
        """As factors."""
        return landmark.LegFamily(
            X(0) + self.keyframe, L(0) + self.leg, np.full(len(self.leg), D(0)), self.range_m, self.angle_rad,
            self.place_n[self.leg, 2], self.off_plane_m, self.sigma, from_quaternion(lidar.T_bs_quat_wxyz),
            lidar.T_bs_pos_m,
        )  # fmt: skip


def uses_legs(problem: Problem) -> bool:
    """Whether legs take part: detections, a declared scanner, and the wish to use them."""
    log = problem.log
    return log.lidar_points is not None and log.lidar is not None and problem.config.lidar.use


def refuse_legs(problem: Problem, what: str) -> None:
    """Refuse what would silently leave the LiDAR out.

    Raises
    ------
    ConfigError : the problem has legs.
    """
    if uses_legs(problem):
        raise ConfigError(
            f"{what} does not take LiDAR legs into account yet: set lidar.use = false for it without them"
        )


def condense(problem: Problem, values: gtsam.Values, gyro_bias_b: Array, accel_bias_b: Array) -> LegReadings:
    """Readings at keyframes `lidar.window_s` or `lidar.window_m` apart, from the poses in `values`.

    Parameters
    ----------
    gyro_bias_b, accel_bias_b : (N-1, 3) biases that carry the poses between keyframes.
    """
    import gtsam

    poses = gtsam.utilities.extractPose3(gtsam.utilities.allPose3s(values))
    rotation, pos = poses[:, :9].reshape(-1, 3, 3), poses[:, 9:]
    vel = np.gradient(pos, problem.keyframe_s, axis=0)
    bridge = ImuBridge(problem.imu.samples, gyro_bias_b, accel_bias_b, problem.gravity_m_s2, problem.earth_rate_n)
    way = Trajectory(problem.keyframe_s, pos, to_quaternion(rotation), vel, None, bridge)
    return gathered(problem.log, problem.config, way, _centres(problem.keyframe_s, _window_s(problem)))


def gathered(log: SensorLog, config: Config, way: Trajectory, centre: npt_int) -> LegReadings:
    """Readings brought together at the keyframes `centre` of a path that is right over the spans between them."""
    lidar, points = log.lidar, log.lidar_points
    assert lidar is not None and points is not None
    rotation, pos = way.rotation_nb, way.pos_n
    inside = (points.t_s >= way.t_s[0]) & (points.t_s <= way.t_s[-1])
    t_s, feature = points.t_s[inside], points.feature[inside]
    window = _nearest(way.t_s[centre], t_s)
    places = _in_n(way, points, inside, lidar)
    names, leg = np.unique(feature, return_inverse=True)
    group, member, count = np.unique(window * len(names) + leg, return_inverse=True, return_counts=True)
    mean = np.column_stack([np.bincount(member, places[:, axis]) / count for axis in range(3)])
    at, which = centre[group // len(names)], group % len(names)
    to_s = so3.transpose(from_quaternion(lidar.T_bs_quat_wxyz))
    in_b = np.einsum("kji,kj->ki", rotation[at], mean - pos[at]) - lidar.T_bs_pos_m
    x, y, off = (in_b @ to_s.T).T
    range_m = np.hypot(x, y)
    seen = np.zeros(len(names), np.int64)
    seen[which[::-1]] = np.arange(len(which))[::-1]
    sigma = _sigma(config.lidar, lidar, range_m, count)
    return LegReadings(at, which, count, range_m, np.arctan2(-x, y), off, sigma, names, mean[seen])


def _window_s(problem: Problem) -> float:
    """Span of a window: systematic errors turn with the bearing, so the machine must not go far within it."""
    config, odometer = problem.config.lidar, problem.log.odometer
    usual = 0.0 if odometer is None else float(np.quantile(np.abs(odometer.speed_m_s), 0.95))
    return min(config.window_s, config.window_m / usual) if usual > 0 else config.window_s


def _sigma(config: LidarConfig, lidar: Lidar, range_m: Array, count: npt_int) -> Array:
    """Noise of a mean reading: the detections' own, and what it takes to bring them together (K, 2)."""
    own = np.array([lidar.range_sigma_m, np.radians(lidar.angle_sigma_deg)]) / np.sqrt(count)[:, None]
    return np.column_stack([np.hypot(own[:, 0], config.together_m), np.hypot(own[:, 1], config.together_m / range_m)])


def _centres(keyframe_s: Array, window_s: float) -> npt_int:
    """Keyframes about `window_s` apart; the middle one of a record that is shorter."""
    wanted = np.arange(keyframe_s[0] + window_s / 2, keyframe_s[-1], window_s)
    if not len(wanted):
        wanted = keyframe_s[[0, -1]].mean(keepdims=True)
    return np.unique(_nearest(keyframe_s, wanted))


def _nearest(grid: Array, t_s: Array) -> npt_int:
    """Index of the nearest entry of an ascending grid for every time."""
    if len(grid) == 1:
        return np.zeros(len(t_s), np.int64)
    right = np.clip(np.searchsorted(grid, t_s), 1, len(grid) - 1)
    return np.asarray(np.where(t_s - grid[right - 1] < grid[right] - t_s, right - 1, right), dtype=np.int64)


def _in_n(
    way: Trajectory, points: LidarPoints, inside: np.ndarray[tuple[int, ...], np.dtype[np.bool_]], lidar: Lidar
) -> Array:
    """Place (M, 3) of every detection."""
    rows = np.flatnonzero(inside)
    out = np.empty((len(rows), 3))
    rotation_bs = from_quaternion(lidar.T_bs_quat_wxyz)
    for lo in range(0, len(rows), _BLOCK):
        part = rows[lo : lo + _BLOCK]
        times, member = np.unique(points.t_s[part], return_inverse=True)
        at = way.at(times)
        rotation, pos = at.rotation_nb[member], at.pos_n[member]
        out[lo : lo + len(part)] = seen_leg(
            rotation, pos, points.range_m[part], points.angle_rad[part], rotation_bs, lidar.T_bs_pos_m
        )
    return out
