"""The linear core of filter and smoother: against dense algebra, the dense MAP solution and the published recursion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from linear_map import SIZE, Interval, filtered_and_smoothed, off, solve
from scipy.linalg import expm

from graphnav.baselines import kalman
from graphnav.baselines.states import PACKED, house_covariance, packed, unpacked

#: Typical sigmas of the 19 states: velocity, attitude, position, biases, mounting, scale.
SIGMAS = np.repeat([0.1, 0.01, 1.0, 1e-4, 0.03, 0.03, 0.05], [3, 3, 3, 3, 3, 3, 1])


def covariance(rng: np.random.Generator, size: int, rank: int | None = None) -> np.ndarray:
    part = rng.normal(size=(size, size if rank is None else rank))
    return part @ part.T


def random_phi(rng: np.random.Generator) -> np.ndarray:
    """Any matrix in the shape that `times_rows` takes."""
    phi = np.eye(SIZE)
    phi[:9, :15] = rng.normal(size=(9, 15))
    return phi


# steps ------------------------------------------------------------------------------------------------------


def test_transition_puts_every_block_in_its_place() -> None:
    """Order of `strapdown.BLOCKS`; what is named there, and nothing else, differs from the identity."""
    blocks = np.random.default_rng(0).normal(size=(10, 3, 3))
    vel, phi, pos, gyro, accel = (slice(3 * k, 3 * k + 3) for k in range(5))
    expected = np.eye(SIZE)
    places = [(phi, phi), (phi, gyro), (vel, phi), (vel, vel), (vel, gyro), (vel, accel)]
    places += [(pos, phi), (pos, vel), (pos, gyro), (pos, accel)]
    for block, place in zip(blocks, places, strict=True):
        expected[place] = block
    assert np.array_equal(kalman.transition(blocks), expected)


@pytest.mark.parametrize("columns", [1, 7, SIZE])
def test_products_with_a_transition(columns: int) -> None:
    rng = np.random.default_rng(1)
    phi, m = random_phi(rng), rng.normal(size=(SIZE, columns))
    expected = phi @ m
    kalman.times_rows(phi, m)
    assert m == pytest.approx(expected, rel=1e-13, abs=1e-13)


def test_time_update() -> None:
    rng = np.random.default_rng(2)
    phi, q, x, p = random_phi(rng), covariance(rng, SIZE, 4), rng.normal(size=SIZE), covariance(rng, SIZE)
    mean, spread = phi @ x, phi @ p @ phi.T + q
    kalman.predict(phi, q, x, p)
    assert x == pytest.approx(mean, rel=1e-13, abs=1e-13)
    assert p == pytest.approx(spread, rel=1e-12, abs=1e-12)
    assert np.array_equal(p, p.T)


def test_measurement_update() -> None:
    """Equation 28 with the gain ``P_k|k H' R^-1`` of the paper, and in information form."""
    rng = np.random.default_rng(3)
    h, z, x, p = rng.normal(size=SIZE), 0.7, rng.normal(size=SIZE), covariance(rng, SIZE)
    before, prior = x.copy(), np.linalg.inv(p)
    innovation, variance, gain = kalman.update(h, z, x, p)
    assert innovation == pytest.approx(z - h @ before)
    assert variance == pytest.approx(1 + h @ np.linalg.inv(prior) @ h)
    assert p == pytest.approx(np.linalg.inv(prior + np.outer(h, h)), rel=1e-9, abs=1e-9)
    assert gain == pytest.approx(p @ h, rel=1e-9, abs=1e-10)
    assert x == pytest.approx(before + gain * innovation)
    assert np.array_equal(p, p.T)


def test_a_measurement_ten_million_times_better_than_the_prior_leaves_a_positive_covariance() -> None:
    rng = np.random.default_rng(4)
    p = covariance(rng, SIZE)
    for _ in range(40):
        kalman.update(1e7 * rng.normal(size=SIZE), 0.0, np.zeros(SIZE), p)
    assert np.linalg.eigvalsh(p).min() > -1e-12


# process noise ----------------------------------------------------------------------------------------------


