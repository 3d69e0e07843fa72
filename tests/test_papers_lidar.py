"""The reproduction of the INS/LiDAR paper, on short logs: rows, page and pictures are of the runs that were made."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from leg_logs import SMOOTH, beside_legs
from tree import ROOT, python

from benchmarks._report import Before
from benchmarks.papers import _lidar_cases as cases
from benchmarks.papers import _lidar_published as published
from benchmarks.papers import _lidar_text as text
from benchmarks.papers import _lidar_worlds as worlds
from benchmarks.papers._lidar_cases import AS_PUBLISHED, FILTER, GRAPH, Found, Job
from benchmarks.papers._lidar_figures import draw
from benchmarks.papers._lidar_kept import keep, kept
from benchmarks.papers._lidar_page import write
from benchmarks.papers._lidar_rows import Results, all_rows, budget, largest
from benchmarks.papers.lidar_ins import taken
from factors import so3
from factors.so3 import from_quaternion
from graphnav.baselines.leg_choice import MODES
from graphnav.config import Config
from graphnav.errors import LogError
from graphnav.evaluation import evaluate
from graphnav.simulation.scenarios import LIDAR
from graphnav.simulation.sensors import earth_rate_n
from graphnav.smooth import smooth

SEED = 3
#: The scenario as it is, on less: 3 cuts of 24 m at 0.3 m/s.
THREE_CUTS = dataclasses.replace(
    LIDAR, length_m=24.0, cycles=3, speed_m_s=0.3, static_s=10.0, tail_s=5.0, retreat_m=6.0, crossing_m=4.0,
    end_work_s=None, duration_s=None, creep_m=(-0.1, -0.1),
)  # fmt: skip


@pytest.fixture(scope="module")
def short_worlds() -> Iterator[pytest.MonkeyPatch]:
    """Cuts of 24 m stand for all worlds: everything is run as it is, on less."""
    with pytest.MonkeyPatch.context() as patch:
        for world in ("comparison_world", "quiet_world", "selection_world"):
            patch.setattr(worlds, world, lambda seed: beside_legs(THREE_CUTS, seed))
        patch.setattr(worlds, "scenario", lambda seed, scans: beside_legs(THREE_CUTS, seed))
        patch.setattr(published, "MODES", ((1, 2, 0.0), (3, 4, 0.0)))
        patch.setattr(published, "NUMBERS", ((2, 2, 0.0),))
        patch.setattr(text, "LENGTH_M", THREE_CUTS.length_m)
        patch.setattr(text, "_SETTLED_S", 30.0)
        yield patch


@pytest.fixture(scope="module")
def results(short_worlds: pytest.MonkeyPatch) -> Results:
    jobs = [job for job in cases.jobs(1, SEED) if job.world not in ("modes", "numbers", "distances")]
    found = Results.of([cases.run_job(job) for job in jobs])
    assert not found.failed
    return found


# What is run ------------------------------------------------------------------------------------------------


def test_jobs_are_different_and_the_graph_comes_last() -> None:
    todo = list(cases.jobs(3, 5))
    assert len(set(todo)) == len(todo) == 4 + 3 * 3 + 1 + 3 * 2
    parts = [job.part for job in todo]
    assert parts == sorted(parts)
    assert {job.world for job in todo} == {
        "paper", "quiet", "scenario", "modes", "numbers", "distances", "correction",
    }  # fmt: skip


def test_the_papers_settings() -> None:
    """Sections 5.1 to 5.3."""
    assert [mode for _, mode, _ in published.MODES] == list(MODES)
    assert {(count, distance) for count, _, distance in published.MODES} == {(3, 0.0)}
    assert published.NUMBERS == ((1, 2, 0.0), (2, 2, 0.0), (3, 2, 0.0), (4, 2, 0.0))
    assert {(c, m) for c, m, _ in published.DISTANCES} == {(1, 2)}
    assert (published.DISTANCES[0][2], published.DISTANCES[-1][2]) == (0.0, 7.5)
    assert (published.CORRECTED, published.COMPARED) == ((1, 2, 7.5), (1, 2, 9.0))
    assert published.largest(published.TRADITIONAL) == (0.636, 0.188, 0.336)
    assert published.largest(published.IMPROVED) == (0.457, 0.181, 0.268)
    assert published.largest(published.PROPOSED) == (0.188, 0.188, 0.082)


def test_every_method_is_blind(short_worlds: pytest.MonkeyPatch, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[bool] = []

    def watched(log: object, *arguments: object) -> object:
        seen.append(getattr(log, "truth", 0) is None)
        return smooth(log, *arguments)

    monkeypatch.setattr("graphnav.smooth.smooth", watched)
    assert isinstance(cases.run_job(Job("correction", SEED)), Found)
    assert seen == [True] * 3


def test_a_run_that_fails_is_counted(short_worlds: pytest.MonkeyPatch, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*arguments: object) -> None:
        raise LogError("no such luck", where="here")

    monkeypatch.setattr("graphnav.smooth.smooth", fails)
    outcome = cases.run_job(Job("paper", SEED, GRAPH))
    assert isinstance(outcome, str)
    assert "paper, seed 3, graph" in outcome
    assert [(r.name, r.value, r.met) for r in all_rows(Results.of([outcome]))] == [("runs that failed", 1.0, False)]


# The paper's world ------------------------------------------------------------------------------------------


def test_the_papers_world_has_the_errors_it_states() -> None:
    """A minute at rest: the attitude error is stated, the gyro shows the Earth as it seems from there, and drifts up.

    Against white noise: 5 sigma, on three axes a false-alarm rate of 2e-6.
    """
    like = dataclasses.replace(SMOOTH, length_m=6.0, cycles=1, creep_m=(), static_s=60.0, duration_s=60.0,
                               att_error_deg=(0.18 / 60, -0.13 / 60, 20.9 / 60))  # fmt: skip
    log = worlds.paper_world(like, 1)
    declared, true = from_quaternion(log.initial.quat_nb_wxyz), from_quaternion(log.truth.quat_nb[0])
    assert np.degrees(so3.log(true.T @ declared)) * 60 == pytest.approx([0.18, -0.13, 20.9], abs=0.02)
    shown = np.degrees(log.imu.gyro_b_rad_s[:5000].mean(axis=0) - declared.T @ earth_rate_n(like.latitude_deg)) * 3600
    white = np.degrees(log.imu.gyro_b_rad_s[:5000].std(axis=0)) * 3600 / np.sqrt(5000)
    assert np.abs(shown[:2]) == pytest.approx([0.0, 0.0], abs=5 * white.max())
    assert shown[2] == pytest.approx(worlds.UP_BIAS_DEG_H, abs=5 * white.max() + 0.01)
    assert (log.odometer.scale_sigma, log.odometer.slip_sigma_m_s) == (like.scale_sigma, like.slip_sigma_m_s)


# Figures ----------------------------------------------------------------------------------------------------


def test_rows_have_their_form(results: Results) -> None:
    rows = all_rows(results)
    assert len({r.name for r in rows}) == len(rows)
    for r in rows:
        assert r.value is not None and np.isfinite(r.value), r
        assert (r.met is None) == (r.target is None), r
    targets = {r.target for r in rows} - {None}
    assert targets == {"<= 0", "<= 1.5 x peer", "<= 0.1 m", "<= 0.05 m", "<= 0.002 m"}
    of_ratio = [r.name for r in rows if r.target == "<= 1.5 x peer"]
    assert all(name.startswith("table 3, paper") for name in of_ratio)
    assert len(of_ratio) == 4 * 3 * 3


def test_rows_of_figure_7_are_told_apart(selected: Results, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its sets of selections share some."""
    monkeypatch.setattr(published, "MODES", tuple((3, mode, 0.0) for mode in range(1, 10)))
    monkeypatch.setattr(published, "NUMBERS", ((1, 2, 0.0),))
    names = [r.name for r in all_rows(selected) if r.name.startswith("figure 7")]
    assert len(set(names)) == len(names) == 9 * (9 + 1 + 6)


