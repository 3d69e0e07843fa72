"""One stereo reading of a point: projection, triangulation, Jacobians, GTSAM's own factor."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from jacobians import ANGLES, analytic, central, factor_jacobian, moved, random_rotation

from factors import stereo
from factors.stereo import StereoCamera

CAMERA = StereoCamera(212.0, 208.0, 210.0, 121.0, 0.095)
SEED = 6


def points_in_view(rng: np.random.Generator, shape: tuple[int, ...] = ()) -> np.ndarray:
    depth = rng.uniform(0.5, 20.0, (*shape, 1))
    return np.concatenate([depth * rng.uniform(-0.9, 0.9, (*shape, 2)), depth], axis=-1)


def scene(rng: np.random.Generator, angle: float | None = None) -> tuple[np.ndarray, ...]:
    """Pose, a point in view, and a mounting; the body turned by `angle` and the camera by it too."""
    rotation, pos = random_rotation(rng, angle), rng.normal(0, 10, 3)
    rotation_bc, pos_b = random_rotation(rng, angle), rng.normal(0, 0.5, 3)
    point = rotation @ (rotation_bc @ points_in_view(rng) + pos_b) + pos
    return rotation, pos, point, rotation_bc, pos_b


def test_paper_depth() -> None:
    """Equation 10 by hand: 212 px x 0.095 m / 4 px."""
    point = stereo.triangulate(CAMERA, np.array([210.0, 206.0, 121.0]))
    np.testing.assert_allclose(point, [0.0, 0.0, 212 * 0.095 / 4], atol=1e-15)


def test_triangulation_undoes_projection() -> None:
    points = points_in_view(np.random.default_rng(SEED), (7, 5))
    pixels = stereo.project(CAMERA, points)
    assert pixels.shape == (7, 5, 3)
    np.testing.assert_allclose(stereo.triangulate(CAMERA, pixels), points, rtol=1e-11, atol=1e-11)


def test_jacobians_of_projection_and_triangulation() -> None:
    rng = np.random.default_rng(SEED)
    for point in points_in_view(rng, (20,)):
        pixels, by_point = stereo.project_with_jacobian(CAMERA, point)
        numeric = central(lambda d, p=point: stereo.project(CAMERA, p + d), 3)
        np.testing.assert_allclose(by_point, numeric, atol=1e-6 * np.abs(numeric).max())
        _, by_pixels = stereo.triangulate_with_jacobian(CAMERA, pixels)
        np.testing.assert_allclose(by_pixels @ by_point, np.eye(3), atol=1e-9)


def test_covariance_of_triangulation() -> None:
    """At disparities of some 20 sigmas the spread of 20,000 draws is that of the covariance.

    Entries of the whitened sample covariance have a sigma of at most sqrt(2 / 20,000) = 0.01; the second order adds
    some (sigma / d)^2 = 0.0025. Limit 5 sigmas: false-alarm rate 6 x 6e-7.
    """
    rng = np.random.default_rng(SEED)
    pixels, sigma = np.array([150.0, 140.0, 170.0]), 0.5
    cov = stereo.triangulated_cov(CAMERA, pixels, sigma)
    drawn = stereo.triangulate(CAMERA, pixels + rng.normal(0, sigma / 2, (20_000, 3)))
    white = np.linalg.solve(np.linalg.cholesky(cov / 4), (drawn - drawn.mean(axis=0)).T)
    assert np.abs(white @ white.T / 20_000 - np.eye(3)).max() < 0.05


@pytest.mark.parametrize("depth", [0.0, -2.0])
def test_points_behind_the_camera_are_refused(depth: float) -> None:
    with pytest.raises(ValueError, match="not in front of the camera"):
        stereo.project(CAMERA, np.array([[0.1, 0.2, 3.0], [0.1, 0.2, depth]]))


def test_swapped_sides_are_refused() -> None:
    with pytest.raises(ValueError, match="swapped"):
        stereo.triangulate(CAMERA, np.array([100.0, 110.0, 50.0]))


@pytest.mark.parametrize("angle", ANGLES)
def test_jacobians(angle: float) -> None:
    rng = np.random.default_rng([SEED, round(angle * 1e6)])
    rotation, pos, point, rotation_bc, pos_b = scene(rng, angle)
    pixels = rng.uniform(0, 200, 3)

    def error(rotation_, pos_, point_, rotation_bc_, pos_b_):
        return stereo.residual(rotation_, pos_, point_, rotation_bc_, pos_b_, pixels, CAMERA)[0]

    _, *exact = stereo.residual(rotation, pos, point, rotation_bc, pos_b, pixels, CAMERA)
    numeric = [
        central(lambda d: error(*moved(rotation, pos, d), point, rotation_bc, pos_b), 6),
        central(lambda d: error(rotation, pos, point + d, rotation_bc, pos_b), 3),
        central(lambda d: error(rotation, pos, point, *moved(rotation_bc, pos_b, d)), 6),
    ]
    for jacobian, differences in zip(exact, numeric, strict=True):
        np.testing.assert_allclose(jacobian, differences, atol=1e-6 * max(1.0, np.abs(differences).max()))


def test_broadcasts_over_many() -> None:
    rng = np.random.default_rng(SEED)
    each = [scene(rng) for _ in range(6)]
    stacked = [np.stack(part) for part in zip(*each, strict=True)]
    pixels = rng.uniform(0, 200, (6, 3))
    together = stereo.residual(*stacked, pixels, CAMERA)
    for k, one in enumerate(each):
        for many, alone in zip(together, stereo.residual(*one, pixels[k], CAMERA), strict=True):
            np.testing.assert_allclose(many[k], alone, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("trial", range(5))
def test_is_the_native_factor(trial: int) -> None:
    """Error and Jacobians of `GenericStereoFactor3D`, which also `stereo_factor` makes."""
    rng = np.random.default_rng([SEED, trial])
    rotation, pos, point, rotation_bc, pos_b = scene(rng)
    pixels = rng.uniform(0, 200, 3)
    values = gtsam.Values()
    values.insert(0, gtsam.Pose3(gtsam.Rot3(rotation), pos))
    values.insert(1, point)
    noise = gtsam.noiseModel.Unit.Create(3)
    native = stereo.stereo_factor(0, 1, pixels, noise, CAMERA, rotation_bc, pos_b)
    assert isinstance(native, gtsam.GenericStereoFactor3D)
    error, by_pose, by_point, _ = stereo.residual(rotation, pos, point, rotation_bc, pos_b, pixels, CAMERA)
    matrix, right = analytic(native, values)
    scale = np.abs(matrix).max()
    np.testing.assert_allclose(right, -error, atol=1e-9)
    np.testing.assert_allclose(matrix, np.hstack([by_pose, by_point]), atol=1e-10 * scale)


def test_factor_with_a_mounting_of_its_own() -> None:
    rng = np.random.default_rng(SEED)
    rotation, pos, point, rotation_bc, pos_b = scene(rng)
    values = gtsam.Values()
    values.insert(0, gtsam.Pose3(gtsam.Rot3(rotation), pos))
    values.insert(1, point)
    values.insert(2, gtsam.Pose3(gtsam.Rot3(rotation_bc), pos_b))
    factor = stereo.mounted_stereo_factor(
        0, 1, 2, np.array([80.0, 60.0, 90.0]), gtsam.noiseModel.Isotropic.Sigma(3, 0.5), CAMERA
    )
    matrix, _ = analytic(factor, values)
    # the sigma of a half doubles the Jacobian, not its differences
    numeric = factor_jacobian(factor, values) / 0.5
    np.testing.assert_allclose(matrix, numeric, atol=1e-6 * np.abs(numeric).max())


def test_a_point_where_it_is_seen_leaves_no_error() -> None:
    rng = np.random.default_rng(SEED)
    point_c = points_in_view(rng)
    rotation, pos, _, rotation_bc, pos_b = scene(rng)
    point = rotation @ (rotation_bc @ point_c + pos_b) + pos
    error, *_ = stereo.residual(rotation, pos, point, rotation_bc, pos_b, stereo.project(CAMERA, point_c), CAMERA)
    assert np.abs(error).max() < 1e-9
