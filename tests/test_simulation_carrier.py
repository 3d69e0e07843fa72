"""UWB anchors on a carrier at the near end of a face: reach, steps and what is declared of them.

Statistical bounds are two-sided with a false-alarm rate of 1e-5 each; seeds are fixed.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from graphnav.log import SensorLog
from graphnav.simulation import simulate
from graphnav.simulation.carrier import carried
from graphnav.simulation.naming import parse_name
from graphnav.simulation.scenarios import MEMS, resolve
from graphnav.simulation.shearer import simulate_shearer
from graphnav.simulation.uwb_truth import uwb_truth
from graphnav.simulation.world import World, build_world, streams

FALSE_ALARM = 1e-5
OPTIONS = {"sensors": ("imu", "odometer", "uwb")}


@cache
def clean() -> SensorLog:
    return simulate_shearer("clean", resolve("shearer-mems", OPTIONS), 2, noise=False)


@cache
def world() -> World:
    of = streams(2)
    return build_world(MEMS, of.geometry, of.machine)


def assert_unit_normal(draws: np.ndarray) -> None:
    """Zero mean and unit variance, each within its bounds."""
    draws = np.ravel(draws)
    assert abs(draws.mean()) < stats.norm.isf(FALSE_ALARM / 2) / np.sqrt(len(draws))
    low, high = stats.chi2.interval(1 - FALSE_ALARM, len(draws))
    assert low < np.sum(draws**2) < high


def test_error_free_ranges_reach_from_the_tag_to_the_declared_anchors() -> None:
    uwb, truth = clean().uwb, clean().truth
    on_sample = np.abs(uwb.t_s * 100 - np.round(uwb.t_s * 100)) < 1e-6
    row = np.round(uwb.t_s[on_sample] * 100).astype(int)
    rot = Rotation.from_quat(truth.quat_nb[row], scalar_first=True)
    places = {anchor.id: anchor.pos_n_m for anchor in uwb.anchor}
    anchor_n = np.array([places[name] for name in uwb.anchor_id[on_sample]])
    distance = np.linalg.norm(truth.pos_n_m[row] + rot.apply([0, 0, -0.3]) - anchor_n, axis=1)
    np.testing.assert_allclose(uwb.range_m[on_sample], distance, rtol=0, atol=1e-11)
    assert 9.9 < uwb.range_m.max() <= 10.0
    assert uwb.range_m.min() > 0.5


def test_every_place_of_the_carrier_has_its_time_its_ids_and_its_group() -> None:
    uwb, events = clean().uwb, clean().events
    place = np.array([int(name.partition(".")[2] or 1) for name in uwb.anchor_id])
    assert (np.diff(place) >= 0).all()
    starts = events.t_s[events.kind == "cut_start"]
    for number, start_s in zip((2, 4), starts[[1, 3]], strict=True):
        # cuts 2 and 4 start at the far end: their carriers are first heard when the machine comes back
        if (place == number).any():
            assert uwb.t_s[place == number].min() > start_s
    step_s = uwb.t_s[place == 3].min()
    assert starts[2] - MEMS.pause_s < step_s < starts[2]
    groups = {anchor.id: anchor.group for anchor in uwb.anchor}
    assert len(groups) == 16
    assert groups["1"] is None
    assert groups["3.2"] == "2"
    assert (uwb.group_sigma_m, uwb.group_turn_sigma_deg) == (0.03, 0.5)
    by_id = {anchor.id: anchor.pos_n_m for anchor in uwb.anchor}
    assert np.linalg.norm(by_id["2.3"] - by_id["2"]) == pytest.approx(0.8)  # two pushes


def test_places_are_off_by_the_declared_displacement_turn_and_survey() -> None:
    moves, turns, surveys = [], [], []
    for seed in range(150):
        spec = resolve("shearer-mems", OPTIONS).ranging
        rigid = carried(world(), replace(spec, survey_m=1e-9), np.random.default_rng(seed), 1.0)
        whole = carried(world(), spec, np.random.default_rng(seed), 1.0)
        declared = np.array([anchor.pos_n_m for anchor in rigid.declared]).reshape(rigid.pos_n_m.shape)
        np.testing.assert_allclose(rigid.pos_n_m[0], declared[0], rtol=0, atol=1e-8)
        surveys.append((whole.pos_n_m - rigid.pos_n_m) / 0.005)
        for true, told in zip(rigid.pos_n_m[1:], declared[1:], strict=True):
            moves.append((true - told).mean(axis=0) / 0.03)
            body, shape = true - true.mean(axis=0), told - told.mean(axis=0)
            turn, _ = Rotation.align_vectors(body, shape)
            np.testing.assert_allclose(turn.apply(shape), body, rtol=0, atol=1e-8)  # rigid
            turns.append(turn.as_rotvec(degrees=True) / 0.5)
    assert_unit_normal(np.array(surveys))
    assert_unit_normal(np.array(moves))
    assert_unit_normal(np.array(turns)[:, 2])
    assert np.abs(np.array(turns)[:, :2]).max() < 1e-6


def test_ranges_are_true_distances_with_the_errors_told_for_scoring() -> None:
    log, truth = simulate("shearer-mems", 4, **OPTIONS), uwb_truth("shearer-mems", 4, **OPTIONS)
    np.testing.assert_array_equal(log.uwb.anchor_id, truth.anchor_id)
    np.testing.assert_allclose(log.uwb.range_m, truth.distance_m + truth.total_m, rtol=0, atol=1e-9)
    found = parse_name(log.name)
    assert (found.scenario, found.seed, found.options) == ("shearer-mems", 4, OPTIONS)


def test_uwb_changes_nothing_else() -> None:
    plain = simulate("shearer-mems", 4)
    with_uwb = simulate("shearer-mems", 4, sensors="imu,odometer,closed-path,uwb")
    assert plain.uwb is None
    np.testing.assert_array_equal(plain.imu.gyro_b_rad_s, with_uwb.imu.gyro_b_rad_s)
    np.testing.assert_array_equal(plain.odometer.speed_m_s, with_uwb.odometer.speed_m_s)
