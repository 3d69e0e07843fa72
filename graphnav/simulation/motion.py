"""When the machine is where: trapezoid speed profiles strung along the lines of a face."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from graphnav.simulation.path import ArcLength, Crossing, Line, attitude

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Trapezoid:
    """Travel from rest to rest: speed up, constant speed, slow down (a triangle if the way is short)."""

    length_m: float
    speed_m_s: float
    accel_m_s2: float

    @property
    def top_m_s(self) -> float:
        """Highest speed reached."""
        return min(self.speed_m_s, float(np.sqrt(self.length_m * self.accel_m_s2)))

    @property
    def duration_s(self) -> float:
        """From rest to rest."""
        return self.length_m / self.top_m_s + self.top_m_s / self.accel_m_s2

    def at(self, t_s: Array) -> tuple[Array, Array]:
        """Way travelled (m) and speed (m/s) at times from the start; constant before and after."""
        a, top, end = self.accel_m_s2, self.top_m_s, self.duration_s
        ramp = top / a
        t = np.clip(t_s, 0.0, end)
        speed = np.minimum(np.minimum(a * t, top), a * (end - t))
        way = np.where(t < ramp, a * t**2 / 2, top * (t - ramp / 2))
        way = np.where(t > end - ramp, self.length_m - a * (end - t) ** 2 / 2, way)
        return way, speed


@dataclass(frozen=True)
class Leg:
    """One travel from rest to rest; `cycle` is the number of the full cut, 0 for end work."""

    arc: ArcLength
    profile: Trapezoid
    start_s: float
    cycle: int

    @property
    def end_s(self) -> float:
        """Time at rest again."""
        return self.start_s + self.profile.duration_s


@dataclass(frozen=True)
class Motion:
    """State of the machine origin and of the undisturbed machine frame.

    Attributes
    ----------
    pos_n, vel_n : ``(N,3)`` m, m/s.
    speed_m_s : ``(N,)`` signed, positive towards the far end.
    rot_nm : N attitudes whose forward axis is the path's tangent.
    """

    pos_n: Array
    vel_n: Array
    speed_m_s: Array
    rot_nm: Rotation


@dataclass(frozen=True)
class Timeline:
    """All legs of a shift in order, at rest in between."""

    legs: tuple[Leg, ...]

    @property
    def end_s(self) -> float:
        """End of the last leg."""
        return self.legs[-1].end_s

    def at(self, t_s: Array) -> Motion:
        """True motion at ascending times, velocity being the exact derivative of position."""
        starts = [leg.start_s for leg in self.legs]
        index = np.maximum(np.searchsorted(starts, t_s, side="right") - 1, 0)
        pos, forward = np.empty((len(t_s), 3)), np.empty((len(t_s), 3))
        roll, speed = np.empty(len(t_s)), np.empty(len(t_s))
        for number in np.unique(index):
            leg, rows = self.legs[number], index == number
            way, rate = leg.profile.at(t_s[rows] - leg.start_s)
            pos[rows], forward[rows], roll[rows] = leg.arc.at(way)
            speed[rows] = leg.arc.direction * rate
        return Motion(pos, speed[:, None] * forward, speed, attitude(forward, roll))


def face_timeline(
    lines: Sequence[Line],
    *,
    length_m: float,
    speed_m_s: float,
    accel_m_s2: float,
    static_s: float,
    pause_s: float,
    retreat_m: float,
    crossing_m: float,
    end_work_s: float | None,
) -> Timeline:
    """Full cuts on every line with the oblique cut between them.

    After each cut: pause, back along the face while crossing to the next line, pause, on the new line to the
    end again, pause. The machine does not turn round: a cut towards the near end has negative speed.

    Parameters
    ----------
    lines : one per cutting cycle; cycle 1 is cut from the near end to the far end, the next one back.
    retreat_m : travel of the oblique cut along the face; the crossing takes `crossing_m` in its middle.
    end_work_s : time between two cuts, pauses lengthened to fill it; None: pauses of `pause_s`.
    """

    def leg(curve: Line | Crossing, start_m: float, end_m: float, start_s: float, cycle: int = 0) -> Leg:
        arc = ArcLength.between(curve, start_m, end_m)
        return Leg(arc, Trapezoid(arc.total_m, speed_m_s, accel_m_s2), start_s, cycle)

    legs: list[Leg] = []
    margin = (retreat_m - crossing_m) / 2
    time = static_s
    for i, line in enumerate(lines):
        start_m, end_m = (0.0, length_m) if i % 2 == 0 else (length_m, 0.0)
        away = -1 if end_m > start_m else 1
        cut = leg(line, start_m, end_m, time, cycle=i + 1)
        legs.append(cut)
        if i + 1 == len(lines):
            break
        turn_m = end_m + away * retreat_m
        oblique = leg(Crossing(line, lines[i + 1], end_m, away, margin, crossing_m), end_m, turn_m, 0.0)
        back = leg(lines[i + 1], turn_m, end_m, 0.0)
        moving = oblique.profile.duration_s + back.profile.duration_s
        pause = pause_s if end_work_s is None else max((end_work_s - moving) / 3, pause_s)
        for part in (oblique, back):
            legs.append(Leg(part.arc, part.profile, legs[-1].end_s + pause, 0))
        time = legs[-1].end_s + pause
    return Timeline(tuple(legs))
