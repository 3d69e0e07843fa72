"""Runs of filter and smoother on simulated shifts, and what the tests of the baselines do to logs."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
from engine_logs import simulated

from graphnav._metrics import attitude_error, truth_at
from graphnav._stages import Stages
from graphnav.baselines.inputs import Inputs
from graphnav.config import Config
from graphnav.filtered import as_inputs
from graphnav.log import SensorLog
from graphnav.run import Run
from graphnav.simulation.scenarios import ShearerSpec
from graphnav.smooth import posed, smooth

FILTERS = ("ekf", "rts", "rts-online")


def config(**sections) -> Config:
    return Config.from_dict(sections)


def faceless(log: SensorLog) -> SensorLog:
    """Without closed path; cuts and the surveyed end stay."""
    return dataclasses.replace(log, face=None)


def inputs_of(log: SensorLog, **sections) -> Inputs:
    """What the baselines take of a log."""
    return as_inputs(posed(log, config(**sections), Stages(None)))


@cache
def run_of(spec: ShearerSpec, seed: int, method: str) -> Run:
    """The default run of a simulated log without closed path; nothing changes a run, so tests may share it."""
    return smooth(faceless(simulated(spec, seed)), method=method)


def errors(run: Run, log: SensorLog) -> tuple[np.ndarray, np.ndarray]:
    """Attitude (rad, body) and position errors (N, 3) at the keyframes."""
    t = run.trajectory
    _, pos, quat = truth_at(log.truth, t.t_s)
    return attitude_error(t.quat_nb, quat), t.pos_n - pos
