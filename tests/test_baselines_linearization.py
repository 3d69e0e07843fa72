"""What the filter believes of errors: their transition, their noise, and a recorded problem solved in one piece."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from engine_logs import SHORT, TWO_CUTS, rows, simulated, until
from filter_runs import inputs_of
from jacobians import central, random_rotation
from linear_map import SIZE, Interval, off, solve
from navigation import FAST_EARTH, HERTZ, NONE, Start, navigate, sampled, start
from scipy import stats

from factors import so3
from factors.earth import earth_rate_n
from factors.increments import Samples
from graphnav.baselines import ekf, kalman, rts
from graphnav.baselines.inputs import PRESETS, Inputs
from graphnav.baselines.plan import prior_covariance
from graphnav.baselines.states import unpacked
from graphnav.log import SensorLog

# error transition -------------------------------------------------------------------------------------------


def anywhere(seed: int) -> Start:
    rng = np.random.default_rng(seed)
    return start(
        rotation_nb=random_rotation(rng),
        vel_n=rng.normal(size=3),
        pos_n=rng.normal(size=3),
        gyro_bias_b=rng.normal(0, 0.01, 3),
        accel_bias_b=rng.normal(0, 0.1, 3),
    )


def transitions(span_s: float, *, earth: np.ndarray = NONE, resting: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """The first nine rows (9, 15) of the transition over a span, by the recursion and by differences through it."""
    at, samples = anywhere(4), sampled(2.0)
    end = [0.5037 + span_s]

    def after(at: Start) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        found = navigate(samples, end, at, start_s=0.5037, earth_n=earth, resting=resting)
        return found.rotation_nb[0], found.vel_n[0], found.pos_n[0]

    nominal = after(at)

    def error(x: np.ndarray) -> np.ndarray:
        rotation, vel, pos = after(at.moved(x))
        return np.concatenate([vel - nominal[1], so3.log(rotation @ nominal[0].T), pos - nominal[2]])

    blocks = navigate(samples, end, at, start_s=0.5037, earth_n=earth, resting=resting).blocks[0]
    return kalman.transition(blocks)[:9, :15], central(error, 15, 1e-4)


def by_block(matrix: np.ndarray) -> np.ndarray:
    """Largest element of every block (3, 5): rows velocity, attitude, position; columns those and the biases."""
    return np.abs(matrix.reshape(3, 3, 5, 3)).max(axis=(1, 3))


@pytest.mark.parametrize("resting", [False, True], ids=["moving", "resting"])
@pytest.mark.parametrize("span_s", [0.1, 1.0])
def test_transition_is_the_derivative_of_the_navigation(span_s: float, resting: bool) -> None:
    """To 1e-3 of every block over an odometer interval, to 1e-4 over a second.

    The gyro bias in position is a third difference over a sample: 2e-5 m for a rad/s, less than 1e-8 m for any gyro.
    """
    found, expected = transitions(span_s, earth=earth_rate_n(35.0), resting=resting)
    size, wrong = by_block(expected), by_block(found - expected)
    limit = (1e-3 if span_s < 1 else 1e-4) * size + 1e-11
    limit[2, 3] += 2e-5
    assert (wrong < limit).all(), wrong / np.maximum(size, 1e-30)
    # velocity and position by every state, attitude by itself and the gyro bias
    seen = np.array([[1, 1, 0, not resting, 1], [0, 1, 0, not resting, 0], [1, 1, 1, not resting, 1]], bool)
    assert np.array_equal(size > 1e-6, seen)


def test_transition_has_every_product_with_the_earths_rate() -> None:
    """A thousand times the Earth's rate: its terms are a tenth of the blocks, the agreement 2e-3."""
    found, expected = transitions(1.0, earth=FAST_EARTH)
    without, _ = transitions(1.0)
    size = by_block(expected)
    used = size > 0
    wrong, earths = by_block(found - expected)[used] / size[used], by_block(without - expected)[used] / size[used]
    assert (wrong < 2e-3).all()
    assert (earths[wrong > 1e-9] > 0.03).all()


def test_transitions_over_epochs_multiply() -> None:
    samples, at, earth = sampled(2.0), anywhere(5), earth_rate_n(35.0)
    epochs = [0.3, 0.456, 1.0]
    parts = navigate(samples, epochs, at, earth_n=earth).blocks
    whole = navigate(samples, epochs[-1:], at, earth_n=earth).blocks[0]
    product = np.eye(SIZE)
    for part in parts:
        product = kalman.transition(part) @ product
    assert product == pytest.approx(kalman.transition(whole), abs=1e-5)


