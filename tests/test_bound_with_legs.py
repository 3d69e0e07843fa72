"""The Cramer-Rao bound of logs with LiDAR legs: what legs bring it, and what the batch smoother reaches of it."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from engine_logs import rows
from lidar_logs import SPEC, TINY, limit, tiny
from scipy.stats import chi2

import graphnav.bound as bound_module
from graphnav._metrics import truth_states
from graphnav.bound import bound
from graphnav.problem import V, X
from graphnav.simulation import shearer
from graphnav.simulation.shearer import simulate_shearer
from graphnav.solvers import elimination

SEEDS = range(8)


def test_legs_bring_it_down() -> None:
    """At every keyframe: information only adds. (A thousandth for calibration at other best values.)"""
    with_legs, without = limit(), limit(0, False)
    assert (with_legs.sigma_n_m < 1.001 * without.sigma_n_m).all()
    assert with_legs.overall.bound_3d_m < 0.7 * without.overall.bound_3d_m


def test_equals_a_dense_inverse(monkeypatch: pytest.MonkeyPatch) -> None:
    """The information of everything, some 600 numbers, inverted at once."""
    seen = []

    def watched(linear: gtsam.GaussianFactorGraph, first: list[int]) -> object:
        seen.append(linear.clone())
        return elimination.elimination(linear, first)

    monkeypatch.setattr(bound_module, "elimination", watched)
    found = bound(tiny())
    ordering = gtsam.Ordering.NaturalGaussianFactorGraph(seen[0])
    matrix, _ = seen[0].jacobian(ordering)
    root = np.linalg.inv(np.linalg.qr(matrix, mode="r"))
    size = {"x": 6, "v": 3, "b": 6, "c": 4, "k": 1, "l": 4, "d": 8}
    at, place = {}, 0
    for k in range(ordering.size()):
        key = ordering.at(k)
        at[key] = np.arange(place, place + size[chr(key >> 56)])
        place += len(at[key])
    assert sum(key >> 56 == ord("l") for key in at) > 10
    for i in range(len(found.t_s)):
        part = root[np.concatenate([at[X(i)], at[V(i)]])]
        expected = part @ part.T
        sigma = np.sqrt(np.diag(expected))
        to_b = np.eye(9)
        to_b[3:6, 3:6] = found.limit.rotation_nb[i].T
        assert np.abs((to_b @ found.limit.cov[i] @ to_b.T - expected) / np.outer(sigma, sigma)).max() < 1e-5


def test_is_linearised_at_the_truth_where_all_else_has_settled(monkeypatch: pytest.MonkeyPatch) -> None:
    found = bound(tiny())
    _, pos, _, vel = truth_states(tiny().truth, found.t_s)
    np.testing.assert_allclose(found.limit.pos_n, pos, atol=1e-12)
    np.testing.assert_allclose(found.limit.vel_n, vel, atol=1e-12)
    monkeypatch.setattr(bound_module, "_STEPS_WITH_LEGS", 8)
    np.testing.assert_allclose(bound(tiny()).sigma_n_m, found.sigma_n_m, rtol=1e-4)


def test_what_the_smoother_leaves_out_has_no_part_in_it() -> None:
    """A leg seen 12 cm too far for half of its time is as if it had not been seen: no bound is lower for it."""
    points = tiny().lidar_points
    number = int(np.bincount(points.feature).argmax())
    own = points.feature == number
    late = own & (points.t_s > np.median(points.t_s[own]))
    damaged = points.replace(range_m=points.range_m + 0.12 * late)
    found, whole, without = (
        bound(replace(tiny(), lidar_points=p)).sigma_n_m for p in (damaged, points, rows(points, ~own))
    )
    assert (found > 0.999 * whole).all()
    assert (found < 1.001 * without).all()


def test_mean_squares_over_eight_seeds() -> None:
    """Squared rms by squared bound, mean over the seeds.

    One log scatters like a mean of four squares (from 48 seeds, whose mean is 1.32 +- 0.13, most of the excess along
    the face), so for an estimator at the bound this is a chi-square of 32 degrees of freedom by 32: above 1.15^2 in one
    of ten draws of eight seeds, below 0.5 in one of 120.
    """
    ratio = [limit(seed).overall.efficiency ** 2 for seed in SEEDS]
    assert 0.5 < np.mean(ratio) < 1.15**2


def test_errors_at_the_end_scatter_as_the_bound_says() -> None:
    """NEES of the position at the end of the log with the bound, a draw of 3 squares a seed; false-alarm rate 1e-3."""
    squares = 0.0
    for seed in SEEDS:
        error, cov = limit(seed).achieved.error_n_m[-1], limit(seed).limit.cov[-1, 3:6, 3:6]
        squares += float(error @ np.linalg.solve(cov, error))
    low, high = chi2.interval(1 - 1e-3, 3 * len(SEEDS))
    assert low < squares < high


@pytest.mark.parametrize("spare", [0.0, 0.03])
def test_truth_of_a_long_log_covers_its_last_keyframe(monkeypatch: pytest.MonkeyPatch, spare: float) -> None:
    """It is recorded at the odometer's rate; the IMU's record may end between two of its samples."""
    monkeypatch.setattr(shearer, "_TRUTH_EVERY_SAMPLE_S", 1.0)
    for spec in (TINY, replace(SPEC, lidar=None)):
        made = simulate_shearer("long", replace(spec, duration_s=20.0 + spare), 0)
        assert made.truth.t_s[-1] == made.imu.t_s[-1]
        assert np.diff(made.truth.t_s)[:-1] == pytest.approx(0.1)
        assert truth_states(made.truth, made.imu.t_s[-1:])[0].all()
