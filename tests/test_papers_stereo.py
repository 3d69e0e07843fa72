"""The reproduction of the roadheader's paper, on short logs of drawn tracks: rows and page are of the runs made."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks._report import Before
from benchmarks.papers import _vio_cases as cases
from benchmarks.papers import _vio_features as features
from benchmarks.papers import _vio_published as published
from benchmarks.papers._vio_cases import CASES, GRAPH, RAW, Bounded, Course, Found
from benchmarks.papers._vio_figures import draw
from benchmarks.papers._vio_kept import keep, kept
from benchmarks.papers._vio_logs import log_of
from benchmarks.papers._vio_page import write
from benchmarks.papers._vio_rows import Results, all_rows, asked, largest, mean
from benchmarks.papers.roadheader_vio import main
from factors import so3
from graphnav.log import SensorLog
from graphnav.simulation.roadheader import simulate_roadheader
from graphnav.simulation.roadheader_figures import ROADHEADER, TrackSpec

RUN = ("sins", "stereo", "vio-kf", cases.RELATIVE, cases.LOOSE, GRAPH)
PAIRS = 2


def short(seed: int) -> SensorLog:
    """A metre and a half with a turn, tracks in place of images."""
    spec = dataclasses.replace(
        ROADHEADER, static_s=20.0, length_m=1.5, turns_s=(4.0, 200.0), turning_s=4.0, turned_s=1.0, rate_hz=2.0,
        images=False, tracks=TrackSpec(count=40),
    )  # fmt: skip
    return simulate_roadheader("roadheader-stereo", spec, seed)


@pytest.fixture(scope="module")
def found() -> Found:
    """A short drive; the case with raw images fails, the others with enhanced images are left out."""
    chosen = {name: CASES[name] for name in RUN} | {RAW: ("lidar-ekf", {})}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cases, "CASES", chosen)
        one = cases.run_cases(3, short(3))
    kept, true = features.matches(3, PAIRS)
    return dataclasses.replace(one, matched=kept, confirmed=true)


def test_every_method_runs_and_a_failure_has_a_row_that_says_why(found: Found) -> None:
    assert {name for name, one in found.courses.items() if isinstance(one, str)} == {RAW}
    rows = {one.name: one for one in all_rows(Results((found,)))}
    (failed,) = (name for name in rows if name.startswith(f"{RAW}: failed"))
    assert "no lidar_points table" in failed
    assert "batch, enhanced: failed: not measured" in rows


def test_courses_begin_with_the_drive_on_rows_of_truth(found: Found) -> None:
    log = short(3)
    for course in found.courses.values():
        if isinstance(course, Course):
            assert course.t_s[0] >= 20.0
            assert np.abs(log.truth.t_s[:, None] - course.t_s).min(axis=0).max() < 2e-3
            assert len(course.t_s) > 20


def test_errors_are_those_of_the_poses(found: Found) -> None:
    log, course = short(3), found.courses[GRAPH]
    assert isinstance(course, Course)
    rows = np.searchsorted(log.truth.t_s, course.t_s - 1e-3)
    np.testing.assert_allclose(course.pose[:, :3] - course.error[:, :3], log.truth.pos_n_m[rows], atol=1e-9)
    up = so3.from_quaternion(log.truth.quat_nb[rows])[:, :, 1]
    yaw = np.degrees(np.arctan2(-up[:, 0], up[:, 1]))
    np.testing.assert_allclose(course.pose[:, 4] - course.error[:, 4], yaw, atol=1e-6)
    assert np.ptp(yaw) > 10.0


def test_angles_differ_by_less_than_half_a_turn() -> None:
    error = cases.difference(np.full((1, 6), 179.0), np.full((1, 6), -179.0))
    np.testing.assert_allclose(error, [[358.0, 358.0, 358.0, -2.0, -2.0, -2.0]])


def test_errors_are_as_large_as_their_sigmas_say(found: Found) -> None:
    """Six axes of five methods within six sigmas: by chance outside in fewer than one of 10^7 correct programs."""
    for name in ("vio-kf", cases.RELATIVE, cases.LOOSE, GRAPH):
        course = found.courses[name]
        assert isinstance(course, Course)
        assert (np.abs(course.error[-1]) < 6 * course.sigma[-1]).all(), name
    assert found.bound is not None
    graph = found.courses[GRAPH]
    assert isinstance(graph, Course)
    np.testing.assert_allclose(found.bound.sigma[-1], graph.sigma[-1], rtol=0.3)


def test_rows_hold_the_runs_figures_beside_the_papers(found: Found) -> None:
    rows, course = {one.name: one for one in all_rows(Results((found,)))}, found.courses["vio-kf"]
    assert isinstance(course, Course)
    assert rows["vio-kf: largest error z"].value == pytest.approx(np.abs(course.error[:, 2]).max())
    assert rows["vio-kf: largest error z"].peer == 0.0150
    assert rows["sins: largest error yaw"].peer == 1.3589
    assert rows["vio-kf: mean error y"].value == pytest.approx(abs(course.error[:, 1].mean()))
    assert rows["batch, loose: standard deviation pitch"].peer == 0.2413
    assert rows["matched features kept by RANSAC, enhanced"].target == ">= 1.2 x peer"


def flat(size: float, sigma: float) -> Found:
    """Errors and bound that are the same on every axis and at any time."""
    t_s = np.arange(3.0)
    course = Course(t_s, np.zeros((3, 6)), np.full((3, 6), size), np.full((3, 6), sigma), (1.0, 1.0), 1.0)
    return Found(0, {GRAPH: course}, Bounded(t_s, np.full((3, 6), sigma)))


def test_half_of_the_papers_errors_is_asked_or_the_bound() -> None:
    low, high = (asked(Results((flat(0.01, sigma),))) for sigma in (0.001, 0.05))
    assert tuple(low) == published.ASKED
    np.testing.assert_allclose(high, [0.065, 0.065, 0.065, 0.065, 0.53, 0.49])
    rows = {one.name: one for one in all_rows(Results((flat(0.01, 0.001),)))}
    assert [rows[f"graph: largest error {axis}"].met for axis in "xyz"] == [True, True, False]
    assert rows["bound: largest sigma x"].value == pytest.approx(0.001)


def test_figures_are_medians_over_the_seeds() -> None:
    results = Results((flat(0.01, 0.01), flat(-0.02, 0.01), flat(0.5, 0.01)))
    for of in (largest, mean):
        np.testing.assert_allclose(results.median(GRAPH, of), 0.02)
    assert results.nees(GRAPH, 0) == 1.0


def test_asked_figures_are_half_of_the_papers() -> None:
    np.testing.assert_allclose(published.ASKED, np.array(published.LARGEST["vio-kf"]) / 2, rtol=0.02)


def test_logs_are_made_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Made by the renderer where they are not there; tracks that an earlier run has left are forgotten."""
    made = []

    def render(scenario: str, seed: int, options: object, folder: Path) -> None:
        made.append((scenario, seed))
        for side in ("left", "right"):
            (folder / side).mkdir()

    monkeypatch.setattr("graphnav.simulation.stereo_images.render_into", render)
    assert log_of(4, tmp_path).name == "roadheader-stereo_seed4"
    (place,) = tmp_path.iterdir()
    tracks = place / ".graphnav" / "tracks-0.parquet"
    tracks.parent.mkdir()
    tracks.touch()
    log_of(4, tmp_path)
    assert not tracks.exists()
    assert made == [("roadheader-stereo", 4)]


