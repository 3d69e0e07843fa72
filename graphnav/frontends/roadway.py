"""The wall of a roadway in the scans of a machine at rest, for `graphnav.frontends.registration`.

At an end of the face the scanner looks past its conveyor at the far wall of the roadway there, which stays where it is
when the face advances. Between the conveyor and the row of support legs nothing stands in the way; legs and what is
behind them advance with the face and are left out. A machine at rest sees the same with every scan, so all scans of a
stop make one of little noise, and dust, which is somewhere else in every scan, drops out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.increments import npt_int
from factors.landmark import MOUNTING, RANGE_BIAS, RANGE_SCALE, true_angle
from factors.so3 import exp, from_quaternion
from graphnav._schema import Array
from graphnav.errors import LogError
from graphnav.frontends.legs import detect
from graphnav.log import Lidar, LidarScans

#: Returns of one beam farther from their median than this many of its spread are dust.
_DUST_SPREADS = 4.0
#: A beam whose returns spread by more than this many sigmas of one reading does not see one thing alone.
_ONE_THING = 10.0
#: A beam counts when this share of the scans agree on it.
_AGREE = 0.6
#: Nothing nearer than this along the face is a roadway: the machine itself and the conveyor's drive are.
_NEAREST_M = 3.0
#: Free space kept beside the legs: supports do not stand in a line to the centimetre.
_BESIDE_M = 0.3
#: Fewest beams on a wall that can be registered.
FEWEST = 12


@dataclass(frozen=True)
class Beams:
    """Mean of the scans of one stop, beam by beam.

    Attributes
    ----------
    range_m, angle_rad : ``(N,)`` as measured, systematic errors included.
    sigma_m : ``(N,)`` 1-sigma of the mean range, from the scatter of the scans. Readings that are all the same show
        the scanner's steps, which no mean makes finer: then the declared sigma of one of them.
    """

    range_m: Array
    angle_rad: Array
    sigma_m: Array

    def where(self, chosen: npt_int) -> Beams:
        """Some of the beams."""
        return Beams(self.range_m[chosen], self.angle_rad[chosen], self.sigma_m[chosen])


def mean_scan(scans: LidarScans, rows: npt_int, range_sigma_m: float) -> Beams:
    """Mean of the scans `rows` of a machine at rest, over the beams on whose range most of them agree.

    Parameters
    ----------
    range_sigma_m : the declared 1-sigma of one range.

    Raises
    ------
    LogError
        Scans of different beams.
    """
    first = int(rows[0])
    geometry = (len(scans.ranges_m[first]), scans.angle_min_rad[first], scans.angle_step_rad[first])
    for row in rows[1:]:
        if (len(scans.ranges_m[row]), scans.angle_min_rad[row], scans.angle_step_rad[row]) != geometry:
            raise scans.error(
                "other beams than the scan before it of the same stop", row=int(row), column="ranges_m",
                fix="give all scans of a stop the same first angle, step and number of beams",
            )  # fmt: skip
    ranges = np.stack([scans.ranges_m[row] for row in rows])
    ranges = np.where(np.isfinite(ranges) & (ranges > 0), ranges, np.nan)
    seen = np.flatnonzero(np.isfinite(ranges).mean(axis=0) > _AGREE)
    ranges = ranges[:, seen]
    off = np.abs(ranges - np.nanmedian(ranges, axis=0))
    spread = 1.4826 * np.nanmedian(off, axis=0)
    ranges[off > _DUST_SPREADS * spread] = np.nan
    count = np.isfinite(ranges).sum(axis=0)
    agreed = np.flatnonzero((count > _AGREE * len(rows)) & (count > 1) & (spread < _ONE_THING * range_sigma_m))
    ranges, seen = ranges[:, agreed], seen[agreed]
    scatter = np.nanstd(ranges, axis=0, ddof=1)
    sigma = np.where(scatter > 0, scatter / np.sqrt(count[agreed]), range_sigma_m)
    return Beams(np.nanmean(ranges, axis=0), geometry[1] + geometry[2] * seen, sigma)


def placed(range_m: Array, angle_rad: Array, lidar: Lidar, calibration: Array, rot_fb: Array) -> Array:
    """Level points from readings, ``(N, 2)``: right and forward of the body in the axes of the face.

    Parameters
    ----------
    range_m, angle_rad : ``(N,)`` as measured.
    lidar : the declared mounting.
    calibration : ``(8,)`` systematic errors, as in `factors.landmark`.
    rot_fb : ``(3, 3)`` attitude of the body in the axes of the face.
    """
    true_m = (range_m - calibration[RANGE_BIAS]) / (1 + calibration[RANGE_SCALE])
    true_rad, _ = true_angle(angle_rad, calibration)
    in_s = np.stack([-true_m * np.sin(true_rad), true_m * np.cos(true_rad), np.zeros_like(true_m)], axis=-1)
    rot_bs = exp(calibration[MOUNTING]) @ from_quaternion(lidar.T_bs_quat_wxyz)
    in_b = in_s @ rot_bs.T + lidar.T_bs_pos_m
    return np.asarray((in_b @ rot_fb.T)[:, :2])


def roadway_beams(
    scans: LidarScans, rows: npt_int, lidar: Lidar, calibration: Array, rot_fb: Array, outwards: int
) -> Beams:
    """The beams of a stop that reach the roadway beyond the end of the face.

    Parameters
    ----------
    scans, rows : the scans, and those of the stop.
    lidar, calibration, rot_fb : see `placed`.
    outwards : -1 at the near end of the face, +1 at the far end: which way along the face the roadway lies.

    Raises
    ------
    LogError
        No roadway seen, or no diameter of the legs declared.
    """
    beams = mean_scan(scans, rows, lidar.range_sigma_m)
    points = placed(beams.range_m, beams.angle_rad, lidar, calibration, rot_fb)
    free = points[:, 0] > _free_from(scans, rows, lidar, calibration, rot_fb)
    found = beams.where(np.flatnonzero(free & (outwards * points[:, 1] > _NEAREST_M)))
    if len(found.range_m) < FEWEST:
        raise LogError(
            f"at {scans.t_s[rows[0]]:.1f} s {len(found.range_m)} beams see the roadway, {FEWEST} are needed",
            where="lidar_scans",
            fix="the wall must lie within the scanner's field and range, seen past the legs of the supports",
        )
    return found


def _free_from(scans: LidarScans, rows: npt_int, lidar: Lidar, calibration: Array, rot_fb: Array) -> float:
    """Right of where (m, to the right of the machine) the view along the face is free: supports stand on the left."""
    part = LidarScans(
        t_s=scans.t_s[rows],
        angle_min_rad=scans.angle_min_rad[rows],
        angle_step_rad=scans.angle_step_rad[rows],
        ranges_m=[scans.ranges_m[row] for row in rows],
    )
    legs = detect(part, lidar)
    assert lidar.leg_diameter_m is not None  # else `detect` has refused
    across = placed(legs.range_m, legs.angle_rad, lidar, calibration, rot_fb)[:, 0]
    across = across[across < 0]
    if not len(across):
        return -np.inf
    # the median: a false circle in the wall or a support out of line must not close the view
    return float(np.median(across)) + lidar.leg_diameter_m / 2 + _BESIDE_M
