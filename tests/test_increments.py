"""Two-speed increments: composition, compensation, grouping."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from strapdown import integrate, means

from factors import so3
from factors.increments import Increments, Samples, compensated_increments, slopes

HERTZ = 100.0


def composed(increments: Increments, rows: slice = slice(None)) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and velocity (in the first body frame) over a run of minor intervals."""
    return composed_with_position(increments, rows)[:2]


def composed_with_position(increments: Increments, rows: slice = slice(None)) -> tuple[np.ndarray, ...]:
    """Rotation, velocity and position (in the first body frame) over a run of minor intervals."""
    rotation, velocity, position = np.eye(3), np.zeros(3), np.zeros(3)
    columns = (increments.dt_s, increments.rotation_b, increments.velocity_b, increments.position_b)
    for dt, turn, gained, moved in zip(*(column[rows] for column in columns), strict=True):
        position = position + velocity * dt + rotation @ moved
        velocity = velocity + rotation @ gained
        rotation = rotation @ so3.exp(turn)
    return rotation, velocity, position


def shaken(seconds: float = 3.0, irregular: bool = False, seed: int = 1) -> Samples:
    """Rough but ordinary signals: swings of 1 Hz with noise."""
    rng = np.random.default_rng(seed)
    count = round(seconds * HERTZ)
    edge = np.arange(count + 1) / HERTZ
    if irregular:
        edge[1:-1] += rng.uniform(-0.4, 0.4, count - 1) / HERTZ
    t = edge[1:, None]
    gyro = 0.5 * np.sin(2 * np.pi * t * [1.0, 1.3, 0.7] + [0, 1, 2]) + rng.normal(0, 0.01, (count, 3))
    accel = np.array([0, 0, 9.8]) + np.cos(2 * np.pi * t * [0.8, 1.1, 1.4]) + rng.normal(0, 0.05, (count, 3))
    return Samples(edge, gyro, accel)


# composition ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("irregular", [False, True])
def test_splitting_at_boundaries_changes_nothing(irregular: bool) -> None:
    """Boundaries inside samples, on their edges and a nanosecond beside them."""
    samples = shaken(irregular=irregular)
    whole = composed_with_position(compensated_increments(samples, np.array([0.0, 3.0]), 0.1))
    inner = [0.0, 0.0137, 1.0, samples.edge_s[150], samples.edge_s[170] + 1e-9, 1.99999, 2.0101, 2.0102, 3.0]
    split = composed_with_position(compensated_increments(samples, np.array(inner), 0.1))
    # what is neglected in a piece is of fourth order in its length
    assert np.linalg.norm(so3.log(whole[0].T @ split[0])) < 1e-8
    assert np.linalg.norm(whole[1] - split[1]) < 1e-7
    assert np.linalg.norm(whole[2] - split[2]) < 1e-7


@given(st.lists(st.floats(0.001, 2.999), max_size=12), st.sampled_from([0.005, 0.02, 0.1, 0.37, 10.0]))
def test_any_boundaries_and_minor_lengths_compose_to_the_same(inner: list[float], minor_s: float) -> None:
    samples = shaken()
    bounds = np.unique(np.round([0.0, *inner, 3.0], 5))
    increments = compensated_increments(samples, bounds, minor_s)
    assert len(increments.first) == len(bounds)
    assert increments.first[0] == 0
    assert increments.first[-1] == len(increments.dt_s)
    assert (np.diff(increments.first) > 0).all()
    lengths = np.add.reduceat(increments.dt_s, increments.first[:-1])
    assert np.allclose(lengths, np.diff(bounds), rtol=0, atol=1e-9)
    assert increments.dt_s.max() < max(minor_s, 1 / HERTZ) + 1 / HERTZ
    rotation, velocity = composed(increments)
    reference = composed(compensated_increments(samples, np.array([0.0, 3.0]), 0.1))
    assert np.linalg.norm(so3.log(reference[0].T @ rotation)) < 1e-8
    assert np.linalg.norm(reference[1] - velocity) < 1e-7


def test_intervals_do_not_touch_each_other() -> None:
    samples, bounds = shaken(), np.array([0.2, 1.0, 1.0004, 2.5])
    together = compensated_increments(samples, bounds, 0.1)
    for k in range(3):
        alone = compensated_increments(samples, bounds[k : k + 2], 0.1)
        rows = slice(together.first[k], together.first[k + 1])
        assert np.allclose(together.rotation_b[rows], alone.rotation_b, atol=1e-15)
        assert np.allclose(together.velocity_b[rows], alone.velocity_b, atol=1e-15)
        assert np.allclose(together.dt_s[rows], alone.dt_s, atol=1e-15)


