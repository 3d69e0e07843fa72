"""Simulated shifts for tests of the engine, made once per session, and ways to damage them."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np

from graphnav.log import Imu, SensorLog
from graphnav.run import Run
from graphnav.simulation.scenarios import MEMS, ShearerSpec
from graphnav.simulation.shearer import simulate_shearer
from graphnav.simulation.world import Errors, World, build_world, draw_errors
from graphnav.smooth import smooth

#: One cut of 8 m with the errors of shearer-mems, after 30 s at rest: a minute, smoothed in a moment.
SHORT = dataclasses.replace(MEMS, length_m=8.0, cycles=1, static_s=30.0, tail_s=5.0)
#: Two cuts of 20 m with an oblique cut between them: everything that shearer-mems has, in 5 minutes.
TWO_CUTS = dataclasses.replace(MEMS, length_m=20.0, cycles=2, static_s=30.0, tail_s=5.0, retreat_m=8.0, crossing_m=6.0)


@cache
def simulated(spec: ShearerSpec = MEMS, seed: int = 0, noise: bool = True) -> SensorLog:
    return simulate_shearer("engine", spec, seed, noise=noise)


@cache
def world(spec: ShearerSpec = MEMS, seed: int = 0) -> World:
    """What is true in `simulated` with the same arguments."""
    streams = np.random.default_rng(seed).spawn(5)
    return build_world(spec, streams[0], streams[1])


@cache
def drawn(spec: ShearerSpec = MEMS, seed: int = 0) -> Errors:
    """The errors made in `simulated` with the same arguments."""
    return draw_errors(spec, np.random.default_rng(seed).spawn(5)[2], 1.0)


@cache
def smoothed(spec: ShearerSpec = MEMS, seed: int = 0, method: str = "batch") -> Run:
    """The default smoothing of `simulated`; nothing changes a run, so tests may share it."""
    return smooth(simulated(spec, seed), method=method)


def rows(record, keep):
    """A record with some of its rows."""
    columns = {f.name: getattr(record, f.name) for f in record.column_fields()}
    return record.replace(**{name: value[keep] for name, value in columns.items() if value is not None})


def until(log: SensorLog, end_s: float) -> SensorLog:
    """The log as if recording had stopped at `end_s`."""
    changes = {name: rows(record, record.t_s <= end_s + 1e-9) for name, record in log.tables().items()}
    return dataclasses.replace(log, **changes)


def without_imu(log: SensorLog, start_s: float, end_s: float) -> SensorLog:
    """The log with a hole in its IMU record: no row in (start_s, end_s]."""
    assert log.imu is not None
    keep = (log.imu.t_s <= start_s + 1e-9) | (log.imu.t_s > end_s + 1e-9)
    return dataclasses.replace(log, imu=rows(log.imu, keep))


def imu_of(t_s: np.ndarray, gyro: np.ndarray | None = None, accel: np.ndarray | None = None) -> Imu:
    """An IMU record with the declared errors of shearer-mems; at rest on a level floor where nothing is given."""
    count = len(t_s)
    return Imu(
        t_s=t_s,
        gyro_b_rad_s=np.zeros((count, 3)) if gyro is None else gyro,
        accel_b_m_s2=np.tile([0, 0, 9.8], (count, 1)) if accel is None else accel,
        **vars(MEMS.imu),
    )
