"""The command line: what goes to which stream, the exit status, and the whole path from log to figures."""

from __future__ import annotations

import importlib
import io
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tree import printed

import graphnav.smooth as smooth_module
from graphnav import cli, demo, log_commands
from graphnav.errors import SolveError
from graphnav.methods import METHODS
from graphnav.readers import read
from graphnav.report import results, terminal
from graphnav.simulation import SCENARIOS

COMMANDS = ("demo", "info", "import", "simulate", "smooth", "evaluate", "compare", "bound", "creep")


@pytest.fixture(scope="module")
def shift(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated log, written by the command line."""
    folder = tmp_path_factory.mktemp("cli") / "shift"
    assert cli.main(["simulate", "full-shift", "--hours", "0.05", "--seed", "3", "-o", str(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def run(shift: Path) -> Path:
    """The run folder of the smoothed log, written by the command line."""
    folder = shift.parent / "run"
    assert cli.main(["smooth", str(shift), "-o", str(folder)]) == 0
    return folder


def failing(error: BaseException) -> Any:
    def raise_it(*_: object, **__: object) -> None:
        raise error

    return raise_it


@pytest.mark.parametrize("command", COMMANDS)
def test_help_shows_an_example(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        cli.main([command, "--help"])
    assert stop.value.code == 0
    text = capsys.readouterr().out
    assert f"example:\n  graphnav {command} " in text


def test_help_lists_the_commands_and_no_others(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        cli.main(["--help"])
    listed = re.findall(r"^    (\w+) ", capsys.readouterr().out, flags=re.MULTILINE)
    assert tuple(listed) == COMMANDS


def test_help_names_every_scenario_option_and_method(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        cli.main(["simulate", "--help"])
    text = capsys.readouterr().out
    for name, scenario in SCENARIOS.items():
        assert name in text
        for option in scenario["options"]:
            assert re.search(rf"--{option.removesuffix('_m').replace('_', '-')}[ ,]", text)
    with pytest.raises(SystemExit):
        cli.main(["smooth", "--help"])
    assert "{" + ",".join(METHODS) + "}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "COMMAND"),
        (["flatten"], "flatten"),
        (["smooth", "log"], "-o/--output"),
        (["smooth", "log", "-o", "run", "--method", "magic"], "'magic'"),
        (["simulate", "full-shift", "--seed", "x", "-o", "log"], "--seed"),
        (["import", "csv", "-o", "log"], "'csv'"),
        (["compare"], "LOG"),
        (["compare", "log", "--seeds", "many"], "--seeds"),
        (["creep"], "LOG"),
        (["creep", "log", "--end", "middle"], "'middle'"),
    ],
)
def test_wrong_use_is_one_line_and_status_2(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(words) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("graphnav: error: ") and err.count("\n") == 1
    assert said in err and "--help" in err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["info", "nowhere"], "nowhere"),
        (["smooth", "nowhere", "-o", "run"], "nowhere"),
        (["evaluate", "nowhere", "nowhere"], "trajectory.parquet"),
        (["simulate", "moonwalk", "-o", "log"], "moonwalk"),
        (
            ["simulate", "shearer-mems", "--hours", "1", "-o", "log"],
            "shearer-mems takes no --hours; it takes --interval, --par, --sensors\n",
        ),
        (
            ["simulate", "face-end-uwb", "--cycles", "2", "-o", "log"],
            "takes no --cycles; it takes --site, --nlos-share",
        ),
        (["compare", "nowhere"], "nowhere"),
        (["compare", "nowhere", "--methods", "batch,magic"], 'unknown method "magic"'),
        (["compare", "nowhere", "--methods", ","], "no method given"),
        (["compare", "nowhere", "--plot", "x.bmp"], "x.bmp"),
        (["compare", "nowhere", "--config", "no.toml"], "no.toml"),
        (["bound", "nowhere"], "nowhere"),
        (["bound", "nowhere", "--plot", "x.bmp"], "x.bmp"),
        (["creep", "nowhere"], "nowhere"),
        (["import", "comma2k19", "-o", "log"], "needs SRC"),
        (["import", "comma2k19", "nowhere", "-o", "log"], "nowhere"),
        (["import", "kitti-gtsam", "--wheel-scale", "0.1", "-o", "log"], "takes no --wheel-scale"),
    ],
)
def test_bad_input_is_one_line_and_status_2(
    words: list[str],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(words) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("graphnav: error: ") and err.count("\n") == 1
    assert said in err
    assert list(tmp_path.iterdir()) == []


def test_info_prints_json_alone(shift: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["info", str(shift), "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["tables"]["imu"]["rows"] == 18_000
    assert err == ""
    assert cli.main(["info", str(shift)]) == 0
    out, err = capsys.readouterr()
    assert out == "" and "odometer" in err


def test_smooth_writes_a_run_with_its_figures(shift: Path, run: Path) -> None:
    summary = json.loads((run / "summary.json").read_text())
    assert summary["converged"] is True and summary["method"] == "batch" and summary["log"] == read(shift).name
    assert summary["seconds"]["read"] > 0
    assert summary["seconds"]["total"] >= summary["seconds"]["read"] + summary["seconds"]["solve"]
    assert summary["keyframes"] == len(results.load(run))
    assert {"odometer_scale", "gyro_bias_x"} <= set(summary["calibration"])
    assert max(summary["errors"]["max_m"]) < 0.3  # three minutes, 12 m of travel


def test_smooth_shows_the_smoother_no_truth(shift: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    original, seen = smooth_module.smooth, []

    def watched(log: Any, **options: Any) -> Any:
        seen.append(log.truth)
        return original(log, **options)

    monkeypatch.setattr(smooth_module, "smooth", watched)
    assert cli.main(["smooth", str(shift), "-o", str(tmp_path / "run")]) == 0
    assert seen == [None]


def test_isam2_and_a_configuration_file(shift: Path, tmp_path: Path) -> None:
    (tmp_path / "my.toml").write_text("[keyframes]\ninterval_s = 2.0\n")
    words = ["smooth", str(shift), "-o", str(tmp_path / "run"), "--method", "isam2"]
    assert cli.main([*words, "--config", str(tmp_path / "my.toml")]) == 0
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["method"] == "isam2"
    assert "interval_s = 2.0" in (tmp_path / "run" / "config.toml").read_text()


def test_configuration_errors_name_the_key(shift: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "my.toml").write_text("[keyframes]\ninterval = 2.0\n")
    words = ["smooth", str(shift), "-o", str(tmp_path / "run"), "--config", str(tmp_path / "my.toml")]
    assert cli.main(words) == 2
    assert "keyframes.interval" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_evaluate_prints_the_keys_of_the_interface(
    shift: Path, run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plot = tmp_path / "run.png"
    assert cli.main(["evaluate", str(run), str(shift), "--json", "--plot", str(plot)]) == 0
    out, err = capsys.readouterr()
    found = json.loads(out)
    assert {"rms_m", "max_m", "per_cycle", "nees_position", "ate_m", "rpe"} <= set(found)
    assert err == "" and plot.exists()
    assert cli.main(["evaluate", str(run), str(shift)]) == 0
    out, err = capsys.readouterr()
    assert out == "" and "NEES" in err and "APE" in err and "SEP" in err


def test_evaluate_refuses_a_log_that_the_run_is_not_of(
    shift: Path, run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other"
    assert cli.main(["simulate", "full-shift", "--hours", "0.02", "--seed", "3", "-o", str(other)]) == 0
    capsys.readouterr()
    assert cli.main(["evaluate", str(run), str(other), "--json"]) == 2
    out, err = capsys.readouterr()
    assert out == "" and "evaluate a run against its own log" in err
    renamed = tmp_path / "renamed"
    shutil.copytree(shift, renamed)
    text = (shift / "log.toml").read_text().replace(f'name = "{read(shift).name}"', 'name = "renamed"')
    (renamed / "log.toml").write_text(text)
    assert cli.main(["evaluate", str(run), str(renamed), "--json"]) == 0
    out, err = capsys.readouterr()
    assert err == f"graphnav: warning: {json.loads(out)['notes'][0]}\n" and "judged by log renamed" in err


def test_compare_prints_the_rows_of_the_interface(
    shift: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plot, text = tmp_path / "compare.png", tmp_path / "tables" / "compare.md"
    words = ["compare", str(shift), "--methods", "batch, isam2"]
    assert cli.main([*words, "--json", "--plot", str(plot), "--markdown", str(text)]) == 0
    out, err = capsys.readouterr()
    rows = json.loads(out)["rows"]
    assert [row["method"] for row in rows] == ["batch", "isam2"]
    assert {"method", "seconds", "rms_m", "max_m", "per_cycle", "nees_position"} <= set(rows[0])
    assert err == "" and plot.exists() and "| isam2 |" in text.read_text()
    assert cli.main(words) == 0
    out, err = capsys.readouterr()
    assert out == "" and "isam2" in err and "NEES" in err


def test_compare_of_seeds_by_the_name_of_a_scenario(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["compare", "full-shift_hours=0.02", "--methods", "batch", "--seeds", "2", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["log"], found["seeds"]) == ("full-shift_hours=0.02", 2)
    assert found["rows"][0]["over_seeds"]["runs"] == 2


def test_compare_shows_the_rest_before_it_tells_of_a_failure(
    shift: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    original = smooth_module.smooth

    def smooth_or_fail(log: Any, config: Any, method: str, progress: Any) -> Any:
        if method == "isam2":
            raise SolveError("not converged; raise the limit")
        return original(log, config, method, progress)

    monkeypatch.setattr(smooth_module, "smooth", smooth_or_fail)
    plot = tmp_path / "compare.png"
    words = ["compare", str(shift), "--methods", "isam2,batch", "--json"]
    assert cli.main([*words, "--plot", str(plot)]) == 2
    out, err = capsys.readouterr()
    assert json.loads(out)["rows"][1]["error"] is None
    assert err == "graphnav: error: isam2 failed: not converged; raise the limit\n"
    assert plot.exists()
    monkeypatch.setattr(smooth_module, "smooth", failing(SolveError("no")))
    assert cli.main([*words, "--plot", str(tmp_path / "none.png")]) == 2
    assert capsys.readouterr().err == "graphnav: error: isam2 failed: no (and 1 more method)\n"
    assert not (tmp_path / "none.png").exists()


def test_bound_prints_json_and_draws(shift: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plot = tmp_path / "bound.png"
    assert cli.main(["bound", str(shift), "--json", "--plot", str(plot)]) == 0
    out, err = capsys.readouterr()
    found = json.loads(out)
    assert {"bound_m", "rms_m", "efficiency", "per_cycle", "over_time"} <= set(found)
    assert 0 < found["efficiency"] < 5
    assert err == "" and plot.exists()
    assert cli.main(["bound", str(shift)]) == 0
    out, err = capsys.readouterr()
    assert out == "" and "Cramer-Rao" in err and "rms / bound" in err


def test_a_log_without_truth_is_smoothed_and_not_judged(
    shift: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    blind = tmp_path / "blind"
    blind.mkdir()
    for item in shift.iterdir():
        if item.stem != "truth":
            (blind / item.name).write_bytes(item.read_bytes())
    assert cli.main(["smooth", str(blind), "-o", str(tmp_path / "run")]) == 0
    assert "errors" not in json.loads((tmp_path / "run" / "summary.json").read_text())
    capsys.readouterr()
    assert cli.main(["evaluate", str(tmp_path / "run"), str(blind), "--json"]) == 2
    out, err = capsys.readouterr()
    assert out == "" and "has no truth table" in err
    assert cli.main(["bound", str(blind)]) == 2
    assert "has no truth table" in capsys.readouterr().err
    assert cli.main(["compare", str(blind), "--methods", "batch,isam2", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["reference"] == "batch"


def test_a_failed_solution_writes_nothing(
    shift: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(smooth_module, "smooth", failing(SolveError("not converged;\n raise the limit")))
    assert cli.main(["smooth", str(shift), "-o", str(tmp_path / "run")]) == 2
    assert capsys.readouterr().err == "graphnav: error: not converged; raise the limit\n"
    assert list(tmp_path.iterdir()) == []


def test_output_that_may_not_be_replaced_is_refused_before_the_work(
    shift: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(smooth_module, "smooth", failing(AssertionError("must not be reached")))
    (tmp_path / "notes.txt").write_text("mine")
    assert cli.main(["smooth", str(shift), "-o", str(tmp_path)]) == 2
    assert "holds notes.txt" in capsys.readouterr().err
    assert cli.main(["smooth", str(shift), "-o", str(shift), "--overwrite"]) == 2
    assert "never replaced" in capsys.readouterr().err
    (tmp_path / "file").write_text("mine")
    for place in ("/proc/none/run", str(tmp_path / "file" / "deep" / "run")):
        assert cli.main(["smooth", str(shift), "-o", place]) == 2
        assert f"{place}: cannot write the run folder (" in capsys.readouterr().err


@pytest.mark.parametrize(
    "line",
    [
        "simulate shearer-mems -o PLACE", "import kitti-gtsam -o PLACE", "smooth LOG -o PLACE", "demo -o PLACE",
        "compare LOG --methods batch --markdown PLACE", "compare LOG --methods batch --plot PLACE.png",
        "bound LOG --plot PLACE.png", "observability LOG --plot PLACE.png", "evaluate RUN LOG --plot PLACE.png",
    ],
)  # fmt: skip
@pytest.mark.parametrize(
    "place",
    ["/proc/none/out", "HERE/file/deep/out", "HERE/held", f"HERE/{'x' * 300}"],
    ids=["none", "file", "held", "long"],
)
def test_no_command_works_for_a_place_that_takes_nothing(
    line: str,
    place: str,
    shift: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """One line that names it, before the work, and nothing left behind."""
    for module, name in (
        ("graphnav.smooth", "smooth"), ("graphnav.compare", "compare"), ("graphnav.bound", "bound"),
        ("graphnav.analysis", "observe"), ("graphnav.readers.kitti_gtsam", "convert"),
        ("graphnav.simulation", "simulate"),
    ):  # fmt: skip
        monkeypatch.setattr(importlib.import_module(module), name, failing(AssertionError("must not be reached")))
    mine = ("file", "held/notes.txt", "held/shearer-mems/run/notes.txt", "held.png/notes.txt")
    for file in (tmp_path / name for name in mine):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("mine")
    before = sorted(tmp_path.rglob("*"))
    place = place.replace("HERE", str(tmp_path))
    words = [word.replace("PLACE", place).replace("LOG", str(shift)).replace("RUN", "run") for word in line.split()]
    assert cli.main(words) == 2
    out = capsys.readouterr()
    assert out.out == "" and out.err.count("\n") == 1 and place in out.err
    assert sorted(tmp_path.rglob("*")) == before


def test_no_output_is_tried_after_what_takes_a_second_to_import() -> None:
    lines = (
        "simulate shearer-mems -o /proc/none/out", "import kitti-gtsam -o /proc/none/out", "demo -o /proc/none/out",
        "smooth log -o /proc/none/out", "compare log --markdown /proc/none/out", "bound log --plot /proc/none/out.png",
        "observability log --plot /proc/none/out.png", "evaluate run log --plot /proc/none/out.png",
    )  # fmt: skip
    code = f"""
import sys
from graphnav.cli import main
for line in {lines!r}:
    assert main(line.split()) == 2, line
    print(line, *sorted({{"gtsam", "numba", "scipy", "pydantic", "open3d", "cv2"}} & set(sys.modules)))
"""
    assert printed(code).splitlines() == list(lines)


def test_the_demonstration_is_not_put_into_a_log(shift: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["demo", "-o", str(shift)]) == 2
    assert capsys.readouterr().err == f"graphnav: error: {shift}: is a log folder; give another folder\n"
    assert not (shift / "shearer-mems").exists()


def test_trying_the_output_leaves_nothing_behind(tmp_path: Path) -> None:
    results.check_writable(tmp_path / "deep" / "run")
    assert list(tmp_path.iterdir()) == []


def test_what_is_unexpected_has_status_1_and_advice(
    shift: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(smooth_module, "smooth", failing(KeyError("x12")))
    words = ["smooth", str(shift), "-o", str(tmp_path / "run")]
    assert cli.main(words) == 1
    err = capsys.readouterr().err
    assert err == "graphnav: unexpected KeyError: 'x12'; rerun with --traceback to see where\n"
    assert cli.main([*words, "--traceback"]) == 1
    err = capsys.readouterr().err
    assert "Traceback (most recent call last)" in err and "advice" not in err.splitlines()[-1]
    monkeypatch.setattr(smooth_module, "smooth", failing(KeyboardInterrupt()))
    assert cli.main(words) == 130
    assert list(tmp_path.iterdir()) == []


def test_import_of_the_drive_in_the_gtsam_package(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["import", "kitti-gtsam", "-o", str(tmp_path / "kitti")]) == 0
    assert "imu" in capsys.readouterr().err
    assert len(read(tmp_path / "kitti").position) > 400


def test_csv_tables_hold_the_same_log(shift: Path, tmp_path: Path) -> None:
    words = ["simulate", "full-shift", "--hours", "0.05", "--seed", "3", "--tables", "csv"]
    assert cli.main([*words, "-o", str(tmp_path / "csv")]) == 0
    assert (tmp_path / "csv" / "imu.csv").exists()
    np.testing.assert_array_equal(read(tmp_path / "csv").imu.gyro_b_rad_s, read(shift).imu.gyro_b_rad_s)


def test_demo_writes_what_it_says(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["demo", "-o", str(tmp_path / "demo"), "--json"]) == 0
    out, err = capsys.readouterr()
    found = json.loads(out)
    seps = [cycle["sep_m"] for cycle in found["shearer_mems"]["errors"]["per_cycle"]]
    assert len(seps) == len(demo.PAPER_SEP_M) == 4
    assert max(seps) < 0.15
    assert 0 < found["kitti_gtsam"]["withheld"]["rms_3d_m"] < 0.5
    for name in ("shearer-mems", "kitti-gtsam"):
        held = tmp_path / "demo" / name
        assert sorted(item.name for item in held.iterdir()) == ["log", "run", "run.png"]
        assert f"{held}: log/, run/ and run.png" in err
    saved = json.loads((tmp_path / "demo" / "shearer-mems" / "run" / "summary.json").read_text())
    assert saved["errors"] == found["shearer_mems"]["errors"]


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_progress_bar_is_for_terminals_and_long_work_only(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = {}
    for name, stream, delay_s in (
        ("pipe", io.StringIO(), 0.0),
        ("short", Terminal(), 3600.0),
        ("long", Terminal(), 0.0),
    ):
        monkeypatch.setattr(sys, "stderr", stream)
        monkeypatch.setattr(terminal, "_DELAY_S", delay_s)
        with terminal.ProgressBar() as progress:
            progress("assemble", 1, 2)
            progress("solve", 3, 10)
        shown[name] = stream.getvalue()
    assert shown["pipe"] == shown["short"] == ""
    assert "assemble" in shown["long"] and "solve" in shown["long"] and "30" in shown["long"]


def test_threads_are_limited_before_numpy_is_imported() -> None:
    program = (
        "import sys, os\n"
        "from graphnav import cli\n"
        "assert 'numpy' not in sys.modules, 'numpy is imported before its threads are limited'\n"
        "cli.main(['info', 'nowhere'])\n"
        "assert 'numpy' in sys.modules\n"
        "print(os.environ['OPENBLAS_NUM_THREADS'])\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, env={"PATH": "/usr/bin"}, check=True
    )
    assert done.stdout == "1\n"


def test_module_runs_as_a_program() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "graphnav", "info", "nowhere"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.startswith("graphnav: error: nowhere")


def test_importers_are_there() -> None:
    for module, _ in log_commands.IMPORTERS.values():
        assert callable(importlib.import_module(module).convert)
