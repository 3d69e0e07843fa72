"""Detections of legs in groups: their means on the ground, and how wrong these are.

A group is all detections of one leg in one window of a few seconds, see `graphnav.legs`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.increments import npt_int
from factors.inertial import M_S2_PER_MG
from factors.so3 import Array
from graphnav.config import LidarConfig
from graphnav.log import SensorLog

npt_bool = np.ndarray[tuple[int, ...], np.dtype[np.bool_]]

#: Sigmas from the median of a group at which a detection does not belong to it.
_APART = 5.7
#: A leg that steps this far, m, between readings this close, s, has moved.
_STEP_M, _SOON_S = 0.15, 30.0
#: Error of bringing detections together along a chain of relative poses, whose declared noise is for far longer, m.
_TOGETHER_M = 2e-3


@dataclass(frozen=True)
class Groups:
    """Rows of a table in groups: `order` sorts them by group, group g is ``bound[g]:bound[g + 1]`` of it.

    Attributes
    ----------
    order : (M,), or None where the rows stand in that order already, which spares looking them up.
    number : (G,) ascending, what the rows of each group have in common.
    """

    order: npt_int | None
    bound: npt_int
    number: npt_int

    @classmethod
    def of(cls, number: npt_int) -> Groups:
        """Rows with the same number."""
        order = None
        if len(number) and np.diff(number).min(initial=0) < 0:
            order = np.argsort(number, kind="stable")
            number = number[order]
        start = np.flatnonzero(np.diff(number, prepend=number[:1] - 1))
        return cls(order, np.append(start, len(number)), number[start])

    @property
    def count(self) -> npt_int:
        """(G,) rows in each."""
        return np.diff(self.bound)

    @property
    def of_row(self) -> npt_int:
        """(M,) group of every row."""
        group = np.repeat(np.arange(len(self.number)), self.count)
        if self.order is None:
            return group
        found = np.empty(len(group), np.int64)
        found[self.order] = group
        return found

    def median(self, values: Array) -> Array:
        """Median of every group, (G,); of an even number of rows the upper one of the middle two."""
        group = self.of_row
        return np.asarray(values[np.lexsort((values, group))][self.bound[:-1] + self.count // 2])

    def mean(self, values: Array) -> Array:
        """Mean of every group, (G,), of values (M,)."""
        ordered = values if self.order is None else values[self.order]
        return np.asarray(np.add.reduceat(ordered, self.bound[:-1]) / self.count)

    def scatter(self, place: Array) -> Array:
        """Mean square (G,) of the level distance of each group's places (M, 3) from their mean."""
        from graphnav.leg_sums import scatter

        return scatter(self.bound, place if self.order is None else place[self.order])


def apart(groups: Groups, place: Array, variance_m2: Array) -> npt_bool:
    """Detections (M,) that lie elsewhere than the others of their group: false circles, wrong numbers.

    A few metres of error in one of a hundred would move their mean by centimetres. So where a group scatters more than
    declared, its median is taken, and what is farther from it than `_APART` times the group's median distance (or the
    declared sigma, whichever is more) is apart. False-alarm rate of a detection with normal errors: 1e-7.

    Parameters
    ----------
    place : (M, 3); variance_m2 : (M,) declared noise of a detection's place, each axis.
    """
    scattered = groups.scatter(place) > 4 * 2 * groups.mean(variance_m2)
    wrong = np.zeros(len(place), bool)
    if scattered.any():
        of_row = groups.of_row
        rows = np.flatnonzero(scattered[of_row])
        some, level = Groups.of(of_row[rows]), place[rows, :2].T
        centre = np.array([some.median(level[0]), some.median(level[1])])
        distance = np.hypot(*(level - centre[:, some.of_row]))
        # of a level normal error the median distance is 1.18 sigma
        usual = np.maximum(some.median(distance) / 1.18, np.sqrt(some.mean(variance_m2[rows])))
        wrong[rows] = distance > _APART * usual[some.of_row]
    return wrong


def split(leg: npt_int, t_s: Array, place: Array, sigma_m: Array) -> tuple[npt_int, npt_int]:
    """A leg that stands elsewhere from one reading to the next has moved, and is another landmark from then on.

    Dead reckoning is good to millimetres over the seconds between two readings, so a step of more than `_STEP_M` (as
    much as the scanner's errors may change with the bearing) and 5 sigma is the leg's own.

    Parameters
    ----------
    leg : (K,); t_s, sigma_m : (K,); place : (K, 3) of its readings.

    Returns
    -------
    leg (K,) with new numbers from the largest on, and what each new one was before.
    """
    order = np.lexsort((t_s, leg))
    same = (np.diff(leg[order]) == 0) & (np.diff(t_s[order]) < _SOON_S)
    moved = same & stepped(place[order][:-1], place[order][1:], sigma_m[order][:-1], sigma_m[order][1:])
    if not moved.any():
        return leg, np.zeros(0, np.int64)
    times = np.concatenate([[0], np.cumsum(moved)])
    starts = np.searchsorted(leg[order], leg[order])
    since_first = times - times[starts]
    before = leg[order][1:][moved]
    found = leg.copy()
    number = leg.max() + times
    found[order] = np.where(since_first > 0, number, leg[order])
    return found, before


