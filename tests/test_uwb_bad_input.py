"""UWB logs that are wrong or too poor: each is handled, or refused in clear words."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from uwb_logs import ANCHORS, passing

import graphnav as gn
from graphnav.config import Config
from graphnav.errors import LogError
from graphnav.evaluation import evaluate
from graphnav.frontends.range_faults import faults
from graphnav.frontends.units import check_units
from graphnav.log import SensorLog
from graphnav.run import Run
from graphnav.simulation import simulate


def smoothed(log: SensorLog) -> Run:
    return gn.smooth(replace(log, truth=None))


def with_ranges(log: SensorLog, range_m: np.ndarray, **declared: object) -> SensorLog:
    assert log.uwb is not None
    return replace(log, uwb=replace(log.uwb, range_m=range_m, **declared))


def off(log: SensorLog, anchor: str, by_m: float) -> np.ndarray:
    """Ranges, those of one anchor off."""
    assert log.uwb is not None
    return log.uwb.range_m + np.where(log.uwb.anchor_id == anchor, by_m, 0.0)


def test_two_anchors_without_a_start_are_refused() -> None:
    with pytest.raises(LogError, match="2 anchors, a position from ranges alone needs 3"):
        smoothed(passing(anchors=ANCHORS[:2], known=False))


def test_two_anchors_with_a_known_start_serve() -> None:
    log = passing(1, anchors=ANCHORS[:2])
    without = gn.smooth(replace(log, truth=None), Config.from_dict({"uwb": {"use": False}}))
    run = smoothed(log)
    rms = [rms_m(each, log) for each in (run, without)]
    assert rms[0] < 0.5 * rms[1]
    (line,) = run.diagnostics.warnings
    assert "the 2 UWB anchors heard lie on one line" in line


def test_what_three_anchors_on_a_line_cannot_tell_is_said() -> None:
    line = np.array([1.0, 0.0, 1.0]) + np.outer(np.arange(3), [0.5, 1.0, 0.2])
    for method in ("batch", "imu-uwb"):
        run = gn.smooth(replace(passing(seconds=30.0, anchors=line), truth=None), method=method)
        assert any("the 3 UWB anchors heard lie on one line" in each for each in run.diagnostics.warnings)


def test_too_few_together_are_told_to_declare_a_position() -> None:
    log = passing(seconds=20.0, known=False)
    assert log.uwb is not None
    rows = np.isin(log.uwb.anchor_id, ["1", "2"])
    columns = {name: getattr(log.uwb, name)[rows] for name in ("t_s", "tag_id", "anchor_id", "range_m")}
    with pytest.raises(LogError, match=r"no three anchors answer together.*declare pos_n_m and pos_sigma_m"):
        smoothed(replace(log, uwb=replace(log.uwb, **columns)))


@pytest.mark.parametrize(("per_metre", "refused"), [(100.0, True), (1000.0, True), (1.0, False)])
def test_ranges_in_another_unit_are_refused(per_metre: float, refused: bool) -> None:
    for log in (passing(seconds=20.0), passing(seconds=20.0, tag_start=(1.0, 40.0, 0.0))):
        assert log.uwb is not None
        found = check_units(with_ranges(log, log.uwb.range_m * per_metre), np.zeros((0, 2)))
        assert len(found) == refused
        assert not refused or "divide ranges in cm by 100" in found[0]


def test_anchors_a_metre_off_are_no_other_unit() -> None:
    log = passing(seconds=20.0)
    for anchor in ("1", "2", "3", "4"):
        assert check_units(with_ranges(log, off(log, anchor, 2.0)), np.zeros((0, 2))) == []


@pytest.mark.parametrize("name", ["anchor", "tag"])
def test_an_id_that_is_declared_twice_is_refused(name: str) -> None:
    log = passing(seconds=20.0)
    assert log.uwb is not None
    declared = getattr(log.uwb, name)
    with pytest.raises(LogError, match=rf'{name} "1" is declared twice.*keep one'):
        replace(log.uwb, **{name: (*declared, declared[0])})


def test_methods_without_ranges_say_so() -> None:
    run = gn.smooth(replace(passing(seconds=20.0), truth=None), method="ekf")
    assert "ekf does not use the table uwb: batch, isam2 and imu-uwb do" in run.diagnostics.warnings


def test_anchors_on_a_line_without_a_start_are_refused() -> None:
    line = np.array([1.0, 0.0, 1.0]) + np.outer(np.arange(4), [0.5, 1.0, 0.2])
    with pytest.raises(LogError, match="the anchors lie on one line"):
        smoothed(passing(anchors=line, known=False))


def test_anchors_in_a_plane_without_a_start_are_refused() -> None:
    flat = ANCHORS * [1, 1, 0] + [0, 0, 2.0]
    with pytest.raises(LogError, match="two mirrored positions"):
        smoothed(passing(anchors=flat, known=False))


def test_a_range_of_zero_is_refused_by_its_row() -> None:
    log = passing(seconds=20.0)
    assert log.uwb is not None
    ranges = log.uwb.range_m.copy()
    ranges[7] = 0.0
    with pytest.raises(LogError, match="row 8"):
        with_ranges(log, ranges)


def test_a_range_of_ten_kilometres_is_left_out() -> None:
    log = passing(2, seconds=30.0)
    assert log.uwb is not None
    ranges = log.uwb.range_m.copy()
    ranges[500] = 10_000.0
    run, clean = smoothed(with_ranges(log, ranges)), smoothed(log)
    assert run.diagnostics.rejected["uwb"] >= 1
    assert np.abs(run.trajectory.pos_n - clean.trajectory.pos_n).max() < 2e-3


@pytest.fixture(scope="module")
def clean() -> tuple[SensorLog, float]:
    """A sound log, and the rms error of its path."""
    log = passing(3)
    return log, rms_m(smoothed(log), log)


def rms_m(run: Run, log: SensorLog) -> float:
    return float(np.linalg.norm(evaluate(run.trajectory, log).rms_m))


@pytest.mark.parametrize(("anchor", "by_m"), [("1", 1.0), ("2", 1.0), ("4", 1.0)])
def test_an_anchor_a_metre_off_is_named(clean: tuple[SensorLog, float], anchor: str, by_m: float) -> None:
    """Left out where the others agree without it, else its constant is estimated; the path is right."""
    log, rms = clean
    run = smoothed(with_ranges(log, off(log, anchor, by_m)))
    (line,) = run.diagnostics.warnings
    assert f"ranges of UWB anchor {anchor} disagree" in line or f"ranges of UWB anchor {anchor} contradicted" in line
    assert rms_m(run, log) < 3 * rms
    if "contradicted" in line:
        bias = run.calibration[f"uwb_bias_{anchor}"]
        assert bias.sigma is not None
        assert abs(bias.value - by_m) < 4 * bias.sigma


def test_two_anchors_off_are_told_and_no_third_is_blamed(clean: tuple[SensorLog, float]) -> None:
    log, _ = clean
    wrong = off(with_ranges(log, off(log, "1", 1.0)), "4", -1.0)
    (line,) = smoothed(with_ranges(log, wrong)).diagnostics.warnings
    assert "UWB ranges contradict each other (" in line
    assert "which anchor is wrong these ranges do not tell" in line


def test_at_the_face_end_the_mirror_image_is_seen_through() -> None:
    """Without anchor 4 the others put the machine on their other side, 2 m off."""
    log = simulate("face-end-uwb", seed=1, site="underground")
    run = smoothed(with_ranges(log, off(log, "4", 1.0)))
    bias = run.calibration["uwb_bias_4"]
    assert bias.sigma is not None
    assert abs(bias.value - 1.0) < 4 * bias.sigma
    assert "UWB anchor 4 contradicted all others" in run.diagnostics.warnings[0]


@pytest.mark.parametrize(("anchor", "by_m"), [(0, 1.0), (3, -0.6)])
def test_positions_alone_tell_the_anchor_and_its_constant(anchor: int, by_m: float) -> None:
    """To a tenth of a metre: what is left are medians and the machine's way within a second."""
    log = passing(4, seconds=40.0)
    found = faults(with_ranges(log, off(log, str(anchor + 1), by_m)), None)
    assert found[0].anchor == anchor
    assert abs(found[0].bias_m - by_m) < 0.1