def test_intervals_too_short_for_rounding() -> None:
    """Boundaries a few units in the last place apart still give every interval its own increment."""
    samples = shaken()
    beside = np.nextafter(2.0, 3.0)
    bounds = np.array([0.0, 1.0, np.nextafter(1.0, 2.0), 2.0, beside, np.nextafter(beside, 3.0), 3.0])
    increments = compensated_increments(samples, bounds, 0.1)
    assert (np.diff(increments.first) >= 1).all()
    lengths = np.add.reduceat(increments.dt_s, increments.first[:-1])
    assert np.allclose(lengths, np.diff(bounds), rtol=0, atol=1e-15)
    plain = composed(compensated_increments(samples, np.array([0.0, 1.0, 2.0, 3.0]), 0.1))
    found = composed(increments)
    assert np.allclose(found[0], plain[0], atol=1e-9)
    assert np.allclose(found[1], plain[1], atol=1e-8)


def test_biases_per_interval_or_for_all() -> None:
    samples, bounds = shaken(), np.array([0.0, 1.0, 2.2, 3.0])
    gyro, accel = np.array([0.01, -0.02, 0.03]), np.array([0.1, 0.2, -0.3])
    clean = Samples(samples.edge_s, samples.gyro_b - gyro, samples.accel_b - accel)
    expected = compensated_increments(clean, bounds, 0.1)
    for many in (False, True):
        biases = [np.tile(b, (3, 1)) if many else b for b in (gyro, accel)]
        found = compensated_increments(samples, bounds, 0.1, *biases)
        assert np.allclose(found.rotation_b, expected.rotation_b, atol=1e-15)
        assert np.allclose(found.velocity_b, expected.velocity_b, atol=1e-15)
    only_second = np.array([[0, 0, 0], gyro, [0, 0, 0]])
    mixed = compensated_increments(samples, bounds, 0.1, only_second)
    plain = compensated_increments(samples, bounds, 0.1)
    same = np.isclose(mixed.rotation_b, plain.rotation_b, atol=1e-15).all(axis=1)
    changed = np.arange(plain.first[1], plain.first[2])
    assert np.flatnonzero(~same).tolist() == changed.tolist()


@pytest.mark.parametrize("bounds", [(-0.5, 1.0), (0.0, 3.5)])
def test_boundaries_outside_the_samples_are_refused(bounds: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match=r"outside the samples 0\.0+\.\.3\.0+ s"):
        compensated_increments(shaken(), np.array(bounds), 0.1)


# accuracy ---------------------------------------------------------------------------------------------------


def test_slopes_are_exact_for_lines_whatever_the_sampling() -> None:
    rng = np.random.default_rng(2)
    edge = np.cumsum(rng.uniform(0.005, 0.02, 50))
    middle = ((edge[1:] + edge[:-1]) / 2)[:, None]
    samples = Samples(edge, middle * [1.0, -2.0, 3.0], 5 - middle * [0.5, 0.1, 0.0])
    gyro_slope, accel_slope = slopes(samples)
    assert np.allclose(gyro_slope, [1.0, -2.0, 3.0])
    assert np.allclose(accel_slope, [-0.5, -0.1, 0.0])


def test_one_sample_has_no_slope() -> None:
    found = slopes(Samples(np.array([0.0, 0.01]), np.ones((1, 3)), np.ones((1, 3))))
    assert np.array_equal(found[0], np.zeros((1, 3)))
    increments = compensated_increments(
        Samples(np.array([0.0, 0.01]), np.ones((1, 3)), np.ones((1, 3))), np.array([0.0, 0.01]), 0.1
    )
    assert np.allclose(increments.rotation_b, 0.01)


def test_rates_and_forces_that_change_linearly() -> None:
    """Against a fine integration; the terms in h^3 are those of rate and force that change within a sample."""
    w, w_dot = np.array([0.6, -0.4, 0.3]), np.array([-1.0, 2.0, 1.5])
    f, f_dot = np.array([1.0, 2.0, 9.8]), np.array([20.0, -30.0, 10.0])

    def rate(t: np.ndarray) -> np.ndarray:
        return w + np.multiply.outer(t, w_dot)

    def force(t: np.ndarray) -> np.ndarray:
        return f + np.multiply.outer(t, f_dot)

    exact_rotation, exact_velocity, exact_position = integrate(rate, force, 0.0, 1.0, step_s=2e-4)

    def errors(hertz: int, crude: bool = False) -> np.ndarray:
        edge = np.arange(hertz + 1) / hertz
        samples = Samples(edge, means(rate, edge), means(force, edge))
        rotation, velocity, position = (
            composed_per_sample(samples)
            if crude
            else composed_with_position(compensated_increments(samples, np.array([0.0, 1.0]), 0.05))
        )
        turn = np.linalg.norm(so3.log(exact_rotation.T @ rotation))
        return np.array([turn, np.linalg.norm(exact_velocity - velocity), np.linalg.norm(exact_position - position)])

    coarse, fine = errors(100), errors(200)
    # what is left of the attitude is of fourth order in the sampling interval, of the others of third order;
    # a wrong term in h^3 would leave the second order
    assert coarse[0] / fine[0] > 12
    assert coarse[1] / fine[1] > 6.5
    assert coarse[2] / fine[2] > 6.5
    assert (coarse * 300 < errors(100, crude=True)).all()


