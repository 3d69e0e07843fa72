"""The compiled loops over detections of legs beside the same in arrays."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from graphnav.leg_means import Groups
from graphnav.leg_sums import on_the_ground, rows_of, scatter


def test_sums_over_groups_are_those_of_arrays() -> None:
    """Forty detections in three groups from seven poses: each mean beside its formula, row by row."""
    rng = np.random.default_rng(0)
    groups = Groups.of(np.repeat([2, 5, 9], [25, 1, 14]))
    scan, r, t = rng.integers(0, 7, 40), rng.uniform(1, 9, 40), rng.uniform(-3, 3, 40)
    frame, scanner = Rotation.random(7, random_state=1).as_matrix(), rng.normal(0, 100, (7, 3))
    means, place = on_the_ground(groups.bound, scan, r, t, frame, scanner)
    zero = np.zeros(40)
    in_s = ([-np.sin(t), np.cos(t), zero], [-np.cos(t), -np.sin(t), zero], [zero, zero, zero + 1])
    u, w, n = (np.einsum("kij,jk->ki", frame[scan], np.array(axis)) for axis in in_s)
    expected = scanner[scan] + r[:, None] * u
    assert np.abs(place - expected).max() < 1e-12
    moves = [
        expected, r[:, None] * u, u, -r[:, None] * w, -(r * t)[:, None] * w, -(r * t**2)[:, None] * w,
        -(r * np.cos(t))[:, None] * n, -(r * np.sin(t))[:, None] * n,
    ]  # fmt: skip
    for g, rows in enumerate((slice(0, 25), slice(25, 26), slice(26, 40))):
        assert np.abs(means[g] - np.array([move[rows].mean(axis=0) for move in moves])).max() < 1e-12
        level = expected[rows, :2]
        assert abs(scatter(groups.bound, place)[g] - np.square(level - level.mean(axis=0)).sum(axis=1).mean()) < 1e-9


def test_names_are_found_in_any_order() -> None:
    names = np.array([3, 4, 7, 100])
    wanted = np.array([3, 4, 7, 100, 3, 7, 4, 4, 100, 3])
    assert names[rows_of(names, wanted)].tolist() == wanted.tolist()
