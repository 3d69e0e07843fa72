"""The reproduction of the IMU/UWB paper, on short logs: rows, page and pictures are of the runs that were made."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from uwb_logs import Errors, passing

from benchmarks._report import Before
from benchmarks.papers import _uwb_cases as cases
from benchmarks.papers import _uwb_published as published
from benchmarks.papers._uwb_cases import CASES, GRAPH, Course, Found, Job
from benchmarks.papers._uwb_figures import draw
from benchmarks.papers._uwb_page import write
from benchmarks.papers._uwb_rows import Results, all_rows, mean_error
from factors import so3
from graphnav.log import SensorLog


@pytest.fixture(scope="module")
def results() -> Results:
    """A short drive stands for both sites; the graph fails."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("graphnav.simulation.simulate", lambda name, seed, site: short(seed))
        patch.setattr(cases, "CASES", CASES | {GRAPH: ("lidar-ekf", {})})
        return Results(tuple(cases.run_job(job) for job in cases.jobs(1, 0, graph=True)))


def short(seed: int) -> SensorLog:
    return passing(seed, Errors(0.013, 0.010, 2.0, 0.003), seconds=24.0, known=False)


def test_jobs_are_both_sites_with_every_seed() -> None:
    todo = list(cases.jobs(2, 3, graph=False))
    assert [(job.site, job.seed) for job in todo] == [(s, k) for s in cases.SITES for k in (3, 4)]
    assert all(GRAPH not in job.cases for job in todo)


def test_a_method_that_fails_has_a_row_that_says_why(results: Results) -> None:
    rows = {one.name: one for one in all_rows(results)}
    (failed,) = (name for name in rows if name.startswith(f"surface, {GRAPH}: failed"))
    assert "no lidar_points table" in failed
    target = rows["surface, graph by UWB alone: mean error x"]
    assert target.met is False
    assert target.value is None


def test_rows_hold_the_runs_figures_beside_the_papers(results: Results) -> None:
    rows = {one.name: one for one in all_rows(results)}
    course = results.courses("surface", "imu-uwb")[0]
    assert rows["surface, imu-uwb: mean error z"].value == pytest.approx(np.abs(course.error_m[:, 2]).mean())
    assert rows["surface, imu-uwb: mean error z"].peer == 0.057
    assert rows["underground, uwb: mean error x"].peer == 0.128
    assert rows["underground, uwb-vbukf: mean error x"].peer is None


def test_targets_of_the_graph_are_judged() -> None:
    course = Course(
        np.arange(3.0), np.zeros((3, 3)), np.full((3, 3), 0.01), np.zeros((3, 3)), np.zeros((3, 3)), (1.0, 1.0), 1.0
    )
    alone = dataclasses.replace(course, error_m=np.full((3, 3), 0.05))
    one = Found("surface", 0, {GRAPH: course, "uwb": alone}, *[np.zeros(1)] * 3, np.zeros(6), (0, 1), np.full(3, 0.01))
    rows = {row.name: row for row in all_rows(Results((one,)))}
    assert rows["surface, graph by UWB alone: mean error x"].ratio == pytest.approx(0.2)
    assert rows["surface, graph by UWB alone: mean error x"].met is True
    assert rows["surface, graph: rms 3-D by the bound"].ratio == pytest.approx(1.0)
    assert rows["surface, graph: attitude NEES"].met is True


def test_a_method_without_use_of_the_ranges_is_no_result() -> None:
    log = dataclasses.replace(short(0), uwb=None)
    assert isinstance(cases.course("uwb", log), str)


def test_angles_are_those_of_the_conventions() -> None:
    yaw, pitch, roll = np.radians([20.0, -10.0, 5.0])
    rotation = so3.exp(np.array([0, 0, yaw])) @ so3.exp(np.array([pitch, 0, 0])) @ so3.exp(np.array([0, roll, 0]))
    assert cases.angles_deg(rotation[None])[0] == pytest.approx([20.0, -10.0, 5.0])


def test_drawn_biases_are_those_of_the_log() -> None:
    from graphnav.simulation import simulate

    log = simulate("face-end-uwb", 3, site="surface")
    known = cases.true_biases(Job("surface", 3, ()))
    gyro = np.degrees(log.imu.gyro_b_rad_s[:900].mean(axis=0)) * 3600
    # at rest: bias, Earth rate of 15 deg/h at most, and white noise of 12 deg/h
    assert gyro == pytest.approx(known[3:], abs=60.0)


def test_page_and_pictures_are_of_these_runs(results: Results, tmp_path: Path) -> None:
    pictures = draw(results, tmp_path / "imu-uwb")
    assert set(pictures) == {f"figure-{k}" for k in (4, 5, 6, 8, 9, 10, 11, 12, 13)}
    page = tmp_path / "imu-uwb.md"
    write(page, results, pictures, "the command", Before.now())
    text = page.read_text(encoding="utf-8")
    x, _, z = results.median("surface", "uwb", mean_error)
    assert f"**{x:.3f} / {z:.3f}**" in text
    assert "the command" in text
    for link in re.findall(r"\]\(([^)]+\.png)\)", text):
        assert (tmp_path / link).exists()
    assert len(re.findall(r"\.png\)", text)) == 9


def test_published_means() -> None:
    assert published.mean("surface", "imu-uwb-vbukf") == (0.022, 0.038)
    assert published.mean("underground", "uwb-vbukf") is None