def stepped(before_n: Array, after_n: Array, before_sigma_m: Array | float, after_sigma_m: Array | float) -> npt_bool:
    """Whether a leg stands elsewhere (...,) than seconds before: places (..., 3) in n and their sigmas (...,), m."""
    step = np.hypot(*np.moveaxis(after_n - before_n, -1, 0)[:2])
    return np.asarray(step > _STEP_M + 5 * np.hypot(after_sigma_m, before_sigma_m))


def spread(moves: Array, frame: Array, mean: Array) -> Array:
    """What averaging makes of the scanner's errors, beyond their effect at the mean: (G, 3, 7) m, rad and m.

    A detection is displaced by ``(rho dK + db) u - r (a3 + (a2 - 1) t + a1 t^2) w`` with u the ray and w to its left
    (the INS/LiDAR shearer paper, equations 1 and 4, to first order), and by ``r (d . w) n`` where the scanner is turned
    by d about an axis of its plane, n its normal. Within a group u, t and the machine's tilt change, so that the mean
    of the displacements is not that of the mean reading: in range and angle, and in height above the plane at the mean
    time. A centimetre of height moves the cut of a leaning leg by a millimetre.

    Parameters
    ----------
    moves : (G, 7, 3) mean displacement in n by one unit of each error, from `graphnav.leg_sums.on_the_ground`.
    frame : (G, 3, 3) u, w and n of the mean reading; mean : (G, 3) its range, angle and height above its plane.

    Returns
    -------
    By the calibration's first five numbers, and by turns about the scanner's right and forward axes; a turn about its
    normal is as a bias of the angle.
    """
    found: Array = np.einsum("gji,gcj->gic", frame, moves)
    rho, theta, off = mean.T
    by_u, by_w = np.array([-np.sin(theta), np.cos(theta)]).T, np.array([-np.cos(theta), -np.sin(theta)]).T
    found[:, 0] -= np.column_stack([rho, np.ones_like(rho), *np.zeros((3, len(rho))), -off[:, None] * by_w])
    along = rho[:, None] * theta[:, None] ** np.arange(3)
    found[:, 1] -= np.column_stack([*np.zeros((2, len(rho))), -along, off[:, None] * by_u])
    found[:, 2, 5:] -= rho[:, None] * by_w
    found[:, 1] /= rho[:, None]
    return found


def together(
    log: SensorLog,
    config: LidarConfig,
    groups: Groups,
    since_s: Array,
    off_s: Array,
    window: npt_int,
    range_m: Array,
    velocity_m2_s2: float | None = None,
) -> Array:
    """Error (G, 2) of carrying detections to their mean time and averaging there, m and rad.

    Between keyframes the path has the accelerometer's short-term motion, and an error of velocity that lasts longer
    than a group. With q the accelerometer's noise (m/s per root second) and r the odometer's (m per root second), the
    velocity of a filter on both has the variance ``q r``; a group whose mean time is off its keyframe's moves by that
    error times the time. Detections spread evenly about the mean time, from -h to h, mean |t| = m = h / 2, keep
    ``q^2 h^3 / 40 = q^2 m^3 / 5`` of the twice integrated noise; a gyro of noise g turns them by ``g^2 m / 3``.
    All this is common to the n legs of a window: as independent errors it would average out among them, so each is
    given n times its variance.

    Parameters
    ----------
    since_s : (M,) time of each detection after its group's mean time; off_s : (G,) of that after its keyframe.
    window : (G,) what legs of one window have in common; range_m : (G,).
    velocity_m2_s2 : `velocity_variance` of the log where it is known already; it reads whole tables.
    """
    if log.imu is None or config.together_m is not None:
        error_m = np.full(len(window), _TOGETHER_M if config.together_m is None else config.together_m)
        return np.column_stack([error_m, error_m / range_m])
    accel = log.imu.accel_random_walk_mg_sqrt_hz * M_S2_PER_MG
    gyro = np.radians(log.imu.gyro_random_walk_deg_sqrt_h) / 60
    away_s = groups.mean(np.abs(since_s))
    common = np.bincount(window)[window]
    lasting = (velocity_variance(log) if velocity_m2_s2 is None else velocity_m2_s2) * off_s**2
    error_m = np.sqrt(common * (lasting + accel**2 * away_s**3 / 5))
    return np.column_stack([error_m, np.hypot(error_m / range_m, gyro * np.sqrt(common * away_s / 3))])


def velocity_variance(log: SensorLog) -> float:
    """Variance of the path's velocity, (m/s)^2; without an odometer, what ranges to legs leave of it.

    Steady state of a filter of integrated acceleration noise q: ``q r`` with speeds of noise r (m per root second),
    ``sqrt(2) q^1.5 p^0.5`` with positions of noise p (m root second).
    """
    lidar, points, odometer, imu = log.lidar, log.lidar_points, log.odometer, log.imu
    assert lidar is not None and points is not None and imu is not None
    accel = imu.accel_random_walk_mg_sqrt_hz * M_S2_PER_MG
    if odometer is not None and len(odometer) > 1:
        step_s = float(np.median(np.diff(odometer.t_s)))
        return float(accel * np.hypot(odometer.slip_sigma_m_s, odometer.sigma_m_s * np.sqrt(step_s)))
    position = lidar.range_sigma_m * np.sqrt((points.t_s[-1] - points.t_s[0]) / len(points.t_s))
    return float(np.sqrt(2 * accel**3 * position))
