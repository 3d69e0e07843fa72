"""Creep of a face: by registration and from positions, against truth; what is left out, and what is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from engine_logs import TWO_CUTS, rows, simulated
from roadway_walls import needs_open3d
from scipy import stats

import graphnav as gn
from graphnav import cli
from graphnav.config import Config
from graphnav.creep import with_truth
from graphnav.creep_rows import Creep, CreepRow
from graphnav.errors import GraphnavError, LogError
from graphnav.log import LidarScans, SensorLog
from graphnav.readers import write
from graphnav.run import Run
from graphnav.simulation.lidar_figures import LidarSpec
from graphnav.simulation.scenarios import LIDAR
from graphnav.simulation.shearer import simulate_shearer

#: Three cuts of 30 m at three times the speed, every error drawn, scans at the stops: two advances at either end.
SPEC = replace(
    LIDAR, length_m=30.0, cycles=3, speed_m_s=0.3, static_s=20.0, tail_s=8.0, pause_s=3.0, retreat_m=24.0,
    crossing_m=20.0, end_work_s=None, duration_s=None, att_error_deg=None, mounting_deg=None,
    lidar=LidarSpec(draw=True, scans=True),
)  # fmt: skip
SEEDS = range(2)
ENDS = ("near", "far")


@pytest.fixture(autouse=True)
def _open3d() -> None:
    needs_open3d()


@cache
def _made(seed: int) -> tuple[SensorLog, Run]:
    shift = simulate_shearer("creeping", SPEC, seed)
    return shift, gn.smooth(replace(shift, truth=None))


@cache
def _found(end: str, seed: int) -> Creep:
    return with_truth(gn.creep(log(seed), run(seed), end=end), log(seed))


def log(seed: int = 0) -> SensorLog:
    return _made(seed)[0]


def run(seed: int = 0) -> Run:
    return _made(seed)[1]


def found(end: str = "near", seed: int = 0) -> Creep:
    return _found(end, seed)


def figures(row: CreepRow) -> list[float]:
    return [row.icp_m, row.icp_sigma_m, row.graph_m, row.graph_sigma_m, row.beams, row.residual]


def scans() -> LidarScans:
    kept = log().lidar_scans
    assert kept is not None
    return kept


def without_scans(*cycles_and_kinds: tuple[int, str]) -> SensorLog:
    """The log without the scans around some events."""
    events = log().events
    assert events is not None
    keep = np.ones(len(scans()), bool)
    for cycle, kind in cycles_and_kinds:
        (time_s,) = events.t_s[(events.cycle == cycle) & (events.kind == kind)]
        keep &= np.abs(scans().t_s - time_s) > 12.0
    return replace(log(), lidar_scans=LidarScans(
        t_s=scans().t_s[keep], angle_min_rad=scans().angle_min_rad[keep],
        angle_step_rad=scans().angle_step_rad[keep],
        ranges_m=[scans().ranges_m[row] for row in np.flatnonzero(keep)],
    ))  # fmt: skip


# Against truth -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("end", ENDS)
def test_creep_is_found_to_two_millimetres_by_both(end: str, seed: int) -> None:
    """The aim of the scenario. Sigmas here are 0.3 mm by registration and 0.6 to 0.9 mm from positions."""
    creep = found(end, seed)
    assert [row.cycle for row in creep.rows] == [1, 2]
    assert creep.joint and creep.notes == ()
    for row in creep.rows:
        assert row.icp_error_m is not None and row.graph_error_m is not None
        assert abs(row.icp_error_m) < 1e-3 and abs(row.graph_error_m) < 2e-3
        assert 0.1e-3 < row.icp_sigma_m < 0.6e-3 < 2e-3
        assert 0.1e-3 < row.graph_sigma_m < 1.5e-3
        assert row.beams > 30 and 0.7 < row.residual < 1.4


def test_the_true_creep_is_the_scenarios() -> None:
    """At the near end by definition; a metre's advance and 30 m away the bends of the line add centimetres."""
    assert [row.true_m for row in found("near").rows] == pytest.approx(LIDAR.creep_m[:2], abs=1e-6)
    assert [row.true_m for row in found("far").rows] == pytest.approx(LIDAR.creep_m[:2], abs=0.15)


