"""KITTI's excerpt: what its reference is worth, and what the graph makes of its images alone."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import graphnav as gn
from benchmarks._drifts import SEGMENTS_M, poses, step_spread
from factors import so3
from graphnav._drift import kitti_drift
from graphnav.log import SensorLog
from graphnav.readers import kitti_stereo


@pytest.fixture(scope="module")
def log(data_dir: Path) -> SensorLog:
    source = data_dir / "kitti_stereo"
    if not source.is_dir():
        pytest.skip(f"no recorded data: {source} is no folder")
    return kitti_stereo.convert(source)


@pytest.mark.data
def test_the_reference_begins_with_a_filled_gap(log: SensorLog) -> None:
    """Its first eleven turns are one and the same to a thousandth of a degree; no two later ones are within ten."""
    spread = step_spread(log)
    first = kitti_stereo.MEASURED_FROM - 1
    assert spread[:first].max() < 1e-3
    assert spread[first + 1 :].min() > 5e-3 and np.median(spread[first:]) > 0.03


@pytest.mark.data
@pytest.mark.slow
def test_drift_of_the_images_alone(log: SensorLog) -> None:
    """Measured 0.60 % and 0.0136 deg/m (aim 1.5 % and 0.01 deg/m: not met); past the gap 0.51 % and 0.0054 deg/m.

    What turns the whole of it by is the filled gap's, so that there is no bound on it but on what is past it. The
    tracks tell that disparities are too small, by 0.15 px.
    """
    run = gn.smooth(dataclasses.replace(log, truth=None))
    rotation, pos = poses(run, log.truth.t_s)
    true_rotation = so3.from_quaternion(log.truth.quat_nb)

    def drift(first: int) -> tuple[float, float]:
        found = kitti_drift(
            (rotation[first:], pos[first:]), (true_rotation[first:], log.truth.pos_n_m[first:]), SEGMENTS_M
        )
        return found.translation_percent, found.rotation_deg_m

    assert drift(0)[0] < 1.0
    assert (np.array(drift(kitti_stereo.MEASURED_FROM)) < [1.0, 0.0075]).all()
    disparity = run.calibration["camera_disparity"]
    assert disparity.value < -2 * disparity.sigma


@pytest.mark.data
@pytest.mark.slow
def test_a_pair_wrongly_declared_as_exact_is_told(log: SensorLog) -> None:
    """By the 0.15 px that it finds where they are an unknown: the prior of what finding features adds is taken out."""
    exact = dataclasses.replace(log, truth=None, stereo=log.stereo.replace(disparity_sigma_px=0.0))
    warnings = gn.smooth(exact).diagnostics.warnings
    assert any(line.startswith("all disparities seem to be 0.1") and "px too small" in line for line in warnings)
    assert not gn.smooth(dataclasses.replace(log, truth=None)).diagnostics.warnings