def test_figures_are_those_of_the_runs(results: Results) -> None:
    """Run again apart from the script, and judged by the public function."""
    rows, log = {r.name: r.value for r in all_rows(results)}, beside_legs(THREE_CUTS, SEED)
    for name, method, config in (
        (AS_PUBLISHED, "lidar-ekf", cases.chosen(1, 2, 9.0)),
        (GRAPH, "batch", cases._UPRIGHT),
    ):
        run = smooth(dataclasses.replace(log, truth=None), Config.from_dict(config), method)
        found = evaluate(run.trajectory, log)
        most = np.max([cycle.max_m for cycle in found.per_cycle], axis=0)
        shown = [rows[f"table 3, paper seed 3, {name}: largest {axis}"] for axis in ("east", "north", "up")]
        assert shown == pytest.approx(most.tolist())
        assert rows[f"table 3, paper seed 3, {name}: mean position NEES"] == pytest.approx(found.nees_position)


def test_the_budget_is_of_one_zone() -> None:
    """North of the paper's table 3 at its first arrival is 0.125 m."""
    behind, ahead = (budget((1, mode, 9.0), 350.0) for mode in (2, 7))
    assert behind is not None and ahead is not None
    assert behind[1] == pytest.approx(0.125, abs=0.01)
    assert ahead[1] > 5 * behind[1]
    assert budget((3, 4, 0.0), 350.0) is None


