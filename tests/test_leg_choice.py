"""Which legs take part: the paper's modes, zones, number and distance, on rows of legs made by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from engine_logs import rows
from leg_logs import SMOOTH, beside_legs, scans

from graphnav.baselines.leg_choice import (
    FRESH,
    MEASURED,
    MODES,
    UNUSED,
    Selection,
    choose,
    goes_forward,
    largest_distance,
)
from graphnav.frontends.cutting_cycles import Cycle

LEGS = np.arange(-12.0, 13.0, 1.5)
NUMBER = np.arange(1, len(LEGS) + 1)
#: A cut to the far end at 0 s, one back from 1 s on.
CUTS = (Cycle(1, 0.0, 1.0, forward=True), Cycle(2, 1.0, 2.0, forward=False))
STANDING = scans(LEGS, NUMBER, np.full(20, 0.2))
MARGIN_M = 0.05


def used(selection: Selection, scan: int, points=STANDING, cycles=CUTS) -> list[float]:
    """Distances ahead of the legs in use in a scan."""
    chosen = choose(points, cycles, selection, MARGIN_M)
    found = chosen.row[scan][chosen.status[scan] != UNUSED]
    return sorted((points.range_m * np.cos(points.angle_rad))[found].round(6).tolist())


# Zones and modes --------------------------------------------------------------------------------------------

#: The paper's table 1 in words: forward, backward.
TABLE_1 = {
    1: ("B", "A"), 2: ("B", "B"), 3: ("B", "AB"), 4: ("AB", "A"), 5: ("AB", "B"), 6: ("AB", "AB"), 7: ("A", "A"),
    8: ("A", "B"), 9: ("A", "AB"),
}  # fmt: skip
#: Nearest three legs of a scanner at 0.2 m by zone, seen from it.
NEAREST = {"A": [1.3, 2.8, 4.3], "B": [-3.2, -1.7, -0.2], "AB": [-1.7, -0.2, 1.3]}


@pytest.mark.parametrize("mode", TABLE_1)
def test_modes_take_the_zones_of_table_1(mode: int) -> None:
    forward, backward = TABLE_1[mode]
    assert used(Selection(3, mode, 0.0), 5) == NEAREST[forward]
    assert used(Selection(3, mode, 0.0), 15) == NEAREST[backward]


def test_table_1_is_complete() -> None:
    assert list(MODES) == list(range(1, 10))
    assert len(set(MODES.values())) == 9


def test_direction_is_that_of_the_last_cut_begun() -> None:
    cuts = (Cycle(1, 10.0, 20.0, forward=True), Cycle(2, 30.0, None, forward=False))
    assert goes_forward(np.array([0.0, 15.0, 25.0, 30.0, 99.0]), cuts).tolist() == [True, True, True, False, False]
    assert goes_forward(np.array([0.0, 5.0]), ()).tolist() == [True, True]


# Number and distance ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 2, 4])
def test_number_of_legs(count: int) -> None:
    assert used(Selection(count, 7, 0.0), 5) == [1.3, 2.8, 4.3, 5.8][:count]


@pytest.mark.parametrize("nearest_m, first", [(0.0, -0.2), (1.0, -1.7), (3.2, -3.2), (9.0, -9.2)])
def test_least_distance(nearest_m: float, first: float) -> None:
    assert used(Selection(1, 2, nearest_m), 5) == [first]


def test_fewer_legs_than_wanted_are_all_used() -> None:
    assert used(Selection(8, 7, 8.0), 5) == [8.8, 10.3, 11.8]


# From scan to scan ------------------------------------------------------------------------------------------


def test_a_leg_is_fresh_once_and_then_measured_until_the_next_one_has_passed() -> None:
    """Driving 6 m past legs 1.5 m apart: behind, at 3 m, every leg is used over just one spacing."""
    points = scans(LEGS, NUMBER, np.arange(0.2, 5.9, 0.01))
    chosen = choose(points, (), Selection(1, 2, 3.0), MARGIN_M)
    assert np.count_nonzero(chosen.status == FRESH) == 4
    assert np.count_nonzero(chosen.status == UNUSED) == 0
    ahead = (points.range_m * np.cos(points.angle_rad))[chosen.row[:, 0]]
    assert ahead.min() > -4.5 - 1e-6 and ahead.max() <= -3.0


def test_legs_keep_their_columns() -> None:
    points = scans(LEGS, NUMBER, np.arange(0.0, 6.0, 0.01))
    chosen = choose(points, (), Selection(3, 2, 0.0), MARGIN_M)
    number = points.feature[chosen.row]
    same = np.diff(number, axis=0) == 0
    assert (chosen.status[1:][same] == MEASURED).all()
    assert (chosen.status[1:][~same] == FRESH).all()
    assert all(len(set(row)) == 3 for row in number.tolist())


def test_noise_at_the_distance_does_not_make_legs_come_and_go() -> None:
    """Creeping past the distance at 1 mm a scan, 1 cm of noise: each of three legs comes into use once."""
    rng = np.random.default_rng(5)
    points = scans(LEGS, NUMBER, np.arange(0.2, 3.2, 0.001))
    noisy = points.replace(range_m=points.range_m + 0.01 * rng.standard_normal(len(points)))
    for mode in (2, 7):
        chosen = choose(noisy, (), Selection(1, mode, 3.0), MARGIN_M)
        assert np.count_nonzero(chosen.status == FRESH) == 3


def test_a_leg_unseen_for_a_moment_keeps_its_place_and_one_long_unseen_does_not() -> None:
    for hole, fresh in ((0.5, 1), (1.5, 2)):
        keep = ~((STANDING.feature == 9) & (STANDING.t_s > 0.2) & (STANDING.t_s <= 0.2 + hole))
        chosen = choose(rows(STANDING, keep), CUTS[:1], Selection(1, 2, 0.0), MARGIN_M)
        assert np.count_nonzero(chosen.status == FRESH) == fresh + (hole > 1.0)


# The paper's step 2 -----------------------------------------------------------------------------------------


def test_the_largest_distance_is_where_supports_have_not_moved() -> None:
    """They move 10.75 m behind, so over one spacing 9.25 m remain, and the paper's 9 m in its steps; with N 3, 6."""
    log = beside_legs()
    assert log.lidar_points is not None
    cut = Cycle(1, 10.0, float(log.events.t_s[1]), forward=True)
    assert largest_distance(log.lidar_points, cut, 1, 1.5) == 9.0
    assert largest_distance(log.lidar_points, cut, 1, None) == 9.0
    assert largest_distance(log.lidar_points, cut, 3, 1.5) == 6.0
    assert largest_distance(log.lidar_points, cut, 8, 1.5) == 0.0


def test_no_leg_passed_no_distance() -> None:
    cut = Cycle(1, 0.0, 2.0, forward=True)
    assert largest_distance(STANDING, dataclasses.replace(cut, start_s=-1.0), 1, 1.5) == 0.0
    assert SMOOTH.lidar is not None and SMOOTH.lidar.supports.lag_m == 10.75
