"""LiDAR detections of legs condensed: all readings of one leg within a few seconds become one, at a keyframe.

Every detection is carried into n by the attitude and position that gyro and odometer give at its own time; those of
one leg around a keyframe are averaged there, and the mean is read back from the path. What the dead
reckoning had wrong is common to both and drops out; what it gains in error within the few seconds is added to the
noise. Systematic errors of the scanner turn with the bearing, so the mean is read at the mean time of its detections,
a known motion away from the keyframe; it lies off the scan plane where the machine pitches, and is kept with its height
above it.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from factors import so3
from factors.increments import npt_int
from factors.legs import LegFamily
from factors.so3 import Array, from_quaternion, to_quaternion
from graphnav.config import Config
from graphnav.leg_means import Groups, apart, npt_bool, split, spread, together
from graphnav.log import Lidar, SensorLog
from graphnav.problem import D, L, Problem, V, X
from graphnav.trajectory import ImuBridge, Trajectory

if TYPE_CHECKING:
    import gtsam

#: Detections brought together at a time, and how many such blocks at once: NumPy lets go of the interpreter.
_BLOCK, _THREADS = 200_000, 2
#: Times this close are the same, s.
_SAME_S = 1e-6


@dataclass(frozen=True)
class LegReadings:
    """Condensed readings: one per leg and window.

    Attributes
    ----------
    keyframe : (K,) index of the one nearest to the mean time; window : (K,) of that of its window.
    leg : (K,) index into `feature`; count : (K,) detections in each.
    turn_b, shift_n : (K, 3, 3), (K, 3) from b at the keyframe to b at the mean time of the detections.
    range_m, angle_rad, off_plane_m : (K,); sigma : (K, 2) m and rad.
    spread : (K, 3, 7) what averaging made of the scanner's errors, see `graphnav.leg_means.spread`.
    feature : (J,) feature numbers of the legs, twice or more for one that moved and kept its number; place_n : (J, 3)
        where each was first seen, for the initial value.
    apart : detections left out, since they lie elsewhere than the others of their leg.
    """

    keyframe: npt_int
    window: npt_int
    leg: npt_int
    count: npt_int
    turn_b: Array
    shift_n: Array
    range_m: Array
    angle_rad: Array
    off_plane_m: Array
    spread: Array
    sigma: Array
    feature: npt_int
    place_n: Array
    apart: int

    def only(self, rows: npt_bool) -> LegReadings:
        """Some of the readings; the legs stay."""
        of_reading = [f.name for f in fields(self) if f.name not in ("feature", "place_n", "apart")]
        return replace(self, **{name: getattr(self, name)[rows] for name in of_reading})

    def disagreement(self, lidar: Lidar, values: gtsam.Values) -> Array:
        """Sigmas (K,) by which each reading is off, range and angle together."""
        error, *_ = self.family(lidar).residuals(values)
        return np.asarray(np.hypot(error[:, 0], error[:, 1]))

    def family(self, lidar: Lidar, loss: float | None = None) -> LegFamily:
        """As factors, see `factors.legs.LegFamily` for the loss."""
        return LegFamily(
            X(0) + self.keyframe, L(0) + self.leg, np.full(len(self.leg), D(0)), self.turn_b, self.shift_n,
            self.range_m, self.angle_rad, self.place_n[self.leg, 2], self.off_plane_m, self.spread, self.sigma,
            from_quaternion(lidar.T_bs_quat_wxyz), lidar.T_bs_pos_m, loss,
        )  # fmt: skip


def uses_legs(problem: Problem) -> bool:
    """Whether legs take part: detections, a declared scanner, and the wish to use them."""
    log = problem.log
    return log.lidar_points is not None and log.lidar is not None and problem.config.lidar.use


def condense(problem: Problem, values: gtsam.Values, gyro_bias_b: Array, accel_bias_b: Array) -> LegReadings:
    """Readings at keyframes `lidar.window_s` or `lidar.window_m` apart, from the poses in `values`.

    Parameters
    ----------
    gyro_bias_b, accel_bias_b : (N-1, 3) biases that carry the poses between keyframes.
    """
    import gtsam

    poses = gtsam.utilities.extractPose3(gtsam.utilities.allPose3s(values))
    rotation, pos = poses[:, :9].reshape(-1, 3, 3), poses[:, 9:]
    # the graph's own: the slope of its positions has their noise, and bends the path between keyframes to one side
    vel = np.array([values.atVector(V(i)) for i in range(len(problem.keyframe_s))])
    bridge = ImuBridge(problem.imu.samples, gyro_bias_b, accel_bias_b, problem.gravity_m_s2, problem.earth_rate_n)
    way = Trajectory(problem.keyframe_s, pos, to_quaternion(rotation), vel, None, bridge)
    return gathered(problem.log, problem.config, way, _centres(problem.keyframe_s, _window_s(problem)))


def gathered(log: SensorLog, config: Config, way: Trajectory, centre: npt_int) -> LegReadings:
    """Readings brought together at the keyframes `centre` of a path that is right over the spans between them."""
    points = log.lidar_points
    assert points is not None
    first, last = np.searchsorted(points.t_s, way.t_s[[0, -1]] + [-_SAME_S, _SAME_S])
    names = np.unique(points.feature[first:last])
    middle_s = (way.t_s[centre][1:] + way.t_s[centre][:-1]) / 2
    change = np.r_[first, first + np.searchsorted(points.t_s[first:last], middle_s), last]
    keyframe = np.repeat(centre, np.diff(change))
    # some windows at a time: as many as keep the arrays small, and the calls for each few
    edges = np.unique(np.r_[change[np.searchsorted(change, np.arange(first, last, _BLOCK))], last])

    def of_block(lo: int, hi: int) -> tuple[Any, ...]:
        return _of_block(log, config, way, np.arange(lo, hi), keyframe[lo - first : hi - first], names)

    with ThreadPoolExecutor(_THREADS) as pool:
        blocks = list(pool.map(of_block, edges[:-1].tolist(), edges[1:].tolist()))
    columns: list[Any] = [np.concatenate(column) for column in zip(*blocks, strict=True)]
    place, at, sigma = columns.pop(), columns[0], columns[-1]
    leg: npt_int = columns[2]
    before: npt_int = np.zeros(0, np.int64)
    if log.imu is not None:  # wheels alone are not good to millimetres over seconds
        leg, before = split(leg, way.t_s[at], place, sigma[:, 0])
    feature = np.concatenate([names, names[before]])
    columns[2] = leg
    seen = np.zeros(len(feature), np.int64)
    seen[leg[::-1]] = np.arange(len(leg))[::-1]
    names_of = [f.name for f in fields(LegReadings)]
    found = dict(zip(names_of, [*columns, feature, place[seen]], strict=False))
    return LegReadings(**found, apart=int(last - first - columns[3].sum()))


@dataclass(frozen=True)
class Windows:
    """The windows in which `condense` brings detections together, one after the other.

    Attributes
    ----------
    centre : (W,) keyframe of each, ascending; first, last : (W,) keyframes between which its detections lie.
    row : (W + 1,) window w holds the rows ``row[w]`` to ``row[w + 1]`` of the table.
    """

    centre: npt_int
    first: npt_int
    last: npt_int
    row: npt_int

    @classmethod
    def of(cls, problem: Problem) -> Windows:
        """Those that have detections, of the span of the keyframes."""
        points, keyframe_s = problem.log.lidar_points, problem.keyframe_s
        assert points is not None
        lo, hi = np.searchsorted(points.t_s, keyframe_s[[0, -1]] + [-_SAME_S, _SAME_S])
        centre = _centres(keyframe_s, _window_s(problem))
        which, count = np.unique(_nearest(keyframe_s[centre], points.t_s[lo:hi]), return_counts=True)
        row, centre = lo + np.concatenate([[0], np.cumsum(count)]), centre[which]
        first = np.searchsorted(keyframe_s, points.t_s[row[:-1]] + _SAME_S) - 1
        last = np.searchsorted(keyframe_s, points.t_s[row[1:] - 1] - _SAME_S)
        # at least one interval, whose motion gives a velocity
        first = np.clip(np.minimum(first, centre), 0, max(len(keyframe_s) - 2, 0))
        return cls(centre, first, np.maximum(np.maximum(last, centre), first + 1), row)


def of_window(
    log: SensorLog, config: Config, way: Trajectory, rows: npt_int, centre: int, velocity_m2_s2: float
) -> LegReadings:
    """Readings of one window alone: its legs in order of their numbers, `place_n` where each was seen.

    Parameters
    ----------
    way : its keyframes; centre : the one at which it is read, an index into `way`.
    rows : of the table of detections; velocity_m2_s2 : see `graphnav.leg_means.velocity_variance`.
    """
    points = log.lidar_points
    assert points is not None
    names = np.unique(points.feature[rows])
    columns = list(_of_block(log, config, way, rows, np.full(len(rows), centre), names, velocity_m2_s2, False))
    place, leg = columns.pop(), columns[2]
    columns[2] = np.arange(len(leg))
    names_of = [f.name for f in fields(LegReadings)]
    found = dict(zip(names_of, [*columns, names[leg], place], strict=False))
    return LegReadings(**found, apart=int(len(rows) - columns[3].sum()))


def _of_block(
    log: SensorLog,
    config: Config,
    way: Trajectory,
    rows: npt_int,
    keyframe: npt_int,
    names: npt_int,
    velocity_m2_s2: float | None = None,
    nearest: bool = True,
) -> tuple[Any, ...]:
    """The readings of some rows of the table, as in `LegReadings`, and the mean places in n.

    Each is read at the keyframe nearest to its mean time, or (not `nearest`) at that of its window: what the path's
    velocity has wrong would else act to one side for all legs that come into view, and to the other for those that
    leave it, as a turn of the scanner does.

    Rows that lie apart from the others of their group are left out.
    """
    from graphnav.leg_sums import on_the_ground, rows_of

    lidar, points = log.lidar, log.lidar_points
    assert lidar is not None and points is not None
    number = keyframe * len(names) + rows_of(names, points.feature[rows])
    order = np.argsort(number, kind="stable")
    groups = Groups.of(number[order])
    scan_s, scan = _scans(points.t_s[rows])
    t_s, ranges, angles = points.t_s[rows][order], points.range_m[rows][order], points.angle_rad[rows][order]
    window, which = groups.number // len(names), groups.number % len(names)
    mean_s = way.t_s[window] + groups.mean(t_s - way.t_s[keyframe[order]])
    at = _nearest(way.t_s, mean_s) if nearest else window
    path_s = np.union1d(scan_s, mean_s)
    turned, path_n = way.poses_at(path_s)
    frames, scanner = turned @ from_quaternion(lidar.T_bs_quat_wxyz), path_n + turned @ lidar.T_bs_pos_m
    means, place = on_the_ground(
        groups.bound, np.searchsorted(path_s, scan_s)[scan[order]], ranges, angles, frames, scanner
    )
    wrong = apart(groups, place, lidar.range_sigma_m**2 + np.square(ranges * np.radians(lidar.angle_sigma_deg)))
    if wrong.any():
        kept = np.sort(order[~wrong])
        return _of_block(log, config, way, rows[kept], keyframe[kept], names, velocity_m2_s2, nearest)
    mean, row = means[:, 0], np.searchsorted(path_s, mean_s)
    rotation, pos, frame = turned[row], path_n[row], frames[row]
    to_b = so3.transpose(from_quaternion(way.quat_nb[at]))
    x, y, off = np.einsum("kji,kj->ik", frame, mean - scanner[row])
    range_m, angle_rad = np.hypot(x, y), np.arctan2(-x, y)
    u_s = np.column_stack([x / range_m, y / range_m])
    frame[..., :2] = frame[..., :2] @ np.stack([u_s, u_s[:, ::-1] * [-1, 1]], axis=-1)
    averaged = spread(means[:, 1:], frame, np.column_stack([range_m, angle_rad, off]))
    own = np.array([lidar.range_sigma_m, np.radians(lidar.angle_sigma_deg)]) / np.sqrt(groups.count)[:, None]
    carried = together(
        log, config.lidar, groups, t_s - mean_s[groups.of_row], mean_s - way.t_s[at], window, range_m, velocity_m2_s2
    )
    return (
        at, window, which, groups.count, to_b @ rotation, pos - way.pos_n[at],
        range_m, angle_rad, off, averaged, np.hypot(own, carried), mean,
    )  # fmt: skip


def _scans(t_s: Array) -> tuple[Array, npt_int]:
    """The different times of ascending ones, and which of them each is."""
    new = np.diff(t_s, prepend=-np.inf) > 0
    return t_s[new], np.cumsum(new) - 1


def _window_s(problem: Problem) -> float:
    """Span of a window: systematic errors turn with the bearing, so the machine must not go far within it."""
    config, odometer = problem.config.lidar, problem.log.odometer
    usual = 0.0 if odometer is None else float(np.quantile(np.abs(odometer.speed_m_s), 0.95))
    return min(config.window_s, config.window_m / usual) if usual > 0 else config.window_s


def _centres(keyframe_s: Array, window_s: float) -> npt_int:
    """Every so many keyframes, at most `window_s` apart; the middle one of a record that is shorter.

    Counted in keyframes, which are evenly spaced for long stretches: the detections of a window then lie evenly to both
    sides of its keyframe, and an error of velocity cancels.
    """
    if len(keyframe_s) < 2:
        return np.zeros(1, np.int64)
    apart = max(int(window_s / np.median(np.diff(keyframe_s)) + 1e-6), 1)
    if apart >= len(keyframe_s):
        return np.array([len(keyframe_s) // 2])
    return np.arange(apart // 2, len(keyframe_s), apart)


def _nearest(grid: Array, t_s: Array) -> npt_int:
    """Index of the nearest entry of an ascending grid for every time."""
    if len(grid) == 1:
        return np.zeros(len(t_s), np.int64)
    right = np.clip(np.searchsorted(grid, t_s), 1, len(grid) - 1)
    return np.asarray(np.where(t_s - grid[right - 1] < grid[right] - t_s, right - 1, right), dtype=np.int64)