def test_outcomes_are_kept_for_the_same_sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    keep(flat(0.25, 0.01), tmp_path)
    one = kept(0, tmp_path)
    assert one is not None
    np.testing.assert_array_equal(Results((one,)).median(GRAPH, largest), 0.25)
    assert kept(1, tmp_path) is None
    monkeypatch.setattr("benchmarks.papers._vio_kept.sources_id", lambda *folders: "others")
    assert kept(0, tmp_path) is None


def test_no_page_is_made_of_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for arguments, said in ((["--no-runs"], "no outcomes of these sources"), (["--seeds", "0"], "at least 1")):
        with pytest.raises(SystemExit):
            main([*arguments, "--logs", str(tmp_path)])
        assert said in capsys.readouterr().err


def test_page_and_pictures_are_of_these_runs(found: Found, tmp_path: Path) -> None:
    results = Results((found,), {"clahe": 0.5, "retinex-dust": 1.0})
    pictures = draw(results, features.shown(3, PAIRS), tmp_path / "roadheader-vio")
    assert set(pictures) == {"figure-8", "figure-9", "figure-14", "way", "errors-filter", "errors-graph"}
    page = tmp_path / "roadheader-vio.md"
    write(page, results, pictures, "the command", Before.now())
    text = page.read_text(encoding="utf-8")
    ours = results.median(GRAPH, largest)
    assert f"**{ours[2]:.4f}**" in text
    assert "the command" in text
    assert "graph, tight, raw images failed: " in text
    links = re.findall(r"\]\(([^)]+\.png)\)", text)
    assert len(links) == 6
    assert all((tmp_path / link).exists() for link in links)
