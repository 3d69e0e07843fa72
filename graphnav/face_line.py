"""The face's line at its stops: what is seen of the roadway there, and how far one stop lies along from another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from factors.increments import npt_int
from factors.so3 import Array
from graphnav.creep_rows import CreepRow
from graphnav.errors import LogError
from graphnav.frontends.registration import Expected, Sight, refined, register
from graphnav.frontends.roadway import Beams, placed, roadway_beams
from graphnav.log import Lidar, LidarScans
from graphnav.run import Stops
from graphnav.stops import POSE, moved

#: A rest this close (s) to the end of a cut is that of its stop, and its scans no farther off than this are used.
_NEXT_S, _STOP_S = 2.0, 30.0
#: Fewest scans of a stop: the sigma of a beam's mean is taken from their scatter.
_FEWEST_SCANS = 10
#: Step of the numerical derivatives, in sigmas of what they are by.
_STEP_SIGMAS = 0.1


@dataclass(frozen=True)
class Seen:
    """The roadway as seen from a stop; `row` is that of the stop among all."""

    row: int
    beams: Beams


@dataclass(frozen=True)
class FaceLine:
    """The estimated stops and the face's axis through two of them.

    Attributes
    ----------
    stops : with the scanner.
    near, far : rows of the stops at either end, between which the axis runs.
    lidar : the declared scanner.
    """

    stops: Stops
    near: int
    far: int
    lidar: Lidar

    def seen(self, row: int, scans: LidarScans, rest_s: Array, end: str) -> Seen:
        """The roadway beyond the end of the face ("near", "far"), from the stop in `row`.

        Raises
        ------
        LogError
            No rest or too few scans there, or no roadway seen.
        """
        rows = _scans_at(scans, rest_s, float(self.stops.t_s[row]))
        rot_fb = self._axes(self.stops).T @ self.stops.rot_nb[row]
        outwards = 1 if end == "far" else -1
        return Seen(row, roadway_beams(scans, rows, self.lidar, self.stops.scanner, rot_fb, outwards))

    def creep(self, cycle: int, first: Seen, second: Seen) -> CreepRow:
        """Creep from one stop to the next by both measurements, with their sigmas.

        Raises
        ------
        GraphnavError
            Too little of the wall is seen from both stops.
        """
        right, turn = self._right_sigma(first.row, second.row), self._turn_sigma(first.row, second.row)
        expected = Expected(self._step(self.stops, first, second), right, turn)
        matched = register(*self._sights(self.stops, first, second), expected)
        start = np.array([*matched.shift_m, matched.turn_rad])

        def both(stops: Stops) -> Array:
            step = self._step(stops, first, second)
            found = refined(*self._sights(stops, first, second), start, replace(expected, shift_m=step))
            return np.array([found.shift_m[1], step[1]])

        value, cov = both(self.stops), self._propagated(both, [first.row, second.row, self.near, self.far])
        sigma = np.sqrt(np.diag(cov) + np.array([matched.cov[1, 1], 0.0]))
        (icp_m, graph_m), (icp_sigma_m, graph_sigma_m) = value.tolist(), sigma.tolist()
        return CreepRow(cycle, icp_m, icp_sigma_m, graph_m, graph_sigma_m, matched.matched, matched.residual)

    def forward(self, stops: Stops) -> Array:
        """The face's axis in n ``(3,)``: level, from the near to the far end."""
        return level(stops.pos_n[self.far] - stops.pos_n[self.near])

    def _axes(self, stops: Stops) -> Array:
        """Right, forward and up of the face in n, ``(3, 3)``."""
        forward = self.forward(stops)
        return np.column_stack([[forward[1], -forward[0], 0.0], forward, [0.0, 0.0, 1.0]])

    def _step(self, stops: Stops, first: Seen, second: Seen) -> Array:
        """From one stop to the next, right and forward, by their smoothed positions."""
        return np.asarray(((stops.pos_n[second.row] - stops.pos_n[first.row]) @ self._axes(stops))[:2])

    def _sights(self, stops: Stops, first: Seen, second: Seen) -> tuple[Sight, Sight]:
        """What was seen from the two stops, each from its own place, in the axes of the face."""
        sight = []
        for seen in (first, second):
            rot_fb = self._axes(stops).T @ stops.rot_nb[seen.row]
            beams = seen.beams
            points = placed(beams.range_m, beams.angle_rad, self.lidar, stops.scanner, rot_fb)
            sight.append(Sight(points, beams.sigma_m))
        return sight[0], sight[1]

    def _right_sigma(self, first: int, second: int) -> float:
        """1-sigma of the way from one stop to another across the face, m."""
        right_n = self._axes(self.stops)[:, 0]
        return self._sigma(first, second, np.r_[np.zeros(3), right_n], np.r_[np.zeros(3), right_n])

    def _turn_sigma(self, first: int, second: int) -> float:
        """1-sigma of the heading of one stop against that of another, rad."""
        up_b = self.stops.rot_nb[:, 2]
        return self._sigma(first, second, np.r_[up_b[first], np.zeros(3)], np.r_[up_b[second], np.zeros(3)])

    def _sigma(self, first: int, second: int, of_first: Array, of_second: Array) -> float:
        """1-sigma of a difference of two stops, whose parts by their errors are `of_first` and `of_second` ``(6,)``."""
        by_error = np.zeros(len(self.stops.cov))
        by_error[POSE * first : POSE * (first + 1)] = -of_first
        by_error[POSE * second : POSE * (second + 1)] = of_second
        return float(np.sqrt(by_error @ self.stops.cov @ by_error))

    def _propagated(self, values: Callable[[Stops], Array], rows: list[int]) -> Array:
        """Covariance of some values that comes from the stops in `rows` and from the scanner, to first order."""
        poses = [POSE * row + k for row in sorted(set(rows)) for k in range(POSE)]
        used = [*poses, *range(POSE * len(self.stops.t_s), len(self.stops.cov))]
        cov = self.stops.cov[np.ix_(used, used)]
        columns = []
        for k, sigma in zip(used, np.sqrt(np.diag(cov)), strict=True):
            error = np.zeros(len(self.stops.cov))
            error[k] = _STEP_SIGMAS * sigma
            columns.append((values(moved(self.stops, error)) - values(moved(self.stops, -error))) / (2 * error[k]))
        by_errors = np.column_stack(columns)
        return np.asarray(by_errors @ cov @ by_errors.T)


def level(vector_n: Array) -> Array:
    """The level part of a vector, of length 1."""
    return np.asarray(np.array([vector_n[0], vector_n[1], 0.0]) / np.hypot(vector_n[0], vector_n[1]))


def _scans_at(scans: LidarScans, rest_s: Array, time_s: float) -> npt_int:
    """Rows of the scans taken at rest around a stop."""
    near = rest_s[(rest_s[:, 0] < time_s + _NEXT_S) & (rest_s[:, 1] > time_s - _NEXT_S)]
    here = np.abs(scans.t_s - time_s) < _STOP_S
    at_rest = ((scans.t_s[:, None] >= near[:, 0]) & (scans.t_s[:, None] <= near[:, 1])).any(axis=1)
    rows = np.flatnonzero(here & at_rest)
    if len(rows) < _FEWEST_SCANS:
        raise LogError(
            f"{len(rows)} scans at rest at the stop at {time_s:.1f} s, {_FEWEST_SCANS} are needed",
            where="lidar_scans",
            fix="record scans for some seconds where the machine stands at the end of the face",
        )
    return rows