def van_loan(force_n: np.ndarray, t: float, gyro: float, accel: float) -> np.ndarray:
    """``int Phi(s) G q G' Phi(s)' ds`` over t of the nine navigation errors, by one matrix exponential."""
    fx = np.array([[0, -force_n[2], force_n[1]], [force_n[2], 0, -force_n[0]], [-force_n[1], force_n[0], 0]])
    f, q = np.zeros((9, 9)), np.zeros((9, 9))
    f[:3, 3:6], f[6:, :3] = -fx, np.eye(3)
    q[:3, :3], q[3:6, 3:6] = accel**2 * np.eye(3), gyro**2 * np.eye(3)
    whole = expm(np.block([[-f, q], [np.zeros((9, 9)), f.T]]) * t)
    return whole[9:, 9:].T @ whole[:9, 9:]


@pytest.mark.parametrize("t", [0.01, 0.1, 1.0])
def test_process_noise_is_the_integral(t: float) -> None:
    rng = np.random.default_rng(5)
    force, gyro, accel = rng.normal(size=(2, 3)) * 8, np.array([1e-3, 2e-3]), np.array([3e-2, 1e-3])
    walk = np.concatenate([np.zeros(9), rng.uniform(1e-6, 1e-4, 10)])
    out = np.full((2, SIZE, SIZE), np.nan)
    kalman.process_noise(force, np.array([t, t / 2]), gyro, accel, walk, False, out)
    for k, span in enumerate((t, t / 2)):
        expected = np.diag(walk * span)
        expected[:9, :9] += van_loan(force[k], span, gyro[k], accel[k])
        scale = np.sqrt(np.outer(*[np.maximum(np.diag(expected), 1e-30)] * 2))
        assert (out[k] - expected) / scale == pytest.approx(np.zeros((SIZE, SIZE)), abs=1e-9)


def test_process_noise_at_rest_is_the_accelerometers_and_the_declared_walks() -> None:
    walk = np.random.default_rng(6).uniform(1e-6, 1e-4, SIZE)
    out = np.full((1, SIZE, SIZE), np.nan)
    kalman.process_noise(np.array([[1.0, 2.0, 9.8]]), np.array([0.5]), np.ones(1), np.array([0.02]), walk, True, out)
    expected = np.diag(walk * 0.5)
    expected[:9, :9] += van_loan(np.zeros(3), 0.5, 0.0, 0.02)
    assert out[0] == pytest.approx(expected, rel=1e-9, abs=1e-15)


# packing and frames -----------------------------------------------------------------------------------------


def test_packing_is_lossless() -> None:
    rng = np.random.default_rng(7)
    p = np.array([covariance(rng, SIZE) for _ in range(3)])
    upper = np.array([packed(m) for m in p])
    assert upper.shape == (3, PACKED)
    assert np.array_equal(unpacked(upper)[0], unpacked(upper[0]))
    assert unpacked(upper) == pytest.approx(p, abs=1e-14)


def test_house_covariance_is_that_of_the_house_errors() -> None:
    """Attitude in b: ``R Exp(theta) = Exp(phi) R``, so ``theta = R' phi``; then position, then velocity."""
    from factors import so3

    rng = np.random.default_rng(8)
    rotation, p = so3.exp(rng.normal(size=(2, 3))), np.array([covariance(rng, SIZE) for _ in range(2)])
    found = house_covariance(rotation, p)
    for k in range(2):
        change = np.zeros((9, SIZE))
        change[:3, 3:6], change[3:6, 6:9], change[6:, :3] = rotation[k].T, np.eye(3), np.eye(3)
        assert found[k] == pytest.approx(change @ p[k] @ change.T, rel=1e-12, abs=1e-12)
    theta = 1e-6 * rng.normal(size=3)
    assert so3.exp(rotation[0] @ theta) @ rotation[0] == pytest.approx(rotation[0] @ so3.exp(theta), abs=1e-15)


# filter and smoother ----------------------------------------------------------------------------------------


def random_interval(rng: np.random.Generator, epochs: int, *, rank: int) -> Interval:
    """Transitions that do not grow, process noise of a rank, up to five measurements an epoch."""
    blocks = 0.3 * rng.normal(size=(epochs, 10, 3, 3))
    blocks[:, [0, 3]] += np.eye(3)
    # rows in units of the states' sigmas, from useless to fifty times better than the prior
    blocks = blocks * scaled_blocks()
    count = rng.integers(0, 6, epochs)
    count[rng.integers(epochs)] *= epochs == 1
    epoch = np.repeat(np.arange(epochs), count)
    rows = rng.normal(size=(len(epoch), SIZE)) * 10 ** rng.uniform(-1, 1.7, (len(epoch), 1)) / SIGMAS
    rows[rng.random(rows.shape) < 0.5] = 0.0
    noise = np.zeros((epochs, SIZE, SIZE))
    for q in noise:
        q[:] = 0.01 * covariance(rng, SIZE, rank) * np.outer(SIGMAS, SIGMAS)
    return Interval(blocks, noise, rows, epoch, rng.normal(size=len(epoch)) * 3)


