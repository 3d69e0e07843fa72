"""The log that a shearer's sensors record of a shift.

Each kind of draw has a random stream of its own, so the same seed gives the same world whatever is measured
in it, and a shorter log is the start of a longer one.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from graphnav.log import (
    Events,
    Face,
    Frames,
    Imu,
    Odometer,
    SensorLog,
    SurveyedPoint,
    Truth,
)
from graphnav.simulation import sensors as sense
from graphnav.simulation.carrier import carrier_ranger
from graphnav.simulation.imu import samples
from graphnav.simulation.naming import log_name
from graphnav.simulation.ranging import Ranger
from graphnav.simulation.scanner import Scanner
from graphnav.simulation.scenarios import ShearerSpec
from graphnav.simulation.world import Errors, Streams, World, build_world, draw_errors, streams

Array = npt.NDArray[np.float64]

_TRUTH_EVERY_SAMPLE_S = 3600.0  # longer logs carry truth at the odometer's rate


def simulate_shearer(
    scenario: str, spec: ShearerSpec, seed: int, *, noise: bool = True, options: Mapping[str, Any] | None = None
) -> SensorLog:
    """The log of a shearer scenario; without `noise` the sensors and the declared start are exact.

    `options` are those that `spec` was made with, for the name of the log.
    """
    of, on = streams(seed), 1.0 if noise else 0.0
    world = build_world(spec, of.geometry, of.machine)
    errors = draw_errors(spec, of.errors, on)
    scanner = None if spec.lidar is None else Scanner(world, spec.lidar, of, on)
    ranger = carrier_ranger(world, of, on)
    imu, odometer, truth = _record(world, errors, of, on, scanner, ranger)
    face = "closed-path" in spec.sensors
    return SensorLog(
        name=log_name(scenario, options or {}, seed),
        frames=Frames(spec.latitude_deg, spec.longitude_deg, 0.0, spec.gravity_m_s2),
        initial=world.declared_start(errors.initial_att_rad, errors.initial_vel_m_s, errors.initial_pos_m),
        imu=imu,
        odometer=odometer,
        face=_face(spec) if face else None,
        surveyed=_surveyed(world, errors, by_end=face),
        events=_events(world),
        uwb=None if ranger is None else ranger.table(ranger.errors()),
        truth=truth,
        **({} if scanner is None else scanner.tables()),
    )


def _record(
    world: World, errors: Errors, of: Streams, on: float, scanner: Scanner | None, ranger: Ranger | None
) -> tuple[Imu, Odometer, Truth]:
    """All tables, block by block, and what scanner and ranger measure; white noise times `on`."""
    spec, count = world.spec, world.count
    every = spec.imu_rate_hz // spec.odometer_rate_hz
    truth_every = 1 if count <= _TRUTH_EVERY_SAMPLE_S * spec.imu_rate_hz else every
    biases = errors.gyro_bias_rad_s, errors.accel_bias_m_s2
    gyro_b, accel_b = np.empty((count, 3)), np.empty((count, 3))
    speeds: list[Array] = []
    rows: list[tuple[Array, Array, Array, Array]] = []
    for first, last in world.blocks():
        t_s, motion, rot_nm = world.states(first, last)
        rot_nb = world.body(rot_nm)
        gyro_b[first:last], accel_b[first:last] = samples(spec, motion, rot_nb, biases, of.imu, on)
        instants = np.arange(first, last + 1)
        new = (instants > first) | (first == 0)  # a block's first state is the last one of the block before
        speeds.append(sense.forward_speed(motion, rot_nm)[new & (instants % every == 0) & (instants > 0)])
        # the last keyframe is at the record's end, wherever the odometer's last sample is
        keep = new & ((instants % truth_every == 0) | (instants == count))
        quat = rot_nb[keep].as_quat(scalar_first=True)
        rows.append((t_s[keep], motion.pos_n[keep], quat, motion.vel_n[keep]))
        if scanner is not None:
            scans = new & (instants % scanner.every == 0) & (instants > 0)
            scanner.add(t_s[scans], motion.pos_n[scans], rot_nb[scans])
        if ranger is not None:
            ranger.add(t_s, motion, rot_nb)
    imu_t_s = np.arange(1, count + 1) / spec.imu_rate_hz
    speed = (1 + errors.odometer_scale) * np.concatenate(speeds)
    speed += on * spec.odometer_sigma_m_s * of.odometer.standard_normal(len(speed))
    return (
        Imu(imu_t_s, gyro_b, accel_b, **vars(spec.imu)),
        Odometer(
            imu_t_s[every - 1 :: every],
            speed,
            sigma_m_s=spec.odometer_sigma_m_s,
            slip_sigma_m_s=spec.slip_sigma_m_s,
            scale_sigma=spec.scale_sigma,
            mounting_sigma_deg=np.array(spec.mounting_sigma_deg),
        ),
        Truth(*(np.concatenate(part) for part in zip(*rows, strict=True))),
    )


def _face(spec: ShearerSpec) -> Face:
    return Face(
        length_m=spec.length_m,
        push_m=spec.push_m,
        push_sigma_m=spec.push_sigma_m,
        along_sigma_m=spec.along_sigma_m,
        creep_m=0.0,
        creep_sigma_m=spec.creep_sigma_m,
        interval_m=spec.interval_m,
    )


def _surveyed(world: World, errors: Errors, *, by_end: bool) -> tuple[SurveyedPoint, ...]:
    """The far end, if the machine gets there; by its time where no face is declared."""
    spec, arrival_s = world.spec, world.timeline.legs[0].end_s
    if arrival_s > world.count / spec.imu_rate_hz:
        return ()
    pos_n = world.timeline.at(np.array([arrival_s])).pos_n[0] + errors.survey_m
    place: dict[str, Any] = {"end": "far"} if by_end else {"t_s": arrival_s}
    return (SurveyedPoint(pos_n_m=pos_n, sigma_m=spec.survey_sigma_m, **place),)


def _events(world: World) -> Events:
    """Starts and ends of the full cuts within the log."""
    end_s = world.count / world.spec.imu_rate_hz
    rows = [
        (time, kind, leg.cycle)
        for leg in world.timeline.legs
        if leg.cycle
        for time, kind in ((leg.start_s, "cut_start"), (leg.end_s, "cut_end"))
        if time <= end_s
    ]
    t_s, kind, cycle = zip(*rows, strict=True)
    return Events(t_s=np.array(t_s), kind=list(kind), cycle=np.array(cycle))
