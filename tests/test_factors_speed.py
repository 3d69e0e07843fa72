"""The odometer preintegrated over intervals: `preintegrate_speed`."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from factors import so3
from factors.increments import Samples, compensated_increments
from factors.inertial import Motion, cumulate
from factors.odometry import Travel, preintegrate_speed


def turning(boundaries_s: np.ndarray, rate_b: np.ndarray, start_s: float = 0.0, end_s: float | None = None) -> Motion:
    """The gyro's attitude within intervals at a constant rate."""
    edge = np.arange(start_s, (end_s or boundaries_s[-1]) + 0.005, 0.01)
    samples = Samples(edge, np.tile(rate_b, (len(edge) - 1, 1)), np.zeros((len(edge) - 1, 3)))
    return cumulate(compensated_increments(samples, boundaries_s, 0.1))


def straight(boundaries_s: np.ndarray) -> Motion:
    return turning(boundaries_s, np.zeros(3))


def vector(travel: Travel) -> np.ndarray:
    """Displacement of the odometer in the body axes at each interval's start, (K, 3)."""
    return travel.mean_b[:, :, 1] * travel.distance_m[:, None]


REGULAR = np.arange(1, 51) / 10
KEYFRAMES = np.array([0.0, 1.0, 2.0, 2.35, 3.0, 4.07, 5.0])


def test_each_sample_counts_in_one_interval() -> None:
    motion = straight(KEYFRAMES)
    total = preintegrate_speed(REGULAR, np.ones(50), KEYFRAMES, motion)
    for k, t in enumerate(REGULAR):
        alone = preintegrate_speed(REGULAR, np.eye(50)[k], KEYFRAMES, motion)
        touched = np.flatnonzero(np.abs(alone.distance_m) > 1e-12)
        # the end of an interval belongs to it, its start does not
        assert touched.tolist() == [int(np.searchsorted(KEYFRAMES, t - 1e-7)) - 1]
    assert total.samples.sum() == 50
    assert total.samples.tolist() == [10, 10, 3, 7, 10, 10]


def test_samples_outside_the_intervals_do_not_count() -> None:
    bounds = np.array([1.0, 2.0])
    motion = turning(bounds, np.zeros(3), 1.0)
    travel = preintegrate_speed(REGULAR, np.where((REGULAR > 1.01) & (REGULAR < 2.01), 1.0, 99.0), bounds, motion)
    assert travel.samples.tolist() == [10]
    assert travel.distance_m == pytest.approx([1.0])


@pytest.mark.parametrize("sampling", ["regular", "irregular", "sparse"])
def test_constant_and_linear_speed_are_exact(sampling: str) -> None:
    rng = np.random.default_rng(1)
    t = {"regular": REGULAR, "irregular": np.sort(rng.uniform(0, 5, 60)), "sparse": np.arange(1, 21) * 0.25}[sampling]
    for a, b in ((0.3, 0.0), (-0.3, 0.0), (0.1, 0.2), (-0.5, 0.1), (0.3, -0.12)):
        travel = preintegrate_speed(t, a + b * t, KEYFRAMES, straight(KEYFRAMES))
        lo, hi = KEYFRAMES[:-1], KEYFRAMES[1:]
        expected = np.column_stack([0 * lo, a * (hi - lo) + b * (hi**2 - lo**2) / 2, 0 * lo])
        enough = travel.samples >= 2
        assert enough.sum() >= 4
        assert np.allclose(vector(travel)[enough], expected[enough], rtol=0, atol=1e-12)


def test_one_sample_stands_for_its_whole_interval() -> None:
    bounds = np.array([0.0, 1.0, 2.0])
    travel = preintegrate_speed(np.array([0.7]), np.array([0.5]), bounds, straight(bounds))
    assert travel.samples.tolist() == [1, 0]
    assert np.allclose(travel.distance_m, [0.5, 0.0])
    assert np.allclose(travel.weight2_s2, [1.0, 0.0])
    assert np.allclose(travel.mean_b, np.eye(3))


