"""How the roadheader moves: along the roadway with two turns out and back, over an uneven floor, shaking."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicHermiteSpline, CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from graphnav.simulation import sensors as sense
from graphnav.simulation.motion import Leg, Motion, Timeline, Trapezoid
from graphnav.simulation.path import ArcLength, Line
from graphnav.simulation.roadheader_figures import RoadheaderSpec
from graphnav.simulation.world import Machine

Array = npt.NDArray[np.float64]

_NODE_M = 0.1
_ROLL_NODE_M = 3.0


@dataclass(frozen=True, kw_only=True)
class Roadheader(Machine):
    """`wobble_rad` has three columns: angles about right, forward and up while travelling."""

    spec: RoadheaderSpec

    def states(self, first: int, last: int) -> tuple[Array, Motion, Rotation]:
        """See `Machine.states`."""
        t_s = np.arange(first, last + 1) / self.spec.imu_rate_hz
        motion = self.timeline.at(t_s)
        share = sense.moving_share(motion, self.spec.speed_m_s)
        shaking = Rotation.from_rotvec(share[:, None] * self.wobble_rad[first : last + 1])
        return t_s, motion, motion.rot_nm * shaking

    def poses(self, t_s: Array) -> tuple[Array, Rotation]:
        """Body positions ``(N,3)`` and attitudes ``R_nb`` at any times, between IMU instants too.

        Between them the IMU turns at a constant rate, as its sample has it, and moves along a cubic.
        """
        grid, motion, rot_nb = self.states(0, self.count)
        pos_n: Array = CubicHermiteSpline(grid, motion.pos_n, motion.vel_n)(t_s)
        return pos_n, Slerp(grid, rot_nb)(t_s)


def build_roadheader(spec: RoadheaderSpec, geometry: np.random.Generator, shaking: np.random.Generator) -> Roadheader:
    """At rest, along the roadway, at rest again; the streams draw the floor and the vibration."""
    arc = ArcLength.between(track(spec, geometry), 0.0, spec.length_m)
    leg = Leg(arc, Trapezoid(arc.total_m, spec.speed_m_s, spec.accel_m_s2), spec.static_s, cycle=0)
    count = round((leg.end_s + spec.tail_s) * spec.imu_rate_hz)
    pairs = [sense.wobble(rng, count + 1, 1.0 / spec.imu_rate_hz, 1.0) for rng in shaking.spawn(2)]
    vibration = np.column_stack(pairs)[:, :3] * spec.vibration_rad
    return Roadheader(spec=spec, timeline=Timeline((leg,)), mounting_rad=np.zeros(3), wobble_rad=vibration)


def track(spec: RoadheaderSpec, rng: np.random.Generator) -> Line:
    """The way of the machine's origin over the floor, by level distance travelled; it starts at the origin of n."""
    nodes = np.arange(0.0, spec.length_m + 1.5 * _NODE_M, _NODE_M)
    fine = np.linspace(0.0, nodes[-1], 50 * len(nodes))
    yaw = _yaw(spec, fine)
    level = np.column_stack([-np.sin(yaw), np.cos(yaw)])
    steps = np.diff(fine)[:, None] * (level[1:] + level[:-1]) / 2
    plan = np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])
    phases = rng.uniform(0.0, 2 * np.pi, 3)
    waves = np.sin(2 * np.pi * np.divide.outer(nodes, spec.wavelengths_m) + phases) - np.sin(phases)
    height = spec.undulation_m * waves.sum(axis=1)
    pos_n = np.column_stack([*(np.interp(nodes, fine, axis) for axis in plan.T), height])
    roll_nodes = np.arange(0.0, nodes[-1] + _ROLL_NODE_M, _ROLL_NODE_M)
    roll = np.deg2rad(spec.roll_deg) * rng.standard_normal(len(roll_nodes))
    return Line(nodes, CubicSpline(nodes, pos_n), CubicSpline(roll_nodes, roll))


def _yaw(spec: RoadheaderSpec, along_m: Array) -> Array:
    """Heading (rad, to the left) at level distances: out to `turn_deg` and back, to the left, then to the right."""
    yaw = np.zeros_like(along_m)
    for side, start_s in zip((1.0, -1.0), spec.turns_s, strict=True):
        begin_m = spec.speed_m_s * (start_s - spec.speed_m_s / spec.accel_m_s2 / 2)
        turn_m, hold_m = spec.speed_m_s * spec.turning_s, spec.speed_m_s * spec.turned_s
        out = _smooth_step((along_m - begin_m) / turn_m)
        back = _smooth_step((along_m - begin_m - turn_m - hold_m) / turn_m)
        yaw += side * np.deg2rad(spec.turn_deg) * (out - back)
    return yaw


def _smooth_step(x: Array) -> Array:
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (10 - 15 * x + 6 * x**2)
