"""Raw scans smoothed: legs are found in them first, and what stands in the way is told."""

from __future__ import annotations

import dataclasses
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from graphnav.config import Config
from graphnav.evaluation import evaluate
from graphnav.log import SensorLog
from graphnav.run import Run
from graphnav.simulation.lidar_figures import LidarSpec
from graphnav.simulation.scenarios import LIDAR
from graphnav.simulation.shearer import simulate_shearer
from graphnav.smooth import smooth

#: One cut of 24 m, scanned throughout, every error drawn.
SPEC = replace(
    LIDAR, length_m=24.0, cycles=1, speed_m_s=0.3, static_s=20.0, tail_s=1.0, pause_s=3.0, retreat_m=6.0,
    crossing_m=4.0, end_work_s=None, duration_s=None, creep_m=(), att_error_deg=None, mounting_deg=None,
    lidar=LidarSpec(draw=True, scans=True),
)  # fmt: skip


@cache
def log() -> SensorLog:
    return simulate_shearer("scanned", SPEC, 0)


def scans_only(**changes: object) -> SensorLog:
    lidar = log().lidar.replace(**changes)
    return dataclasses.replace(log(), lidar_points=None, lidar=lidar, truth=None)


@cache
def run() -> Run:
    return smooth(scans_only())


def test_legs_are_found_and_used() -> None:
    """As good as with the simulator's own detections: sigmas within a tenth, errors within 4 of them (1e-4 each)."""
    assert not run().diagnostics.warnings
    given = smooth(dataclasses.replace(log(), truth=None))
    none = smooth(scans_only(), Config.from_dict({"lidar": {"use": False}}))
    mine, theirs, without = (np.sqrt(r.trajectory.cov[:, 4, 4]).mean() for r in (run(), given, none))
    assert mine < 1.1 * theirs
    assert mine < 0.9 * without
    error = evaluate(run().trajectory, log()).error_n_m
    sigma = np.sqrt(np.diagonal(run().trajectory.cov, axis1=1, axis2=2)[: len(error), 3:6])
    assert (np.abs(error) < 4 * sigma).all()


def test_a_wrong_spacing_is_told_and_changes_nothing() -> None:
    spoilt = smooth(scans_only(feature_spacing_m=3.0))
    assert any("feature_spacing_m is 3 m" in line for line in spoilt.diagnostics.warnings)
    apart = np.abs(spoilt.trajectory.pos_n - run().trajectory.pos_n)
    assert (apart < 0.5 * np.sqrt(np.diagonal(run().trajectory.cov, axis1=1, axis2=2)[:, 3:6])).all()


@pytest.mark.parametrize(
    ("changed", "config", "words"),
    [
        ({"leg_diameter_m": None}, {}, "declare lidar.leg_diameter_m"),
        ({}, {"side": "right"}, "no leg was found on the side"),
    ],
)
def test_scans_that_are_not_used_are_told(changed: dict[str, object], config: dict[str, str], words: str) -> None:
    found = smooth(scans_only(**changed), Config.from_dict({"lidar": config}))
    assert any(words in line for line in found.diagnostics.warnings)


def test_scans_without_a_scanner_are_told() -> None:
    bare = dataclasses.replace(log(), lidar_points=None, lidar=None, truth=None)
    assert any("section [lidar]" in line for line in smooth(bare).diagnostics.warnings)