@pytest.mark.parametrize("speed", [(0.3, 0.0), (-0.3, 0.0), (0.05, 0.25), (0.3, -0.25)])
@pytest.mark.parametrize("rate", [(0.0, 0.0, 0.2), (0.1, 0.0, -0.1), (0.05, 0.3, 0.1)])
def test_turning_and_changing_speed(speed: tuple[float, float], rate: tuple[float, ...]) -> None:
    """Against a fine quadrature of ``R(t) [0, v(t), 0]``."""
    bounds = np.array([0.0, 1.0])
    travel = preintegrate_speed(
        REGULAR[:10], speed[0] + speed[1] * REGULAR[:10], bounds, turning(bounds, np.array(rate))
    )
    u = (np.arange(20_000) + 0.5) / 20_000
    axes = so3.exp(np.outer(u, rate))[:, :, 1]
    exact = np.mean(axes * (speed[0] + speed[1] * u)[:, None], axis=0)
    # Two approximations, both far below the slip of a machine: the quadrature is exact to linear order only (the
    # ten samples lie at the ends of their tenths: 1/600 of the second derivative), and the mean frame is the
    # nearest rotation, whose forward axis differs from the chord by products of rates about two axes, over 24.
    curvature = np.linalg.norm(
        np.gradient(np.gradient(axes * (speed[0] + speed[1] * u)[:, None], u, axis=0), u, axis=0), axis=1
    )
    allowed = 1.2 * curvature.max() / 600 + np.linalg.norm(exact) * np.linalg.norm(rate) ** 2 / 24
    assert allowed < 2e-3
    assert np.linalg.norm(vector(travel)[0] - exact) < allowed
    # the mean machine frame is a rotation whose forward axis is the direction travelled in
    assert np.allclose(travel.mean_b[0] @ travel.mean_b[0].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(travel.mean_b[0]) == pytest.approx(1.0)
    across = np.cross(travel.mean_b[0][:, 1], exact / np.linalg.norm(exact))
    assert np.linalg.norm(across) < allowed / np.linalg.norm(exact)


def test_reversal_within_an_interval() -> None:
    """Forward and back: no direction of travel, so the mean frame is the mean attitude and the distance the sum."""
    bounds, rate = np.array([0.0, 1.0]), np.array([0.0, 0.0, 0.2])
    speed = np.where(REGULAR[:10] < 0.55, 0.3, -0.3)
    travel = preintegrate_speed(REGULAR[:10], speed, bounds, turning(bounds, rate))
    assert abs(travel.distance_m[0]) < 0.05
    middle = so3.exp(rate / 2)
    assert np.linalg.norm(so3.log(middle.T @ travel.mean_b[0])) < 0.02


def test_attitude_at_samples_is_that_of_their_own_interval() -> None:
    """Several intervals at once are what each gives alone."""
    rate = np.array([0.02, -0.05, 0.3])
    whole = preintegrate_speed(REGULAR, 0.2 + 0.01 * REGULAR, KEYFRAMES, turning(KEYFRAMES, rate))
    for k in range(len(KEYFRAMES) - 1):
        bounds = KEYFRAMES[k : k + 2]
        alone = preintegrate_speed(REGULAR, 0.2 + 0.01 * REGULAR, bounds, turning(bounds, rate, 0.0, 5.0))
        assert np.allclose(vector(whole)[k], vector(alone)[0], atol=1e-12)
        assert np.allclose(whole.mean_b[k], alone.mean_b[0], atol=1e-12)
        assert whole.weight2_s2[k] == pytest.approx(alone.weight2_s2[0])


def test_variance_is_what_is_claimed() -> None:
    """``sigma^2 weight2`` against 4,000 draws of white noise: chi-square bounds, false-alarm rate 1e-5 per interval."""
    rng, sigma, draws = np.random.default_rng(2), 0.01, 4000
    motion = straight(KEYFRAMES)
    found = np.array(
        [
            preintegrate_speed(REGULAR, 0.3 + sigma * rng.normal(size=50), KEYFRAMES, motion).distance_m
            for _ in range(draws)
        ]
    )
    claimed = sigma**2 * preintegrate_speed(REGULAR, np.ones(50), KEYFRAMES, motion).weight2_s2
    low, high = stats.chi2.interval(1 - 1e-5, draws - 1)
    ratio = found.var(axis=0, ddof=1) * (draws - 1) / claimed
    assert (ratio > low).all() and (ratio < high).all()
    # and the errors of neighbouring intervals are independent: no sample is used twice
    correlation = np.corrcoef(found.T)[np.triu_indices(6, 1)]
    assert np.abs(correlation).max() < stats.norm.isf(1e-5 / 15) / np.sqrt(draws)


def test_weights_are_those_of_least_variance() -> None:
    """No other weights that integrate constants and lines have a smaller variance (Lagrange conditions)."""
    bounds = np.array([0.0, 1.3])
    t = np.sort(np.random.default_rng(3).uniform(0, 1.3, 9))
    motion = straight(bounds)
    weights = np.array([preintegrate_speed(t, np.eye(9)[k], bounds, motion).distance_m[0] for k in range(9)])
    system = np.vstack([np.ones(9), t])
    best = np.linalg.pinv(system) @ [1.3, 1.3**2 / 2]
    claimed = preintegrate_speed(t, np.ones(9), bounds, motion).weight2_s2[0]
    assert np.sum(best**2) == pytest.approx(claimed, rel=1e-9)
    assert np.allclose(np.abs(weights), np.abs(best), atol=1e-12)