def test_of_three_anchors_none_can_be_told() -> None:
    log = passing(4, seconds=20.0, anchors=ANCHORS[:3])
    assert faults(with_ranges(log, off(log, "1", 1.0)), np.array([0.5, 7.0, 0.0])) == []


def test_healthy_ranges_do_not_contradict_each_other() -> None:
    """Multipath of one anchor and all."""
    assert smoothed(simulate("face-end-uwb", seed=0, site="underground")).diagnostics.warnings == []


@pytest.mark.parametrize("anchor", ["1", "3"])
def test_ranges_of_one_anchor_a_metre_off_are_estimated_where_declared(anchor: str) -> None:
    log = passing(3)
    run = smoothed(with_ranges(log, off(log, anchor, 1.0), bias_sigma_m=0.5))
    bias = run.calibration[f"uwb_bias_{anchor}"]
    assert bias.sigma is not None
    assert abs(bias.value - 1.0) < 4 * bias.sigma
    assert run.diagnostics.rejected.get("uwb", 0) < 0.01 * len(run.trajectory) * 40
    assert run.diagnostics.warnings == []


@pytest.mark.slow
def test_a_second_path_that_fits_as_well_is_told() -> None:
    """Constants of a metre, a start that is not known: two paths 2 m apart, of the same likelihood."""
    log = simulate("face-end-uwb", seed=5, site="underground")
    (line,) = smoothed(with_ranges(log, off(log, "3", 1.0), bias_sigma_m=1.0)).diagnostics.warnings
    assert "UWB ranges fit another path as well, 2." in line
