"""The reproduction of the RTS paper, on short logs: its rows, tables and pictures are of the runs that were made."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from engine_logs import SHORT, TWO_CUTS, drawn, simulated, world
from tree import ROOT, python

from benchmarks._report import Before
from benchmarks.papers import _cases as cases
from benchmarks.papers import _published as published
from benchmarks.papers._drawn import drawn as drawn_values
from benchmarks.papers._figures import draw
from benchmarks.papers._judged import judge
from benchmarks.papers._navigation import pure_inertial, reckoned
from benchmarks.papers._page import write
from benchmarks.papers._results import Results
from benchmarks.papers._rows import all_rows
from benchmarks.papers._sheet import filled, number
from graphnav._stages import Stages
from graphnav.config import Config
from graphnav.errors import LogError
from graphnav.evaluation import evaluate
from graphnav.smooth import posed, smooth

SEED = 3


@pytest.fixture(scope="module")
def short_scenario() -> Iterator[pytest.MonkeyPatch]:
    """Two cuts of 20 m stand for the scenario: everything is run as it is, on less."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("graphnav.simulation.simulate", lambda scenario, seed, **options: simulated(TWO_CUTS, seed))
        patch.setattr("graphnav.simulation.scenarios.resolve", lambda scenario, options: TWO_CUTS)
        patch.setattr("graphnav.simulation.scenarios.MEMS", TWO_CUTS)
        patch.setattr(published, "PURE_INERTIAL_S", 60.0)
        yield patch


@pytest.fixture(scope="module")
def results(short_scenario: pytest.MonkeyPatch) -> Results:
    jobs = [cases.Job("base", SEED, keep=True)]
    jobs += [cases.Job("interval", SEED, interval, keep=True) for interval in (6, 10)]
    jobs += [cases.Job("par", SEED, par) for par in (1, 12)] + [cases.Job("small", SEED)]
    found = Results.of(cases.run_job(job) for job in jobs)
    assert not found.failed
    return found


# what is run ------------------------------------------------------------------------------------------------


def test_jobs_cover_every_figure_once() -> None:
    todo = list(cases.jobs(3, 2, first_seed=5))
    assert len({(job.log, job.seed) for job in todo}) == len(todo) == 3 * (1 + 2 + 1) + 2 * 12
    assert {job.log for job in todo} >= {"interval 2", "interval 6", "interval 10", "par 1", "par 12"}
    assert {job.seed for job in todo if job.keep} == {5}


def test_estimators_get_no_truth(short_scenario: pytest.MonkeyPatch) -> None:
    log, blind = cases._simulated(cases.Job("base", SEED))
    assert log.truth is not None
    assert blind.truth is None


def test_a_run_that_fails_is_counted(short_scenario: pytest.MonkeyPatch) -> None:
    def fails(*args: object, **options: object) -> None:
        raise LogError("no such luck", where="here")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("graphnav.smooth.smooth", fails)
        outcome = cases.run_job(cases.Job("par", SEED, 4))
    assert isinstance(outcome, str)
    assert "par 4, seed 3" in outcome
    rows = all_rows(Results.of([outcome]))
    assert [(r.name, r.value, r.met) for r in rows] == [("runs that failed", 1.0, False)]


# figures ----------------------------------------------------------------------------------------------------


def test_rows_have_their_form(results: Results) -> None:
    rows = all_rows(results)
    assert len({r.name for r in rows}) == len(rows)
    for r in rows:
        assert r.value is not None and np.isfinite(r.value) and r.value >= 0, r
        assert (r.met is None) == (r.target is None), r
    assert [r.name for r in rows if r.target == "<= 1.15 x peer"] == [
        "no closed path: rms of rts matched, graph beside"
    ]
    assert not [r for r in rows if r.target == "<= 0.07 m"]


def test_the_graphs_target_is_for_twenty_seeds(results: Results) -> None:
    one = results.of_log("interval 2")[0]
    twenty = Results.of(dataclasses.replace(one, seed=seed) for seed in range(20))
    targets = [r for r in all_rows(twenty) if r.target == "<= 0.07 m"]
    assert {r.name for r in targets} == {f"table 3, graph: SEP of cycle {c}" for c in (1, 2)}
    assert all(r.met == (r.value is not None and r.value <= 0.07) for r in targets)


def test_papers_numbers_stand_beside() -> None:
    assert published.PROPOSED == (0.50, 0.32, 0.13, 0.17)
    assert published.COMPENSATED == (0.21, 0.29, 0.33, 0.17)
    assert published.TRADITIONAL == (1.75, 1.99, 2.28, 2.31)


def test_figures_are_those_of_the_runs(results: Results, short_scenario: pytest.MonkeyPatch) -> None:
    """Run again apart from the script, by the public function, and judged by the public one."""
    rows = {r.name: r.value for r in all_rows(results)}
    log = simulated(TWO_CUTS, SEED)
    blind = dataclasses.replace(log, truth=None)
    for name, method, config in (
        ("figures 7-8, interval 2, ekf paper", "ekf", {"filter": {"preset": "paper"}}),
        ("figures 7-8, interval 2, graph", "batch", {}),
    ):
        found = evaluate(smooth(blind, Config.from_dict(config), method).trajectory, log)
        assert [rows[f"{name}: rms {axis}"] for axis in ("east", "north", "up")] == pytest.approx(found.rms_m.tolist())
        assert rows[f"{name}: mean position NEES"] == pytest.approx(found.nees_position)
    found = evaluate(smooth(blind, Config.from_dict(cases.WITHOUT), "rts").trajectory, log)
    assert rows["no closed path: rms of rts matched, graph beside"] == pytest.approx(found.ate_unaligned_m)


