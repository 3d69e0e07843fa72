"""Which detections are the same leg: a running map of the legs in view, in which the machine is located scan by scan.

Every scan is predicted by dead reckoning, matched with the map leg by leg and aligned with it, robustly, so that the
supports that are being advanced do not drag the machine along. A leg that then leaves its place in the map by more than
noise allows has moved: its number ends there and its detections become a new leg's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graphnav._schema import Array
from graphnav.baselines._compiled import compiled
from graphnav.frontends.legs.circles import Circles
from graphnav.frontends.legs.motion import PlanarMotion
from graphnav.frontends.legs.segmentation import Int

#: Legs in the map at one time; the one unseen for longest makes room.
_MOST = 128
#: Detections before a leg helps to locate the machine.
_CONFIRMED = 3
#: Time constants of a leg's place in the map and of where it is now.
_PLACE_S, _NOW_S = 20.0, 0.4
#: An unseen leg leaves the map after this time; one seen fewer than `_CONFIRMED` times sooner.
_FORGET_S, _FORGET_NEW_S = 30.0, 1.0
_ALIGNMENTS = 4

ENDS = ("in view to the end", "out of view", "moved", "lost")


@dataclass(frozen=True)
class Tracks:
    """Detections by leg.

    Attributes
    ----------
    number : (K,) leg of each detection, counting from 0 in the order of birth.
    place_m : (K, 2) where the detection is in the map.
    end : (T,) why each number ended, an index of `ENDS`.
    pose : (S, 3) right, forward and heading of s in the map at each scan.
    """

    number: Int
    place_m: Array
    end: Int
    pose: Array


def track(circles: Circles, motion: PlanarMotion, gate_m: float, moved_m: float) -> Tracks:
    """Number the detections so that one number is one leg at one place.

    Parameters
    ----------
    circles : detections in the order of the scans.
    motion : of s between the scans.
    gate_m : a detection farther from every leg of the map is a new leg; at most half the spacing of the legs.
    moved_m : displacement above its noise that makes a leg a new one.

    Returns
    -------
    Tracks
        When dead reckoning over a time without matches could confuse one leg with its neighbour, all legs start anew
        ("lost").
    """
    variance = (circles.cov_s_m2[:, 0, 0] + circles.cov_s_m2[:, 1, 1]) / 2
    first = np.searchsorted(circles.scan, np.arange(len(motion.t_s) + 1))
    dt = float(np.median(np.diff(motion.t_s))) if len(motion.t_s) > 1 else 1.0
    number = np.full(len(circles), -1, np.int64)
    place = np.empty((len(circles), 2))
    end = np.zeros(len(circles) + 1, np.int64)
    pose = np.empty((len(motion.t_s), 3))
    count = _track(
        motion.t_s, motion.step_s_m, motion.turn_rad, motion.sigma_m, motion.sigma_rad, first,
        circles.pos_s_m, variance, gate_m, moved_m, max(_PLACE_S / dt, 10.0), max(_NOW_S / dt, 3.0),
        number, place, end, pose,
    )  # fmt: skip
    return Tracks(number, place, end[:count], pose)


@compiled
def _track(
    t_s: Array, step: Array, turn: Array, sigma_m: Array, sigma_rad: Array, first: Int, pos: Array, variance: Array,
    gate: float, moved: float, place_count: float, now_count: float,
    number: Int, place: Array, end: Int, pose: Array,
) -> int:  # fmt: skip
    """Loop over scans; fills in number, place, end and pose, returns the count of numbers."""
    legs = np.zeros((_MOST, 8))  # place, now (x, y each), detections, last seen, variance of one detection, number
    alive = np.zeros(_MOST, np.bool_)
    x, y, heading, var_m, var_rad, reach = 0.0, 0.0, 0.0, 0.0, 0.0, 1.0
    born = 0
    match = np.empty(_MOST, np.int64)
    clock = 0.0  # runs while scans come: legs cannot be seen without
    for scan in range(len(t_s)):
        clock += min(t_s[scan] - t_s[max(scan - 1, 0)], _FORGET_NEW_S)
        c, s = np.cos(heading), np.sin(heading)
        x, y = x + c * step[scan, 0] - s * step[scan, 1], y + s * step[scan, 0] + c * step[scan, 1]
        heading += turn[scan]
        var_m, var_rad = var_m + sigma_m[scan] ** 2, var_rad + sigma_rad[scan] ** 2
        low, high = first[scan], min(first[scan + 1], first[scan] + _MOST)
        for k in range(low, high):
            reach = max(reach, np.hypot(pos[k, 0], pos[k, 1]))
        # lost: neighbours could be taken for one another
        if high > low and np.sqrt(var_m + var_rad * reach**2 / 4) > gate / 2:
            for leg in range(_MOST):
                if alive[leg]:
                    alive[leg], end[np.int64(legs[leg, 7])] = False, 3
            var_m, var_rad = 0.0, 0.0
        _match(pos[low:high], x, y, heading, legs, alive, gate, match)
        x, y, heading, var_m, var_rad = _align(
            pos[low:high], variance[low:high], x, y, heading, legs, alive, match, var_m, var_rad
        )
        _match(pos[low:high], x, y, heading, legs, alive, gate, match)
        pose[scan, 0], pose[scan, 1], pose[scan, 2] = x, y, heading
        c, s = np.cos(heading), np.sin(heading)
        for k in range(low, high):
            px = x + c * pos[k, 0] - s * pos[k, 1]
            py = y + s * pos[k, 0] + c * pos[k, 1]
            place[k, 0], place[k, 1] = px, py
            leg = match[k - low]
            if leg < 0 and _beside(legs, alive, px, py, gate / 2, clock):
                continue  # a second piece of a leg already seen in this scan
            if leg < 0 or _has_moved(legs[leg], px, py, variance[k], moved, place_count, now_count):
                if leg >= 0:
                    end[np.int64(legs[leg, 7])] = 2
                else:
                    leg = _room(legs, alive, end)
                legs[leg, 0], legs[leg, 1], legs[leg, 2], legs[leg, 3] = px, py, px, py
                legs[leg, 4], legs[leg, 6], legs[leg, 7] = 1.0, variance[k], born
                alive[leg] = True
                born += 1
            legs[leg, 5] = clock
            number[k] = np.int64(legs[leg, 7])
        for leg in range(_MOST):
            if alive[leg]:
                unseen = clock - legs[leg, 5]
                new = legs[leg, 4] < _CONFIRMED
                away = np.hypot(legs[leg, 0] - x, legs[leg, 1] - y) > 1.2 * reach
                if unseen > (_FORGET_NEW_S if new else _FORGET_S) or (away and unseen > 0):
                    alive[leg], end[np.int64(legs[leg, 7])] = False, 1
    return born


@compiled
def _match(
    pos: Array, x: float, y: float, heading: float, legs: Array, alive: npt.NDArray[np.bool_], gate: float, match: Int
) -> None:
    """Nearest leg of every detection within the gate, each leg to its nearest detection only; -1 for none."""
    c, s = np.cos(heading), np.sin(heading)
    taken = np.full(_MOST, np.inf)
    owner = np.full(_MOST, -1)
    for k in range(len(pos)):
        px, py = x + c * pos[k, 0] - s * pos[k, 1], y + s * pos[k, 0] + c * pos[k, 1]
        best, nearest = gate, -1
        for leg in range(_MOST):
            if alive[leg]:
                distance = np.hypot(px - legs[leg, 2], py - legs[leg, 3])
                if distance < best:
                    best, nearest = distance, leg
        match[k] = nearest
        if nearest >= 0:
            if best < taken[nearest]:
                if owner[nearest] >= 0:
                    match[owner[nearest]] = -1
                taken[nearest], owner[nearest] = best, k
            else:
                match[k] = -1


@compiled
def _align(
    pos: Array, variance: Array, x: float, y: float, heading: float, legs: Array, alive: npt.NDArray[np.bool_],
    match: Int, var_m: float, var_rad: float,
) -> tuple[float, float, float, float, float]:  # fmt: skip
    """Pose that fits the confirmed legs best, with the predicted one as prior; and what is left of its variances."""
    x0, y0, heading0 = x, y, heading
    prior_m, prior_rad = 1 / max(var_m, 1e-10), 1 / max(var_rad, 1e-12)
    weight_m, weight_rad = 0.0, 0.0
    for _ in range(_ALIGNMENTS):
        c, s = np.cos(heading), np.sin(heading)
        h00, h02, h11, h12, h22 = prior_m, 0.0, prior_m, 0.0, prior_rad
        g0, g1, g2 = prior_m * (x0 - x), prior_m * (y0 - y), prior_rad * (heading0 - heading)
        weight_m, weight_rad = 0.0, 0.0
        for k in range(len(pos)):
            leg = match[k]
            if leg < 0 or legs[leg, 4] < _CONFIRMED:
                continue
            rx, ry = c * pos[k, 0] - s * pos[k, 1], s * pos[k, 0] + c * pos[k, 1]
            ex, ey = legs[leg, 0] - x - rx, legs[leg, 1] - y - ry
            var = variance[k] + legs[leg, 6] / legs[leg, 4]
            w = 1 / (1 + (ex * ex + ey * ey) / (9 * var)) ** 2 / var
            # the place moves by (1, 0), (0, 1) and (-ry, rx) per unit of the pose
            h00, h11, h02, h12 = h00 + w, h11 + w, h02 - w * ry, h12 + w * rx
            h22 += w * (rx * rx + ry * ry)
            g0, g1, g2 = g0 + w * ex, g1 + w * ey, g2 + w * (rx * ey - ry * ex)
            weight_m, weight_rad = weight_m + w, weight_rad + w * (rx * rx + ry * ry)
        # the two shifts do not mix: eliminate both
        d2 = (g2 - h02 * g0 / h00 - h12 * g1 / h11) / (h22 - h02**2 / h00 - h12**2 / h11)
        x, y, heading = x + (g0 - h02 * d2) / h00, y + (g1 - h12 * d2) / h11, heading + d2
    return x, y, heading, 1 / (prior_m + weight_m), 1 / (prior_rad + weight_rad)


@compiled
def _has_moved(
    leg: Array, px: float, py: float, variance: float, moved: float, place_count: float, now_count: float
) -> bool:
    """Take one more detection in; whether the leg now is too far from its place."""
    leg[4] += 1
    leg[6] += (variance - leg[6]) / min(leg[4], now_count)
    fast, slow = 1 / min(leg[4], now_count), 1 / min(leg[4], place_count)
    leg[2], leg[3] = leg[2] + (px - leg[2]) * fast, leg[3] + (py - leg[3]) * fast
    leg[0], leg[1] = leg[0] + (px - leg[0]) * slow, leg[1] + (py - leg[1]) * slow
    distance = np.hypot(leg[2] - leg[0], leg[3] - leg[1])
    return bool(distance > moved + 4 * np.sqrt(leg[6] * fast))


@compiled
def _beside(legs: Array, alive: npt.NDArray[np.bool_], px: float, py: float, near: float, clock: float) -> bool:
    """Whether a leg seen in this very scan is that near."""
    for leg in range(_MOST):
        if alive[leg] and legs[leg, 5] == clock and np.hypot(legs[leg, 2] - px, legs[leg, 3] - py) < near:
            return True
    return False


@compiled
def _room(legs: Array, alive: npt.NDArray[np.bool_], end: Int) -> int:
    """A free row of the map, or that of the leg unseen for longest."""
    oldest = 0
    for leg in range(_MOST):
        if not alive[leg]:
            return leg
        if legs[leg, 5] < legs[oldest, 5]:
            oldest = leg
    end[np.int64(legs[oldest, 7])] = 1
    return oldest