def test_sigmas_are_right() -> None:
    """Mean square of error by sigma of eight registrations: false-alarm rate 1e-3, taken as independent.

    Those of one log share the face's axis, which makes the alarm more frequent, not less.
    """
    z = np.array([row.icp_error_m / row.icp_sigma_m for s in SEEDS for end in ENDS for row in found(end, s).rows])
    assert len(z) == 8
    low, high = stats.chi2.interval(1 - 1e-3, len(z))
    assert low < (z**2).sum() < high


def test_truth_plays_no_part() -> None:
    blind = gn.creep(replace(log(), truth=None), run())
    for row, seeing in zip(blind.rows, found().rows, strict=True):
        assert row.true_m is None
        assert figures(row) == pytest.approx(figures(seeing), rel=1e-9)  # sums run in several threads


def test_without_a_joint_covariance_sigmas_are_too_large_and_it_is_told() -> None:
    apart = gn.creep(log(), replace(run(), stops=None))
    assert not apart.joint and "no joint covariance" in apart.notes[0]
    for row, joint in zip(apart.rows, found().rows, strict=True):
        assert row.graph_m == pytest.approx(joint.graph_m, abs=1e-5)
        assert row.graph_sigma_m > 2 * joint.graph_sigma_m
        assert row.icp_sigma_m > joint.icp_sigma_m


def test_the_run_need_not_have_used_the_scanner() -> None:
    """Then the declared sigmas of its calibration stand in: the registration is less sure, and as right."""
    bare = gn.smooth(replace(log(), truth=None), Config.from_dict({"lidar": {"use": False}}))
    creep = with_truth(gn.creep(log(), bare), log())
    for row, better in zip(creep.rows, found().rows, strict=True):
        assert row.icp_sigma_m > better.icp_sigma_m
        assert abs(row.icp_error_m) < 4.5 * row.icp_sigma_m  # false-alarm rate 7e-6 each
        assert abs(row.graph_error_m) < 4.5 * row.graph_sigma_m


# Stops -------------------------------------------------------------------------------------------------------


def test_stops_are_the_ends_of_the_cuts_with_what_they_have_in_common() -> None:
    stops, events = run().stops, log().events
    assert stops is not None and events is not None and run().trajectory.cov is not None
    assert np.abs(stops.t_s - events.t_s).max() < 1e-3
    assert stops.cov.shape == (6 * 6 + 8, 6 * 6 + 8)
    at = run().trajectory.at(stops.t_s)
    assert np.abs(at.pos_n - stops.pos_n).max() < 1e-4  # keyframe and event: up to a millisecond apart
    for k in range(6):
        own = stops.cov[6 * k : 6 * k + 6, 6 * k : 6 * k + 6]
        assert np.sqrt(np.diag(own)) == pytest.approx(np.sqrt(np.diag(at.cov[k])[:6]), rel=1e-3)
    # the first two at the far end: centimetres each, millimetres from one to the other
    first, second = slice(9, 11), slice(15, 17)
    apart = stops.cov[first, first] + stops.cov[second, second]
    difference = apart - stops.cov[first, second] - stops.cov[second, first]
    assert np.trace(difference) < 0.02 * np.trace(apart)


def test_stops_of_a_run_of_another_log_are_not_found() -> None:
    stops = run().stops
    assert stops is not None
    late = replace(run(), stops=replace(stops, t_s=stops.t_s + 1.0))
    with pytest.raises(GraphnavError, match=r"no keyframe at 20\.000 s, where a cut .* smooth this log with keyframes"):
        gn.creep(log(), late)


def test_a_run_without_covariances_has_no_sigma_to_give() -> None:
    bare = replace(run(), stops=None, trajectory=replace(run().trajectory, cov=None))
    with pytest.raises(GraphnavError, match="no covariances, so creep would have no sigma; smooth with covariance"):
        gn.creep(log(), bare)


# What cannot be told -----------------------------------------------------------------------------------------


def test_a_stop_without_scans_is_left_out_and_told() -> None:
    creep = gn.creep(without_scans((1, "cut_start")), run())
    assert [row.cycle for row in creep.rows] == [2]
    assert figures(creep.rows[0]) == pytest.approx(figures(found().rows[1]), rel=1e-9)
    (note,) = creep.notes
    assert note.startswith("the stop of cycle 1 is left out: lidar_scans: 0 scans at rest at the stop at 20.0 s")


