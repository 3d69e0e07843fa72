"""Cutting cycles, face coordinate and closed-path points from odometer and events.

Source of the closed path: J. Zheng et al., Micromachines 12 (2021) 1527, section 2.2: points at a fixed interval
along the face, each advanced by the push from one cycle to the next.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from graphnav._schema import Array
from graphnav.errors import LogError
from graphnav.frontends.rest import odometer_rest
from graphnav.log import Odometer, SensorLog

#: A stretch in one direction counts as a cut when it covers this share of the face.
_CUT_SHARE = 0.7
#: From 99.8 % of a cut to the stop, and from the stop to 0.2 %, it takes no longer than this.
_STOPPING_S = 30.0


@dataclass(frozen=True)
class Cycle:
    """One full cut from end to end of the face.

    Attributes
    ----------
    number : counts from 1.
    start_s, end_s : span of the cut; `end_s` is None where the log ends within it.
    forward : True from the near to the far end.
    """

    number: int
    start_s: float
    end_s: float | None
    forward: bool


@dataclass(frozen=True)
class ClosedPathPoint:
    """One point of the face passed in two successive cycles.

    Attributes
    ----------
    s_m : face coordinate; first_s, second_s : times of the passes; cycle : number of the first one.
    push_m : advance expected between them, along the machine's right axis.
    at_end : at an end of the face, where the machine's stops and not the odometer say that it is the same point.
    """

    s_m: float
    first_s: float
    second_s: float
    cycle: int
    push_m: float
    at_end: bool


def mileage(odometer: Odometer) -> Array:
    """Signed distance covered since the first odometer sample (N,), m (trapezoidal)."""
    step = np.diff(odometer.t_s) * (odometer.speed_m_s[1:] + odometer.speed_m_s[:-1]) / 2
    return np.concatenate([[0.0], np.cumsum(step)])


def find_cycles(log: SensorLog) -> tuple[Cycle, ...]:
    """Cutting cycles from the log's events, or from the odometer where there are none.

    Without events a cut is a stretch between two reversals that covers at least 70 % of the face (of the longest such
    stretch, where the face length is unknown).

    Raises
    ------
    LogError : events that do not pair up.
    """
    if log.events is not None:
        return _from_events(log)
    if log.odometer is None or log.face is None:
        return ()
    return _from_odometer(log.odometer, log.face.length_m)


def _from_events(log: SensorLog) -> tuple[Cycle, ...]:
    events = log.events
    assert events is not None
    starts: dict[int, float] = {}
    ends: dict[int, float] = {}
    for row, (t, kind, number) in enumerate(zip(events.t_s, events.kind, events.cycle, strict=True)):
        group = starts if kind == "cut_start" else ends
        if int(number) in group:
            raise events.error(f"second {kind} of cycle {number}", row=row, column="kind")
        if kind == "cut_end" and int(number) not in starts:
            raise events.error(f"cut_end of cycle {number} without its cut_start", row=row, column="kind")
        group[int(number)] = float(t)
    return tuple(
        Cycle(number, start, ends.get(number), forward=number % 2 == 1) for number, start in sorted(starts.items())
    )


def _from_odometer(odometer: Odometer, length_m: float) -> tuple[Cycle, ...]:
    travelled = mileage(odometer)
    turns = _reversals(travelled, threshold=max(0.02 * length_m, 20 * odometer.sigma_m_s * 0.1))
    stops = odometer_rest(odometer)
    cycles: list[Cycle] = []
    for a, b in itertools.pairwise(turns):
        covered = travelled[b] - travelled[a]
        if abs(covered) < _CUT_SHARE * length_m:
            continue
        margin = 0.002 * length_m
        progress = np.abs(travelled[a : b + 1] - travelled[a])
        begin = a + int(np.flatnonzero(progress <= margin)[-1])
        finish = a + int(np.flatnonzero(progress >= abs(covered) - margin)[0])
        start_s, end_s = _at_stops(stops, float(odometer.t_s[begin]), float(odometer.t_s[finish]))
        # a cut that the end of the log breaks off has not reached the end of the face
        done = b < turns[-1] or abs(covered) > 0.97 * length_m
        cycles.append(Cycle(len(cycles) + 1, start_s, end_s if done else None, forward=bool(covered > 0)))
    return tuple(cycles)


def _at_stops(stops: Array, start_s: float, end_s: float) -> tuple[float, float]:
    """Start and end of a cut moved outwards to the stops next to them, where the machine stands at the end of the face.

    A surveyed end and the closed path are told of these times: a second before the stop is centimetres short of it.
    """
    before = stops[(stops[:, 0] <= start_s) & (stops[:, 1] > start_s - _STOPPING_S)]
    after = stops[(stops[:, 1] >= end_s) & (stops[:, 0] < end_s + _STOPPING_S)]
    start = min(start_s, float(before[-1, 1])) if len(before) else start_s
    return start, max(end_s, float(after[0, 0])) if len(after) else end_s


def _reversals(travelled: Array, threshold: float) -> list[int]:
    """Rows where the direction of travel changes by more than `threshold` metres, first and last row included."""
    turns, extreme, direction = [0], 0, 0
    for row in range(1, len(travelled)):
        gone = travelled[row] - travelled[extreme]
        if direction == 0:
            if abs(gone) > threshold:
                direction, extreme = int(np.sign(gone)), row
        elif gone * direction > 0:
            extreme = row
        elif -gone * direction > threshold:
            turns.append(extreme)
            direction, extreme = -direction, row
    turns.append(len(travelled) - 1)
    return turns


@dataclass(frozen=True)
class _Pass:
    cycle: Cycle
    t_s: Array
    s_m: Array

    def time_at(self, s_m: float) -> float:
        return float(
            np.interp(s_m, self.s_m, self.t_s) if self.s_m[-1] > self.s_m[0] else np.interp(-s_m, -self.s_m, self.t_s)
        )


def face_coordinates(log: SensorLog, cycles: tuple[Cycle, ...]) -> list[_Pass]:
    """Face coordinate over time in every cut, from the odometer.

    A complete cut runs from end to end, so its odometer distance is stretched to the face length: the unknown scale
    factor drops out, and the coordinate is right at both ends. A cut broken off by the end of the log takes the scale
    of the complete ones.
    """
    odometer, face = log.odometer, log.face
    if odometer is None or face is None:
        return []
    travelled = mileage(odometer)
    measured = [
        abs(float(np.interp(c.end_s, odometer.t_s, travelled) - np.interp(c.start_s, odometer.t_s, travelled)))
        for c in cycles
        if c.end_s is not None
    ]
    for cycle_length in measured:
        if not 0.7 < cycle_length / face.length_m < 1.3:
            raise LogError(
                f"a cut covers {cycle_length:.2f} m by odometer, the face is {face.length_m:.2f} m",
                where="[face]",
                column="length_m",
                fix="correct length_m, the events or the odometer's unit",
            )
    usual = float(np.median(measured)) if measured else face.length_m
    passes = []
    for cycle in cycles:
        end = cycle.end_s if cycle.end_s is not None else float(odometer.t_s[-1])
        inside = (odometer.t_s > cycle.start_s) & (odometer.t_s < end)
        t = np.concatenate([[cycle.start_s], odometer.t_s[inside], [end]])
        gone = np.abs(np.interp(t, odometer.t_s, travelled) - np.interp(cycle.start_s, odometer.t_s, travelled))
        share = gone / (gone[-1] if cycle.end_s is not None else usual)
        # noise at creeping speed must not make the coordinate turn back
        share = np.maximum.accumulate(share) + 1e-12 * np.arange(len(t))
        passes.append(_Pass(cycle, t, face.length_m * (share if cycle.forward else 1 - share)))
    return passes


def closed_path_points(
    log: SensorLog, cycles: tuple[Cycle, ...], interval_m: float | None = None
) -> tuple[ClosedPathPoint, ...]:
    """Points of the face passed in successive cycles, `interval_m` apart, in the order of their second pass.

    Parameters
    ----------
    log : with `[face]` and an odometer.
    cycles : from `find_cycles`.
    interval_m : spacing along the face; default `face.interval_m`. Ends of the face are included.
    """
    face = log.face
    if face is None:
        return ()
    interval = interval_m if interval_m is not None else face.interval_m
    passes = {p.cycle.number: p for p in face_coordinates(log, cycles)}
    grid = np.append(np.arange(0.0, face.length_m - interval / 2, interval), face.length_m)
    points = []
    for number, first in passes.items():
        second = passes.get(number + 1)
        if second is None:
            continue
        low = max(first.s_m.min(), second.s_m.min()) - 1e-6
        high = min(first.s_m.max(), second.s_m.max()) + 1e-6
        for s in grid[(grid >= low) & (grid <= high)]:
            push = push_at(log, number, float(s))
            at_end = s in (grid[0], grid[-1])
            points.append(
                ClosedPathPoint(float(s), first.time_at(float(s)), second.time_at(float(s)), number, push, at_end)
            )
    return tuple(sorted(points, key=lambda p: p.second_s))


def push_at(log: SensorLog, cycle: int, s_m: float) -> float:
    """Measured push at a face coordinate after a cycle, or the declared one where none was measured."""
    assert log.face is not None
    if log.push is not None:
        rows = np.flatnonzero(log.push.cycle == cycle)
        if len(rows):
            order = rows[np.argsort(log.push.s_m[rows])]
            s, push = log.push.s_m[order], log.push.push_m[order]
            if s[0] - log.face.interval_m <= s_m <= s[-1] + log.face.interval_m:
                return float(np.interp(s_m, s, push))
    return log.face.push_m
