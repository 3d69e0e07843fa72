"""The VB-UKF: exact integrals, the Kalman filter as its limit, and a noise that it has to learn."""

from __future__ import annotations

import numpy as np
import pytest

from graphnav.baselines.vbukf import Adaptation, Smoothed, smooth, unscented, update

STEP = 0.1
SURE = Adaptation(accel_density=0.02, memory_s=1e9, trust=1e9)
ADAPTING = Adaptation(accel_density=0.02, memory_s=10.0)


def drawn(seed: int, sigma: np.ndarray, density: float = 0.02) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, true states of nearly constant velocity, and positions measured with sigmas (N,)."""
    rng, count = np.random.default_rng(seed), len(sigma)
    drive = np.linalg.cholesky(np.array([[STEP**3 / 3, STEP**2 / 2], [STEP**2 / 2, STEP]])) * density
    state = np.zeros((count, 6))
    state[0, 3:] = 0.1 * rng.standard_normal(3)
    for k in range(1, count):
        push = drive @ rng.standard_normal((2, 3))
        state[k, :3] = state[k - 1, :3] + STEP * state[k - 1, 3:] + push[0]
        state[k, 3:] = state[k - 1, 3:] + push[1]
    return STEP * np.arange(count), state, state[:, :3] + sigma[:, None] * rng.standard_normal((count, 3))


def filtered(seed: int, sigma: np.ndarray, guess: float, how: Adaptation) -> tuple[np.ndarray, Smoothed]:
    t, true, measured = drawn(seed, sigma)
    return true, smooth(t, measured, np.eye(3) * guess**2, (np.zeros(3), np.full(3, 0.1)), how)


def kalman(t: np.ndarray, measured: np.ndarray, sigma: float, density: float) -> tuple[np.ndarray, np.ndarray]:
    """The textbook filter, axis by axis in one, to compare with."""
    state, cov = np.r_[measured[0], np.zeros(3)], np.diag(np.r_[np.full(3, sigma**2), np.full(3, 0.01)])
    turn = np.eye(6) + STEP * np.eye(6, k=3)
    drive = np.kron([[STEP**3 / 3, STEP**2 / 2], [STEP**2 / 2, STEP]], np.eye(3)) * density**2
    for z in measured[1:]:
        state, cov = turn @ state, turn @ cov @ turn.T + drive
        gain = cov[:, :3] @ np.linalg.inv(cov[:3, :3] + sigma**2 * np.eye(3))
        state, cov = state + gain @ (z - state[:3]), cov - gain @ cov[:3]
    return state, cov


# Integrals --------------------------------------------------------------------------------------------------


def test_sigma_points_are_exact_for_what_is_linear() -> None:
    rng = np.random.default_rng(0)
    root, mean, map_ = rng.standard_normal((6, 6)), rng.standard_normal(6), rng.standard_normal((3, 6))
    cov = root @ root.T
    centre, spread, cross = unscented(mean, cov, lambda points: points @ map_.T)
    assert centre == pytest.approx(map_ @ mean)
    assert spread == pytest.approx(map_ @ cov @ map_.T)
    assert cross == pytest.approx(cov @ map_.T)


def test_sigma_points_see_curvature() -> None:
    """The mean of a square is the square of the mean and the variance, which a linearization lacks."""
    centre, _, _ = unscented(np.array([2.0, 0.0]), np.diag([0.5, 1.0]), lambda points: points[:, :1] ** 2)
    assert centre[0] == pytest.approx(4.5)


def test_the_alternation_ends_where_both_agree() -> None:
    mean, cov, scale, freedom = np.zeros(6), np.eye(6), np.eye(3) * 4.0, 9.0
    measured = np.array([3.0, 0.0, -1.0])
    state, spread, after, noise = update(mean, cov, scale, freedom, measured, lambda points: points[:, :3])
    gap = measured - state[:3]
    assert after == pytest.approx(scale + np.outer(gap, gap) + spread[:3, :3], rel=1e-4)
    assert noise == pytest.approx(after / (freedom - 4), rel=1e-4)
    assert state[:3] == pytest.approx(np.linalg.solve(np.eye(3) + noise, measured), rel=1e-4)


# Against the Kalman filter ----------------------------------------------------------------------------------


def test_a_noise_that_is_sure_makes_it_the_kalman_filter() -> None:
    sigma = np.full(300, 0.1)
    t, _, measured = drawn(3, sigma)
    out = smooth(t, measured, np.eye(3) * 0.01, (np.zeros(3), np.full(3, 0.1)), SURE)
    state, cov = kalman(t, measured, 0.1, 0.02)
    assert out.state[-1] == pytest.approx(state, abs=1e-6)
    assert out.cov[-1] == pytest.approx(cov, abs=1e-7)


def test_consistent_where_its_model_holds() -> None:
    """NEES of the last position of 60 draws: chi-square of 180; NIS of 900 rows: false alarms 1 in 1000 each."""
    total = 0.0
    for seed in range(60):
        true, out = filtered(seed, np.full(300, 0.1), 0.1, ADAPTING)
        error = out.state[-1, :3] - true[-1, :3]
        total += error @ np.linalg.solve(out.cov[-1, :3, :3], error)
    assert 123.0 < total < 249.0
    nis = np.mean(out.innovation[1:] ** 2 / out.variance[1:])
    assert abs(nis - 1) < 3.3 * np.sqrt(2 / 897)


# Learning the noise -----------------------------------------------------------------------------------------


def test_a_wrong_guess_of_the_noise_is_unlearnt() -> None:
    """Five memories of 100 measurements each and three axes: their sigma is known to 2 %, three of that allowed."""
    for guess in (0.01, 1.0):
        learnt = []
        for seed in range(5):
            _, out = filtered(seed, np.full(600, 0.1), guess, ADAPTING)
            learnt.append(np.trace(out.noise[500:], axis1=1, axis2=2).mean() / 3)
        assert np.sqrt(np.mean(learnt)) == pytest.approx(0.1, rel=0.06)


def test_a_step_of_the_noise_is_followed() -> None:
    """From 5 to 20 cm at 60 s: within 30 s, three times its memory, the noise is known to 20 %."""
    sigma = np.where(np.arange(1200) < 600, 0.05, 0.20)
    _, out = filtered(2, sigma, 0.05, ADAPTING)
    learnt = np.sqrt(np.trace(out.noise, axis1=1, axis2=2) / 3)
    assert learnt[300:600].mean() == pytest.approx(0.05, rel=0.2)
    assert learnt[900:].mean() == pytest.approx(0.20, rel=0.2)
    assert learnt[600:650].mean() < learnt[900:].mean()


def test_adapting_is_worth_it_where_the_noise_changes() -> None:
    """Calm after 60 s of noise: the last 40 s of calm, four memories, adaptive and with a fixed noise."""
    sigma, errors = np.where(np.arange(1200) < 600, 0.30, 0.02), []
    for how in (ADAPTING, SURE):
        true, out = filtered(4, sigma, 0.21, how)
        errors.append(np.sqrt(np.mean((out.state[:, :3] - true[:, :3])[800:] ** 2)))
    assert errors[0] < 0.7 * errors[1]


def test_it_looks_at_the_past_alone() -> None:
    t, _, measured = drawn(5, np.full(100, 0.1))
    start = np.zeros(3), np.full(3, 0.1)
    whole, part = (smooth(t[:n], measured[:n], np.eye(3) * 0.01, start, ADAPTING).state for n in (100, 60))
    assert whole[:60] == pytest.approx(part)
