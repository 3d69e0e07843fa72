"""Plaza1: the importer, ranges in the graph of a log without an IMU, and what smoothing makes of the drive."""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path

import gtsam
import numpy as np
import pytest
from jacobians import factor_jacobian
from robot_logs import robot_log

import graphnav as gn
from benchmarks._planar import judge
from factors.carried_ranging import CarriedRanges
from graphnav.errors import LogError, SolveError
from graphnav.evaluation import evaluate
from graphnav.log import SensorLog, Uwb, UwbAnchor, UwbTag
from graphnav.readers import plaza, read, write
from graphnav.run import Run

FILES = (plaza.ODOMETRY_FILE, plaza.RANGE_FILE, plaza.MAT_FILE)


@cache
def log() -> SensorLog:
    return plaza.convert()


@cache
def run() -> Run:
    return gn.smooth(dataclasses.replace(log(), truth=None))


# The importer -----------------------------------------------------------------------------------------------


def test_ranges_and_steps_as_recorded() -> None:
    table = np.loadtxt(gtsam.findExampleDataFile(plaza.RANGE_FILE))
    assert log().uwb.range_m.sum() == pytest.approx(table[:, 3].sum())
    assert (np.diff(log().uwb.t_s) >= 0).all() and (np.diff(table[:, 0]) < 0).sum() == 2
    steps = np.loadtxt(gtsam.findExampleDataFile(plaza.ODOMETRY_FILE))
    # a motion's chord is a little shorter than its arc
    chord = np.linalg.norm(log().relative_pose.pos_m, axis=1)
    np.testing.assert_allclose(chord, np.abs(steps[:, 1]) * np.sinc(steps[:, 2] / 2 / np.pi), atol=1e-12)