def composed_per_sample(samples: Samples) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """GTSAM's integration, sample by sample."""
    pim = gtsam.PreintegratedImuMeasurements(gtsam.PreintegrationParams.MakeSharedU(9.8), gtsam.imuBias.ConstantBias())
    for force, rate, dt in zip(samples.accel_b, samples.gyro_b, np.diff(samples.edge_s), strict=True):
        pim.integrateMeasurement(force, rate, dt)
    return pim.deltaRij().matrix(), pim.deltaVij(), pim.deltaPij()


@pytest.mark.parametrize("minor_s", [0.02, 0.05, 0.1])
@pytest.mark.parametrize("frequency_hz", [1.0, 4.0, 10.0])
def test_coning_and_sculling_against_the_exact_attitude(frequency_hz: float, minor_s: float) -> None:
    """A cone of 1 deg about up while the platform shakes sideways in step, 10 s: the classic worst case.

    Attitude ``Exp([a cos, a sin, 0])`` and acceleration in n are given, so all else is exact.
    """
    a, omega, shake = np.radians(1.0), 2 * np.pi * frequency_hz, 2.0
    end = 10.0

    def phi(t: np.ndarray) -> np.ndarray:
        return a * np.stack([np.cos(omega * t), np.sin(omega * t), 0 * t], axis=-1)

    def phi_dot(t: np.ndarray) -> np.ndarray:
        return a * omega * np.stack([-np.sin(omega * t), np.cos(omega * t), 0 * t], axis=-1)

    def rate(t: np.ndarray) -> np.ndarray:
        return np.einsum("...ij,...j->...i", so3.right_jacobian(phi(t)), phi_dot(t))

    def force(t: np.ndarray) -> np.ndarray:
        in_n = shake * np.stack([np.sin(omega * t), 0 * t, 0 * t], axis=-1) + [0, 0, 9.8]
        return np.einsum("...ji,...j->...i", so3.exp(phi(t)), in_n)

    edge = np.arange(round(end * HERTZ) + 1) / HERTZ
    samples = Samples(edge, means(rate, edge), means(force, edge))
    begin = so3.exp(phi(np.float64(0.0)))
    exact = begin.T @ so3.exp(phi(np.float64(end)))
    velocity_n = shake * (1 - np.cos(omega * end)) / omega * np.array([1.0, 0, 0]) + np.array([0, 0, 9.8 * end])
    ours = composed(compensated_increments(samples, np.array([0.0, end]), minor_s))
    theirs = composed_per_sample(samples)
    turned = [np.linalg.norm(so3.log(exact.T @ rotation)) for rotation, *_ in (ours, theirs)]
    moved = [np.linalg.norm(begin @ velocity - velocity_n) for _, velocity, *_ in (ours, theirs)]
    # The slopes are differences over two samples: good at 1 Hz, worth their while at 10 Hz.
    gain = {1.0: 500.0, 4.0: 40.0, 10.0: 6.0}[frequency_hz]
    assert turned[0] * gain < turned[1]
    assert moved[0] * gain < moved[1]


def test_constant_turn_is_exact_for_any_rate() -> None:
    w, f = np.array([0.3, -1.0, 2.0]), np.array([1.0, 2.0, 9.8])
    edge = np.arange(201) / HERTZ
    samples = Samples(edge, np.tile(w, (200, 1)), np.tile(f, (200, 1)))
    rotation, velocity = composed(compensated_increments(samples, np.array([0.0, 2.0]), 0.1))
    assert np.allclose(rotation, Rotation.from_rotvec(2 * w).as_matrix(), atol=1e-13)
    # the velocity series stops after (w h)^2 / 6: its next term is (w h)^3 / 24
    assert np.linalg.norm(velocity - 2 * so3.left_jacobian(2 * w) @ f) < 2 * 10 * (np.linalg.norm(w) / HERTZ) ** 3 / 24