def test_rms_is_over_all_seeds_and_sep_their_median(results: Results) -> None:
    one = results.of_log("interval 2")[0]
    worse = {name: dataclasses.replace(j, rms_3d_m=7 * j.rms_3d_m, sep_m=tuple(9 * s for s in j.sep_m))
             for name, j in one.judged.items()}  # fmt: skip
    three = Results.of([one, one, dataclasses.replace(one, seed=9, judged=worse)])
    own = one.judged["graph"]
    assert three.rms_3d_m("interval 2", "graph") == pytest.approx(own.rms_3d_m * np.sqrt((1 + 1 + 49) / 3))
    assert three.sep_m("interval 2", "graph") == pytest.approx(own.sep_m)


# what was drawn ---------------------------------------------------------------------------------------------


def test_calibration_is_judged_by_what_was_drawn(results: Results, short_scenario: pytest.MonkeyPatch) -> None:
    names = ("gyro_bias_y", "accel_bias_z", "odometer_scale", "odometer_mounting_up")
    errors, mounting = drawn(TWO_CUTS, SEED), world(TWO_CUTS, SEED).mounting_rad
    expected = [
        np.degrees(errors.gyro_bias_rad_s[1]) * 3600, errors.accel_bias_m_s2[2] / 9.80665e-3,
        errors.odometer_scale, np.degrees(mounting[2]),
    ]  # fmt: skip
    assert drawn_values("shearer-mems", SEED, names) == pytest.approx(expected)
    # within 5 sigma of what the graph says of itself
    run = smooth(dataclasses.replace(simulated(TWO_CUTS, SEED), truth=None))
    one = results.of_log("interval 2")[0]
    assert one.known is not None
    for name, known, error in zip(one.names, one.known, one.calibrated["graph"].final, strict=True):
        estimate = run.calibration[name]
        assert estimate.value - known == pytest.approx(error, abs=1e-9)
        assert estimate.sigma is not None and abs(error) < 5 * estimate.sigma


def test_navigation_without_errors_stays_at_the_truth() -> None:
    """Exact sensors and the right calibration: pure inertial within 1 mm after 40 s, dead reckoning within 5 cm."""
    log = simulated(SHORT, 1, noise=False)
    problem = posed(dataclasses.replace(log, truth=None), Config(), Stages(None))
    error = pure_inertial(problem, log, np.zeros(3), np.zeros(3), 40.0)
    assert error.shape == (40, 3)
    assert np.abs(error).max() < 1e-3
    biased = pure_inertial(problem, log, np.zeros(3), np.array([0.01, 0, 0]), 40.0)
    assert np.linalg.norm(biased[-1]) == pytest.approx(0.5 * 0.01 * 40.0**2, rel=0.02)
    known = np.concatenate([[0.0], world(SHORT, 1).mounting_rad])
    assert max(judge(reckoned(problem, np.zeros(3), known), log, False).rms_m) < 0.05
    assert max(judge(reckoned(problem, np.zeros(3), np.zeros(4)), log, False).rms_m) > 0.05


# the page ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def page(results: Results, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("page") / "paper.md"
    write(path, results, draw(results, path.with_suffix("")), Before.now())
    return path


def test_page_shows_its_pictures(page: Path) -> None:
    links = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", page.read_text(encoding="utf-8"))
    assert len(links) == 6
    for link in links:
        picture = page.parent / link
        assert picture.read_bytes()[:4] == b"\x89PNG"
        assert picture.stat().st_size < 120_000


def test_page_says_what_was_measured(page: Path, results: Results) -> None:
    words = page.read_text(encoding="utf-8")
    sep = results.sep_m("interval 2", "graph")
    assert f"| factor graph | {' | '.join(f'{value:.3f}' for value in sep)} |" in words
    assert f"{results.last_scale_error('par 12', 'rts-online matched'):.3f} off with RTS" in words
    assert "nan" not in words and "None" not in words
    tables = [line for line in words.splitlines() if line.startswith("|")]
    assert len(tables) > 60
    assert all(len(line) <= 120 for line in words.splitlines() if line[:1] not in "|!")


def test_paragraphs_are_broken_and_tables_are_not() -> None:
    long = " ".join(["word"] * 60)
    assert filled(f"# {long}\n\n| {long} |\n| x |") == f"# {long}\n\n| {long} |\n| x |"
    lines = filled(f"- {long}\n- short").splitlines()
    assert lines[0].startswith("- word") and lines[1].startswith("  word") and lines[-1] == "- short"


@pytest.mark.parametrize("value, shown", [(None, "-"), (0.01234, "0.0123"), (12.34, "12.3"), (12345.6, "12,346")])
def test_numbers_are_short(value: float | None, shown: str) -> None:
    assert number(value) == shown


# the script -------------------------------------------------------------------------------------------------


def test_wrong_arguments_are_refused() -> None:
    done = python("-m", "benchmarks.papers.mems_odometer", "--seeds", "0", cwd=ROOT)
    assert done.returncode == 2
    assert "at least 1" in done.stderr
    assert not done.stdout


@pytest.mark.slow
def test_script(tmp_path: Path) -> None:
    done = python(
        "-m", "benchmarks.papers.mems_odometer", "--json", "--seeds", "1", "--par-seeds", "0", "--page",
        str(tmp_path / "page.md"), "--figures", str(tmp_path / "pictures"), cwd=ROOT,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout, parse_constant=lambda text: pytest.fail(f"{text} is not JSON"))
    assert found.keys() == {"machine", "versions", "rows"}
    rows = {r["name"]: r for r in found["rows"]}
    for cycle, peer in enumerate(published.PROPOSED, 1):
        assert rows[f"table 3, rts-online paper: SEP of cycle {cycle}"]["peer"] == peer
    assert "pictures/comparison.png" in (tmp_path / "page.md").read_text(encoding="utf-8")
