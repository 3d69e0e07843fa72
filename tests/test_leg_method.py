"""`lidar-ekf` as a method: configuration, what it tells, refusals, `compare` and the command line."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from engine_logs import SHORT, simulated
from leg_logs import SMOOTH, beside_legs, blind

import graphnav.compare as compare_module
from graphnav.cli import main
from graphnav.compare import compare
from graphnav.config import Config
from graphnav.errors import ConfigError, LogError
from graphnav.evaluation import evaluate
from graphnav.leg_filtered import CORRECTION
from graphnav.readers import write
from graphnav.run import Run
from graphnav.smooth import smooth


@pytest.fixture(scope="module")
def run() -> Run:
    return smooth(blind(beside_legs()), method="lidar-ekf")


def config(**values: object) -> Config:
    return Config.from_dict({"lidar_filter": values})


# What it gives ----------------------------------------------------------------------------------------------


def test_it_follows_the_legs_without_odometer_rest_or_closed_path(run: Run) -> None:
    log = beside_legs()
    assert evaluate(run.trajectory, log).max_m.max() < 0.1
    without = smooth(dataclasses.replace(blind(log), odometer=None), method="lidar-ekf")
    assert without.trajectory.pos_n[-1] == pytest.approx(run.trajectory.pos_n[-1], abs=0.05)


def test_it_tells_what_it_chose_and_corrected(run: Run) -> None:
    (chosen,) = run.diagnostics.history
    assert chosen["mode"] in (2, 7)
    assert chosen["features"] == 1
    assert chosen["distance_m"] == 9.0
    arrival = chosen[f"arrival_right_m_mode_{chosen['mode']}"]
    estimate = run.calibration[CORRECTION]
    assert estimate.value == pytest.approx(np.degrees(arrival / SMOOTH.length_m))
    assert (estimate.sigma, estimate.unit) == (None, "deg")


def test_biases_are_its_calibration_and_the_odometer_is_not(run: Run) -> None:
    biases = {f"{sensor}_bias_{axis}" for sensor in ("gyro", "accel") for axis in "xyz"}
    assert run.calibration.keys() == biases | {CORRECTION}
    assert run.innovations.kinds == ("leg range", "leg bearing", "leg height")
    assert run.diagnostics.nis.keys() == {"all", *run.innovations.kinds}
    assert not [text for text in run.diagnostics.warnings if "does not use" in text]


def test_the_truth_does_not_count(run: Run) -> None:
    assert smooth(beside_legs(), method="lidar-ekf").trajectory.pos_n == pytest.approx(run.trajectory.pos_n, abs=0)


def test_scans_that_share_an_error_count_as_one(run: Run) -> None:
    """25 scans a second: with `independent_s` at zero they are white, and the position is taken for far surer."""
    chosen = {"mode": int(run.diagnostics.history[0]["mode"]), "distance_m": 9.0}
    shared, white = (
        smooth(blind(beside_legs()), config(**chosen, independent_s=s), "lidar-ekf").trajectory.cov[-1]
        for s in (1.0, 0.0)
    )
    assert np.sqrt(shared[4, 4] / white[4, 4]) > 1.5


# Refusals ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "values, text",
    [
        ({"mode": 10}, "lidar_filter.mode"),
        ({"features": 0}, "lidar_filter.features"),
        ({"distance_m": -1.0}, "lidar_filter.distance_m"),
        ({"leg": "cone"}, "lidar_filter.leg"),
        ({"picm": 1}, "lidar_filter.picm"),
        ({"feature": 2}, 'unknown key lidar_filter.feature; did you mean "features"'),
    ],
)
def test_wrong_configuration_is_refused(values: dict[str, object], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        config(**values)


def test_a_log_without_legs_or_scanner_is_refused() -> None:
    with pytest.raises(LogError, match="no lidar_points table; lidar-ekf needs detected legs"):
        smooth(blind(simulated(SHORT, 0)), method="lidar-ekf")
    with pytest.raises(LogError, match=r"no \[lidar\] section"):
        smooth(dataclasses.replace(blind(beside_legs()), lidar=None), method="lidar-ekf")


# compare and the command line -------------------------------------------------------------------------------


def test_compare_has_it_by_default_where_there_are_legs() -> None:
    assert all(row.converged for row in compare(beside_legs(), ["lidar-ekf", "ekf"]).rows)
    assert "lidar-ekf" in compare_module._every(beside_legs())
    assert "lidar-ekf" not in compare_module._every(simulated(SHORT, 0))
    (refused,) = compare(simulated(SHORT, 0), ["lidar-ekf"]).rows
    assert refused.error is not None and "lidar_points" in refused.error


def test_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(beside_legs(), tmp_path / "log")
    (tmp_path / "config.toml").write_text("[lidar_filter]\nmode = 7\n", encoding="utf-8")
    arguments = ["smooth", str(tmp_path / "log"), "-o", str(tmp_path / "run"), "--method", "lidar-ekf"]
    assert main([*arguments, "--config", str(tmp_path / "config.toml")]) == 0
    summary = json.loads((tmp_path / "run" / "summary.json").read_text(encoding="utf-8"))
    assert summary["method"] == "lidar-ekf"
    assert CORRECTION in summary["calibration"]
    assert "mode = 7" in (tmp_path / "run" / "config.toml").read_text(encoding="utf-8")
    write(simulated(SHORT, 0), tmp_path / "plain")
    capsys.readouterr()
    assert main(["smooth", str(tmp_path / "plain"), "-o", str(tmp_path / "none"), "--method", "lidar-ekf"]) != 0
    assert "no lidar_points table" in capsys.readouterr().err
    assert not (tmp_path / "none").exists()
