"""The log of a machine that drives past the UWB anchors at the face end.

The paper: Cao Bo, Wang Shibo, Ge Shirong, Lu Cheng, "Research on shearer positioning experiment based on IMU and UWB
at the end of underground coal mining working face", Coal Science and Technology 51 (2023) no. 6, 217-228: its sites,
its speed and the rates of its sensors. Noise and biases of the sensors are the scenario's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from graphnav.log import Frames, Imu, SensorLog, Truth
from graphnav.simulation import imu, ranging
from graphnav.simulation import sensors as sense
from graphnav.simulation.motion import Leg, Timeline, Trapezoid
from graphnav.simulation.naming import log_name
from graphnav.simulation.path import ArcLength, Points
from graphnav.simulation.uwb_figures import FaceEndSpec
from graphnav.simulation.world import Machine, Streams, streams

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Straight:
    """A level line along y of n; its face coordinate is y."""

    x_m: float
    z_m: float

    def at(self, u_m: Array) -> Points:
        """See `path.Curve.at`."""
        pos_n = np.column_stack([np.full(len(u_m), self.x_m), u_m, np.full(len(u_m), self.z_m)])
        return pos_n, np.tile([0.0, 1.0, 0.0], (len(u_m), 1)), np.zeros(len(u_m))


def build_machine(spec: FaceEndSpec, rng: np.random.Generator) -> Machine:
    """At rest, along the line without turning round, at rest again; `rng` draws the vibration."""
    line = Straight(spec.tag_x_m, spec.tag_z_m - spec.ranging.lever_arm_b_m[2])
    arc = ArcLength.between(line, spec.from_y_m, spec.to_y_m)
    leg = Leg(arc, Trapezoid(arc.total_m, spec.speed_m_s, spec.accel_m_s2), spec.static_s, cycle=0)
    count = round((leg.end_s + spec.tail_s) * spec.imu_rate_hz)
    vibration = sense.wobble(rng, count + 1, 1.0 / spec.imu_rate_hz, np.deg2rad(spec.vibration_deg))
    return Machine(spec=spec, timeline=Timeline((leg,)), mounting_rad=np.zeros(3), wobble_rad=vibration)


def face_end_ranger(spec: FaceEndSpec, of: Streams, on: float) -> ranging.Ranger:
    """The tag and its anchors, which a survey has put where the paper has them."""
    survey_rng, error_rng = of.uwb.spawn(2)
    return ranging.Ranger(spec.ranging, ranging.surveyed(spec.ranging, survey_rng, on), error_rng, on)


def simulate_face_end(
    scenario: str, spec: FaceEndSpec, seed: int, *, noise: bool = True, options: Mapping[str, Any] | None = None
) -> SensorLog:
    """The log of a face-end scenario; without `noise` sensors, anchors and declared start are exact.

    `options` are those that `spec` was made with, for the name of the log.
    """
    of, on = streams(seed), 1.0 if noise else 0.0
    machine = build_machine(spec, of.machine)
    biases = imu.draw_biases(spec.imu, of.errors, on)
    att_rad = imu.draw_triple(of.errors, np.deg2rad(spec.att_sigma_deg), on)
    vel_m_s = imu.draw_triple(of.errors, spec.vel_sigma_m_s, on)
    t_s, motion, rot_nm = machine.states(0, machine.count)
    rot_nb = machine.body(rot_nm)
    ranger = face_end_ranger(spec, of, on)
    ranger.add(t_s, motion, rot_nb)
    return SensorLog(
        name=log_name(scenario, options or {}, seed),
        frames=Frames(spec.latitude_deg, spec.longitude_deg, 0.0, spec.gravity_m_s2),
        initial=machine.declared_start(att_rad, vel_m_s),
        imu=Imu(t_s[1:], *imu.samples(spec, motion, rot_nb, biases, of.imu, on), **vars(spec.imu)),
        uwb=ranger.table(ranger.errors()),
        truth=Truth(t_s, motion.pos_n, rot_nb.as_quat(scalar_first=True), motion.vel_n),
    )
