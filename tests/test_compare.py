"""Methods side by side: figures, failures, seeds, names of simulated logs, table and picture."""

from __future__ import annotations

import inspect
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from engine_logs import SHORT, TWO_CUTS, simulated, smoothed

import graphnav as gn
import graphnav.compare as compare_module
import graphnav.smooth as smooth_module
from graphnav._consistency import OverRuns, band
from graphnav._cycles import CycleError
from graphnav._seeds import over_seeds
from graphnav.compare import compare
from graphnav.comparison import COLUMNS, Comparison, Curve, MethodRow, NisBand
from graphnav.config import Config
from graphnav.errors import ConfigError, GraphnavError, LogError, SolveError
from graphnav.evaluation import evaluate
from graphnav.methods import LEG_METHODS, METHODS, STEREO_METHODS, UWB_METHODS
from graphnav.readers import write
from graphnav.report import comparison as report
from graphnav.simulation import SCENARIOS, simulate, stereo_images
from graphnav.simulation.naming import Simulated, log_name, parse_name
from graphnav.smooth import smooth

GRAPH = ("batch", "isam2")


@pytest.fixture(scope="module")
def compared() -> Comparison:
    return compare(simulated(TWO_CUTS, 0), GRAPH)


# One log ----------------------------------------------------------------------------------------------------


def test_rows_hold_what_evaluate_says(compared: Comparison) -> None:
    assert [row.method for row in compared.rows] == list(GRAPH)
    assert (compared.log, compared.reference, compared.seeds) == ("engine_seed0", "truth", 0)
    for row in compared.rows:
        found = evaluate(smoothed(TWO_CUTS, 0, row.method).trajectory, simulated(TWO_CUTS, 0))
        assert row.rms_m == pytest.approx(found.rms_m, abs=1e-9)
        assert row.max_m == pytest.approx(found.max_m, abs=1e-9)
        assert [c.sep_m for c in row.per_cycle] == pytest.approx([c.sep_m for c in found.per_cycle], abs=1e-9)
        assert row.nees_position == pytest.approx(found.nees_position, rel=1e-6)
        assert row.nees_attitude == pytest.approx(found.nees_attitude, rel=1e-6)
        assert row.converged and row.error is None and row.nis is None
        assert row.seconds > 0 and row.curve.error_n_m.shape == (len(row.curve.t_s), 3)


def test_json_has_the_keys_of_the_interface(compared: Comparison) -> None:
    rows = compared.to_dict()["rows"]
    wanted = {"method", "seconds", "rms_m", "max_m", "per_cycle", "nees_position", "nees_attitude", "nis", "converged"}
    assert all(wanted | {"warnings", "error"} == set(row) for row in rows)
    assert set(rows[0]["per_cycle"][0]) == {"cycle", "sep_m", "max_m"}
    assert len(rows[0]["rms_m"]) == len(rows[0]["max_m"]) == 3


def test_a_filter_shows_its_nis() -> None:
    (row,) = compare(simulated(SHORT, 0), ["ekf"]).rows
    nis = row.to_dict()["nis"]
    assert nis["rows"] > 100 and nis["band"] == pytest.approx(band(nis["rows"]))
    assert nis["mean"] == smooth(replace(simulated(SHORT, 0), truth=None), method="ekf").innovations.nis().mean


def test_no_method_is_shown_the_truth(monkeypatch: pytest.MonkeyPatch) -> None:
    original, seen = smooth_module.smooth, []

    def watched(log: Any, *rest: Any) -> Any:
        seen.append(log.truth)
        return original(log, *rest)

    monkeypatch.setattr(smooth_module, "smooth", watched)
    compare(simulated(SHORT, 0), GRAPH)
    assert seen == [None, None]


