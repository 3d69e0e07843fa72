"""Keyframes: the times at which states are estimated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graphnav._schema import Array
from graphnav.config import Config
from graphnav.errors import LogError
from graphnav.frontends.cutting_cycles import ClosedPathPoint, Cycle, closed_path_points, find_cycles, mileage
from graphnav.frontends.ranging_spans import RangingSpan, ranging_keyframes, ranging_spans
from graphnav.frontends.rest import rest_spans
from graphnav.log import RelativePose, SensorLog

#: Measurements closer than this share a keyframe (at 1 m/s it is a millimetre).
SAME_S = 1e-3
#: A regular keyframe this close to a measurement's, in intervals, is left out.
_NEAR = 0.3
#: Frames of tracked features that no motions chose are keyframes where they are this far apart, s.
_VIEW_S = 0.05


@dataclass(frozen=True)
class Frontend:
    """What the log says before any estimation.

    Attributes
    ----------
    keyframe_s : (N,) keyframe times.
    cycles, closed_path : cutting cycles and closed-path points.
    rest_s : (K, 2) spans at rest.
    fixes : (time, position (3,), sigma (3,)) of absolute positions and surveyed points.
    ranging : spans of UWB ranges.
    guide : motions of the camera that lead to initial values and are no measurements of their own.
    """

    keyframe_s: Array
    cycles: tuple[Cycle, ...]
    closed_path: tuple[ClosedPathPoint, ...]
    rest_s: Array
    fixes: tuple[tuple[float, Array, Array], ...]
    ranging: tuple[RangingSpan, ...] = ()
    guide: RelativePose | None = None

    def index(self, t_s: float) -> int:
        """The keyframe nearest to a time."""
        right = int(np.clip(np.searchsorted(self.keyframe_s, t_s), 1, len(self.keyframe_s) - 1))
        left_nearer = t_s - self.keyframe_s[right - 1] < self.keyframe_s[right] - t_s
        return right - 1 if left_nearer else right


def run_frontend(
    log: SensorLog, config: Config, rest_s: Array | None = None, guide: RelativePose | None = None
) -> Frontend:
    """Find cycles, closed-path points, rest and fixes, and place the keyframes.

    Policy: a keyframe at the start and end of the IMU record, at the exact time of every measurement that needs one
    (closed-path points, fixes, surveyed points, events), every `interval_s` (and `distance_m`) in between. Without an
    IMU the chain of relative poses is the record, and LiDAR detections need one too: wheels do not carry them far.

    Parameters
    ----------
    rest_s : (K, 2) spans at rest where they are known already; None finds them.
    guide : motions of the camera between frames that become keyframes.
    """
    start, end = _record(log, guide)
    cycles = find_cycles(log)
    use_path = config.closed_path.form != "off" and log.odometer is not None
    closed = closed_path_points(log, cycles, config.closed_path.interval_m) if use_path else ()
    closed = tuple(p for p in closed if start - SAME_S <= p.first_s and p.second_s <= end + SAME_S)
    fixes = _fixes(log, cycles, start, end) if config.position.use else ()
    wanted = [p.first_s for p in closed] + [p.second_s for p in closed] + [t for t, _, _ in fixes]
    if config.keyframes.events:
        wanted += [t for c in cycles for t in (c.start_s, c.end_s) if t is not None]
    if log.imu is None and log.lidar_points is not None and log.lidar is not None and config.lidar.use:
        wanted += np.unique(log.lidar_points.t_s).tolist()
    if log.imu is not None and log.relative_pose is not None and config.relative_pose.use:
        wanted += log.relative_pose.t_from_s.tolist() + log.relative_pose.t_to_s.tolist()
    if guide is not None:
        wanted += guide.t_from_s.tolist() + guide.t_to_s.tolist()
    elif log.stereo_tracks is not None and log.stereo is not None and config.stereo.form == "tight":
        wanted += _apart(np.unique(log.stereo_tracks.t_s), _VIEW_S).tolist()
    ranging = () if log.uwb is None or not config.uwb.use else ranging_spans(log.uwb, start, end)
    if log.uwb is not None:
        wanted += ranging_keyframes(log.uwb, ranging, config.keyframes.interval_s).tolist()
    times = place_keyframes(start, end, np.array(wanted, float), config, log)
    found = rest_spans(log) if rest_s is None and config.rest.use else rest_s
    rest = found if found is not None and config.rest.use else np.zeros((0, 2))
    return Frontend(times, cycles, closed, np.asarray(rest, float).reshape(-1, 2), fixes, ranging, guide)


def _record(log: SensorLog, guide: RelativePose | None) -> tuple[float, float]:
    """Start and end of what carries the state: the IMU, or else relative poses, or else motions that guide."""
    if log.imu is not None:
        return log.imu.start_s, float(log.imu.t_s[-1])
    poses = guide if log.relative_pose is None else log.relative_pose
    if poses is not None:
        return float(poses.t_from_s[0]), float(poses.t_to_s[-1])
    fix = "smoothing needs an IMU, or relative poses that follow each other"
    raise LogError("no imu table and no relative_pose table", where=f"log {log.name}", fix=fix)


def place_keyframes(start_s: float, end_s: float, wanted_s: Array, config: Config, log: SensorLog) -> Array:
    """Merge wanted times with the regular ones (N,).

    Wanted times within a millisecond share a keyframe. A regular one near a wanted one is left out; where that, or the
    distance travelled, leaves too wide a space, it is divided evenly.
    """
    interval = config.keyframes.interval_s
    inside = np.sort(wanted_s[(wanted_s > start_s + SAME_S) & (wanted_s < end_s - SAME_S)])
    wanted = np.concatenate([[start_s], _apart(inside), [end_s]])
    regular = np.arange(np.ceil(start_s / interval) * interval, end_s, interval)
    near = np.clip(np.searchsorted(wanted, regular), 1, len(wanted) - 1)
    apart = np.minimum(np.abs(regular - wanted[near]), np.abs(regular - wanted[near - 1]))
    times = np.union1d(wanted, regular[apart > _NEAR * interval])
    shares = np.diff(times) / interval
    if config.keyframes.distance_m is not None and log.odometer is not None:
        way = np.interp(times, log.odometer.t_s, mileage(log.odometer))
        shares = np.maximum(shares, np.abs(np.diff(way)) / config.keyframes.distance_m)
    return _divided(times, np.where(shares > 1 + _NEAR, np.ceil(shares), 1).astype(int))


def _apart(times: Array, least_s: float = SAME_S) -> Array:
    """Ascending times without those less than a millisecond (or as given) after the last one kept."""
    kept: list[float] = []
    for t in times.tolist():
        if not kept or t - kept[-1] > least_s:
            kept.append(t)
    return np.array(kept)


def _divided(times: Array, parts: npt.NDArray[np.int_]) -> Array:
    """Every space between times divided into a number of equal parts."""
    if (parts == 1).all():
        return times
    spaces = zip(times[:-1], times[1:], parts, strict=True)
    return np.append(np.concatenate([a + (b - a) * np.arange(n) / n for a, b, n in spaces]), times[-1])


def _fixes(
    log: SensorLog, cycles: tuple[Cycle, ...], start: float, end: float
) -> tuple[tuple[float, Array, Array], ...]:
    """Absolute positions and surveyed points within the record, in order of time."""
    found = []
    if log.position is not None:
        for t, pos, sigma in zip(log.position.t_s, log.position.pos_n_m, log.position.sigma_n_m, strict=True):
            if start - SAME_S <= t <= end + SAME_S:
                found.append((float(t), pos, sigma))
    for point in log.surveyed:
        when = point.t_s if point.t_s is not None else _arrival(cycles, far=point.end == "far")
        if when is not None and start - SAME_S <= when <= end + SAME_S:
            found.append((float(when), point.pos_n_m, np.full(3, point.sigma_m)))
    return tuple(sorted(found, key=lambda fix: fix[0]))


def _arrival(cycles: tuple[Cycle, ...], far: bool) -> float | None:
    """First time at an end of the face: a forward cut ends at the far one and starts at the near one."""
    times = [c.end_s if c.forward == far else c.start_s for c in cycles]
    known = [t for t in times if t is not None]
    return min(known) if known else None
