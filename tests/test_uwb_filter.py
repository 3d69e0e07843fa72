"""The paper's filter: its squared-range measurement, consistency where its model holds, and the four methods."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from jacobians import central
from uwb_logs import Errors, passing

import graphnav.compare as compare_module
from factors import so3
from graphnav.baselines.squared_range import decayed, squared_range
from graphnav.cli import main
from graphnav.compare import compare
from graphnav.config import Config
from graphnav.errors import LogError
from graphnav.evaluation import evaluate
from graphnav.log import SensorLog
from graphnav.methods import UWB_METHODS
from graphnav.ranged import range_table
from graphnav.readers import write
from graphnav.run import Run
from graphnav.smooth import smooth

WHITE = Errors(0.02)
AS_SURFACE = Errors(0.013, 0.010, 2.0, 0.003, gyro_bias_deg_h=720.0)


def run_of(log: SensorLog, method: str, **chosen: object) -> Run:
    return smooth(replace(log, truth=None), Config.from_dict({"uwb_filter": chosen}), method)


# The measurement --------------------------------------------------------------------------------------------


def gap(x: np.ndarray, h: np.ndarray | None = None) -> float:
    anchor, tag, lever = np.array([1.1, 0.5, 1.4]), np.array([0.5, 5.0, 0.1]), np.array([0.3, -0.2, -0.4])
    return squared_range(tag, lever, anchor, 4.8, x, np.empty(15) if h is None else h)


@pytest.mark.parametrize("size", [0.0, 0.3])
def test_derivative_of_the_squared_range(size: float) -> None:
    at = size * np.random.default_rng(3).standard_normal(15)
    h = np.empty(15)
    gap(at, h)
    # predicted is measured less the gap
    assert h == pytest.approx(-central(lambda d: np.array([gap(at + d)]), 15)[0], abs=1e-6)


def test_an_error_of_position_is_the_papers_second_order_form() -> None:
    """Equation 22: 2 (p - a) dp + dp^2 in our sign, without range error."""
    shift = np.array([0.4, -0.3, 0.2])
    anchor, tag = np.array([1.1, 0.5, 1.4]), np.array([0.5, 5.0, 0.1])
    x = np.zeros(15)
    x[6:9] = shift
    predicted = (2 * (tag - anchor) + shift) @ shift
    assert gap(np.zeros(15)) - gap(x) == pytest.approx(predicted)


def test_the_lever_arm_turns_with_the_attitude() -> None:
    """To first order the tag is at p + Exp(phi) R l."""
    phi, lever = 1e-5 * np.array([1.0, -2.0, 3.0]), np.array([0.3, -0.2, -0.4])
    x, turned = np.zeros(15), np.zeros(15)
    x[3:6], turned[6:9] = phi, so3.exp(phi) @ lever - lever
    assert gap(x) == pytest.approx(gap(turned), abs=1e-8)


def test_biases_forget_as_a_markov_process_does() -> None:
    x, p, keep = np.ones(15), np.eye(15) + 0.1, np.array([0.9, 0.9, 0.9, 0.5, 0.5, 0.5])
    before = p.copy()
    decayed(keep, x, p)
    whole = np.diag(np.r_[np.ones(9), keep])
    assert x == pytest.approx(np.diag(whole))
    assert p == pytest.approx(whole @ before @ whole)


# Consistency ------------------------------------------------------------------------------------------------


def test_innovations_are_as_large_as_predicted() -> None:
    """White ranges: NIS of all 1,600 within the band of a consistent filter, false alarm 1 in 20, and white."""
    run = run_of(passing(1, WHITE, seconds=40.0), "imu-uwb")
    nis = run.innovations.nis("squared range")
    assert nis.rows == 1600
    assert nis.inside
    assert abs(nis.lag_one) < 5 / np.sqrt(nis.rows)


def test_errors_are_as_large_as_the_covariances_say() -> None:
    """NEES at the last keyframe of 24 logs, position and attitude: chi-square of 72 each, false alarm 1 in 1000."""
    total = np.zeros(2)
    for seed in range(24):
        log = passing(seed, WHITE, seconds=20.0)
        run = run_of(log, "imu-uwb")
        last = evaluate(run.trajectory, log)
        cov = run.trajectory.cov[-1]
        for k, (error, rows) in enumerate(((last.error_n_m[-1], slice(3, 6)), (last.att_error_b_rad[-1], slice(0, 3)))):
            total[k] += error @ np.linalg.solve(cov[rows, rows], error)
    assert (total > 39.0).all()
    assert (total < 116.0).all()


def test_markov_errors_taken_for_white_make_it_too_sure_and_inflating_does_not() -> None:
    white, inflated = (
        np.mean(
            [
                evaluate(run_of(log, "imu-uwb", inflate=inflate).trajectory, log).nees_position
                for log in (passing(seed, AS_SURFACE, seconds=40.0, known=False) for seed in range(4))
            ]
        )
        for inflate in (False, True)
    )
    assert white > 2.0
    assert inflated < 1.5


def test_a_start_without_a_position_ends_where_a_known_one_does() -> None:
    known, unknown = (
        run_of(passing(5, WHITE, seconds=40.0, known=known), "imu-uwb").trajectory for known in (True, False)
    )
    assert unknown.pos_n[-1] == pytest.approx(known.pos_n[-1], abs=0.02)


def test_any_keyframe_spacing_gives_the_same_path() -> None:
    log, ends = passing(2, WHITE, seconds=30.0), []
    for interval_s in (0.1, 1.0, 0.07):
        config = Config.from_dict({"keyframes": {"interval_s": interval_s}})
        ends.append(smooth(replace(log, truth=None), config, "imu-uwb").trajectory.pos_n[-1])
    # rest rows are cut differently, and the error is fed back at other times
    assert np.ptp(ends, axis=0).max() < 5e-3


def test_rest_holds_the_heading() -> None:
    """A gyro bias of 0.2 deg/s: no range tells it to a tag on the IMU's axis."""
    log = passing(4, AS_SURFACE, seconds=60.0)
    with_rest = evaluate(run_of(log, "imu-uwb").trajectory, log)
    config = Config.from_dict({"rest": {"use": False}})
    without = evaluate(smooth(replace(log, truth=None), config, "imu-uwb").trajectory, log)
    assert with_rest.max_deg.max() < 2.5
    assert without.max_deg[2] > 2 * with_rest.max_deg[2]