def test_a_stop_between_others_without_scans_leaves_nothing() -> None:
    with pytest.raises(LogError, match=r"0 scans at rest at the stop at \d+\.\d s, 10 are needed; record scans"):
        gn.creep(without_scans((2, "cut_end")), run())


def test_a_wall_that_is_moved_is_told() -> None:
    """Half a metre of coal is cut off the roadway's wall after the first cycle: both measurements no longer agree."""
    second_s = run().stops.t_s[3]
    ranges = [r + 0.03 * (t > second_s - 5.0) for t, r in zip(scans().t_s, scans().ranges_m, strict=True)]
    creep = gn.creep(replace(log(), lidar_scans=scans().replace(ranges_m=ranges)), run())
    assert any(
        n.startswith("after cycle 1 registration and positions are") and "sigmas apart" in n for n in creep.notes
    )


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"lidar_scans": None}, r"log creeping_seed0, lidar_scans: no scans; record raw scans at the ends"),
        ({"lidar": None}, r"log creeping_seed0, lidar_scans: no scans; .*declare \[lidar\]"),
        ({"face": None}, r"log\.toml, \[face\]: missing; creep is that of a longwall face"),
    ],
    ids=["scans", "lidar", "face"],
)
def test_a_log_that_lacks_something_is_told_so(change: dict[str, None], said: str) -> None:
    with pytest.raises(LogError, match=said):
        gn.creep(replace(log(), **change))


def test_one_cycle_has_no_creep() -> None:
    events = log().events
    assert events is not None
    with pytest.raises(LogError, match=r"events: cycles with a stop at the near end: \[1\]; creep needs two or more"):
        gn.creep(replace(log(), events=rows(events, events.cycle == 1)), run())


def test_an_unknown_end() -> None:
    with pytest.raises(GraphnavError, match='end "left", expected "near" or "far"'):
        gn.creep(log(), end="left")


def test_judging_needs_truth_at_the_stops() -> None:
    truth = log().truth
    assert truth is not None
    with pytest.raises(GraphnavError, match=r"no truth table to judge by; add truth\.parquet"):
        with_truth(found(), replace(log(), truth=None))
    with pytest.raises(GraphnavError, match="truth does not cover all stops at the near end"):
        with_truth(found(), replace(log(), truth=rows(truth, truth.t_s < 300.0)))


# The command -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def shift(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("creep") / "shift"
    write(log(), folder)
    return folder


def test_the_command_prints_json_alone(shift: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["creep", str(shift), "--json", "--end", "far"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert (printed["log"], printed["end"], printed["joint"], printed["notes"]) == ("creeping_seed0", "far", True, [])
    assert [row["cycle"] for row in printed["rows"]] == [1, 2]
    for row, expected in zip(printed["rows"], found("far").rows, strict=True):
        assert row["icp_m"] == pytest.approx(expected.icp_m, abs=2e-5)  # the folder keeps numbers to its own steps
        assert row["icp_error_m"] == pytest.approx(row["icp_m"] - row["true_m"])
        assert row["graph_error_m"] == pytest.approx(row["graph_m"] - row["true_m"])


def test_the_command_shows_a_table(shift: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["creep", str(shift)]) == 0
    out, err = capsys.readouterr()
    assert out == "" and "creep after each cycle" in err and "near end" in err
    for row in found().rows:
        assert f"{row.true_m:.4f}" in err


def test_without_truth_the_command_judges_nothing(
    shift: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(replace(log(), truth=None), tmp_path / "blind")
    assert cli.main(["creep", str(tmp_path / "blind"), "--json"]) == 0
    assert {row["true_m"] for row in json.loads(capsys.readouterr().out)["rows"]} == {None}


def test_the_command_refuses_a_log_without_lidar_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(simulated(TWO_CUTS), tmp_path / "mems")
    assert cli.main(["creep", str(tmp_path / "mems"), "--json"]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1
    assert "lidar_scans: no scans; record raw scans at the ends of the face" in err
