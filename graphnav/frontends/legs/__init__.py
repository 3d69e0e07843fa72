"""Legs of roof supports in raw LiDAR scans: found, located, and numbered as landmarks at rest.

Each file is one step: `segmentation` cuts scans into runs of beams, `circles` fits the legs, `motion` says how the
machine moved between scans, `association` tells which detections are one leg, `rest` which of them is a landmark.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from graphnav._schema import Array
from graphnav.errors import LogError
from graphnav.frontends.legs.association import ENDS, Tracks, track
from graphnav.frontends.legs.circles import REASONS, Circles, fit_circles, joined
from graphnav.frontends.legs.motion import PlanarMotion, planar_motion, undistorted
from graphnav.frontends.legs.rest import common_motion, numbered
from graphnav.frontends.legs.segmentation import Beams, Segments, segment
from graphnav.log import Lidar, LidarPoints, LidarScans, SensorLog

__all__ = [
    "ENDS", "REASONS", "Beams", "Circles", "Legs", "PlanarMotion", "Segments", "Tracks",
    "detect", "fit_circles", "legs", "planar_motion", "segment", "track", "undistorted", "with_legs",
]  # fmt: skip

#: Scans worked on at one time: some 10 MB.
_BLOCK = 2000
#: A detection this share of the spacing from a leg is another leg's; without a spacing, this many diameters.
_GATE_SHARE, _GATE_DIAMETERS = 0.4, 2.5
#: The least displacement that makes a support a moved one: systematic errors of a LiDAR shift a leg that passes by less
#: within the 20 s over which it is compared, and a push is several times as long.
MOVED_M = 0.08
#: The spacing measured may differ from the declared one by this share.
_SPACING_TOLERANCE = 0.15


@dataclass(frozen=True)
class Legs:
    """Legs found in the scans of a log.

    Attributes
    ----------
    points : detections of legs at rest, in the order of time; None where there are none.
    cov : (K, 2, 2) covariance of range (m) and angle (rad) of each.
    rejected : what was not used, by reason: runs of beams that are no leg, and detections of nothing at rest.
    moved : how many times a leg was found away from its place; a slow advance counts several times.
    warnings : what a user should look at.
    """

    points: LidarPoints | None
    cov: Array
    rejected: dict[str, int]
    moved: int
    warnings: tuple[str, ...]


def legs(
    log: SensorLog,
    *,
    side: str | None = "left",
    max_range_m: float = np.inf,
    sweep_s: float = 0.0,
    moved_m: float = MOVED_M,
) -> Legs:
    """Find the legs in every scan, and number them as landmarks.

    Parameters
    ----------
    log : with `lidar_scans` and, in ``[lidar]``, ``leg_diameter_m``; ``feature_spacing_m`` where legs stand in a row.
    side : "left", "right" or None for both: where legs may be, seen along s's forward axis.
    max_range_m : returns from farther away are dropped.
    sweep_s : time from the first to the last beam of a scan, whose stamp is the first beam's; what is seen later is
        moved to where it would be seen at the stamp. 0: all beams at once.
    moved_m : displacement above its noise that makes a leg a new one.

    Returns
    -------
    Legs

    Raises
    ------
    LogError
        No scans, no diameter, or an unknown side.
    """
    lidar, scans = _needed(log)
    assert lidar.leg_diameter_m is not None
    if side not in ("left", "right", None):
        raise LogError(f'side "{side}", expected "left", "right" or None', where="lidar_scans")
    motion = planar_motion(log, scans.t_s)
    circles = detect(scans, lidar, max_range_m)
    if side is not None:
        circles = circles.where((circles.pos_s_m[:, 0] < 0) == (side == "left"))
    if sweep_s:
        circles = _swept(circles, motion, scans, sweep_s)
    spacing = lidar.feature_spacing_m
    gate_m = _GATE_SHARE * spacing if spacing is not None else _GATE_DIAMETERS * lidar.leg_diameter_m
    tracks = track(circles, motion, gate_m, moved_m)
    seen = np.zeros(len(motion.t_s), bool)
    seen[circles.scan] = True
    all_move = common_motion(tracks, motion, seen)
    number = numbered(circles, tracks, motion, moved_m, all_move)
    found = circles.where(number > 0)
    number = number[number > 0]
    rejected = {**circles.rejected, "not at rest or seen too rarely": len(circles) - len(found)}
    warnings = _warnings(found, tracks, all_move, lidar)
    moved = int((tracks.end[np.unique(tracks.number[tracks.number >= 0])] == ENDS.index("moved")).sum())
    points = None
    if len(found):
        points = LidarPoints(
            t_s=motion.t_s[found.scan], feature=number, range_m=found.range_m, angle_rad=found.angle_rad
        )
    return Legs(points, found.polar_covariance(), rejected, moved, tuple(warnings))


def with_legs(log: SensorLog, found: Legs) -> SensorLog:
    """The log with the legs found as its `lidar_points`."""
    return dataclasses.replace(log, lidar_points=found.points)


def detect(scans: LidarScans, lidar: Lidar, max_range_m: float = np.inf) -> Circles:
    """Legs in every scan on its own, in the order of the scans.

    Parameters
    ----------
    scans : raw scans.
    lidar : with `leg_diameter_m`; its range and angle sigma weigh the returns.
    max_range_m : returns from farther away are dropped.

    Raises
    ------
    LogError
        No diameter is declared.
    """
    if lidar.leg_diameter_m is None:
        raise LogError("not declared", where="[lidar]", column="leg_diameter_m", fix="declare the legs' diameter")
    sigma_rad = float(np.radians(lidar.angle_sigma_deg))
    parts, rejected = [], dict.fromkeys(REASONS[1:], 0)
    for low in range(0, len(scans), _BLOCK):
        rows = slice(low, low + _BLOCK)
        beams = Beams.stacked(list(scans.ranges_m[rows]), scans.angle_min_rad[rows], scans.angle_step_rad[rows])
        segments = segment(beams, lidar.leg_diameter_m, lidar.range_sigma_m, max_range_m=max_range_m)
        part = fit_circles(beams, segments, lidar.leg_diameter_m, lidar.range_sigma_m, sigma_rad)
        for reason, count in part.rejected.items():
            rejected[reason] += count
        parts.append(dataclasses.replace(part, scan=part.scan + low))
    return joined(parts, rejected)


def _needed(log: SensorLog) -> tuple[Lidar, LidarScans]:
    if log.lidar_scans is None or log.lidar is None:
        raise LogError("no scans", where=f"log {log.name}", column="lidar_scans", fix="add the table and [lidar]")
    if log.lidar.leg_diameter_m is None:
        raise LogError("not declared", where="[lidar]", column="leg_diameter_m", fix="declare the legs' diameter")
    return log.lidar, log.lidar_scans


def _swept(circles: Circles, motion: PlanarMotion, scans: LidarScans, sweep_s: float) -> Circles:
    """Centres where they would be seen at the stamps of their scans."""
    beams = np.array([len(r) for r in scans.ranges_m])
    since = sweep_s * circles.beam / np.maximum(beams[circles.scan] - 1, 1)
    rows = circles.scan
    moved = undistorted(circles.pos_s_m, since, motion.rate_s_m_s[rows], motion.turn_rate_rad_s[rows])
    return dataclasses.replace(circles, pos_s_m=moved)


def _warnings(found: Circles, tracks: Tracks, all_move: Array, lidar: Lidar) -> list[str]:
    """Notes on what looks wrong in the scans or in what the log declares of them."""
    notes = []
    if not len(found):
        notes.append("no leg was found in any scan: check leg_diameter_m and the side")
    elif lidar.feature_spacing_m is not None:
        measured = _spacing(found)
        if measured is not None and abs(measured / lidar.feature_spacing_m - 1) > _SPACING_TOLERANCE:
            notes.append(
                f"legs stand {measured:.2f} m apart, [lidar] feature_spacing_m is {lidar.feature_spacing_m:g} m"
            )
    lost = int((tracks.end == ENDS.index("lost")).sum())
    if lost:
        notes.append(f"{lost} legs were lost over times without scans or matches; what was seen after them is new")
    for start_s, end_s in all_move[:5]:
        notes.append(
            f"{start_s:.1f} to {end_s:.1f} s: all legs together move against the odometer (slip, or all supports "
            "advance); what is seen after it is new"
        )
    return notes


def _spacing(found: Circles) -> float | None:
    """Median distance of neighbours in the same scan."""
    order = np.lexsort([found.pos_s_m[:, 1], found.scan])
    same = np.diff(found.scan[order]) == 0
    gaps = np.linalg.norm(np.diff(found.pos_s_m[order], axis=0), axis=1)[same]
    return float(np.median(gaps)) if len(gaps) else None
