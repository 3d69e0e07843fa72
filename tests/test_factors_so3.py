"""Rotations as arrays: against the exponential series, GTSAM, and central differences."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from jacobians import ANGLES, random_rotation
from scipy.linalg import expm

from factors import so3

DIRECTIONS = [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (0.6, -0.8, 0.0), (0.36, 0.48, -0.8)]


def vectors(angle: float) -> np.ndarray:
    return angle * np.array(DIRECTIONS)


@pytest.mark.parametrize("angle", [*ANGLES, 9.9e-4, 1.01e-3, 4.0, 6.2])
def test_exp_is_the_matrix_exponential(angle: float) -> None:
    for phi, rotation in zip(vectors(angle), so3.exp(vectors(angle)), strict=True):
        assert np.allclose(rotation, expm(so3.skew(phi)), rtol=0, atol=2e-15 * max(1, angle) * 10)
        assert np.allclose(rotation, gtsam.Rot3.Expmap(phi).matrix(), rtol=0, atol=1e-14)
        assert np.allclose(rotation @ rotation.T, np.eye(3), rtol=0, atol=1e-14)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-9, 1e-5, 1e-3, 0.3, 2.0, np.pi - 1e-3, np.pi - 1e-7])
def test_log_undoes_exp(angle: float) -> None:
    assert np.allclose(
        so3.log(so3.exp(vectors(angle))), vectors(angle), rtol=0, atol=1e-14 + 2e-16 / max(np.pi - angle, 1e-2)
    )


def test_log_at_half_a_turn_gives_either_of_the_two_vectors() -> None:
    for phi in vectors(np.pi):
        found = so3.log(so3.exp(phi))
        assert min(np.abs(found - phi).max(), np.abs(found + phi).max()) < 1e-9
        assert np.allclose(so3.exp(found), so3.exp(phi), atol=1e-12)


def test_log_agrees_with_gtsam() -> None:
    rng = np.random.default_rng(1)
    for angle in np.linspace(0, 3.1, 20):
        rotation = random_rotation(rng, angle)
        assert np.allclose(so3.log(rotation), gtsam.Rot3.Logmap(gtsam.Rot3(rotation)), rtol=0, atol=1e-10)


@pytest.mark.parametrize("angle", ANGLES)
def test_left_and_right_jacobians_predict_the_perturbed_rotation(angle: float) -> None:
    rng, step = np.random.default_rng(2), 1e-6
    for phi in vectors(angle):
        d = step * rng.normal(size=3)
        change = so3.exp(phi + d), so3.exp(phi - d)
        left = (so3.log(change[0] @ so3.exp(phi).T) - so3.log(change[1] @ so3.exp(phi).T)) / 2
        right = (so3.log(so3.exp(phi).T @ change[0]) - so3.log(so3.exp(phi).T @ change[1])) / 2
        assert np.allclose(so3.left_jacobian(phi) @ d, left, rtol=0, atol=1e-9 * step / 1e-6)
        assert np.allclose(so3.right_jacobian(phi) @ d, right, rtol=0, atol=1e-9 * step / 1e-6)
        assert np.abs(so3.left_jacobian(phi) @ d - left).max() < 1e-5 * np.linalg.norm(d)


@pytest.mark.parametrize("angle", ANGLES)
def test_right_jacobian_agrees_with_gtsam(angle: float) -> None:
    for phi in vectors(angle):
        assert np.allclose(so3.right_jacobian(phi), gtsam.Rot3.ExpmapDerivative(phi), rtol=0, atol=1e-9)


def test_left_jacobian_is_the_mean_rotation() -> None:
    phi = np.array([0.4, -1.1, 0.7])
    nodes, weights = np.polynomial.legendre.leggauss(12)
    mean = np.tensordot(weights / 2, so3.exp(np.outer((nodes + 1) / 2, phi)), axes=1)
    assert np.allclose(so3.left_jacobian(phi), mean, rtol=0, atol=1e-14)


@given(st.lists(st.floats(-3, 3), min_size=3, max_size=3))
def test_quaternion_round_trip(phi: list[float]) -> None:
    rotation = so3.exp(np.array(phi))
    quat = so3.to_quaternion(rotation)
    assert quat[0] >= 0
    assert np.isclose(np.linalg.norm(quat), 1)
    assert np.allclose(so3.from_quaternion(quat), rotation, atol=1e-14)


def test_quaternion_order_is_w_first_and_hamilton() -> None:
    quarter = so3.to_quaternion(so3.exp(np.array([0, 0, np.pi / 2])))
    assert np.allclose(quarter, [np.sqrt(0.5), 0, 0, np.sqrt(0.5)])
    turned = so3.from_quaternion(np.array([np.sqrt(0.5), 0, 0, np.sqrt(0.5)])) @ [1.0, 0, 0]
    assert np.allclose(turned, [0, 1, 0])  # counter-clockwise seen from above
    assert np.allclose(gtsam.Rot3.Quaternion(*quarter).matrix(), so3.from_quaternion(quarter))


def test_skew_is_the_cross_product() -> None:
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=(2, 4, 3))
    assert np.allclose(np.einsum("kij,kj->ki", so3.skew(a), b), np.cross(a, b))


def test_functions_broadcast_over_leading_axes() -> None:
    phi = np.random.default_rng(4).normal(size=(2, 5, 3))
    phi[0, 0] = 0  # both branches of the series in one call
    for function in (so3.skew, so3.exp, so3.left_jacobian, so3.right_jacobian):
        together = function(phi)
        assert together.shape == (2, 5, 3, 3)
        assert np.array_equal(together[1, 3], function(phi[1, 3]))
        assert np.array_equal(together[0, 0], function(phi[0, 0]))
    rotation = so3.exp(phi)
    assert np.allclose(so3.log(rotation)[1, 2], so3.log(rotation[1, 2]))
    assert np.allclose(so3.to_quaternion(rotation)[1, 2], so3.to_quaternion(rotation[1, 2]))
    assert np.allclose(so3.from_quaternion(so3.to_quaternion(rotation)), rotation)
