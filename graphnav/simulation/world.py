"""The true world of a shearer's shift, and the errors made in observing it.

`World` holds what is so: the lines of the face, the motion, the mounting of the IMU, the wobble of the
machine. `Errors` holds what the sensors and the people at the start got wrong.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from graphnav.log import InitialState
from graphnav.simulation import sensors as sense
from graphnav.simulation.imu import draw_biases, draw_triple
from graphnav.simulation.machine_figures import MachineSpec
from graphnav.simulation.motion import Motion, Timeline, face_timeline
from graphnav.simulation.path import Line, first_line, pushed_line
from graphnav.simulation.scenarios import ShearerSpec

Array = npt.NDArray[np.float64]

_BLOCK = 65_536  # states worked on at a time: bounds the memory of a full shift


class Streams(NamedTuple):
    """One random stream for each kind of draw: new kinds come last, so that logs of before stay as they were."""

    geometry: np.random.Generator
    machine: np.random.Generator
    errors: np.random.Generator
    imu: np.random.Generator
    odometer: np.random.Generator
    supports: np.random.Generator
    lidar: np.random.Generator
    points: np.random.Generator
    roadways: np.random.Generator
    scans: np.random.Generator
    uwb: np.random.Generator
    tracks: np.random.Generator
    images: np.random.Generator


def streams(seed: int) -> Streams:
    """The random streams of a log."""
    return Streams(*np.random.default_rng(seed).spawn(len(Streams._fields)))


def image_seed(seed: int) -> np.random.SeedSequence:
    """The seed of what a log's images are made of: that of its stream `images`."""
    return np.random.SeedSequence(seed).spawn(len(Streams._fields))[Streams._fields.index("images")]


@dataclass(frozen=True)
class Errors:
    """Everything drawn once per log, in SI units; zero in an error-free log."""

    gyro_bias_rad_s: Array
    accel_bias_m_s2: Array
    odometer_scale: float
    initial_att_rad: Array
    initial_pos_m: Array
    initial_vel_m_s: Array
    survey_m: Array


@dataclass(frozen=True, kw_only=True)
class Machine:
    """A machine's true motion, a state for every IMU instant.

    Attributes
    ----------
    mounting_rad : angles alpha with ``v_m = Exp(alpha) v_b``.
    wobble_rad : ``(N+1, 2)`` pitch and crab at nominal speed, one row per IMU instant from 0 s on.
    """

    spec: MachineSpec
    timeline: Timeline
    mounting_rad: Array
    wobble_rad: Array

    @property
    def count(self) -> int:
        """Number of IMU samples."""
        return len(self.wobble_rad) - 1

    def blocks(self) -> Iterator[tuple[int, int]]:
        """First and last instants of the blocks that a shift is worked through in; neighbours share one."""
        for first in range(0, self.count, _BLOCK):
            yield first, min(first + _BLOCK, self.count)

    def states(self, first: int, last: int) -> tuple[Array, Motion, Rotation]:
        """Times (s), motion and machine attitude ``R_nm`` of instants `first` to `last`, both included."""
        t_s = np.arange(first, last + 1) / self.spec.imu_rate_hz
        motion = self.timeline.at(t_s)
        return t_s, motion, sense.wobbling(motion, self.wobble_rad[first : last + 1], self.spec.speed_m_s)

    def body(self, rot_nm: Rotation) -> Rotation:
        """Attitude ``R_nb`` of the IMU."""
        return rot_nm * Rotation.from_rotvec(self.mounting_rad)

    def declared_start(self, att_rad: Array, vel_m_s: Array, pos_m: Array | None = None) -> InitialState:
        """The start as the log declares it: the true one with these errors, the position unknown without one."""
        spec, (_, motion, rot_nm) = self.spec, self.states(0, 0)
        rot_nb = self.body(rot_nm) * Rotation.from_rotvec(att_rad)
        known = {} if pos_m is None else {"pos_n_m": motion.pos_n[0] + pos_m, "pos_sigma_m": [spec.pos_sigma_m] * 3}
        return InitialState(
            quat_nb_wxyz=rot_nb[0].as_quat(scalar_first=True),
            att_sigma_deg=np.array(spec.att_sigma_deg),
            vel_n_m_s=motion.vel_n[0] + vel_m_s,
            vel_sigma_m_s=np.full(3, spec.vel_sigma_m_s),
            static_until_s=spec.static_s,
            **known,
        )


