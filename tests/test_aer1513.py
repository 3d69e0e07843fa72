"""AER1513: the importer on hand-made files, on the recording, and what smoothing makes of it."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat
from test_importers import same

from benchmarks._planar import judge, repeated, residuals
from benchmarks._wheel_fit import best_corrections
from benchmarks.real_legs import smoothed
from factors import so3
from graphnav.errors import LogError
from graphnav.frontends.motion_chain import motion_chain
from graphnav.log import SensorLog
from graphnav.readers import aer1513, read, write
from graphnav.readers.aer1513 import AS_RECORDED, CORRECTIONS

Variables = dict[str, np.ndarray]


# Hand-made files --------------------------------------------------------------------------------------------


def line(count: int = 31) -> Variables:
    t = 0.1 * np.arange(count)[:, None]
    x = 1.0 + 0.2 * t
    return {
        "t": t, "v": np.full_like(t, 0.2), "r": 4.0 - x, "x_true": x, "l": np.array([[4.0]]),
        "v_var": np.array([[0.0025]]), "r_var": np.array([[0.0004]]),
    }  # fmt: skip


def floor(count: int = 31) -> Variables:
    """Northward past two tubes, the second of which is seen from row 10 on; the reference is lost in row 5."""
    t = 0.1 * np.arange(count)[:, None]
    y = 0.3 * t[:, 0]
    tubes = np.array([[1.0, 2.0], [-1.0, 4.0]])
    away = tubes[None] - np.stack([np.zeros(count), y + 0.2], axis=-1)[:, None]
    ranges = np.linalg.norm(away, axis=-1)
    ranges[:10, 1] = 0.0
    return {
        "t": t, "v": np.full_like(t, 0.3), "om": np.zeros_like(t), "r": ranges,
        "b": np.arctan2(away[..., 1], away[..., 0]) - np.pi / 2, "l": tubes, "d": np.array([[0.2]]),
        "x_true": np.zeros_like(t), "y_true": y[:, None], "th_true": np.full_like(t, np.pi / 2),
        "true_valid": (np.arange(count) != 5)[:, None].astype(np.uint8),
        "v_var": np.array([[0.0025]]), "om_var": np.array([[0.0016]]), "r_var": np.array([[0.0009]]),
        "b_var": np.array([[0.0004]]),
    }  # fmt: skip


def saved(folder: Path, variables: Variables, name: str) -> Path:
    savemat(folder / name, variables)
    return folder


def test_line_as_recorded(tmp_path: Path) -> None:
    log = aer1513.convert(saved(tmp_path, line(), "dataset1.mat"), dataset=1, corrections=AS_RECORDED)
    assert log.relative_pose is not None and log.lidar is not None and log.lidar_points is not None
    chain = motion_chain(log)
    np.testing.assert_allclose(chain.pos[-1], [0.0, 0.6, 0.0], atol=1e-12)
    np.testing.assert_allclose(np.sqrt(chain.cov[:, 4, 4]), 0.1 * 0.05)
    np.testing.assert_allclose(so3.from_quaternion(log.truth.quat_nb)[:, :2, 1], [[1.0, 0.0]] * 31, atol=1e-12)
    np.testing.assert_allclose(log.lidar_points.t_s, [0.0, 1.0, 2.0, 3.0])
    np.testing.assert_allclose(log.lidar_points.range_m, [3.0, 2.8, 2.6, 2.4])
    (mark,) = log.lidar.landmark
    np.testing.assert_array_equal(mark.pos_n_m, [4.0, 0.0, 0.0])
    run = smoothed(log)
    assert judge(run, log, axes=1).rms_m < 1e-3


def test_floor_as_recorded(tmp_path: Path) -> None:
    log = aer1513.convert(saved(tmp_path, floor(), "dataset2.mat"), corrections=AS_RECORDED, interval_s=0.1)
    points = log.lidar_points
    assert points is not None and log.lidar is not None
    assert len(points) == 31 + 21
    assert (points.feature[points.t_s < 0.95] == 1).all()
    assert len(log.truth) == 30 and 0.5 not in log.truth.t_s.round(3)
    np.testing.assert_array_equal(log.lidar.T_bs_pos_m, [0.0, 0.2, 0.0])
    assert log.lidar.range_sigma_m == pytest.approx(0.03)
    assert np.radians(log.lidar.angle_sigma_deg) == pytest.approx(0.02)
    assert log.lidar.range_bias_sigma_m is None
    run = smoothed(log)
    assert judge(run, log).rms_m < 1e-3
    assert np.abs(residuals(run, log)[2]).max() < 1e-3


def test_corrections(tmp_path: Path) -> None:
    log = aer1513.convert(saved(tmp_path, floor(), "dataset2_first_half.mat"), interval_s=0.1)
    known = CORRECTIONS[2]
    way = known.speed_scale * (0.3 - known.speed_at_rest_m_s) * 0.1
    turn = -known.turn_scale * known.turn_at_rest_rad_s * 0.1
    chain = motion_chain(log)
    np.testing.assert_allclose(so3.log(chain.rotation[1]), [0.0, 0.0, turn], atol=1e-12)
    direction = known.wheels_yaw_rad + turn / 2
    np.testing.assert_allclose(chain.pos[1], [-way * np.sin(direction), way * np.cos(direction), 0.0], atol=1e-9)
    assert log.lidar is not None and log.lidar_points is not None
    assert log.lidar_points.t_s[0] == pytest.approx(-known.laser_delay_s)
    assert log.lidar.range_bias_sigma_m is not None
    assert np.arctan2(*log.lidar.T_bs_pos_m[:2]) == pytest.approx(-known.wheels_yaw_rad)


def test_unknown_landmarks_and_thinned_scans(tmp_path: Path) -> None:
    log = aer1513.convert(saved(tmp_path, floor(), "dataset2.mat"), landmarks="unknown", interval_s=0.5)
    assert log.lidar is not None and log.lidar_points is not None
    assert log.lidar.landmark == ()
    assert (np.diff(np.unique(log.lidar_points.t_s)) > 0.49).all()


def without(name: str) -> Callable[[Variables], Variables]:
    return lambda variables: {key: value for key, value in variables.items() if key != name}


def put(name: str, value: object) -> Callable[[Variables], Variables]:
    return lambda variables: {**variables, name: np.asarray(value)}


def at(name: str, row: int, value: float) -> Callable[[Variables], Variables]:
    def change(variables: Variables) -> Variables:
        wrong = variables[name].astype(float)
        wrong[row] = value
        return {**variables, name: wrong}

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (without("om"), "om: missing variable; fetch it again"),
        (put("v", np.zeros((30, 1))), "v: 30 x 1 numbers, expected 31 x 1"),
        (put("r", np.zeros((31, 3))), "r: 31 x 3 numbers, expected 31 x 2"),
        (put("l", np.zeros((2, 3))), "l: 2 x 3 numbers, expected N x 2"),
        (put("d", "ahead"), "d: not numeric"),
        (at("v", 4, np.nan), "row 5, v: expected a finite number"),
        (at("t", 4, 0.3), "row 5, t: time does not ascend"),
        (put("t", np.zeros((1, 1))), "t: 1 rows, expected at least 2"),
        (put("b_var", [[0.0]]), "b_var: variance 0, expected above zero"),
    ],
)
def test_what_is_damaged_is_named(tmp_path: Path, change: Callable[[Variables], Variables], message: str) -> None:
    with pytest.raises(LogError) as error:
        aer1513.convert(saved(tmp_path, change(floor()), "dataset2.mat"))
    assert "dataset2.mat" in str(error.value)
    assert message in str(error.value)


def test_no_matlab_file(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"dataset1\.mat: no such file; pass the folder"):
        aer1513.convert(tmp_path, dataset=1)
    (tmp_path / "dataset1.mat").write_text("t, v\n")
    with pytest.raises(LogError, match=r"dataset1\.mat: not a MATLAB file"):
        aer1513.convert(tmp_path, dataset=1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"dataset": 4}, "dataset 4 of aer1513, expected 1, 2 or 3"),
        ({"landmarks": "some"}, 'landmarks "some", expected "known" or "unknown"'),
        ({"interval_s": 0.0}, "interval_s 0.0, expected a time above zero"),
    ],
)
def test_options_that_are_none(tmp_path: Path, options: dict[str, object], message: str) -> None:
    with pytest.raises(LogError, match=message):
        aer1513.convert(tmp_path, **options)


def test_a_source_is_needed() -> None:
    with pytest.raises(LogError, match="needs a source folder"):
        aer1513.convert(None)


# The recording ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def folder(data_dir: Path) -> Path:
    found = data_dir / "aer1513_utias"
    if not found.is_dir():
        pytest.skip(f"no recording at {found}")
    return found


@cache
def recorded(folder: Path, **options: object) -> SensorLog:
    return aer1513.convert(folder, **options)


@pytest.mark.data
def test_recording_is_whole(folder: Path) -> None:
    log = recorded(folder, interval_s=0.1)
    assert len(log.relative_pose) == 6303
    assert len(log.truth) == 6132
    assert len(log.lidar_points) == 31298
    assert len(log.lidar.landmark) == 17
    assert len(recorded(folder, dataset=1, interval_s=0.1).lidar_points) == 12709


@pytest.mark.data
@pytest.mark.parametrize("dataset", [1, 2])
def test_through_a_folder(folder: Path, tmp_path: Path, dataset: int) -> None:
    log = recorded(folder, dataset=dataset)
    write(log, tmp_path / "log")
    same(read(tmp_path / "log"), log)


@pytest.mark.data
@pytest.mark.parametrize(
    ("options", "rms_m", "nees"),
    [
        ({}, 0.02, (0.7, 1.6)),
        ({"landmarks": "unknown"}, 0.03, (0.02, 1.6)),
        # what the corrections spare: wheels and laser contradict each other
        ({"corrections": AS_RECORDED}, 0.06, (3.0, 10.0)),
    ],
)
def test_floor_with_laser(folder: Path, options: dict[str, object], rms_m: float, nees: tuple[float, float]) -> None:
    """Asked for is 0.06 m rms with known tubes; bounds about what docs/real-data.md states."""
    log = recorded(folder, **options)
    found = judge(smoothed(log), log)
    assert found.rms_m < rms_m
    assert nees[0] < found.nees < nees[1]


@pytest.mark.data
def test_floor_by_wheels_alone(folder: Path) -> None:
    log = recorded(folder)
    assert judge(smoothed(log, use_legs=False), log).rms_m < 1.5


@pytest.mark.data
def test_line_with_a_range_each_second(folder: Path) -> None:
    """Asked for is 0.03 m rms."""
    for options in ({}, {"corrections": AS_RECORDED}):
        log = recorded(folder, dataset=1, **options)
        found = judge(smoothed(log), log, axes=1)
        assert found.rms_m < (0.022 if options else 0.015)
        assert found.nees < 3.0


@pytest.mark.data
def test_scans_within_a_second_repeat_their_errors(folder: Path) -> None:
    """Why the importer takes one scan a second: without truth, from what the known tubes leave."""
    log = recorded(folder, interval_s=0.1)
    t_s, feature, left = residuals(smoothed(log), log)
    assert repeated(t_s, feature, left[:, 0], 0.1) > 0.7
    assert repeated(t_s, feature, left[:, 0], 5.0) < 0.1


@pytest.mark.data
def test_corrections_are_those_that_fit_wheels_and_laser_best(folder: Path) -> None:
    """Found again in the first 200 s within a sigma; truth has no part in it."""
    for name, (value, sigma) in best_corrections(folder).items():
        assert abs(value - getattr(CORRECTIONS[2], name)) < sigma, name
