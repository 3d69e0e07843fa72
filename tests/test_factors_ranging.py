"""UWB ranges: geometry, Jacobians, carrying to the time of a range, the Markov error, losses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import gtsam
import numpy as np
import pytest
from jacobians import ANGLES, analytic, central, factor_jacobian, moved, random_rotation

from factors import inertial, ranging, robust
from factors.increments import Samples, compensated_increments
from factors.inertial import Motion, cumulate, predict
from factors.time_offset import TimeOffset

RNG_SEED = 8
GRAVITY, EARTH = 9.8, np.array([0.0, 6e-5, 4e-5])


@pytest.mark.parametrize("angle", ANGLES)
def test_jacobians_of_the_residual(angle: float) -> None:
    rng = np.random.default_rng(RNG_SEED)
    rotation, pos, lever, anchor = random_rotation(rng, angle), rng.normal(0, 5, 3), rng.normal(0, 0.5, 3), np.ones(3)
    error, by_pose, by_anchor = ranging.range_residual(rotation, pos, lever, anchor, np.asarray(4.0))
    assert error == pytest.approx(np.linalg.norm(pos + rotation @ lever - anchor) - 4.0)

    def off(delta: np.ndarray) -> np.ndarray:
        r, p = moved(rotation, pos, delta)
        return np.atleast_1d(ranging.range_residual(r, p, lever, anchor, np.asarray(4.0))[0])

    np.testing.assert_allclose(by_pose[None], central(off, 6), atol=1e-8)
    np.testing.assert_allclose(
        by_anchor[None],
        central(
            lambda d: np.atleast_1d(ranging.range_residual(rotation, pos, lever, anchor + d, np.asarray(4.0))[0]), 3
        ),
        atol=1e-8,
    )


def test_residual_is_that_of_the_native_factor() -> None:
    """GTSAM's range factor with a transform: the tag's lever arm as the sensor's pose in the body."""
    rng = np.random.default_rng(RNG_SEED)
    noise = gtsam.noiseModel.Isotropic.Sigma(1, 0.1)
    for _ in range(20):
        rotation, pos, lever, anchor = (
            random_rotation(rng),
            rng.normal(0, 5, 3),
            rng.normal(0, 0.5, 3),
            rng.normal(size=3),
        )
        values = gtsam.Values()
        values.insert(0, gtsam.Pose3(gtsam.Rot3(rotation), pos))
        values.insert(1, anchor)
        native = gtsam.RangeFactorWithTransform3D(0, 1, 4.0, noise, gtsam.Pose3(gtsam.Rot3(), lever))
        error, by_pose, by_anchor = ranging.range_residual(rotation, pos, lever, anchor, np.asarray(4.0))
        jacobian, right = analytic(native, values)
        np.testing.assert_allclose(right, -np.atleast_1d(error) / 0.1, atol=1e-9)
        np.testing.assert_allclose(jacobian, np.r_[by_pose, by_anchor][None] / 0.1, atol=1e-9)


def shaken(rng: np.random.Generator, count: int = 60) -> Samples:
    """Samples of a shaken and turning IMU, 100 a second."""
    return Samples(np.arange(count + 1) / 100, rng.normal(0, 0.3, (count, 3)), rng.normal([0, 0, 9.8], 1, (count, 3)))


def family(rng: np.random.Generator, count: int = 5) -> tuple[ranging.RangeFamily, gtsam.Values]:
    """Ranges to two anchors within 0.6 s after one keyframe, the first at the keyframe itself."""
    t_s = np.r_[0.0, np.sort(rng.uniform(0.05, 0.59, count - 1))]
    bias = np.r_[rng.normal(0, 0.05, 3), rng.normal(0, 0.01, 3)]
    fine = compensated_increments(shaken(rng), np.unique(np.r_[0.0, t_s]), 0.05, bias[3:], bias[:3])
    motion = cumulate(inertial.Increments(np.array([0, len(fine.dt_s)]), *list(vars(fine).values())[1:]))
    ends = fine.first[1:] - 1
    first = Motion(
        np.arange(count + 1), np.r_[0.0, motion.elapsed_s[ends]],
        np.concatenate([np.eye(3)[None], motion.rotation[ends]]),
        np.vstack([np.zeros(3), motion.velocity_b[ends]]), np.vstack([np.zeros(3), motion.position_b[ends]]),
    )  # fmt: skip
    anchor = np.arange(count) % 2
    w_first, w_second, _ = ranging.markov_weights(t_s / 2, np.full(count, 0.3))
    found = ranging.RangeFamily(
        np.zeros(count, int), np.full(count, 1), np.full(count, 2), np.full(count, 3), np.full(count, 4), anchor,
        np.full(count, 2), 5 + anchor, first, np.tile(bias[:3], (count, 1)), np.tile(bias[3:], (count, 1)),
        rng.normal(0, 0.3, (count, 3)), np.array([[3.0, 1, 2], [-2, 4, 1]])[anchor], rng.uniform(2, 5, count),
        rng.uniform(0.01, 0.1, count), 0.05 * np.column_stack([w_first, w_second]), GRAVITY, EARTH,
    )  # fmt: skip
    values = gtsam.Values()
    values.insert(0, gtsam.Pose3(gtsam.Rot3(random_rotation(rng)), rng.normal(0, 1, 3)))
    values.insert(1, rng.normal(0, 0.5, 3))
    values.insert(2, gtsam.imuBias.ConstantBias(bias[:3], bias[3:]))
    for key, size in ((3, 2), (4, 2), (5, 4), (6, 4)):
        values.insert(key, rng.normal(0, 0.1, size))
    return found, values


