"""Rest and known positions: Jacobians, physics, native factors."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from jacobians import ANGLES, analytic, central, factor_jacobian, random_rotation

from factors import position, so3, stationary
from factors.earth import earth_rate_n

EARTH_N = earth_rate_n(35.0)


@pytest.mark.parametrize("angle", ANGLES)
def test_zero_rate_jacobians(angle: float) -> None:
    """With a rate large enough for differences to see; the residual is linear in it."""
    rng = np.random.default_rng(1)
    rotation, bias, rate, big_n = random_rotation(rng, angle), rng.normal(size=3), rng.normal(size=3), 1e4 * EARTH_N
    _, by_attitude, by_bias = stationary.zero_rate_residual(rotation, bias, rate, big_n)
    by_difference = central(lambda d: stationary.zero_rate_residual(rotation @ so3.exp(d), bias, rate, big_n)[0], 3)
    assert np.allclose(by_attitude, by_difference, rtol=0, atol=1e-8)
    by_difference = central(lambda d: stationary.zero_rate_residual(rotation, bias + d, rate, big_n)[0], 3)
    assert np.allclose(by_bias, by_difference, rtol=0, atol=1e-8)


def test_a_resting_gyro_reads_earth_rate_and_bias() -> None:
    rng = np.random.default_rng(2)
    bias = rng.normal(0, 1e-3, 3)
    facing_north = stationary.zero_rate_residual(np.eye(3), bias, bias + EARTH_N, EARTH_N)[0]
    assert np.allclose(facing_north, 0, atol=1e-18)
    rotation = random_rotation(rng)
    assert np.allclose(stationary.zero_rate_residual(rotation, bias, bias + rotation.T @ EARTH_N, EARTH_N)[0], 0)


def test_zero_rate_arrays_give_what_single_calls_give() -> None:
    rng = np.random.default_rng(3)
    rotation = np.array([random_rotation(rng) for _ in range(8)])
    bias, rate = rng.normal(size=(2, 8, 3))
    together = stationary.zero_rate_residual(rotation, bias, rate, EARTH_N)
    for k in range(8):
        for a, b in zip(together, stationary.zero_rate_residual(rotation[k], bias[k], rate[k], EARTH_N), strict=True):
            assert np.allclose(a[k], b, atol=1e-16)


def at_rest(angle: float) -> gtsam.Values:
    rng = np.random.default_rng(4)
    values = gtsam.Values()
    values.insert(0, gtsam.Pose3(gtsam.Rot3(random_rotation(rng, angle)), rng.normal(size=3)))
    values.insert(1, gtsam.imuBias.ConstantBias(rng.normal(0, 0.01, 3), rng.normal(0, 0.001, 3)))
    values.insert(2, rng.normal(size=3))
    return values


@pytest.mark.parametrize("angle", ANGLES)
def test_zero_rate_factor_is_its_residual(angle: float) -> None:
    values, rate = at_rest(angle), np.array([1e-3, -2e-3, 5e-4])
    factor = stationary.zero_rate_factor(0, 1, rate, 1e4 * EARTH_N, gtsam.noiseModel.Isotropic.Sigma(3, 1e-3))
    expected = stationary.zero_rate_residual(
        values.atPose3(0).rotation().matrix(), values.atConstantBias(1).gyroscope(), rate, 1e4 * EARTH_N
    )
    assert np.allclose(factor.unwhitenedError(values), expected[0], atol=1e-15)
    assert np.allclose(analytic(factor, values)[0] * 1e-3, factor_jacobian(factor, values), rtol=0, atol=1e-8)


@pytest.mark.parametrize("angle", ANGLES)
def test_zero_rate_factor_is_gtsams_magnetometer_factor(angle: float) -> None:
    """A vector known in n and measured in b with a bias: native `MagPoseFactorPose3`, of opposite sign."""
    values, rate = at_rest(angle), np.array([1e-3, -2e-3, 5e-4])
    size = float(np.linalg.norm(EARTH_N))
    unit = gtsam.noiseModel.Unit.Create(3)
    native = gtsam.MagPoseFactorPose3(
        0, rate, size, EARTH_N / size, values.atConstantBias(1).gyroscope(), unit, gtsam.Pose3()
    )
    ours = stationary.zero_rate_factor(0, 1, rate, EARTH_N, unit)
    assert np.allclose(ours.unwhitenedError(values), -native.unwhitenedError(values), rtol=0, atol=1e-15)
    assert np.allclose(analytic(ours, values)[0][:, :6], -analytic(native, values)[0], rtol=0, atol=1e-15)


def test_zero_velocity_factor_measures_the_velocity() -> None:
    values = at_rest(1.0)
    factor = stationary.zero_velocity_factor(2, 1e-3)
    assert np.allclose(factor.unwhitenedError(values), values.atVector(2))
    assert np.allclose(analytic(factor, values)[0], np.eye(3) * 1e3)


def test_unmoved_factor_is_zero_for_equal_poses_and_weighs_turn_and_shift() -> None:
    values = at_rest(1.0)
    factor = stationary.unmoved_factor(0, 5, 1e-5, 1e-4)
    values.insert(5, values.atPose3(0))
    assert np.allclose(factor.unwhitenedError(values), 0, atol=1e-15)
    values.update(5, values.atPose3(0).compose(gtsam.Pose3(gtsam.Rot3.Expmap(np.array([1e-5, 0, 0])), np.zeros(3))))
    assert factor.error(values) == pytest.approx(0.5, rel=1e-6)
    values.update(5, values.atPose3(0).compose(gtsam.Pose3(gtsam.Rot3(), np.array([0, 0, 1e-4]))))
    assert factor.error(values) == pytest.approx(0.5, rel=1e-6)


def test_position_factor_is_gtsams_gps_factor() -> None:
    values, measured = at_rest(2.0), np.array([3.0, -1.0, 0.5])
    sigma = np.array([0.1, 0.2, 0.4])
    ours = position.position_factor(0, measured, sigma)
    native = gtsam.GPSFactor(0, measured, gtsam.noiseModel.Diagonal.Sigmas(sigma))
    assert np.allclose(ours.unwhitenedError(values), values.atPose3(0).translation() - measured)
    assert np.allclose(ours.unwhitenedError(values), native.unwhitenedError(values))
    assert ours.error(values) == pytest.approx(native.error(values))
    assert np.allclose(analytic(ours, values)[0], analytic(native, values)[0], atol=1e-12)


def test_one_sigma_stands_for_three() -> None:
    values, measured = at_rest(2.0), np.array([3.0, -1.0, 0.5])
    one, three = (position.position_factor(0, measured, sigma) for sigma in (0.1, np.full(3, 0.1)))
    assert one.error(values) == three.error(values)
