"""The run folder: what is written is read back, whole or not at all; and the pictures of a run."""

from __future__ import annotations

import json
import math
import tomllib
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation

from graphnav.config import Config
from graphnav.errors import GraphnavError
from graphnav.evaluation import evaluate
from graphnav.log import Events, Frames, Position, SensorLog, SurveyedPoint, Truth
from graphnav.report import results
from graphnav.report.plots import plot_run
from graphnav.report.text import to_json
from graphnav.trajectory import Trajectory

COLUMNS = ["t_s", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz", "vx_m_s", "vy_m_s", "vz_m_s"]
COLUMNS += ["p_xx", "p_xy", "p_xz", "p_yy", "p_yz", "p_zz", "a_xx", "a_xy", "a_xz", "a_yy", "a_yz", "a_zz"]
SUMMARY = ["method", "converged", "iterations", "keyframes", "seconds", "peak_rss_mb"]
SUMMARY += ["calibration", "rejected", "warnings", "errors"]


@dataclass(frozen=True)
class MadeRun:
    trajectory: Trajectory
    calibration: dict[str, Any] = field(
        default_factory=lambda: {
            "odometer_scale": SimpleNamespace(value=np.float64(0.01), sigma=0.002, unit=""),
            "gyro_bias": SimpleNamespace(value=np.array([1e-3, 2e-3, 3e-3]), sigma=np.ones(3), unit="rad/s"),
        }
    )
    config: Config = field(default_factory=Config)
    diagnostics: Any = field(
        default_factory=lambda: SimpleNamespace(
            method="batch",
            converged=True,
            iterations=5,
            keyframes=40,
            seconds=dict.fromkeys(("read", "frontend", "assemble", "solve", "covariance", "total"), 0.5),
            peak_rss_mb=210.5,
            rejected={"odometer": np.int64(3)},
            nis=None,
            warnings=("one hole of 0.7 s in imu",),
        )
    )


def made_trajectory(count: int = 40, with_cov: bool = True) -> Trajectory:
    rng = np.random.default_rng(3)
    root = rng.normal(size=(count, 9, 9)) * 0.1
    return Trajectory(
        t_s=np.arange(count) * 1.1 + 1e9 / 7,  # no finite decimal: rounding would show
        pos_n=rng.normal(size=(count, 3)) / 3,
        quat_nb=Rotation.random(count, rng=rng).as_quat(scalar_first=True),
        vel_n=rng.normal(size=(count, 3)),
        cov=root @ root.transpose(0, 2, 1) if with_cov else None,
    )


def made_log(trajectory: Trajectory, truth: bool = True) -> SensorLog:
    t = trajectory.t_s
    return SensorLog(
        name="made",
        frames=Frames(latitude_deg=35.0),
        position=Position(t_s=t[::4], pos_n_m=trajectory.pos_n[::4], sigma_n_m=np.full((len(t[::4]), 3), 0.1)),
        events=Events(t_s=[t[3], t[20]], kind=["cut_start", "cut_end"], cycle=[1, 1]),
        surveyed=(SurveyedPoint(pos_n_m=[0.0, 0.0, 0.0], sigma_m=0.02, t_s=float(t[5])),),
        truth=Truth(t_s=t, pos_n_m=trajectory.pos_n + 0.05, quat_nb=trajectory.quat_nb) if truth else None,
    )


def test_run_folder_holds_what_the_interface_says(tmp_path: Path) -> None:
    trajectory = made_trajectory()
    evaluation = evaluate(trajectory, made_log(trajectory))
    folder = results.save(MadeRun(trajectory), tmp_path / "deep" / "run", evaluation=evaluation)
    assert sorted(item.name for item in folder.iterdir()) == sorted(results.FILES)
    names = pq.read_table(folder / "trajectory.parquet").column_names
    assert names == [*COLUMNS, "v_xx", "v_xy", "v_xz", "v_yy", "v_yz", "v_zz"]
    assert Config.from_toml(folder / "config.toml") == Config()
    assert tomllib.loads((folder / "config.toml").read_text())["batch"]["max_iterations"] == 25
    summary = json.loads((folder / "summary.json").read_text())
    assert list(summary) == SUMMARY
    assert set(summary["seconds"]) == {"read", "frontend", "assemble", "solve", "covariance", "total"}
    assert summary["calibration"]["odometer_scale"] == {"value": 0.01, "sigma": 0.002, "unit": ""}
    assert summary["calibration"]["gyro_bias"]["value"] == [1e-3, 2e-3, 3e-3]
    assert summary["rejected"] == {"odometer": 3}
    assert summary["errors"] == json.loads(to_json(evaluation.to_dict()))
    assert list(tmp_path.iterdir()) == [tmp_path / "deep"]  # no drafts left
    assert list((tmp_path / "deep").iterdir()) == [folder]


def test_trajectory_comes_back_number_for_number(tmp_path: Path) -> None:
    trajectory = made_trajectory()
    back = results.load(results.save(MadeRun(trajectory), tmp_path / "run"))
    for name in ("t_s", "pos_n", "quat_nb", "vel_n"):
        np.testing.assert_array_equal(getattr(back, name), getattr(trajectory, name))
    known = np.zeros((9, 9), bool)
    for block in (slice(0, 3), slice(3, 6), slice(6, 9)):
        known[block, block] = True
    upper = np.triu(known)
    np.testing.assert_array_equal(back.cov[:, upper], trajectory.cov[:, upper])
    np.testing.assert_array_equal(back.cov[:, known], back.cov.transpose(0, 2, 1)[:, known])
    assert np.isnan(back.cov[:, ~known]).all()


def test_position_covariance_is_in_the_p_columns(tmp_path: Path) -> None:
    trajectory = made_trajectory()
    table = pq.read_table(results.save(MadeRun(trajectory), tmp_path / "run") / "trajectory.parquet")
    np.testing.assert_array_equal(table["p_xz"].to_numpy(), trajectory.cov[:, 3, 5])
    np.testing.assert_array_equal(table["a_yz"].to_numpy(), trajectory.cov[:, 1, 2])
    np.testing.assert_array_equal(table["v_yy"].to_numpy(), trajectory.cov[:, 7, 7])


def test_run_without_covariances(tmp_path: Path) -> None:
    folder = results.save(MadeRun(made_trajectory(with_cov=False)), tmp_path / "run")
    table = pq.read_table(folder / "trajectory.parquet")
    assert table.column_names[:23] == COLUMNS
    assert table["p_xx"].null_count == 40
    assert results.load(folder).cov is None


def test_tum_file_has_full_precision_and_its_own_quaternion_order(tmp_path: Path) -> None:
    trajectory = made_trajectory()
    folder = results.save(MadeRun(trajectory), tmp_path / "run")
    rows = np.loadtxt(folder / "trajectory.tum")
    np.testing.assert_array_equal(rows[:, 0], trajectory.t_s)
    np.testing.assert_array_equal(rows[:, 1:4], trajectory.pos_n)
    np.testing.assert_array_equal(rows[:, [7, 4, 5, 6]], trajectory.quat_nb)


def test_a_run_is_replaced_and_other_folders_are_not(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    (folder).mkdir()
    results.save(MadeRun(made_trajectory(10)), folder)  # an empty folder
    results.save(MadeRun(made_trajectory(20)), folder)  # a run
    assert len(results.load(folder)) == 20
    (folder / "notes.txt").write_text("mine")
    with pytest.raises(GraphnavError, match=r"holds notes\.txt, which is no part of a run.*--overwrite"):
        results.save(MadeRun(made_trajectory(30)), folder)
    assert (folder / "notes.txt").read_text() == "mine" and len(results.load(folder)) == 20
    results.save(MadeRun(made_trajectory(30)), folder, overwrite=True)
    assert sorted(item.name for item in folder.iterdir()) == sorted(results.FILES)


def test_a_recorded_log_is_never_replaced(tmp_path: Path) -> None:
    (tmp_path / "log").mkdir()
    (tmp_path / "log" / "log.toml").write_text("")
    with pytest.raises(GraphnavError, match="is a log folder and is never replaced"):
        results.save(MadeRun(made_trajectory()), tmp_path / "log", overwrite=True)
    (tmp_path / "file").write_text("")
    with pytest.raises(GraphnavError, match="is a file; give a folder"):
        results.save(MadeRun(made_trajectory()), tmp_path / "file", overwrite=True)


def test_the_working_folder_is_never_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    for folder in (".", ".."):
        with pytest.raises(GraphnavError, match="is the working folder or holds it"):
            results.save(MadeRun(made_trajectory()), folder, overwrite=True)


@pytest.mark.parametrize("broken", ["_write_tum", "_summary", "_move_into_place"])
def test_a_failure_leaves_what_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, broken: str) -> None:
    results.save(MadeRun(made_trajectory(10)), tmp_path / "run")

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(results, broken, fail)
    for name in ("run", "new"):
        with pytest.raises(GraphnavError, match="No space left on device"):
            results.save(MadeRun(made_trajectory(20)), tmp_path / name)
    assert [item.name for item in tmp_path.iterdir()] == ["run"]
    assert len(results.load(tmp_path / "run")) == 10


def test_a_trajectory_that_is_not_finite_is_not_written(tmp_path: Path) -> None:
    trajectory = made_trajectory()
    pos = trajectory.pos_n.copy()
    pos[7, 1] = math.nan
    with pytest.raises(GraphnavError, match="is not finite; nothing was written"):
        results.save(MadeRun(replace(trajectory, pos_n=pos)), tmp_path / "run")
    assert list(tmp_path.iterdir()) == []


def test_errors_on_loading_name_file_row_and_column(tmp_path: Path) -> None:
    with pytest.raises(GraphnavError, match=r"no trajectory\.parquet; give a folder that `graphnav smooth` wrote"):
        results.load(tmp_path)
    (tmp_path / "log.toml").write_text("")
    with pytest.raises(GraphnavError, match="is a log: the run comes first, then the log"):
        results.load(tmp_path)
    folder = results.save(MadeRun(made_trajectory()), tmp_path / "run")
    path = folder / "trajectory.parquet"
    table = pq.read_table(path)
    pq.write_table(table.drop_columns(["qx"]), path)
    with pytest.raises(GraphnavError, match=r"trajectory\.parquet: no column qx"):
        results.load(folder)
    pq.write_table(table.take(list(range(39, -1, -1))), path)
    with pytest.raises(GraphnavError, match="row 2, t_s: time does not ascend"):
        results.load(folder)
    index = table.column_names.index("y_m")
    pq.write_table(table.set_column(index, "y_m", [[0.0, None] + [0.0] * 38]), path)
    with pytest.raises(GraphnavError, match="row 2, y_m: not a finite number"):
        results.load(folder)
    path.write_bytes(b"not parquet")
    with pytest.raises(GraphnavError, match="not a readable parquet file"):
        results.load(folder)


def test_json_is_strict() -> None:
    assert json.loads(to_json({"a": math.nan, "b": [np.float64(1.5), math.inf], "c": np.arange(2)})) == {
        "a": None,
        "b": [1.5, None],
        "c": [0, 1],
    }


@pytest.mark.parametrize("truth", [True, False])
@pytest.mark.parametrize("with_cov", [True, False])
def test_pictures_are_written_whole(tmp_path: Path, truth: bool, with_cov: bool) -> None:
    trajectory = made_trajectory(with_cov=with_cov)
    path = plot_run(trajectory, made_log(trajectory, truth), tmp_path / "sub" / "run.png")
    assert path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert list(path.parent.iterdir()) == [path]


def test_picture_of_withheld_positions_and_unknown_endings(tmp_path: Path) -> None:
    trajectory = made_trajectory()
    log = made_log(trajectory, truth=False)
    given, withheld = (
        log.position,
        log.position.replace(t_s=log.position.t_s + 2.0, pos_n_m=trajectory.pos_n[2::4]),
    )
    path = plot_run(trajectory, replace(log, position=given), tmp_path / "run.svg", withheld=withheld)
    text = path.read_text()
    assert text.startswith("<?xml") and "</svg>" in text
    with pytest.raises(GraphnavError, match=r"run\.bmp: a picture's name ends in \.png, \.pdf or \.svg"):
        plot_run(trajectory, log, tmp_path / "run.bmp")
