"""Odometer residuals: Jacobians against central differences, factors against residuals and native factors."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from jacobians import ANGLES, analytic, central, factor_jacobian, moved, random_rotation

from factors import so3
from factors.odometry import (
    DisplacementFamily,
    displacement_factor,
    displacement_residual,
    velocity_factor,
    velocity_residual,
)

LEVER = np.array([0.3, -1.2, 0.7])
#: Mounting angles from none to wild (rad).
ALPHAS = (np.zeros(3), np.array([1e-9, -1e-9, 1e-9]), np.array([0.05, -0.01, 0.06]), np.array([0.9, -1.4, 1.1]))
#: Odometer readings: at rest, creeping, fast, and backward (m/s or m).
READINGS = (0.0, 0.01, -0.02, 0.3, -0.3, 20.0, -20.0)


def state(
    rng: np.random.Generator, angle: float, alpha: np.ndarray, measured: float, scale: float
) -> dict[str, np.ndarray]:
    """A machine that travels about `measured` along its forward axis, with some slip, from a pose turned by `angle`."""
    rotation = random_rotation(rng, angle)
    travelled_m = np.array([0.1, 1.0, -0.1]) * np.array([1, measured / (1 + scale), 1]) + rng.normal(0, 0.01, 3)
    return {
        "rotation": rotation,
        "in_b": so3.exp(alpha).T @ travelled_m,
        "calibration": np.r_[scale, alpha],
    }


# velocity ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("alpha", ALPHAS, ids=["none", "tiny", "usual", "wild"])
@pytest.mark.parametrize("angle", ANGLES)
def test_velocity_jacobians(angle: float, alpha: np.ndarray) -> None:
    for measured in READINGS:
        check_velocity_jacobians(angle, alpha, measured)


def check_velocity_jacobians(angle: float, alpha: np.ndarray, measured: float) -> None:
    rng = np.random.default_rng(1)
    at = state(rng, angle, alpha, measured, 0.05)
    rate_b = rng.normal(0, 0.5, 3)
    rotation, calibration = at["rotation"], at["calibration"]
    vel_n = rotation @ (at["in_b"] - np.cross(rate_b, LEVER))

    def error(r: np.ndarray = rotation, v: np.ndarray = vel_n, c: np.ndarray = calibration) -> np.ndarray:
        return velocity_residual(r, v, c, np.float64(measured), rate_b, LEVER)[0]

    _, by_pose, by_velocity, by_calibration = velocity_residual(
        rotation, vel_n, calibration, np.float64(measured), rate_b, LEVER
    )
    size = 1 + np.abs(vel_n).max()
    numeric = central(lambda d: error(r=rotation @ so3.exp(d)), 3)
    assert np.allclose(by_pose[:, :3], numeric, rtol=0, atol=1e-8 * size)
    assert np.array_equal(by_pose[:, 3:], np.zeros((3, 3)))
    assert np.allclose(by_velocity, central(lambda d: error(v=vel_n + d), 3), rtol=0, atol=1e-8 * size)
    assert np.allclose(by_calibration, central(lambda d: error(c=calibration + d), 4), rtol=0, atol=1e-8 * size)


def test_velocity_residual_is_zero_for_a_machine_that_follows_the_model() -> None:
    rng = np.random.default_rng(2)
    for speed in (0.0, 0.02, -0.02, 0.3, -0.3, 15.0):
        rotation, alpha, scale = random_rotation(rng), np.radians([3.0, -1.0, -4.0]), 0.04
        rate_b = rng.normal(0, 0.1, 3)
        wheel_b = so3.exp(alpha).T @ [0.0, speed, 0.0]  # v_m = Exp(alpha) v_b
        vel_n = rotation @ (wheel_b - np.cross(rate_b, LEVER))
        error = velocity_residual(rotation, vel_n, np.r_[scale, alpha], np.float64((1 + scale) * speed), rate_b, LEVER)[
            0
        ]
        assert np.allclose(error, 0, atol=1e-12)


def test_paper_sign_of_the_mounting_angles() -> None:
    """A machine that drives where its IMU points 2 deg to the left of: alpha about up is +2 deg."""
    # forward in m is 2 deg to the right of the IMU's forward axis: v_b = [sin 2, cos 2, 0]
    two = np.radians(2.0)
    vel_n = np.array([np.sin(two), np.cos(two), 0.0])
    calibration = np.array([0.0, 0.0, 0.0, two])
    error = velocity_residual(np.eye(3), vel_n, calibration, np.float64(1.0), np.zeros(3), np.zeros(3))[0]
    assert np.allclose(error, 0, atol=1e-12)


# displacement -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("alpha", ALPHAS, ids=["none", "tiny", "usual", "wild"])
@pytest.mark.parametrize("angle", ANGLES)
def test_displacement_jacobians(angle: float, alpha: np.ndarray) -> None:
    for measured in READINGS:
        check_displacement_jacobians(angle, alpha, measured)


def check_displacement_jacobians(angle: float, alpha: np.ndarray, measured: float) -> None:
    rng = np.random.default_rng(3)
    at = state(rng, angle, alpha, measured, -0.05)
    mean_b = random_rotation(rng, 0.2)
    rotation_i, pos_i = at["rotation"], rng.normal(0, 20, 3)
    rotation_j = rotation_i @ random_rotation(rng, angle)
    pos_j = pos_i + rotation_i @ (mean_b @ at["in_b"] + LEVER) - rotation_j @ LEVER
    calibration = at["calibration"]

    def error(
        i: tuple[np.ndarray, np.ndarray] = (rotation_i, pos_i),
        j: tuple[np.ndarray, np.ndarray] = (rotation_j, pos_j),
        c: np.ndarray = calibration,
    ) -> np.ndarray:
        return displacement_residual(*i, *j, c, np.float64(measured), mean_b, LEVER)[0]

    _, by_i, by_j, by_calibration = displacement_residual(
        rotation_i, pos_i, rotation_j, pos_j, calibration, np.float64(measured), mean_b, LEVER
    )
    near = 3e-8 * (1 + abs(measured))
    assert np.allclose(by_i, central(lambda d: error(i=moved(rotation_i, pos_i, d)), 6), rtol=0, atol=near)
    assert np.allclose(by_j, central(lambda d: error(j=moved(rotation_j, pos_j, d)), 6), rtol=0, atol=near)
    assert np.allclose(by_calibration, central(lambda d: error(c=calibration + d), 4), rtol=0, atol=near)


def test_displacement_residual_is_zero_for_a_machine_that_follows_the_model() -> None:
    rng = np.random.default_rng(4)
    for distance in (0.0, 0.03, -0.03, 0.3, -0.3, 8.0):
        alpha, scale, mean_b = np.radians([2.0, 0.5, -3.0]), -0.03, random_rotation(rng, 0.1)
        rotation_i, pos_i = random_rotation(rng), rng.normal(0, 50, 3)
        rotation_j = rotation_i @ random_rotation(rng, 0.2)
        wheel_b = mean_b @ so3.exp(alpha).T @ [0.0, distance, 0.0]
        pos_j = pos_i + rotation_i @ (LEVER + wheel_b) - rotation_j @ LEVER
        error = displacement_residual(
            rotation_i, pos_i, rotation_j, pos_j, np.r_[scale, alpha], np.float64((1 + scale) * distance), mean_b, LEVER
        )[0]
        assert np.allclose(error, 0, atol=1e-12)


@pytest.mark.parametrize("distance", [0.03, 0.4, -0.4])
def test_displacement_is_a_native_between_factor_when_nothing_is_to_be_calibrated(distance: float) -> None:
    """No mounting, scale or lever arm, a straight interval: the translation rows of a `BetweenFactorPose3`."""
    rng = np.random.default_rng(5)
    rotation, pos_i = random_rotation(rng), rng.normal(0, 10, 3)
    unit = gtsam.noiseModel.Unit.Create
    native = gtsam.BetweenFactorPose3(0, 1, gtsam.Pose3(gtsam.Rot3(), [0, distance, 0]), unit(6))
    ours = displacement_factor(0, 1, 2, distance, np.eye(3), unit(3), np.zeros(3))
    values = gtsam.Values()
    values.insert(0, gtsam.Pose3(gtsam.Rot3(rotation), pos_i))
    values.insert(1, gtsam.Pose3(gtsam.Rot3(rotation), pos_i + rotation @ [0, distance, 0]))
    values.insert(2, np.zeros(4))
    assert np.allclose(analytic(ours, values)[0][:, :12], analytic(native, values)[0][3:], atol=1e-12)
    # and for any error
    values.update(1, gtsam.Pose3(gtsam.Rot3(rotation), pos_i + rotation @ [0.02, distance + 0.01, -0.03]))
    assert np.allclose(ours.unwhitenedError(values), native.unwhitenedError(values)[3:], atol=1e-12)


# the scale factor ------------------------------------------------------------------------------------------


def test_the_gain_multiplies_all_three_rows() -> None:
    """Zheng (2021), equation 3. A gain on the forward row alone would reward a short path: less slip for it."""
    calibration = np.array([0.1, 0.0, 0.0, 0.0])
    velocity = np.array([0.02, 0.3, -0.01])
    error = velocity_residual(np.eye(3), velocity, calibration, np.float64(0.32), np.zeros(3), np.zeros(3))[0]
    assert np.allclose(error, [1.1 * 0.02, 1.1 * 0.3 - 0.32, -1.1 * 0.01], atol=1e-15)
    error = displacement_residual(
        np.eye(3), np.zeros(3), np.eye(3), velocity, calibration, np.float64(0.32), np.eye(3), np.zeros(3)
    )[0]
    assert np.allclose(error, [1.1 * 0.02, 1.1 * 0.3 - 0.32, -1.1 * 0.01], atol=1e-15)


def test_a_shorter_path_with_a_larger_gain_costs_the_same() -> None:
    """Path and slip scaled down by the gain: the odometer alone cannot tell, so it must not prefer either."""
    for gain in (0.9, 1.0, 1.2):
        path = np.array([0.02, 0.3, -0.01]) / gain
        calibration = np.r_[gain - 1, 0.0, 0.0, 0.0]
        error = displacement_residual(
            np.eye(3), np.zeros(3), np.eye(3), path, calibration, np.float64(0.3), np.eye(3), np.zeros(3)
        )[0]
        assert np.allclose(error, [0.02, 0.0, -0.01], atol=1e-15)


# arrays and factors -----------------------------------------------------------------------------------------


def many(count: int = 60) -> dict[str, np.ndarray]:
    """Random intervals: slow and fast, forward and backward, at any attitude."""
    rng = np.random.default_rng(6)
    rotation_i = np.array([random_rotation(rng) for _ in range(count)])
    rotation_j = np.array([r @ random_rotation(rng, 0.3) for r in rotation_i])
    distance = rng.choice([0.0, 0.02, -0.03, 0.3, -0.3, 5.0], count)
    pos_i = rng.normal(0, 30, (count, 3))
    step = np.column_stack([rng.normal(0, 0.02, count), distance * 1.02, rng.normal(0, 0.02, count)])
    return {
        "rotation_i": rotation_i,
        "pos_i": pos_i,
        "rotation_j": rotation_j,
        "pos_j": pos_i + np.einsum("kij,kj->ki", rotation_i, step),
        "calibration": np.column_stack([rng.normal(0, 0.05, count), rng.normal(0, 0.1, (count, 3))]),
        "distance_m": distance,
        "mean_b": np.array([random_rotation(rng, 0.15) for _ in range(count)]),
    }


def test_arrays_give_what_single_calls_give() -> None:
    at = many()
    together = displacement_residual(**at, lever_arm_b=LEVER)
    for k in range(len(at["distance_m"])):
        single = displacement_residual(**{name: value[k] for name, value in at.items()}, lever_arm_b=LEVER)
        for a, b in zip(together, single, strict=True):
            assert a.shape[1:] == b.shape
            assert np.allclose(a[k], b, rtol=1e-13, atol=1e-13)


def test_velocity_arrays_give_what_single_calls_give() -> None:
    at, rng = many(), np.random.default_rng(7)
    rate = rng.normal(0, 0.3, (60, 3))
    velocity = np.einsum(
        "kij,kj->ki", at["rotation_i"], np.column_stack([np.zeros(60), at["distance_m"], np.zeros(60)])
    )
    arguments = (at["rotation_i"], velocity, at["calibration"], at["distance_m"], rate)
    together = velocity_residual(*arguments, LEVER)
    for k in range(60):
        single = velocity_residual(*(value[k] for value in arguments), LEVER)
        for a, b in zip(together, single, strict=True):
            assert np.allclose(a[k], b, rtol=1e-13, atol=1e-13)


def values_of(at: dict[str, np.ndarray]) -> gtsam.Values:
    values, count = gtsam.Values(), len(at["distance_m"])
    for k in range(count):
        values.insert(k, gtsam.Pose3(gtsam.Rot3(at["rotation_i"][k]), at["pos_i"][k]))
        values.insert(1000 + k, gtsam.Pose3(gtsam.Rot3(at["rotation_j"][k]), at["pos_j"][k]))
        values.insert(2000 + k, at["calibration"][k])
        values.insert(3000 + k, at["rotation_i"][k] @ [0.01, at["distance_m"][k], -0.01])
    return values


def test_displacement_factor_is_its_residual() -> None:
    at, sigmas = many(), np.array([0.01, 0.002, 0.02])
    values = values_of(at)
    for k in range(60):
        noise = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
        factor = displacement_factor(k, 1000 + k, 2000 + k, at["distance_m"][k], at["mean_b"][k], noise, LEVER)
        error, *jacobians = displacement_residual(**{n: v[k] for n, v in at.items()}, lever_arm_b=LEVER)
        a, b = analytic(factor, values)
        assert np.allclose(factor.unwhitenedError(values), error, atol=1e-12)
        assert factor.error(values) == pytest.approx(0.5 * np.sum((error / sigmas) ** 2))
        assert np.allclose(a, np.hstack(jacobians) / sigmas[:, None], rtol=1e-10, atol=1e-8)
        assert np.allclose(b, -error / sigmas, rtol=1e-10, atol=1e-9)
        assert np.allclose(a * sigmas[:, None], factor_jacobian(factor, values), atol=2e-7)


def test_velocity_factor_is_its_residual() -> None:
    at, rate = many(), np.array([0.1, -0.2, 0.3])
    values = values_of(at)
    for k in range(60):
        speed = float(at["distance_m"][k])
        factor = velocity_factor(k, 3000 + k, 2000 + k, speed, rate, gtsam.noiseModel.Isotropic.Sigma(3, 0.01), LEVER)
        expected = velocity_residual(
            at["rotation_i"][k], values.atVector(3000 + k), at["calibration"][k], np.float64(speed), rate, LEVER
        )
        assert np.allclose(factor.unwhitenedError(values), expected[0], atol=1e-12)
        assert np.allclose(analytic(factor, values)[0] * 0.01, factor_jacobian(factor, values), atol=2e-7)


def test_family_linearizes_like_its_factors_one_by_one() -> None:
    at, rng = many(), np.random.default_rng(8)
    values = values_of(at)
    keys = np.arange(60)
    family = DisplacementFamily(
        keys, keys + 1000, 2000 + keys // 4, at["distance_m"], at["mean_b"], rng.uniform(0.001, 0.1, (60, 3)), LEVER
    )
    together, single = gtsam.GaussianFactorGraph(), gtsam.NonlinearFactorGraph()
    family.linearize_into(together, values, block=7)  # the last block is a part of one
    for k in range(60):
        single.add(family.factor(k))
    one_by_one = single.linearize(values)
    assert together.size() == 60
    ordering = gtsam.Ordering.ColamdGaussianFactorGraph(one_by_one)
    ours, expected = together.hessian(ordering), one_by_one.hessian(ordering)
    assert np.allclose(ours[0], expected[0], rtol=1e-9, atol=1e-9 * np.abs(expected[0]).max())
    assert np.allclose(ours[1], expected[1], rtol=1e-9, atol=1e-9 * np.abs(expected[1]).max())
    zero = values.zeroVectors()
    assert together.error(zero) == pytest.approx(one_by_one.error(zero), rel=1e-12)
    assert together.error(zero) == pytest.approx(single.error(values), rel=1e-12)


def test_family_takes_tiny_sigmas_as_sigmas() -> None:
    """GTSAM's "smart" noise would make a hard constraint of what is below 1e-8."""
    at = {name: value[:1] for name, value in many().items()}
    values = values_of(at)
    family = DisplacementFamily(
        np.array([0]), np.array([1000]), np.array([2000]), at["distance_m"], at["mean_b"], np.full((1, 3), 1e-9), LEVER
    )
    together, single = gtsam.GaussianFactorGraph(), gtsam.NonlinearFactorGraph()
    family.linearize_into(together, values)
    single.add(family.factor(0))
    one_by_one = single.linearize(values)
    assert together.error(values.zeroVectors()) == pytest.approx(one_by_one.error(values.zeroVectors()), rel=1e-9)