def test_jacobians_of_carried_ranges() -> None:
    """By pose, velocity, biases, Markov errors and anchors; Earth rate is left out of them, which is 1e-5 of them."""
    readings, values = family(np.random.default_rng(RNG_SEED))
    (factor,) = readings.factors()
    jacobian, right = analytic(factor, values)
    error, _ = readings.residuals(values)
    np.testing.assert_allclose(right, -error, atol=1e-12)
    expected = factor_jacobian(factor, values)
    scale = 1 / readings.sigma_m[:, None]
    np.testing.assert_allclose(jacobian / scale, expected / scale, atol=3e-4)
    columns = np.r_[0:9, 15 : jacobian.shape[1]]  # all but the bias, whose Jacobian takes the force as constant
    np.testing.assert_allclose((jacobian / scale)[:, columns], (expected / scale)[:, columns], atol=1e-4)


def clocked(rng: np.random.Generator) -> tuple[ranging.RangeFamily, gtsam.Values]:
    """The same ranges carried at an offset of 0.1 s, where 0.13 s is the estimate."""
    readings, values = family(rng)
    values.insert(9, np.array([0.13]))
    return replace(readings, clock=TimeOffset(9, 0.1, rng.normal(0, 1.0, (len(readings.range_m), 3)))), values


def test_jacobians_of_ranges_with_a_time_offset() -> None:
    readings, values = clocked(np.random.default_rng(RNG_SEED))
    (factor,) = readings.factors()
    jacobian, expected = analytic(factor, values)[0], factor_jacobian(factor, values)
    scale = 1 / readings.sigma_m[:, None]
    np.testing.assert_allclose(jacobian / scale, expected / scale, atol=3e-4)
    np.testing.assert_allclose(jacobian[:, -1:] / scale, expected[:, -1:] / scale, atol=1e-7)
    assert np.abs(jacobian[:, -1:] / scale).max() > 0.1


def test_an_offset_moves_the_tag_along_its_velocity() -> None:
    """None where the ranges are carried to already; otherwise as if the anchors had gone the other way."""
    readings, values = clocked(np.random.default_rng(RNG_SEED))
    clock = readings.clock
    assert clock is not None
    without = replace(readings, clock=None)
    away = replace(without, anchor_n=without.anchor_n - 0.03 * clock.velocity_n)
    np.testing.assert_allclose(readings.residuals(values)[0], away.residuals(values)[0], atol=1e-9)
    values.update(9, np.array([0.1]))
    np.testing.assert_array_equal(readings.residuals(values)[0], without.residuals(values)[0])
    some = readings.only(np.array([1, 3]))
    np.testing.assert_allclose(some.residuals(values)[0], readings.residuals(values)[0][[1, 3]], atol=1e-12)


@pytest.mark.parametrize("drawn", [family, clocked])
def test_linearized_together_is_one_by_one(
    drawn: Callable[[np.random.Generator], tuple[ranging.RangeFamily, gtsam.Values]],
) -> None:
    readings, values = drawn(np.random.default_rng(RNG_SEED))
    linear = gtsam.GaussianFactorGraph()
    readings.linearize_into(linear, values)
    (factor,) = readings.factors()
    together, alone = linear.at(0).jacobian(), analytic(factor, values)
    np.testing.assert_allclose(together[0], alone[0], atol=1e-12)
    np.testing.assert_allclose(together[1], alone[1], atol=1e-12)