def failing_for(method: str, error: Exception) -> Any:
    original = smooth_module.smooth

    def smooth_or_fail(log: Any, config: Any, name: str, progress: Any = None) -> Any:
        if name == method:
            raise error
        return original(log, config, name, progress)

    return smooth_or_fail


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (SolveError("not converged;\n raise the limit"), "not converged; raise the limit"),
        (ZeroDivisionError("division by zero"), "unexpected ZeroDivisionError: division by zero"),
        (NotImplementedError(), "unexpected NotImplementedError"),
    ],
)
def test_a_method_that_fails_does_not_lose_the_others(
    monkeypatch: pytest.MonkeyPatch, error: Exception, told: str
) -> None:
    monkeypatch.setattr(smooth_module, "smooth", failing_for("batch", error))
    found = compare(simulated(SHORT, 0), GRAPH)
    failed, good = found.rows
    assert found.failed == (failed,)
    assert failed.error == told and failed.rms_m is None and not failed.converged
    assert good.error is None and max(good.rms_m) < 0.2
    assert "| batch | failed | - |" in found.to_markdown() and f"- batch failed: {told}" in found.to_markdown()
    assert failed.to_dict()["rms_m"] is None


def test_without_truth_the_first_method_stands_in() -> None:
    log = replace(simulated(SHORT, 0), truth=None)
    found = compare(log, ["isam2", "batch"])
    assert found.reference == "isam2"
    assert found.rows[0].rms_m == (0, 0, 0)
    off = smoothed(SHORT, 0).trajectory.pos_n - smoothed(SHORT, 0, "isam2").trajectory.pos_n
    assert found.rows[1].rms_m == pytest.approx(np.sqrt(np.mean(off**2, axis=0)), abs=1e-9)
    assert all(row.nees_position is None and row.nees_attitude is None for row in found.rows)
    assert "differences from isam2" in found.title
    assert any("no truth" in note for note in found.notes())


def test_a_reference_that_fails_is_passed_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(smooth_module, "smooth", failing_for("batch", SolveError("no")))
    found = compare(replace(simulated(SHORT, 0), truth=None), GRAPH)
    assert found.reference == "isam2" and found.rows[0].error == "no"


def test_configuration_reaches_every_method() -> None:
    config = Config.from_dict({"keyframes": {"interval_s": 2.0}})
    usual, coarse = compare(simulated(SHORT, 0), GRAPH), compare(simulated(SHORT, 0), GRAPH, config)
    for before, after in zip(usual.rows, coarse.rows, strict=True):
        assert len(after.curve.t_s) < 0.7 * len(before.curve.t_s)


def test_progress_of_a_method_goes_up_to_its_end() -> None:
    heard: dict[str, list[float]] = {}
    compare(
        simulated(SHORT, 0), GRAPH, progress=lambda what, done, total: heard.setdefault(what, []).append(done / total)
    )
    assert list(heard) == list(GRAPH)
    for shares in heard.values():
        assert shares == sorted(shares) and shares[-1] == 1


def test_methods_are_checked_before_the_work() -> None:
    with pytest.raises(ConfigError, match=r'unknown method "magic"; known: batch, isam2, rts'):
        compare("nowhere", ["batch", "magic"])
    with pytest.raises(ConfigError, match="no method given"):
        compare("nowhere", [])
    assert compare_module._checked(["batch", "ekf", "batch"]) == ("batch", "ekf")
    unserved = LEG_METHODS + UWB_METHODS + STEREO_METHODS
    assert compare_module._every(simulated(SHORT, 0)) == tuple(m for m in METHODS if m not in unserved)


def test_logs_by_folder_and_by_name(tmp_path: Path) -> None:
    write(simulate("full-shift", 2, hours=0.02), tmp_path / "log")
    by_folder, by_name = compare(tmp_path / "log", ["batch"]), compare("full-shift_hours=0.02_seed2", ["batch"])
    assert by_folder.log == by_name.log == "full-shift_hours=0.02_seed2"
    assert by_folder.rows[0].rms_m == pytest.approx(by_name.rows[0].rms_m, rel=1e-6)
    with pytest.raises(LogError, match="no such folder"):
        compare(tmp_path / "nowhere", ["batch"])