# process noise ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("resting", [False, True], ids=["moving", "resting"])
def test_process_noise_is_what_noisy_samples_do_to_the_navigation(resting: bool) -> None:
    """2000 runs of half a second with white noise on both sensors, at a constant force, as the model has it.

    Sum of squares and every second moment of whitened errors; false-alarm rate 1e-3 in all.
    """
    rng, span_s, count = np.random.default_rng(6), 0.5, 2000
    gyro, accel = 2e-3, 5e-3
    edge = np.arange(round(span_s * HERTZ) + 1) / HERTZ
    at = start(rotation_nb=random_rotation(rng))
    still = np.zeros((len(edge) - 1, 3))
    force = still + at.rotation_nb.T @ [1.0, -0.5, 9.8]
    true = navigate(Samples(edge, still, force), [span_s], at, resting=resting)
    errors = np.empty((count, 9))
    for k in range(count):
        noisy = Samples(
            edge,
            still + gyro * np.sqrt(HERTZ) * rng.normal(size=still.shape),
            force + accel * np.sqrt(HERTZ) * rng.normal(size=still.shape),
        )
        run = navigate(noisy, [span_s], at, resting=resting)
        turned = so3.log(run.rotation_nb[0] @ true.rotation_nb[0].T)
        errors[k] = np.concatenate([run.vel_n[0] - true.vel_n[0], turned, run.pos_n[0] - true.pos_n[0]])
    q = np.empty((1, SIZE, SIZE))
    kalman.process_noise(
        true.force_n, np.array([span_s]), np.array([gyro]), np.array([accel]), np.zeros(SIZE), resting, q
    )
    used = np.diag(q[0])[:9] > 0
    assert used.sum() == (6 if resting else 9)
    assert not errors[:, ~used].any()
    white = np.linalg.solve(np.linalg.cholesky(q[0][:9, :9][np.ix_(used, used)]), errors[:, used].T)
    size = len(white)
    low, high = stats.chi2.interval(1 - 5e-4, size * count)
    assert low < np.sum(white**2) < high
    moments = white @ white.T / count - np.eye(size)
    limit = stats.norm.ppf(1 - 2.5e-4 / (size * (size + 1) / 2)) / np.sqrt(count)
    assert (np.abs(moments) < limit * np.sqrt(1 + np.eye(size))).all(), moments


# a recorded problem -----------------------------------------------------------------------------------------


def recorded(
    inputs: Inputs, monkeypatch: pytest.MonkeyPatch
) -> tuple[list[Interval], np.ndarray, np.ndarray, np.ndarray]:
    """The linear problem that the smoother solves, its smoothed errors (N, 19) and covariances, and the filter's."""
    parts: list[Interval] = []
    smoothed: list[tuple[np.ndarray, np.ndarray]] = []
    forward, backward, feedback = kalman.interval, kalman.backward, ekf.fed_back

    def interval(blocks, noise, h, epoch, z, x, p, *rest):
        assert not x.any()
        forward(blocks, noise, h, epoch, z, x, p, *rest)
        parts.append(Interval(blocks.copy(), noise.copy(), h, epoch, z, x.copy()))

    def fed_back(*args):
        reset = feedback(*args)
        parts[-1] = dataclasses.replace(parts[-1], reset=reset)
        return reset

    def back(*args):
        out = backward(*args)
        smoothed.append(out[2:])
        return out

    with monkeypatch.context() as patch:
        patch.setattr(kalman, "interval", interval)
        patch.setattr(ekf, "fed_back", fed_back)
        patch.setattr(kalman, "backward", back)
        filter_, _ = rts._online(inputs, PRESETS["matched"], None)
        smoothed.clear()
        rts.smooth_span(filter_, 0, len(parts), rts.Estimates.empty(len(parts) + 1))
    filtered = unpacked(np.asarray(filter_.estimates.covariance))
    x = np.array([np.zeros(SIZE), *(x for x, _ in smoothed)])[::-1]
    return parts, x, np.array([filtered[-1], *(p for _, p in smoothed)])[::-1], filtered


def start_of_a_cut() -> SensorLog:
    """Five seconds at rest and fifteen of the first cut."""
    log = simulated(dataclasses.replace(SHORT, static_s=5.0), 1)
    return until(dataclasses.replace(log, events=None), 20.0)


def two_small_cuts() -> SensorLog:
    """Two cuts of 4 m with closed path, surveyed end and smoothing on the way; the odometer twice a second."""
    spec = dataclasses.replace(TWO_CUTS, length_m=4.0, static_s=5.0, tail_s=2.0, retreat_m=2.0, crossing_m=1.5)
    log = simulated(dataclasses.replace(spec, pause_s=4.0), 2)
    return dataclasses.replace(log, odometer=rows(log.odometer, slice(4, None, 5)))


@pytest.mark.parametrize("log", [start_of_a_cut, two_small_cuts])
def test_smoother_is_the_dense_map_solution_of_a_recorded_log(log, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every linearization, noise and measurement of the filter's pass in one least-squares problem.

    Smoothed errors agree to 1e-9 of their sigmas (3e-12 measured), covariances to 1e-8 (2e-11).
    """
    inputs = inputs_of(log())
    parts, x, p, filtered = recorded(inputs, monkeypatch)
    assert (log is two_small_cuts) == bool(inputs.closed_path)
    prior = prior_covariance(inputs, PRESETS["matched"])
    states, spread = solve(prior, parts)
    wrong = off(x, p, states, spread)
    assert wrong[0] < 1e-9
    assert wrong[1] < 1e-8
    assert off(x[-1:], filtered[-1:], states[-1:], spread[-1:])[1] < 1e-8
    # far from where the filter was: the smoother had something to do
    assert (np.abs(states).max(axis=0) > 0.5 * np.sqrt(np.diagonal(spread, axis1=1, axis2=2)).min(axis=0)).sum() > 12