def test_parts_of_a_log_are_joined(results: Results) -> None:
    one = results.first("paper")
    assert one is not None and one.courses.keys() >= {AS_PUBLISHED, FILTER, GRAPH}
    graph = dataclasses.replace(one, courses={GRAPH: one.courses[GRAPH]})
    other = dataclasses.replace(one, courses={FILTER: one.courses[FILTER]})
    (joined,) = Results.of([graph, other]).found
    assert joined.courses.keys() == {GRAPH, FILTER}


# Kept outcomes ----------------------------------------------------------------------------------------------


def test_kept_outcomes_come_back(results: Results, tmp_path: Path) -> None:
    one, job = results.first("paper"), Job("paper", SEED)
    assert one is not None and kept(job, tmp_path) is None
    keep(job, one, tmp_path)
    keep(Job("quiet", SEED), "no such luck", tmp_path)
    back = kept(job, tmp_path)
    assert isinstance(back, Found)
    assert back.cuts == one.cuts and back.icp_m is None
    for name, course in one.courses.items():
        again = back.courses[name]
        assert largest(again) == pytest.approx(largest(course), abs=1e-6)
        assert again.error_m == pytest.approx(course.error_m, abs=1e-6)
        assert (again.told, again.nees_position) == (course.told, course.nees_position)
    assert taken([job, Job("quiet", SEED), Job("scenario", SEED)], tmp_path).keys() == {job, Job("quiet", SEED)}
    assert kept(Job("quiet", SEED), tmp_path) == "no such luck"


# The page ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def selected(results: Results, short_worlds: pytest.MonkeyPatch) -> Results:
    """With stand-ins for figure 7, whose selections all run the same code."""
    with pytest.MonkeyPatch.context() as patch:
        for name, of in (("MODES", (3, range(1, 10))), ("NUMBERS", (1, (2,)))):
            patch.setattr(published, name, tuple((of[0], mode, 0.0) for mode in of[1]))
        one = results.first("correction")
        assert one is not None
        course = one.courses[FILTER]
        astray = dataclasses.replace(course, stop_m=course.stop_m + 1.0)
        figure_7 = [
            dataclasses.replace(
                one, world=world, courses={cases.label(s): course if s[1] in (2, 7) else astray for s in chosen}
            )
            for world, chosen in (
                ("modes", published.MODES), ("numbers", published.NUMBERS), ("distances", published.DISTANCES),
            )
        ]  # fmt: skip
    return Results((*results.found, *figure_7), ())


@pytest.fixture(scope="module")
def page(selected: Results, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("page") / "paper.md"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(published, "MODES", tuple((3, mode, 0.0) for mode in range(1, 10)))
        patch.setattr(published, "NUMBERS", ((1, 2, 0.0),))
        write(path, selected, draw(selected, path.with_suffix("")), Before.now())
    return path


def test_page_shows_its_pictures(page: Path) -> None:
    links = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", page.read_text(encoding="utf-8"))
    assert len(links) == 3
    for link in links:
        picture = page.parent / link
        assert picture.read_bytes()[:4] == b"\x89PNG"
        assert picture.stat().st_size < 250_000


def test_page_says_what_was_measured(page: Path, results: Results) -> None:
    words = page.read_text(encoding="utf-8")
    one = results.first("paper")
    assert one is not None
    shown = " / ".join(f"{value:.3f}" for value in largest(one.courses[GRAPH]))
    assert f"| factor graph | - | **{shown}** |" in words
    assert "*0.188 / 0.188 / 0.082*" in words
    assert "nan" not in words and "None" not in words
    assert all(len(line) <= 120 for line in words.splitlines() if line[:1] not in "|!")


def test_page_makes_do_with_what_is_there(results: Results, tmp_path: Path) -> None:
    one = results.first("paper")
    assert one is not None
    alone = Results((dataclasses.replace(one, courses={k: v for k, v in one.courses.items() if k != GRAPH}),), ("x",))
    write(tmp_path / "page.md", alone, draw(alone, tmp_path / "page"), Before.now())
    words = (tmp_path / "page.md").read_text(encoding="utf-8")
    assert "Runs that failed: x." in words
    assert "| factor graph |" not in words and "Figure 7:" not in words


# The script -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "arguments, words", [(["--seeds", "0"], "at least 1"), (["--no-runs"], "--no-runs needs --kept")]
)
def test_wrong_arguments_are_refused(arguments: list[str], words: str) -> None:
    done = python("-m", "benchmarks.papers.lidar_ins", *arguments, cwd=ROOT)
    assert done.returncode == 2
    assert words in done.stderr
    assert not done.stdout