@dataclass(frozen=True, kw_only=True)
class World(Machine):
    """What is true of a shearer's shift; `lines` are those of the face, one per cutting cycle."""

    spec: ShearerSpec
    lines: tuple[Line, ...]


def build_world(spec: ShearerSpec, geometry: np.random.Generator, machine: np.random.Generator) -> World:
    """Draw the face, the mounting and the wobble."""
    roll_sigma = np.deg2rad(spec.roll_sigma_deg)
    lines = [
        first_line(
            geometry,
            length_m=spec.length_m,
            interval_m=spec.interval_m,
            heading_rad=np.deg2rad(spec.heading_deg),
            bend_m=spec.bend_m,
            undulation_m=spec.undulation_m,
            wavelength_m=spec.wavelength_m,
            roll_sigma_rad=roll_sigma,
        )
    ]
    for push in range(spec.cycles - 1):
        lines.append(
            pushed_line(
                geometry,
                lines[-1],
                push_m=spec.push_m,
                push_sigma_m=spec.push_sigma_m,
                roll_sigma_rad=roll_sigma,
                creep_m=creep_of(spec, push),
                forward_n=face_frame(spec)[:, 1],
            )
        )
    timeline = face_timeline(
        lines,
        length_m=spec.length_m,
        speed_m_s=spec.speed_m_s,
        accel_m_s2=spec.accel_m_s2,
        static_s=spec.static_s,
        pause_s=spec.pause_s,
        retreat_m=spec.retreat_m,
        crossing_m=spec.crossing_m,
        end_work_s=spec.end_work_s,
    )
    duration_s = timeline.end_s + spec.tail_s if spec.duration_s is None else spec.duration_s
    count = round(duration_s * spec.imu_rate_hz)
    mounting = np.deg2rad(spec.mounting_sigma_deg) * machine.standard_normal(3)
    if spec.mounting_deg is not None:
        mounting = np.deg2rad(spec.mounting_deg)
    sigma_rad = spec.slip_sigma_m_s / spec.speed_m_s
    return World(
        spec=spec,
        lines=tuple(lines),
        timeline=timeline,
        mounting_rad=mounting,
        wobble_rad=sense.wobble(machine, count + 1, 1.0 / spec.imu_rate_hz, sigma_rad),
    )


def creep_of(spec: ShearerSpec, push: int) -> float | None:
    """Shift of the near end along the face (m) with push 0, 1, ...; None for none."""
    return spec.creep_m[push] if push < len(spec.creep_m) else None


def face_frame(spec: ShearerSpec) -> Array:
    """Level axes of the face (right: the way of the push, forward: towards the far end, up) in n, ``(3, 3)``."""
    sin, cos = np.sin(np.deg2rad(spec.heading_deg)), np.cos(np.deg2rad(spec.heading_deg))
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def draw_errors(spec: ShearerSpec, rng: np.random.Generator, on: float) -> Errors:
    """Draw with the sigmas that the log declares, times `on` (0: none); what the scenario fixes is drawn in vain."""
    gyro_bias, accel_bias = draw_biases(spec.imu, rng, on)
    drawn = Errors(
        gyro_bias_rad_s=gyro_bias,
        accel_bias_m_s2=accel_bias,
        odometer_scale=float(on * spec.scale_sigma * rng.standard_normal()),
        initial_att_rad=draw_triple(rng, np.deg2rad(spec.att_sigma_deg), on),
        initial_pos_m=draw_triple(rng, spec.pos_sigma_m, on),
        initial_vel_m_s=draw_triple(rng, spec.vel_sigma_m_s, on),
        survey_m=draw_triple(rng, spec.survey_sigma_m, on),
    )
    return drawn if spec.att_error_deg is None else replace(drawn, initial_att_rad=on * np.deg2rad(spec.att_error_deg))