def test_module_is_callable_and_public() -> None:
    assert gn.compare is compare_module
    assert inspect.signature(gn.compare) == inspect.signature(compare)
    assert gn.compare(simulated(SHORT, 0), methods=["batch"]).rows[0].converged


# Seeds ------------------------------------------------------------------------------------------------------


def test_seeds_are_simulated_again_in_worker_processes() -> None:
    before = dict(os.environ)
    heard = []
    found = compare(
        "full-shift_hours=0.03",
        ["batch"],
        seeds=3,
        progress=lambda what, done, total: heard.append((what, done, total)),
    )
    assert dict(os.environ) == before
    assert heard == [("seeds", 1, 3), ("seeds", 2, 3), ("seeds", 3, 3)]
    assert (found.log, found.seeds, found.reference) == ("full-shift_hours=0.03", 3, "truth")
    alone = [compare(simulate("full-shift", seed, hours=0.03), ["batch"]).rows[0] for seed in range(3)]
    (row,) = found.rows
    assert row.rms_m == pytest.approx(np.sqrt(np.mean([np.square(r.rms_m) for r in alone], axis=0)))
    assert row.max_m == pytest.approx(np.max([r.max_m for r in alone], axis=0))
    nees = OverRuns.of([r.nees_position for r in alone])
    assert row.nees_position == pytest.approx(nees.mean)
    assert row.over_seeds.nees_position.standard_error == pytest.approx(nees.standard_error)
    assert "3 seeds" in found.title
    assert row.to_dict()["over_seeds"]["runs"] == 3


@pytest.mark.parametrize("methods", [["sins", "batch"], ["sins"]])
def test_images_of_a_scenario_are_rendered_where_a_method_looks_at_them(
    monkeypatch: pytest.MonkeyPatch, methods: list[str]
) -> None:
    """With seeds and by name, each into a folder of its own that is gone in the end."""
    drawn, seen = [], []

    def draw(scenario: str, seed: int, options: Any, folder: Path, **_: Any) -> None:
        assert folder.is_dir() and not list(folder.iterdir())
        drawn.append((scenario, seed, options, folder))

    def judged(log: Any, *_: Any) -> Any:
        seen.append(log.stereo_pairs.folder)
        return "truth", 0, ()

    monkeypatch.setattr(stereo_images, "render_into", draw)
    monkeypatch.setattr(compare_module, "_compared", judged)
    task = compare_module._Task(parse_name("roadheader-stereo_rate_hz=2"), tuple(methods), Config())
    assert task.run(3) == ()
    compare("roadheader-stereo_seed4", methods)
    wanted = [("roadheader-stereo", 3, {"rate_hz": 2.0}), ("roadheader-stereo", 4, {})] if "batch" in methods else []
    assert [call[:3] for call in drawn] == wanted
    assert seen == ([call[3] for call in drawn] or [None, None])
    assert not any(folder.exists() for *_, folder in drawn)


def test_seeds_need_a_scenario(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match='log "engine_seed0" was not simulated from a scenario'):
        compare(simulated(SHORT, 0), ["batch"], seeds=2)
    with pytest.raises(ConfigError, match="seeds = -1"):
        compare(simulated(SHORT, 0), ["batch"], seeds=-1)
    with pytest.raises(LogError, match="no such folder"):
        compare(tmp_path / "nowhere", ["batch"], seeds=2)


def made_row(seed: int, error: str | None = None) -> MethodRow:
    """A row of made-up figures that differ by seed."""
    if error is not None:
        return MethodRow("batch", error=error)
    size = 0.1 * (seed + 1)
    t = np.arange(5.0) + 0.3 * seed
    return MethodRow(
        method="batch",
        seconds=1.0 + seed,
        rms_m=(size, 0.0, 2 * size),
        max_m=(3 * size, 1.0, 0.0),
        per_cycle=(CycleError(1, 0.0, 4.0, size, (size, 2 * size, 0.0)),),
        nees_position=1.0 + 0.1 * seed,
        nis=NisBand(1.0 + seed, 0.9, 1.1, 100 * (seed + 1)),
        converged=True,
        warnings=("slow",),
        curve=Curve(t, np.tile([size, 0.0, -size], (5, 1))),
    )