def scaled_blocks() -> np.ndarray:
    """Units of the blocks, (10, 1, 1): sigma of the row's state by sigma of the column's."""
    s = SIGMAS[::3]
    rows, columns = [1, 1, 0, 0, 0, 0, 2, 2, 2, 2], [1, 3, 1, 0, 3, 4, 1, 0, 3, 4]
    return (s[rows] / s[columns])[:, None, None]


def random_system(seed: int, *, rank: int = SIZE, intervals: int = 6) -> tuple[np.ndarray, list[Interval]]:
    rng = np.random.default_rng(seed)
    prior = covariance(rng, SIZE) * np.outer(SIGMAS, SIGMAS)
    parts = [random_interval(rng, int(rng.integers(1, 6)), rank=rank) for _ in range(intervals)]
    # one keyframe's feedback is a change of coordinates
    reset = np.eye(SIZE)
    reset[3:6, 3:6] += 0.1 * rng.normal(size=(3, 3))
    parts[2] = replace(parts[2], shift=rng.normal(size=SIZE) * SIGMAS, reset=reset)
    return prior, parts


@pytest.mark.parametrize("rank", [0, 3, 9, SIZE])
@pytest.mark.parametrize("seed", range(3))
def test_filter_and_smoother_are_the_dense_map_solution(seed: int, rank: int) -> None:
    """States to 1e-10 of their sigma, covariances to 1e-9, with process noise of full rank or less.

    Without any, the first state is smoothed to a hundredth of its filtered sigma, and ``P - P L P`` loses the square
    of that: covariances to 1e-6.
    """
    prior, parts = random_system(seed, rank=rank)
    mean = np.random.default_rng(seed + 100).normal(size=SIZE) * SIGMAS
    limit = [1e-10, 1e-9 if rank else 1e-6]
    states, spread = solve(prior, parts, mean)
    filtered, p, smoothed, smoothed_p = filtered_and_smoothed(prior, parts, mean)
    assert (np.array(off(smoothed, smoothed_p, states, spread)) < limit).all()
    assert max(off(filtered[-1:], p[-1:], states[-1:], spread[-1:])) < 1e-10
    # the smoother had something to do
    assert off(filtered, p, states, spread)[0] > 0.1
    # a filtered state is the dense solution of what was measured until then
    early, early_p = solve(prior, parts[:3], mean)
    assert max(off(filtered[3:4], p[3:4], early[3:], early_p[3:])) < 1e-10


