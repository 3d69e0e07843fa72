"""Closed-path residuals: Jacobians, the papers' equation, native factors."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from jacobians import ANGLES, analytic, central, factor_jacobian, moved, random_rotation

from factors import closed_path, so3

ADVANCE = np.array([0.4, -0.17, 0.02])
ALPHAS = (np.zeros(3), np.array([1e-9, 0, -1e-9]), np.array([0.05, -0.01, 0.06]), np.array([0.9, -1.4, 1.1]))


def passes(rng: np.random.Generator, angle: float, alpha: np.ndarray, error: float = 0.05) -> tuple[np.ndarray, ...]:
    """Two passes over one point, the second about the advance away from the first and turned by a little."""
    rotation_i, pos_i = random_rotation(rng, angle), rng.normal(0, 30, 3)
    pos_j = pos_i + rotation_i @ so3.exp(alpha).T @ (ADVANCE + rng.normal(0, error, 3))
    return rotation_i, pos_i, rotation_i @ random_rotation(rng, 0.05), pos_j


@pytest.mark.parametrize("alpha", ALPHAS, ids=["none", "tiny", "usual", "wild"])
@pytest.mark.parametrize("angle", ANGLES)
def test_relative_jacobians(angle: float, alpha: np.ndarray) -> None:
    rng = np.random.default_rng(1)
    rotation_i, pos_i, _, pos_j = passes(rng, angle, alpha)
    calibration = np.r_[0.04, alpha]

    def error(i=(rotation_i, pos_i), j=pos_j, c=calibration) -> np.ndarray:
        return closed_path.relative_residual(*i, j, c, ADVANCE)[0]

    _, by_i, by_j_n, by_calibration = closed_path.relative_residual(rotation_i, pos_i, pos_j, calibration, ADVANCE)
    assert np.allclose(by_i, central(lambda d: error(i=moved(rotation_i, pos_i, d)), 6), rtol=0, atol=3e-8)
    assert np.allclose(by_j_n, central(lambda d: error(j=pos_j + d), 3), rtol=0, atol=3e-8)
    assert np.allclose(by_calibration, central(lambda d: error(c=calibration + d), 4), rtol=0, atol=3e-8)
    assert np.array_equal(by_calibration[:, 0], np.zeros(3))  # the scale factor has no part in it


def test_relative_residual_is_the_papers_equation() -> None:
    """``p_{j} = p_i + R_nb Exp(-alpha) D_m`` has residual zero (Zheng 2021, equations 5-6)."""
    rng = np.random.default_rng(2)
    for alpha in ALPHAS:
        rotation, pos_i = random_rotation(rng), rng.normal(0, 30, 3)
        pos_j = pos_i + rotation @ so3.exp(-alpha) @ ADVANCE
        error = closed_path.relative_residual(rotation, pos_i, pos_j, np.r_[0.0, alpha], ADVANCE)[0]
        assert np.allclose(error, 0, atol=1e-13)


def test_push_is_along_the_machines_right_axis() -> None:
    """A machine that points north is pushed east."""
    north = np.eye(3)
    error = closed_path.relative_residual(
        north, np.zeros(3), np.array([0.4, 0, 0]), np.zeros(4), np.array([0.4, 0, 0])
    )[0]
    assert np.allclose(error, 0)
    west = so3.exp(np.array([0, 0, np.pi / 2]))
    error = closed_path.relative_residual(west, np.zeros(3), np.array([0, 0.4, 0]), np.zeros(4), np.array([0.4, 0, 0]))[
        0
    ]
    assert np.allclose(error, 0)


def test_arrays_give_what_single_calls_give() -> None:
    rng = np.random.default_rng(3)
    rows = [passes(rng, rng.uniform(0, np.pi), np.zeros(3)) for _ in range(12)]
    rotation, pos_i, _, pos_j = (np.array(part) for part in zip(*rows, strict=True))
    calibration = rng.normal(0, 0.1, (12, 4))
    advance = rng.normal(0, 1, (12, 3))
    together = closed_path.relative_residual(rotation, pos_i, pos_j, calibration, advance)
    for k in range(12):
        single = closed_path.relative_residual(rotation[k], pos_i[k], pos_j[k], calibration[k], advance[k])
        for a, b in zip(together, single, strict=True):
            assert np.allclose(a[k], b, atol=1e-14)


def values_at(angle: float, alpha: np.ndarray, seed: int = 4) -> gtsam.Values:
    rotation_i, pos_i, rotation_j, pos_j = passes(np.random.default_rng(seed), angle, alpha)
    values = gtsam.Values()
    values.insert(0, gtsam.Pose3(gtsam.Rot3(rotation_i), pos_i))
    values.insert(1, gtsam.Pose3(gtsam.Rot3(rotation_j), pos_j))
    values.insert(2, np.r_[0.03, alpha])
    values.insert(3, np.array([-0.2]))
    return values


@pytest.mark.parametrize("angle", ANGLES)
def test_factors_are_their_residual(angle: float) -> None:
    noise = closed_path.advance_noise(0.03, 0.5)
    for alpha in ALPHAS:
        values = values_at(angle, alpha)
        poses = values.atPose3(0).matrix(), values.atPose3(1).matrix()
        arguments = poses[0][:3, :3], poses[0][:3, 3], poses[1][:3, 3], values.atVector(2)
        plain = closed_path.relative_factor(0, 1, 2, ADVANCE, noise)
        creeping = closed_path.creeping_factor(0, 1, 2, 3, ADVANCE, noise)
        shifted = closed_path.relative_residual(*arguments, ADVANCE + np.array([0, -0.2, 0]))[0]
        assert np.allclose(plain.unwhitenedError(values), closed_path.relative_residual(*arguments, ADVANCE)[0])
        assert np.allclose(creeping.unwhitenedError(values), shifted)
        sigmas = np.array([0.03, 0.5, 0.03])  # right, forward, up
        for factor in (plain, creeping):
            whitened, b = analytic(factor, values)
            assert np.allclose(whitened * sigmas[:, None], factor_jacobian(factor, values), rtol=0, atol=1e-7)
            assert np.allclose(b * sigmas, -factor.unwhitenedError(values), atol=1e-12)


def test_creep_is_added_along_the_face() -> None:
    values = values_at(0.4, np.zeros(3))
    noise = closed_path.advance_noise(0.03, 0.03)
    creeping = closed_path.creeping_factor(0, 1, 2, 3, ADVANCE, noise)
    plain = closed_path.relative_factor(0, 1, 2, ADVANCE + np.array([0, -0.2, 0]), noise)
    assert np.allclose(creeping.unwhitenedError(values), plain.unwhitenedError(values), atol=1e-14)


def test_relative_factor_is_a_native_between_factor_where_the_machine_does_not_turn() -> None:
    """Without mounting angles and turn: the translation rows of a `BetweenFactorPose3` with the advance."""
    rng = np.random.default_rng(5)
    rotation, pos_i = random_rotation(rng), rng.normal(0, 10, 3)
    values = gtsam.Values()
    values.insert(0, gtsam.Pose3(gtsam.Rot3(rotation), pos_i))
    values.insert(1, gtsam.Pose3(gtsam.Rot3(rotation), pos_i + rotation @ ADVANCE))
    values.insert(2, np.zeros(4))
    unit = gtsam.noiseModel.Unit.Create
    native = gtsam.BetweenFactorPose3(0, 1, gtsam.Pose3(gtsam.Rot3(), ADVANCE), unit(6))
    ours = closed_path.relative_factor(0, 1, 2, ADVANCE, unit(3))
    assert np.allclose(analytic(ours, values)[0][:, :12], analytic(native, values)[0][3:], atol=1e-12)
    values.update(1, gtsam.Pose3(gtsam.Rot3(rotation), pos_i + rotation @ (ADVANCE + np.array([0.02, -0.05, 0.01]))))
    assert np.allclose(ours.unwhitenedError(values), native.unwhitenedError(values)[3:], atol=1e-12)


def test_absolute_factor_is_a_position_prior() -> None:
    values = values_at(0.7, np.zeros(3))
    predicted = np.array([1.0, 2.0, -3.0])
    factor = closed_path.absolute_factor(1, predicted, gtsam.noiseModel.Isotropic.Sigma(3, 0.1))
    assert np.allclose(factor.unwhitenedError(values), values.atPose3(1).translation() - predicted)
    expected = np.zeros((3, 6))
    expected[:, 3:] = values.atPose3(1).rotation().matrix()
    assert np.allclose(analytic(factor, values)[0] * 0.1, expected, atol=1e-12)
    assert np.allclose(expected, factor_jacobian(factor, values), atol=1e-7)
    assert list(factor.keys()) == [1]