def test_seeds_become_one_row() -> None:
    found = over_seeds("x", [(made_row(0),), (made_row(1),), (made_row(2, "no"),), (made_row(3),)], 4)
    (row,) = found.rows
    assert row.seconds == 2.0
    assert row.rms_m == pytest.approx(np.sqrt([0.07, 0.0, 0.28]))
    assert row.max_m == pytest.approx((1.2, 1.0, 0.0))
    assert row.per_cycle[0].sep_m == pytest.approx(0.2)
    assert row.per_cycle[0].max_m == pytest.approx((0.4, 0.8, 0.0))
    assert row.nees_position == pytest.approx(np.mean([1.0, 1.1, 1.3])) and row.nees_attitude is None
    assert row.nis.mean == pytest.approx((100 + 2 * 200 + 4 * 400) / 700) and row.nis.rows == 700
    assert (row.nis.low, row.nis.high) == band(700)
    assert row.error == "1 of 4 runs; seed 2: no" and row.warnings == tuple(f"seed {k}: slow" for k in (0, 1, 3))
    assert "batch: seed 0: slow (and 2 more warnings)" in found.notes()
    assert (row.over_seeds.runs, row.over_seeds.failed) == (3, 1)
    np.testing.assert_allclose(row.curve.t_s, [1.0, 2.0, 3.0, 4.0])  # what all three cover, on whole seconds
    np.testing.assert_allclose(row.curve.error_n_m, np.tile(np.sqrt([0.07, 0.0, 0.07]), (4, 1)))
    assert found.failed == (row,)


def test_no_seed_that_succeeds_is_a_row_with_its_error() -> None:
    (row,) = over_seeds("x", [(made_row(0, "first"),), (made_row(1, "second"),)], 2).rows
    assert row.error == "2 of 2 runs; seed 0: first" and row.rms_m is None


# Names of simulated logs --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("scenario", "options", "name"),
    [
        ("shearer-mems", {}, "shearer-mems_seed3"),
        ("shearer-mems", {"interval_m": 2, "par": 0}, "shearer-mems_seed3"),
        ("shearer-mems", {"interval_m": 6}, "shearer-mems_interval_m=6_seed3"),
        ("shearer-mems", {"par": 12, "interval_m": 10.0}, "shearer-mems_interval_m=10_par=12_seed3"),
        ("full-shift", {"hours": 0.05}, "full-shift_hours=0.05_seed3"),
        ("full-shift", {"sensors": "imu,odometer"}, "full-shift_sensors=imu,odometer_seed3"),
        ("full-shift", {"sensors": ("imu", "odometer", "closed-path")}, "full-shift_seed3"),
    ],
)
def test_names_tell_scenario_options_and_seed(scenario: str, options: dict[str, Any], name: str) -> None:
    assert log_name(scenario, options, 3) == name
    found = parse_name(name)
    assert (found.scenario, found.seed) == (scenario, 3)
    assert log_name(found.scenario, found.options, found.seed) == name
    assert log_name(scenario, options, None) == name.removesuffix("_seed3")
    assert set(found.options) <= set(SCENARIOS[scenario]["options"])


def test_a_simulated_log_can_be_simulated_again_from_its_name() -> None:
    log = simulate("shearer-mems", 5, interval_m=10, par=2)
    assert log.name == "shearer-mems_interval_m=10_par=2_seed5"
    found = parse_name(log.name)
    again = simulate(found.scenario, found.seed, **found.options)
    np.testing.assert_array_equal(again.imu.gyro_b_rad_s, log.imu.gyro_b_rad_s)
    assert again.face.interval_m == log.face.interval_m == 10.0


