"""Lines of a longwall face: where the machine travels in each cutting cycle.

A line is a curve of the face coordinate ``u``: the distance along the face from the near end, measured on
the line of cycle 1. The line of the next cycle is the same conveyor after the push: every node of it has
moved by the push along the machine's right axis there, plus an error of its own to the right and up. A point
therefore keeps its coordinate ``u`` from line to line, and between nodes a C2 spline carries the conveyor,
which cannot kink.

A pushed line is slightly longer than the one before (its independent push errors make it wind: about 0.6 mm
per metre and cycle for 3 cm at nodes 2 m apart). Motion runs on true path length, so a machine that tells the
two lines' points by odometer matches them along the face only to within its own noise and that excess. This
is real and is the reason why no further error along the face is drawn.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicHermiteSpline, CubicSpline
from scipy.spatial.transform import Rotation

Array = npt.NDArray[np.float64]
Points = tuple[Array, Array, Array]

_ROLL_NODE_M = 10.0  # the floor's cross slope varies over about this distance
_ARC_STEP_M = 0.05  # Hermite interpolation of u over path length is then good to 1e-9 m
_GAUSS_X, _GAUSS_W = np.polynomial.legendre.leggauss(5)


class Curve(Protocol):
    """Anything the machine can follow."""

    def at(self, u_m: Array) -> Points:
        """Position in n ``(N,3)`` m, its derivative by `u_m` ``(N,3)`` and the roll ``(N,)`` rad."""
        ...


def attitude(slope_n: Array, roll_rad: Array) -> Rotation:
    """Attitude ``R_nm`` with its forward axis along `slope_n`.

    Yaw about up, then pitch about right, then roll about forward.
    """
    east, north, up = slope_n.T
    yaw = np.arctan2(-east, north)
    pitch = np.arctan2(up, np.hypot(east, north))
    return Rotation.from_euler("ZXY", np.column_stack([yaw, pitch, roll_rad]))


@dataclass(frozen=True)
class Line:
    """The conveyor line of one cutting cycle.

    Attributes
    ----------
    nodes_m : ``(K,)`` face coordinates of the nodes; the last is at or beyond the far end.
    pos_n : spline of the position, ``(N,3)`` m.
    roll : spline of the roll, ``(N,)`` rad.
    """

    nodes_m: Array
    pos_n: CubicSpline
    roll: CubicSpline

    def at(self, u_m: Array) -> Points:
        """See `Curve.at`."""
        return self.pos_n(u_m), self.pos_n(u_m, 1), self.roll(u_m)


@dataclass(frozen=True)
class Crossing:
    """The oblique cut: from one line over to the next, smoothly, while moving away from a face end.

    The lateral share follows a quintic smooth step, so position, attitude and rate join both lines
    without a jump.

    Attributes
    ----------
    before, after : lines to leave and to reach.
    end_m : face coordinate of the end.
    away : +1 or -1, sign of the travel away from that end.
    margin_m, length_m : straight travel before the step, and the step's length.
    """

    before: Line
    after: Line
    end_m: float
    away: int
    margin_m: float
    length_m: float

    def at(self, u_m: Array) -> Points:
        """See `Curve.at`."""
        x = np.clip((self.away * (u_m - self.end_m) - self.margin_m) / self.length_m, 0.0, 1.0)
        share = x**3 * (10 - 15 * x + 6 * x**2)
        rate = self.away * 30 * x**2 * (1 - x) ** 2 / self.length_m
        (p0, d0, roll0), (p1, d1, roll1) = self.before.at(u_m), self.after.at(u_m)
        w = share[:, None]
        pos = p0 + w * (p1 - p0)
        slope = d0 + w * (d1 - d0) + rate[:, None] * (p1 - p0)
        return pos, slope, roll0 + share * (roll1 - roll0)


def first_line(
    rng: np.random.Generator,
    *,
    length_m: float,
    interval_m: float,
    heading_rad: float,
    bend_m: float,
    undulation_m: float,
    wavelength_m: float,
    roll_sigma_rad: float,
) -> Line:
    """The line of cycle 1: it starts at the origin of n and has path length `length_m`.

    In plan it bends by `bend_m` at most from the straight line through its ends (three half waves with
    random weights); in height it follows the floor's undulation at a random phase.

    Parameters
    ----------
    heading_rad : general direction, from north towards west.
    interval_m : distance between nodes.
    """
    weights = rng.standard_normal(3) / np.arange(1, 4)
    phase = rng.uniform(0.0, 2 * np.pi)

    def local(x: Array) -> Array:
        """Right, forward, up of the general direction."""
        side = np.sin(np.pi * np.outer(x, np.arange(1, 4)) / length_m) @ weights
        height = undulation_m * (np.sin(2 * np.pi * x / wavelength_m + phase) - np.sin(phase))
        return np.column_stack([side, x, height])

    fine = np.linspace(0.0, length_m, 2001)
    weights *= bend_m / np.abs(local(fine)[:, 0]).max()
    nodes = interval_m * np.arange(np.ceil(length_m / interval_m - 1e-9) + 1)
    dense = np.linspace(0.0, 1.01 * nodes[-1], 20001)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(local(dense), axis=0), axis=1))])
    sin, cos = np.sin(heading_rad), np.cos(heading_rad)
    to_n = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    pos_n = local(np.interp(nodes, along, dense)) @ to_n.T
    return Line(nodes, _spline(nodes, pos_n), _roll(rng, nodes[-1], roll_sigma_rad))


def pushed_line(
    rng: np.random.Generator,
    line: Line,
    *,
    push_m: float,
    push_sigma_m: float,
    roll_sigma_rad: float,
    creep_m: float | None = None,
    forward_n: Array | None = None,
) -> Line:
    """The line of the next cycle: every node moved along the machine's right axis, with errors right and up.

    Parameters
    ----------
    push_m : advance per cycle.
    push_sigma_m : 1-sigma of each node's own error, to the right and up.
    creep_m : shift of the near end along `forward_n`, the general direction of the face. All nodes move along the
        machine's forward axis by the one length that gives it; None: no such move.
    """
    pos_n, slope, roll = line.at(line.nodes_m)
    move_m = np.zeros_like(pos_n)
    move_m[:, [0, 2]] = push_sigma_m * rng.standard_normal((len(pos_n), 2))
    move_m[:, 0] += push_m
    rot_nm = attitude(slope, roll)
    if creep_m is not None and forward_n is not None:
        towards_m = forward_n @ rot_nm[0].as_matrix()
        move_m[:, 1] = (creep_m - towards_m[[0, 2]] @ move_m[0, [0, 2]]) / towards_m[1]
    moved = pos_n + rot_nm.apply(move_m)
    return Line(line.nodes_m, _spline(line.nodes_m, moved), _roll(rng, line.nodes_m[-1], roll_sigma_rad))


def _spline(nodes_m: Array, values: Array) -> CubicSpline:
    # Natural ends: no bending moment where the conveyor ends, and no run-away of the last interval.
    return CubicSpline(nodes_m, values, bc_type="natural")


def _roll(rng: np.random.Generator, length_m: float, sigma_rad: float) -> CubicSpline:
    nodes = np.linspace(0.0, length_m, max(int(np.ceil(length_m / _ROLL_NODE_M)), 3) + 1)
    return _spline(nodes, sigma_rad * rng.standard_normal(len(nodes)))


@dataclass(frozen=True)
class ArcLength:
    """Path length along a stretch of a curve, and its inverse.

    Attributes
    ----------
    curve : what is followed.
    total_m : path length of the stretch, above zero.
    direction : +1 if ``u`` grows with the path length, else -1.
    u_of_s : spline of ``u`` over the path length from the stretch's start.
    """

    curve: Curve
    total_m: float
    direction: int
    u_of_s: CubicHermiteSpline

    @classmethod
    def between(cls, curve: Curve, start_m: float, end_m: float) -> ArcLength:
        """Measure `curve` from face coordinate `start_m` to `end_m`."""
        u = np.linspace(start_m, end_m, max(int(abs(end_m - start_m) / _ARC_STEP_M), 8) + 1)
        half = np.diff(u)[:, None] / 2
        points = (u[:-1, None] + half) + half * _GAUSS_X
        speed = np.linalg.norm(curve.at(points.ravel())[1], axis=1).reshape(points.shape)
        s = np.concatenate([[0.0], np.cumsum((np.abs(half) * speed) @ _GAUSS_W)])
        direction = 1 if end_m > start_m else -1
        inverse_slope = direction / np.linalg.norm(curve.at(u)[1], axis=1)
        return cls(curve, float(s[-1]), direction, CubicHermiteSpline(s, u, inverse_slope))

    def at(self, s_m: Array) -> tuple[Array, Array, Array]:
        """Position ``(N,3)``, unit vector of *growing u* ``(N,3)``, roll ``(N,)`` at path length `s_m`.

        The machine does not turn round, so that unit vector is its forward axis in both directions of travel.
        """
        pos, slope, roll = self.curve.at(self.u_of_s(np.clip(s_m, 0.0, self.total_m)))
        return pos, slope / np.linalg.norm(slope, axis=1)[:, None], roll
