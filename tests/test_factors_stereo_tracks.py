"""Readings of tracked features as a family: Jacobians, GTSAM's native factor, losses, points behind the camera."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from jacobians import ANGLES, central, random_rotation

from factors import so3
from factors.stereo import StereoCamera, project, stereo_factor
from factors.stereo_tracks import TrackFamily

CAMERA = StereoCamera(223.0, 224.0, 211.5, 119.5, 0.095)
E, SIGMA_PX = gtsam.symbol("e", 0), 0.5
COUNT = 6


def X(i: int) -> int:
    return gtsam.symbol("x", i)


def P(j: int) -> int:
    return gtsam.symbol("p", j)


def world(seed: int, mounted: bool, angle: float | None = None, **changes: object) -> tuple[TrackFamily, gtsam.Values]:
    """Two poses that see three points each, read with noise; values are off by a little."""
    rng = np.random.default_rng(seed)
    declared, place = random_rotation(rng), rng.normal(size=3)
    values = gtsam.Values()
    pixels = []
    points = np.column_stack([rng.uniform(-1, 1, 3), rng.uniform(-1, 1, 3), rng.uniform(2, 8, 3)])
    first = random_rotation(rng, angle), rng.normal(size=3)
    points_n = (points @ declared.T + place) @ first[0].T + first[1]
    for i in range(2):
        rotation, pos = (first[0] @ so3.exp(0.02 * rng.normal(size=3)), first[1] + 0.1 * rng.normal(size=3))
        values.insert(X(i), gtsam.Pose3(gtsam.Rot3(rotation), pos))
        points_c = ((points_n - pos) @ rotation - place) @ declared
        pixels.append(project(CAMERA, points_c) + rng.normal(0, SIGMA_PX, (3, 3)))
    for j, point in enumerate(points_n):
        values.insert(P(j), point + rng.normal(0, 0.05, 3))
    values.insert(E, rng.normal(0, 0.05, 8))
    family = TrackFamily(
        np.repeat([X(0), X(1)], 3), np.tile([P(0), P(1), P(2)], 2), E if mounted else None, np.concatenate(pixels),
        SIGMA_PX, CAMERA, declared, place, **changes,
    )  # fmt: skip
    return family, values


@pytest.mark.parametrize("angle", ANGLES)
def test_jacobians(angle: float) -> None:
    """By pose, point and mounting, at attitudes of any angle."""
    family, values = world(1, True, angle)
    _, by = family.residuals(values)

    def error(key: int, delta: np.ndarray) -> np.ndarray:
        change = gtsam.VectorValues()
        change.insert(key, delta)
        return family.residuals(values.retract(change))[0][4]

    for key, size, found in ((X(1), 6, by[0]), (P(1), 3, by[1]), (E, 8, by[2])):
        differences = central(lambda d, key=key: error(key, d), size)
        np.testing.assert_allclose(found[4], differences, rtol=1e-4, atol=1e-3)


def test_with_a_known_mounting_it_is_the_native_factor() -> None:
    family, values = world(2, False)
    linear = gtsam.GaussianFactorGraph()
    family.linearize_into(linear, values)
    noise = gtsam.noiseModel.Isotropic.Sigma(3, SIGMA_PX)
    for k in range(COUNT):
        native = stereo_factor(
            int(family.pose_key[k]), int(family.point_key[k]), family.pixels[k], noise, CAMERA,
            family.rotation_bc, family.pos_bc,
        )  # fmt: skip
        for ours, theirs in zip(linear.at(k).jacobian(), native.linearize(values).jacobian(), strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-6)


def test_the_linear_error_is_that_of_the_loss() -> None:
    family, values = world(3, True, loss="geman-mcclure", scale=2.0)
    linear = gtsam.GaussianFactorGraph()
    family.linearize_into(linear, values)
    ratio = (family.off(values) / 2.0) ** 2
    assert linear.error(values.zeroVectors()) == pytest.approx((2.0 * ratio / (1 + ratio)).sum())


def test_a_point_behind_the_camera_pulls_nothing() -> None:
    """An iteration that goes astray has a large error there, so that its step is shortened, and no slope."""
    family, values = world(4, False)
    behind = values.atPose3(X(0)).transformFrom(family.pos_bc - family.rotation_bc @ [0.0, 0.0, 1.0])
    values.update(P(0), behind)
    error, by = family.residuals(values)
    assert np.abs(error[0]).min() > 100
    assert not by[0][0].any() and not by[1][0].any()
    assert by[0][1].any()


def test_a_point_behind_all_cameras_stays_where_it_is() -> None:
    """Without a row of its own it would leave the whole system without a solution."""
    family, values = world(4, False)
    values.update(P(0), values.atPose3(X(0)).transformFrom(family.pos_bc - family.rotation_bc @ [0.0, 0.0, 5.0]))
    _, by = family.residuals(values)
    assert not by[1][[0, 3]].any()
    linear = gtsam.GaussianFactorGraph()
    family.linearize_into(linear, values)
    for i in range(2):  # and the poses are known
        linear.push_back(gtsam.JacobianFactor(X(i), 1e3 * np.eye(6), np.zeros(6), gtsam.noiseModel.Unit.Create(6)))
    step = linear.optimize()
    assert np.abs(step.at(P(0))).max() < 1e-12
    assert np.abs(step.at(P(1))).max() > 1e-6


def test_some_of_them() -> None:
    family, values = world(5, True)
    rows = np.array([0, 4])
    np.testing.assert_array_equal(family.only(rows).off(values), family.off(values)[rows])
    assert replace(family, loss="huber").only(rows).loss == "huber"
