"""What `graphnav info` tells of a log."""

from __future__ import annotations

import dataclasses
import io
import json

import numpy as np
import pytest
from machine_logs import machine
from rich.console import Console
from sample_logs import every_sensor_log, small_log

from graphnav import log as gl
from graphnav.report.info import describe, render


def text(info, width=200):
    console = Console(file=io.StringIO(), width=width)
    render(info, console)
    return console.file.getvalue()


def test_everything_in_it_is_json_and_comes_back_equal():
    info = describe(every_sensor_log())
    assert json.loads(json.dumps(info, allow_nan=False)) == info


def test_spans_rates_and_rows():
    info = describe(machine(100, (40, 90, 0.3), static_until_s=30.0))
    assert info["name"] == "machine"
    assert info["epoch"] is None
    assert (info["start_s"], info["end_s"]) == (0.01, 100.0)
    assert info["duration_s"] == pytest.approx(99.99)
    assert list(info["tables"]) == ["imu", "odometer"]
    imu, odometer = info["tables"]["imu"], info["tables"]["odometer"]
    assert (imu["rows"], odometer["rows"]) == (10_000, 1_000)
    assert imu["rate_hz"] == pytest.approx(100)
    assert odometer["rate_hz"] == pytest.approx(10)
    assert imu["gaps"] == odometer["gaps"] == []
    assert info["suspicious"] == []
    assert [round(span["start_s"], -1) for span in info["rest"]] == [0, 90]
    assert [round(span["end_s"], -1) for span in info["rest"]] == [40, 100]


def test_gaps_are_given_from_sample_to_sample():
    log = small_log(rows=1000)
    keep = np.ones(1000, dtype=bool)
    keep[[200, 201, 202, 700]] = False  # three samples lost, and a single one, which is no gap
    imu = log.imu.replace(**{f.name: getattr(log.imu, f.name)[keep] for f in gl.Imu.column_fields()})
    gaps = describe(dataclasses.replace(log, imu=imu))["tables"]["imu"]["gaps"]
    assert gaps == [{"start_s": pytest.approx(2.0), "length_s": pytest.approx(0.04)}]


def test_a_sensor_that_samples_in_bursts_has_gaps_only_where_bursts_are_missing():
    t = np.concatenate([start + np.array([0.0, 0.0, 0.01, 0.02]) for start in range(20) if start not in (7, 8)])
    n = len(t)
    points = gl.LidarPoints(t_s=t, feature=np.arange(n), range_m=np.ones(n), angle_rad=np.zeros(n))
    log = dataclasses.replace(small_log(), lidar=gl.Lidar(range_sigma_m=0.1, angle_sigma_deg=0.1), lidar_points=points)
    table = describe(log)["tables"]["lidar_points"]
    assert table["rate_hz"] == pytest.approx(100)
    assert table["gaps"] == [{"start_s": pytest.approx(6.02), "length_s": pytest.approx(2.98)}]


def test_tables_of_happenings_have_no_rate():
    tables = describe(every_sensor_log())["tables"]
    for name in ("events", "push"):
        assert tables[name]["rate_hz"] is None
        assert tables[name]["gaps"] == []


def test_declared_figures_with_their_defaults():
    info = describe(every_sensor_log())
    assert info["declared"]["imu"]["gyro_bias_deg_h"] == 720.0
    assert info["declared"]["face"]["creep_sigma_m"] == 0.0
    anchor = {"id": "7", "pos_n_m": [1.0, 2.0, 3.0], "sigma_m": 0.005, "group": "carrier", "bias_sigma_m": None}
    assert info["declared"]["uwb"]["anchor"][1] == anchor
    assert info["surveyed"][0]["end"] == "far"
    assert "t_s" not in info["declared"]["imu"]
    assert "truth" not in info["declared"]


def test_suspicious_units_and_contradictions_are_listed_not_raised():
    log = machine(100, (40, 90, 0.3))
    info = describe(dataclasses.replace(log, imu=log.imu.replace(accel_b_m_s2=log.imu.accel_b_m_s2 / 9.80665)))
    assert len(info["suspicious"]) == 1
    assert "in g" in info["suspicious"][0]
    info = describe(machine(100, (40, 90, 0.3), static_until_s=60.0))
    assert "static_until_s" in info["suspicious"][0]
    assert info["rest"] == []


def test_the_view_for_the_terminal_holds_the_figures():
    log = machine(100, (40, 90, 0.3))
    shown = text(describe(log))
    for part in (
        "machine",
        "imu",
        "10,000",
        "100.000",
        "gyro_bias_deg_h = 720",
        "at rest",
        "nothing suspicious",
    ):
        assert part in shown
    wrong = dataclasses.replace(log, imu=log.imu.replace(accel_b_m_s2=-log.imu.accel_b_m_s2))
    assert "suspicious: table imu, accel_z_m_s2" in text(describe(wrong))


def test_odd_names_are_shown_as_they_are():
    """Square brackets in a name are no markup."""
    log = dataclasses.replace(every_sensor_log(), name="[red]shift[/red] [1]")
    shown = text(describe(log))
    assert "[red]shift[/red] [1]" in shown
    assert "2026-03-01T06:00:00Z" in shown
    assert "surveyed 2" in shown
    assert "anchor = 2 declared" in shown


def test_the_view_goes_to_standard_error(capsys):
    render(describe(small_log()))
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "small" in captured.err