def published(prior: np.ndarray, parts: list[Interval], mean: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Zheng et al. (2021), equations 28-31 as they stand: smoothed states and covariances at the keyframes."""
    unit = np.diag(1 / SIGMAS)
    x, p = [unit @ mean], [unit @ prior @ unit]
    ahead: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    keyframes = [0]
    for part in parts:
        for e, si in enumerate(part.transitions()):
            phi = unit @ si * SIGMAS
            x_ahead, p_ahead = phi @ x[-1], phi @ p[-1] @ phi.T + unit @ part.noise[e] @ unit
            ahead.append((phi, x_ahead, p_ahead))
            h, z = part.rows[part.row_epoch == e] * SIGMAS, part.z[part.row_epoch == e]
            # P_k|k H' R^-1 with R = 1
            gain = np.linalg.solve(h @ p_ahead @ h.T + np.eye(len(h)), h @ p_ahead).T
            x.append(x_ahead + gain @ (z - h @ x_ahead))
            p.append((np.eye(SIZE) - gain @ h) @ p_ahead)
        # feedback: a change of coordinates, which the smoother's gain turns back exactly
        phi = unit @ part.reset * SIGMAS
        ahead.append((phi, phi @ (x[-1] - unit @ part.shift), phi @ p[-1] @ phi.T))
        x.append(ahead[-1][1])
        p.append(ahead[-1][2])
        keyframes.append(len(x) - 1)
    smoothed, spread = [x[-1]], [p[-1]]
    for k in range(len(ahead) - 1, -1, -1):
        phi, x_ahead, p_ahead = ahead[k]
        a = p[k] @ phi.T @ np.linalg.inv(p_ahead)
        smoothed.append(x[k] + a @ (smoothed[-1] - x_ahead))
        spread.append(p[k] + a @ (spread[-1] - p_ahead) @ a.T)
    states, covariances = np.array(smoothed[::-1])[keyframes], np.array(spread[::-1])[keyframes]
    return states * SIGMAS, covariances * np.outer(SIGMAS, SIGMAS)


@pytest.mark.parametrize("seed", range(3))
def test_the_published_recursion_gives_the_same(seed: int) -> None:
    """In units of the states' sigmas: in SI units the inverse of the predicted covariance would lose more digits."""
    prior, parts = random_system(seed)
    mean = np.zeros(SIZE)
    _, _, smoothed, smoothed_p = filtered_and_smoothed(prior, parts, mean)
    states, spread = published(prior, parts, mean)
    assert max(off(states, spread, smoothed, smoothed_p)) < 1e-9


def test_intervals_without_measurements() -> None:
    rng = np.random.default_rng(11)
    prior, parts = random_system(11)
    empty = Interval(parts[0].blocks, parts[0].noise, np.empty((0, SIZE)), np.empty(0, np.int64), np.empty(0))
    parts = [empty, parts[1], empty, parts[3], empty]
    states, spread = solve(prior, parts, rng.normal(size=SIZE) * SIGMAS * 0)
    _, _, smoothed, smoothed_p = filtered_and_smoothed(prior, parts)
    assert max(off(smoothed, smoothed_p, states, spread)) < 1e-10


def test_how_an_interval_is_cut_changes_nothing() -> None:
    """Keyframes are bookkeeping: one interval of all epochs ends where several do."""
    prior, parts = random_system(12)
    parts = [replace(p, shift=np.zeros(SIZE), reset=np.eye(SIZE)) for p in parts]
    first = np.cumsum([0, *(len(p.blocks) for p in parts)])
    whole = Interval(
        np.concatenate([p.blocks for p in parts]),
        np.concatenate([p.noise for p in parts]),
        np.concatenate([p.rows for p in parts]),
        np.concatenate([p.row_epoch + n for p, n in zip(parts, first, strict=False)]),
        np.concatenate([p.z for p in parts]),
    )
    one, many = filtered_and_smoothed(prior, [whole]), filtered_and_smoothed(prior, parts)
    ends = [0, -1]
    assert max(off(*(r[ends] for r in (*one[2:], *many[2:])))) < 1e-10


def test_smoothing_without_maps_filters_the_same() -> None:
    prior, parts = random_system(13)
    part = parts[0]
    results = []
    for smoothing in (True, False):
        x, p = np.zeros(SIZE), prior.copy()
        a, c, big_c = np.full((SIZE, SIZE), np.nan), np.full(SIZE, np.nan), np.full((SIZE, SIZE), np.nan)
        innovation, variance = np.empty(len(part.z)), np.empty(len(part.z))
        kalman.interval(
            part.blocks, part.noise, part.rows, part.row_epoch, part.z, x, p, innovation, variance, smoothing,
            a, c, big_c,
        )  # fmt: skip
        results.append((x, p, innovation, variance))
        assert np.isnan(a).all() != smoothing
    for with_maps, without in zip(*results, strict=True):
        assert np.array_equal(with_maps, without)


def test_normalized_innovations_of_the_right_model_are_white() -> None:
    """Truth drawn from the model: their squares sum to a chi-square; false-alarm rate 1e-4."""
    from scipy.stats import chi2

    rng, total, count = np.random.default_rng(14), 0.0, 0
    for seed in range(20, 60):
        prior, parts = random_system(seed)
        x_true = np.linalg.cholesky(prior) @ rng.normal(size=SIZE)
        x, p = np.zeros(SIZE), prior.copy()
        for part in parts:
            z = np.empty(len(part.z))
            for e, phi in enumerate(part.transitions()):
                x_true = phi @ x_true + np.linalg.cholesky(part.noise[e]) @ rng.normal(size=SIZE)
                here = part.row_epoch == e
                z[here] = part.rows[here] @ x_true + rng.normal(size=int(here.sum()))
            innovation, variance = np.empty(len(z)), np.empty(len(z))
            kalman.interval(
                part.blocks, part.noise, part.rows, part.row_epoch, z, x, p, innovation, variance, False,
                np.empty((SIZE, SIZE)), np.empty(SIZE), np.empty((SIZE, SIZE)),
            )  # fmt: skip
            total += float(np.sum(innovation**2 / variance))
            count += len(z)
    low, high = chi2.interval(1 - 1e-4, count)
    assert count > 400
    assert low < total < high