@pytest.mark.parametrize(
    "name",
    [
        "engine_seed0",
        "shift_042",
        "shearer-mems_x=2_seed1",
        "shearer-mems_par=x_seed1",
        "shearer-mems_seed",
        "",
        "full-shift_2",
    ],
)
def test_other_names_are_no_scenarios(name: str) -> None:
    assert parse_name(name) is None


def test_a_name_without_a_seed() -> None:
    assert parse_name("shearer-mems") == Simulated("shearer-mems", {}, None)
    assert parse_name("full-shift_hours=0.5") == Simulated("full-shift", {"hours": 0.5}, None)


# Table and picture --------------------------------------------------------------------------------------------


def test_markdown_is_a_table_with_notes(compared: Comparison) -> None:
    lines = compared.to_markdown().splitlines()
    assert lines[0] == "**engine_seed0: errors against truth**"
    table = [line for line in lines if line.startswith("|")]
    assert len(table) == 2 + len(GRAPH)
    assert all(line.count("|") == len(COLUMNS) + 1 for line in table)
    assert any(line.startswith("- NEES: 1 is consistent; 95 % band 0.07 to 3.12") for line in lines)


def test_a_warning_of_several_methods_is_told_once() -> None:
    rows = (replace(made_row(0), method="a"), replace(made_row(0), method="b"), replace(made_row(0), warnings=()))
    notes = Comparison("made", "truth", 0, rows).notes()
    assert [note for note in notes if "slow" in note] == ["a, b: slow"]


def test_terminal_table_goes_to_standard_error(compared: Comparison, capsys: pytest.CaptureFixture[str]) -> None:
    report.show(compared)
    out, err = capsys.readouterr()
    assert out == ""
    assert all(method in err for method in GRAPH) and "NEES" in err


def with_errors(sizes: list[float]) -> Comparison:
    """Methods whose errors swing with these amplitudes."""
    t = np.arange(100.0)
    rows = [
        MethodRow(
            f"m{k}",
            1.0,
            (size,) * 3,
            (size,) * 3,
            per_cycle=(CycleError(1, 10.0, 60.0, size, (size,) * 3),),
            curve=Curve(t, size * np.sin(t)[:, None] * np.ones(3)),
        )
        for k, size in enumerate(sizes)
    ]
    return Comparison("made", "truth", 0, tuple(rows))


@pytest.mark.parametrize(
    ("sizes", "scale"), [([0.04, 0.05], "linear"), ([0.04, 4.0], "symlog"), ([0.0, 0.04], "linear")]
)
def test_axes_that_one_method_would_flatten_are_logarithmic(sizes: list[float], scale: str) -> None:
    from matplotlib.figure import Figure

    axes = Figure().subplots()
    report._scale(axes, [row.curve.error_n_m[:, 0].__abs__() for row in with_errors(sizes).rows])
    assert axes.get_yscale() == scale


@pytest.mark.parametrize("seeds", [0, 2])
@pytest.mark.parametrize("sizes", [[0.04, 0.05], [0.04, 4.0], [0.0, 0.0], [0.0, 0.01, 1.0]])
def test_picture_is_written(sizes: list[float], seeds: int, tmp_path: Path) -> None:
    made = replace(with_errors(sizes), seeds=seeds)
    if seeds:  # rms values have no sign
        rows = [replace(row, curve=Curve(row.curve.t_s, np.abs(row.curve.error_n_m))) for row in made.rows]
        made = replace(made, rows=tuple(rows))
    assert report.plot(made, tmp_path / "x.png").stat().st_size > 10_000
    assert [p.name for p in tmp_path.iterdir()] == ["x.png"]


def test_every_method_has_a_colour_of_its_own() -> None:
    assert len(report._LINES) >= len(METHODS)
    assert len({colour for colour, *_ in report._LINES}) == len(report._LINES)


def test_nothing_to_draw_is_said(tmp_path: Path) -> None:
    nothing = Comparison("made", "truth", 0, (MethodRow("batch", error="no"),))
    with pytest.raises(GraphnavError, match="nothing to draw"):
        report.plot(nothing, tmp_path / "x.png")
