"""Recorded drives and flights through the whole engine.

The KITTI-derived drive comes with GTSAM, so its tests always run; the others need the recorded data.
"""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from graphnav._metrics import truth_at
from graphnav.evaluation import evaluate, withheld_error
from graphnav.log import Position, SensorLog
from graphnav.readers import euroc, kitti_gtsam
from graphnav.run import Run
from graphnav.smooth import smooth

# KITTI ------------------------------------------------------------------------------------------------------


@cache
def drive() -> SensorLog:
    return kitti_gtsam.convert(None)


@cache
def kept_and_withheld(gap_s: float | None = None) -> tuple[SensorLog, Position]:
    return kitti_gtsam.split(drive(), gap_s=gap_s) if gap_s else kitti_gtsam.split(drive())


@pytest.mark.parametrize("method", ["batch", "isam2"])
def test_kitti_every_other_position_withheld(method: str) -> None:
    """470 s, 3.7 km by car, fixes 2 s apart: asked for is 0.5 m, the fixes are good to 0.07 m per axis."""
    log, withheld = kept_and_withheld()
    run = smooth(log, method=method)
    found = withheld_error(run.trajectory, withheld)
    assert found.count > 200
    assert found.rms_3d_m < 0.2
    assert max(found.max_m) < 0.5
    assert found.nees_position is not None
    assert 0.4 < found.nees_position < 2.0
    # the eight stretches that were filled in are told as holes
    assert any("holes in the IMU record were bridged" in warning for warning in run.diagnostics.warnings)


@pytest.mark.parametrize(("gap_s", "rms_m"), [(10.0, 0.5), (30.0, 3.0), (60.0, 4.0)])
def test_kitti_with_gaps_between_the_positions(gap_s: float, rms_m: float) -> None:
    """A car without odometer carried by its IMU alone, as long again as it had positions before."""
    log, withheld = kept_and_withheld(gap_s)
    found = withheld_error(smooth(log).trajectory, withheld)
    assert found.rms_3d_m < rms_m
    assert found.nees_position is not None
    assert found.nees_position < 5.0


def test_kitti_biases_are_those_of_a_real_unit() -> None:
    """Within the declared turn-on sigmas, and known better than they were declared."""
    log, _ = kept_and_withheld()
    found = smooth(log).calibration
    assert log.imu is not None
    for axis in "xyz":
        gyro, accel = found[f"gyro_bias_{axis}"], found[f"accel_bias_{axis}"]
        assert abs(gyro.value) < 3 * log.imu.gyro_bias_deg_h
        assert abs(accel.value) < 3 * log.imu.accel_bias_mg
        assert gyro.sigma is not None
        assert accel.sigma is not None
        assert gyro.sigma < 0.5 * log.imu.gyro_bias_deg_h
        assert accel.sigma < 0.5 * log.imu.accel_bias_mg


# EuRoC ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def flight_folder(data_dir: Path) -> Path:
    folder = data_dir / "euroc_v1_01_easy"
    if not folder.is_dir():
        pytest.skip(f"no recorded data: {folder} is no folder")
    return folder


def rms_between(run: Run, log: SensorLog) -> float:
    """Position error (norm) at ten times a second, keyframes or not."""
    assert log.truth is not None
    t = np.arange(run.trajectory.t_s[0] + 0.1, run.trajectory.t_s[-1] - 0.1, 0.1)
    known, pos, _ = truth_at(log.truth, t)
    error = run.trajectory.at(t[known]).pos_n - pos
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))


@pytest.mark.data
@pytest.mark.parametrize("method", ["batch", "isam2"])
def test_euroc_with_a_position_each_second(flight_folder: Path, method: str) -> None:
    """A drone between positions of 1 cm: asked for is 0.05 m."""
    log = euroc.convert(flight_folder)
    run = smooth(log, method=method)
    assert np.linalg.norm(evaluate(run.trajectory, log).rms_m) < 0.02
    assert rms_between(run, log) < 0.02


@pytest.mark.data
def test_euroc_with_a_position_each_five_seconds(flight_folder: Path) -> None:
    log = euroc.convert(flight_folder, position_rate_hz=0.2)
    run = smooth(log)
    found = evaluate(run.trajectory, log)
    assert np.linalg.norm(found.rms_m) < 0.05
    assert rms_between(run, log) < 0.06
    assert found.nees_position is not None
    assert found.nees_position < 2.0
    # roll and pitch to a few tenths of a degree; heading was declared to 5 deg
    assert (found.rms_deg < [0.5, 0.5, 2.0]).all()


@pytest.mark.data
def test_euroc_truth_plays_no_part(flight_folder: Path) -> None:
    log = euroc.convert(flight_folder)
    with_truth, without = smooth(log), smooth(dataclasses.replace(log, truth=None))
    assert np.array_equal(with_truth.trajectory.pos_n, without.trajectory.pos_n)
    assert np.array_equal(with_truth.trajectory.cov, without.trajectory.cov)