def test_start_tells_nothing_of_the_truth() -> None:
    start = log().initial
    np.testing.assert_array_equal(start.quat_nb_wxyz, [1.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(start.pos_n_m, 0.0)
    assert start.att_sigma_deg[2] > 90.0 and (start.pos_sigma_m[:2] >= 1000.0).all()


def test_written_and_read_again(tmp_path: Path) -> None:
    write(log(), tmp_path / "log")
    again = read(tmp_path / "log")
    for name in ("t_s", "range_m", "anchor_id", "tag_id"):
        np.testing.assert_array_equal(getattr(again.uwb, name), getattr(log().uwb, name))
    assert again.uwb.scale_sigma == log().uwb.scale_sigma
    assert [a.id for a in again.uwb.anchor] == [a.id for a in log().uwb.anchor]
    np.testing.assert_array_equal(again.relative_pose.pos_m, log().relative_pose.pos_m)


@pytest.mark.parametrize("missing", FILES)
def test_missing_file_is_named(tmp_path: Path, missing: str) -> None:
    for name in set(FILES) - {missing}:
        (tmp_path / name).write_bytes(Path(gtsam.findExampleDataFile(name)).read_bytes())
    with pytest.raises(LogError, match=missing):
        plaza.convert(tmp_path)


# What smoothing makes of it ---------------------------------------------------------------------------------


def test_position_within_half_a_metre() -> None:
    """The issue's target; measured 0.26 m."""
    assert judge(run(), log()).rms_m < 0.4


def test_the_ranges_show_their_scale() -> None:
    scale = run().calibration["uwb_scale"]
    assert abs(scale.value - 0.066) < 4 * scale.sigma and scale.sigma < 0.005


def test_constants_alone_do_not_explain_the_ranges() -> None:
    """2.8 m on the median, but what is left changes with the distance: the reason for the scale error."""
    uwb = log().uwb.replace(scale_sigma=None)
    other = gn.smooth(dataclasses.replace(log(), uwb=uwb, truth=None))
    biases = [item.value for name, item in other.calibration.items() if name.startswith("uwb_bias")]
    assert 1.5 < np.mean(biases) < 3.2
    assert judge(other, log()).rms_m > 2 * judge(run(), log()).rms_m
    assert other.diagnostics.history[-1]["error"] > run().diagnostics.history[-1]["error"] + 100


@pytest.mark.parametrize("yaw_deg", [90.0, 180.0])
def test_any_declared_heading_leads_to_the_same_path(yaw_deg: float) -> None:
    half = np.radians(yaw_deg / 2)
    turned = log().initial.replace(quat_nb_wxyz=np.array([np.cos(half), 0.0, 0.0, np.sin(half)]))
    other = gn.smooth(dataclasses.replace(log(), initial=turned, truth=None))
    assert np.abs(other.trajectory.pos_n - run().trajectory.pos_n).max() < 0.05


# The factor and drawn ranges --------------------------------------------------------------------------------


def test_residuals_have_these_jacobians() -> None:
    rng = np.random.default_rng(5)
    count = 6
    family = CarriedRanges.of(
        pose_key=np.zeros(count, np.int64), anchor_key=np.full(count, 10), lever_arm_b=rng.normal(size=(count, 3)),
        anchor_n=10 * rng.normal(size=(count, 3)), range_m=rng.uniform(5, 15, count), sigma_m=np.full(count, 0.1),
        markov_key=np.full(count, 20), next_key=np.full(count, 21), slot=np.arange(count) % 2,
        slots=np.full(count, 2), markov_m=rng.uniform(0.1, 0.5, (count, 2)), scale_key=30,
    )  # fmt: skip
    values = gtsam.Values()
    values.insert(0, gtsam.Pose3.Expmap(rng.normal(size=6)))
    values.insert(10, rng.normal(size=4))
    values.insert(20, rng.normal(size=2))
    values.insert(21, rng.normal(size=2))
    values.insert(30, np.array([0.07]))
    (factor,) = family.factors()
    linear = factor.linearize(values)
    assert sorted(linear.keys()) == [0, 10, 20, 21, 30]
    np.testing.assert_allclose(linear.getA(), factor_jacobian(factor, values), atol=1e-5)


def ranged(seed: int, place_known: bool = False) -> SensorLog:
    """A robot among four anchors with constants of 0.3 m, a scale error of 5 % and ranges each tenth of a second."""
    rng = np.random.default_rng(1000 + seed)
    drawn = robot_log(seed, legs="none")
    truth = drawn.truth
    t_s = np.arange(truth.t_s[0] + 0.03, truth.t_s[-1], 0.1)
    pos = np.column_stack([np.interp(t_s, truth.t_s, truth.pos_n_m[:, axis]) for axis in range(3)])
    middle = truth.pos_n_m.mean(axis=0)
    places = middle + np.array([[9.0, 8.0, 0.0], [-8.0, 9.0, 0.0], [-9.0, -7.0, 0.0], [7.0, -9.0, 0.0]])
    which = np.arange(len(t_s)) % 4
    constant = 0.3 * rng.normal(size=4)
    distance = np.linalg.norm(pos - places[which], axis=1)
    range_m = (1 + 0.05 * rng.normal()) * distance + constant[which] + 0.1 * rng.normal(size=len(t_s))
    uwb = Uwb(
        t_s=t_s, tag_id=np.full(len(t_s), "1", dtype=object), anchor_id=which.astype(str).astype(object),
        range_m=range_m, sigma_m=0.1, bias_sigma_m=0.3, scale_sigma=0.05, tag=(UwbTag(id="1"),),
        anchor=tuple(UwbAnchor(id=str(i), pos_n_m=p, sigma_m=1e-3) for i, p in enumerate(places)),
    )  # fmt: skip
    start = drawn.initial
    if not place_known:
        start = start.replace(pos_n_m=np.zeros(3), pos_sigma_m=np.array([1000.0, 1000.0, start.pos_sigma_m[2]]))
    return dataclasses.replace(drawn, uwb=uwb, initial=start)


def test_ranges_by_reflection_are_left_out() -> None:
    """A tenth of the ranges is 3 m too long: nearly these alone are left out, and the path stays."""
    drawn = ranged(3)
    wrong = np.random.default_rng(7).random(len(drawn.uwb)) < 0.1
    bad = drawn.uwb.replace(range_m=drawn.uwb.range_m + 3.0 * wrong)
    clean = gn.smooth(dataclasses.replace(drawn, truth=None))
    found = gn.smooth(dataclasses.replace(drawn, uwb=bad, truth=None))
    rejected = found.diagnostics.rejected
    assert wrong.sum() <= rejected["uwb"] <= wrong.sum() + 4
    assert rejected["uwb"] == sum(n for name, n in rejected.items() if name.startswith("uwb anchor"))
    assert np.abs(found.trajectory.pos_n - clean.trajectory.pos_n).max() < 0.1


def test_a_start_that_nothing_tells_is_refused() -> None:
    with pytest.raises(SolveError, match="place at the start"):
        gn.smooth(dataclasses.replace(ranged(0), uwb=None, truth=None))


def test_drawn_ranges_are_as_good_as_the_covariances_say() -> None:
    """NEES of east and north at one time over 12 runs: 24 degrees of freedom, false alarm 1e-4."""
    from scipy import stats

    total = 0.0
    for seed in range(12):
        drawn = ranged(seed)
        found = gn.smooth(dataclasses.replace(drawn, truth=None))
        middle = len(found.trajectory.t_s) // 2
        judged = evaluate(found.trajectory, drawn)
        row = int(np.argmin(np.abs(judged.t_s - found.trajectory.t_s[middle])))
        error = judged.error_n_m[row, :2]
        total += error @ np.linalg.solve(found.trajectory.at(judged.t_s[row]).cov[0][3:5, 3:5], error)
    low, high = stats.chi2.ppf([5e-5, 1 - 5e-5], 24)
    assert low < total < high