def test_a_range_is_read_at_its_own_time() -> None:
    """The carried pose is that of strapdown integration to the time of the range."""
    rng = np.random.default_rng(RNG_SEED)
    readings, values = family(rng)
    pose, vel = values.atPose3(0), values.atVector(1)
    count = len(readings.range_m)
    rotation, pos, _ = predict(
        np.tile(pose.rotation().matrix(), (count, 1, 1)), np.tile(pose.translation(), (count, 1)),
        np.tile(vel, (count, 1)),
        readings.motion, np.arange(count), GRAVITY, EARTH,
    )  # fmt: skip
    anchor = np.array([values.atVector(int(key)) for key in readings.anchor_key])
    tag = pos + np.einsum("kij,kj->ki", rotation, readings.lever_arm_b)
    distance = np.linalg.norm(tag - readings.anchor_n - anchor[:, 1:], axis=1)
    slots = readings.slot
    markov = readings.markov_m[:, 0] * values.atVector(3)[slots] + readings.markov_m[:, 1] * values.atVector(4)[slots]
    expected = (distance + anchor[:, 0] + markov - readings.range_m) / readings.sigma_m
    np.testing.assert_allclose(readings.residuals(values)[0], expected, atol=1e-9)


def test_between_two_times_a_markov_error_is_what_a_joint_normal_says() -> None:
    """Against conditioning the process's covariance at three times."""
    for unit, span in ((0.1, 0.3), (0.0, 0.2), (0.2, 0.2), (1.0, 5.0), (1e-4, 2e-4)):
        at = np.array([0.0, span, unit])
        cov = np.exp(-np.abs(at[:, None] - at))
        gain = cov[2, :2] @ np.linalg.inv(cov[:2, :2])
        first, second, left = ranging.markov_weights(np.array([unit]), np.array([span]))
        np.testing.assert_allclose([first[0], second[0]], gain, atol=1e-7)
        assert left[0] == pytest.approx(1 - gain @ cov[:2, 2], abs=1e-7)


def test_markov_factor_is_the_processs_transition() -> None:
    values = gtsam.Values()
    values.insert(0, np.array([0.5, -1.0]))
    values.insert(1, np.array([0.2, 0.3]))
    factor = ranging.markov_factor(0, 1, 0.4, 2)
    decay = np.exp(-0.4)
    expected = (np.array([0.2, 0.3]) - decay * np.array([0.5, -1.0])) / np.sqrt(1 - decay**2)
    np.testing.assert_allclose(factor.unwhitenedError(values), expected, rtol=1e-12)
    np.testing.assert_allclose(analytic(factor, values)[0], factor_jacobian(factor, values), atol=1e-8)


@pytest.mark.parametrize("loss", ["none", "huber", "cauchy", "geman-mcclure"])
def test_weights_are_the_slopes_of_the_losses(loss: robust.Loss) -> None:
    error = np.linspace(-9, 9, 40)
    slope = (robust.losses(error + 1e-6, loss, 2.0) - robust.losses(error - 1e-6, loss, 2.0)) / 2e-6
    np.testing.assert_allclose(slope, robust.weights(error, loss, 2.0) * error, atol=1e-7)
    small = np.array([1e-4])
    assert robust.losses(small, loss, 2.0) == pytest.approx(small**2 / 2, rel=1e-6)


@pytest.mark.parametrize("loss", ["huber", "cauchy", "geman-mcclure"])
def test_linear_error_is_that_of_the_loss(loss: robust.Loss) -> None:
    readings, values = family(np.random.default_rng(RNG_SEED))
    robustly = replace(readings, loss=loss, scale=1.5)
    linear = gtsam.GaussianFactorGraph()
    robustly.linearize_into(linear, values)
    error, _ = readings.residuals(values)
    assert np.abs(error).max() > 3
    assert linear.error(values.zeroVectors()) == pytest.approx(robust.losses(error, loss, 1.5).sum(), rel=1e-9)
    # and its gradient that of the losses: a small step changes the sum as the linear graph's gradient says
    change = gtsam.VectorValues()
    for key in values.keys():
        change.insert(key, np.full(len(values.zeroVectors().at(key)), 1e-7))
    told = linear.error(change) - linear.error(values.zeroVectors())
    after, _ = readings.residuals(values.retract(change))
    assert told == pytest.approx((robust.losses(after, loss, 1.5) - robust.losses(error, loss, 1.5)).sum(), rel=1e-3)
