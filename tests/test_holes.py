"""Long silence of a sensor is told where it should have been heard, and nowhere else."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from uwb_logs import ANCHORS, passing

from graphnav.holes import leg_hole, range_hole
from graphnav.log import Uwb
from graphnav.trajectory import Trajectory

KEYFRAMES_S = np.arange(600.0)
NO_REST = np.zeros((0, 2))


def legs(*spans: tuple[int, int]) -> SimpleNamespace:
    """Readings at every second keyframe of some spans."""
    return SimpleNamespace(keyframe=np.concatenate([np.arange(a, b, 2) for a, b in spans]))


@pytest.mark.parametrize(
    ("readings", "rest_s", "told"),
    [
        (legs((0, 600)), NO_REST, False),
        (legs((0, 300), (360, 600)), NO_REST, False),
        (legs((0, 301), (480, 600)), NO_REST, True),
        (legs((0, 301), (480, 600)), np.array([[10.0, 20.0], [310.0, 470.0]]), False),
        (legs((0, 301), (480, 600)), np.array([[100.0, 350.0]]), True),
        (legs((0, 100)), NO_REST, False),  # the scanner is not carried on
        (legs((0, 1)), NO_REST, False),
        (legs((0, 0)), NO_REST, False),
    ],
)
def test_legs(readings: SimpleNamespace, rest_s: np.ndarray, told: bool) -> None:
    found = leg_hole(readings, None, KEYFRAMES_S, rest_s)
    assert bool(found) == told
    assert not told or "from 300 to 480 s" in found[0]


def test_legs_that_disagree_were_seen() -> None:
    assert leg_hole(legs((0, 301), (480, 600)), legs((320, 460)), KEYFRAMES_S, NO_REST) == []


def ranged(pos_n: np.ndarray, silent: np.ndarray) -> tuple[Uwb, Trajectory]:
    """Ranges along a path at its times but where it is silent."""
    path = Trajectory(KEYFRAMES_S, pos_n, np.tile([1.0, 0, 0, 0], (600, 1)), np.zeros((600, 3)))
    rows = np.flatnonzero(~silent)
    uwb = passing(seconds=1.0).uwb
    anchor = np.arange(len(rows)) % len(ANCHORS)
    range_m = np.linalg.norm(pos_n[rows] - ANCHORS[anchor], axis=1)
    ids = np.array([each.id for each in uwb.anchor], dtype=object)[anchor]
    tags = np.full(len(rows), uwb.tag[0].id, dtype=object)
    return uwb.replace(t_s=KEYFRAMES_S[rows], tag_id=tags, anchor_id=ids, range_m=range_m), path


def test_ranges_that_fail_near_the_anchors_are_told() -> None:
    near = np.column_stack([np.zeros(600), 7 + 3 * np.sin(KEYFRAMES_S / 20), np.zeros(600)])
    silent = (KEYFRAMES_S > 200) & (KEYFRAMES_S < 380)
    (line,) = range_hole(*ranged(near, silent))
    assert "from 200 to 380 s" in line
    assert range_hole(*ranged(near, (KEYFRAMES_S > 200) & (KEYFRAMES_S < 260))) == []


def test_a_machine_that_is_away_is_not_missed() -> None:
    """It leaves the face end, cuts for five minutes and comes back."""
    away = np.column_stack([np.zeros(600), 5 + 0.2 * np.clip(300 - np.abs(KEYFRAMES_S - 300), 0, 300), np.zeros(600)])
    silent = away[:, 1] > 15.0
    assert silent.sum() > 300
    assert range_hole(*ranged(away, silent)) == []