def test_gate_rejects_delayed_ranges_and_says_how_many() -> None:
    log = passing(6, Errors(0.013, multipath=0.2), seconds=40.0)
    gated, plain = run_of(log, "imu-uwb", gate_sigmas=4.0), run_of(log, "imu-uwb")
    assert 40 < gated.diagnostics.rejected["uwb"] < 90
    assert not plain.diagnostics.rejected
    assert evaluate(gated.trajectory, log).sep_m < 0.7 * evaluate(plain.trajectory, log).sep_m
    assert any("innovations of squared range" in text for text in plain.diagnostics.warnings)


def test_given_time_constants_move_the_biases() -> None:
    log = passing(7, WHITE, seconds=30.0)
    moving, constant = (run_of(log, "imu-uwb", **chosen) for chosen in ({"bias_time_s": 100.0}, {}))
    assert moving.history.sigma[-1, 3:].min() > 3 * constant.history.sigma[-1, 3:].min()


def test_ranges_at_rest_are_calmer_where_that_is_declared() -> None:
    uwb = replace(passing(errors=AS_SURFACE, seconds=12.0).uwb, rest_factor=0.25)
    table = range_table(uwb, inflate=False)
    quick = np.hypot(0.013, 0.010)
    assert table.sigma_m[0] == pytest.approx(np.hypot(quick, 0.003), rel=1e-3)
    assert table.rest_sigma_m[0] == pytest.approx(np.hypot(quick / 4, 0.003), rel=1e-3)
    assert range_table(uwb, inflate=True).sigma_m[0] > 0.06


# The four methods -------------------------------------------------------------------------------------------


def test_all_four_follow_the_machine_and_say_what_they_know() -> None:
    log = passing(0, AS_SURFACE, seconds=40.0, known=False)
    for method in UWB_METHODS:
        run = run_of(log, method)
        found = evaluate(run.trajectory, log)
        assert run.diagnostics.method == method
        assert found.sep_m < 0.2, method
        assert np.isfinite(run.trajectory.cov).all()
        assert (np.linalg.eigvalsh(run.trajectory.cov) > -1e-12).all()
    assert run.diagnostics.nis.keys() == {"all", "position"}


def test_ranges_alone_tell_dilution_and_no_attitude() -> None:
    log = passing(0, WHITE, seconds=20.0)
    run = run_of(log, "uwb")
    (told,) = run.diagnostics.history
    assert told["epochs"] == len(run.trajectory)
    assert told["gdop_median"] == told["pdop_median"] > told["hdop_median"]
    assert evaluate(run.trajectory, log).nees_attitude < 0.01
    assert "ranges alone tell no attitude" in run.diagnostics.warnings[0]
    assert run.trajectory.quat_nb == pytest.approx(np.tile(log.initial.quat_nb_wxyz, (len(run.trajectory), 1)))


def test_ranges_alone_need_no_imu() -> None:
    log = passing(0, WHITE, seconds=20.0)
    run = smooth(replace(log, imu=None, initial=None, truth=None), method="uwb-vbukf")
    assert np.abs(run.trajectory.pos_n - run_of(log, "uwb-vbukf").trajectory.pos_n).max() < 0.1


def test_compare_has_them_by_default_where_there_are_ranges() -> None:
    log = passing(0, WHITE, seconds=20.0)
    assert set(UWB_METHODS) <= set(compare_module._every(log))
    assert not set(UWB_METHODS) & set(compare_module._every(replace(log, uwb=None)))
    rows = compare(log, UWB_METHODS).rows
    assert all(row.converged and row.nees_position is not None for row in rows)
    (refused,) = compare(replace(log, uwb=None), ["imu-uwb"]).rows
    assert "no uwb table" in refused.error


@pytest.mark.parametrize("method", UWB_METHODS)
def test_a_log_without_ranges_is_refused(method: str) -> None:
    with pytest.raises(LogError, match="log passing: no uwb table, which this method needs"):
        smooth(replace(passing(seconds=12.0), uwb=None, truth=None), method=method)


def test_command_line(tmp_path: Path) -> None:
    write(passing(0, AS_SURFACE, seconds=20.0), tmp_path / "log")
    for method in UWB_METHODS:
        assert main(["smooth", str(tmp_path / "log"), "-o", str(tmp_path / method), "--method", method]) == 0
        summary = json.loads((tmp_path / method / "summary.json").read_text(encoding="utf-8"))
        assert summary["method"] == method
