"""Motions of a camera whose mounting may be unknown: residual, Jacobians, the native factor's equal, losses."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from jacobians import ANGLES, central, factor_jacobian, moved, random_rotation

from factors import so3
from factors.mounted_motion import MotionFamily, residual
from factors.relative_pose import Motions, between_factor, relative, seen_from

KEY = gtsam.symbol("e", 0)


def pose(rotation: np.ndarray, pos: np.ndarray) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rotation, pos
    return out


def measured_by(
    pose_i: np.ndarray, pose_j: np.ndarray, rotation_bc: np.ndarray, pos_bc: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The motion of c between two poses of b, by composing poses."""
    c_i, c_j = (each @ pose(rotation_bc, pos_bc) for each in (pose_i, pose_j))
    return relative(c_i[:3, :3], c_i[:3, 3], c_j[:3, :3], c_j[:3, 3])


def test_no_error_where_motion_and_mounting_are_true() -> None:
    rng = np.random.default_rng(0)
    declared, place = random_rotation(rng), rng.normal(size=3)
    unknown = np.r_[0.1, -0.2, 0.3, 0.05, 0.02, -0.4]
    poses = [pose(random_rotation(rng), rng.normal(size=3)) for _ in range(2)]
    rotation, pos = measured_by(*poses, declared @ so3.exp(unknown[:3]), place + unknown[3:])
    error = residual(
        poses[0][None], poses[1][None], unknown[None], declared, place, Motions(rotation[None], pos[None], np.eye(6))
    )[0]
    np.testing.assert_allclose(error, 0.0, atol=1e-12)


@pytest.mark.parametrize("angle", ANGLES[:-2])
def test_jacobians(angle: float) -> None:
    """By both poses and the mounting, with errors of up to nearly half a turn."""
    rng = np.random.default_rng(1)
    declared, place, unknown = random_rotation(rng), rng.normal(size=3), rng.normal(0, 0.1, 6)
    one = pose(random_rotation(rng), rng.normal(size=3))
    two = pose(random_rotation(rng), rng.normal(size=3))
    rotation, pos = measured_by(one, two, declared @ so3.exp(unknown[:3]), place + unknown[3:])
    wrong = Motions((rotation @ random_rotation(rng, angle))[None], pos[None] + 0.1, np.eye(6)[None])

    def error(first: np.ndarray, second: np.ndarray, mounting: np.ndarray) -> np.ndarray:
        return residual(
            pose(*moved(one[:3, :3], one[:3, 3], first))[None],
            pose(*moved(two[:3, :3], two[:3, 3], second))[None],
            (unknown + mounting)[None], declared, place, wrong,
        )[0][0]  # fmt: skip

    zero = np.zeros(6)
    _, by_i, by_j, by_mounting = residual(one[None], two[None], unknown[None], declared, place, wrong)
    # the angle of a rotation near half a turn is known to less: so are its differences
    tolerance = 1e-6 if angle < 3 else 1e-3
    for found, expected in (
        (by_i[0], central(lambda d: error(d, zero, zero), 6)),
        (by_j[0], central(lambda d: error(zero, d, zero), 6)),
        (by_mounting[0], central(lambda d: error(zero, zero, d), 6)),
    ):
        np.testing.assert_allclose(found, expected, atol=tolerance)


def family(rng: np.random.Generator, unknown: bool, **changes: object) -> tuple[MotionFamily, gtsam.Values]:
    """Two motions between three poses, off by what their covariances allow."""
    values = gtsam.Values()
    poses = [pose(random_rotation(rng), rng.normal(size=3)) for _ in range(3)]
    for i, each in enumerate(poses):
        values.insert(i, gtsam.Pose3(each))
    values.insert(KEY, np.zeros(8))
    declared, place = random_rotation(rng), rng.normal(size=3)
    exact = [measured_by(poses[k], poses[k + 1], declared, place) for k in range(2)]
    root = rng.normal(size=(2, 6, 6)) * 0.01 + 0.02 * np.eye(6)
    rotation = np.array([r @ so3.exp(rng.normal(0, 0.01, 3)) for r, _ in exact])
    pos = np.array([p for _, p in exact]) + rng.normal(0, 0.01, (2, 3))
    motions = Motions(rotation, pos, root @ np.swapaxes(root, 1, 2))
    made = MotionFamily(
        np.array([0, 1]), np.array([1, 2]), KEY if unknown else None, motions, declared, place, **changes
    )
    return made, values


def test_a_known_mounting_is_the_native_factor_of_the_body() -> None:
    """The motions of b in a `BetweenFactorPose3`: the same linear factor, to second order in the error."""
    made, values = family(np.random.default_rng(2), unknown=False)
    small = MotionFamily(made.key_i, made.key_j, None, made.measured, made.rotation_bc, made.pos_bc)
    linear = gtsam.GaussianFactorGraph()
    small.linearize_into(linear, values)
    body = seen_from(made.measured, made.rotation_bc, made.pos_bc)
    native = gtsam.NonlinearFactorGraph()
    for k in range(2):
        native.add(between_factor(k, k + 1, body.rotation[k], body.pos[k], body.cov[k]))
    ours, theirs = (graph.hessian()[0] for graph in (linear, native.linearize(values)))
    np.testing.assert_allclose(ours, theirs, atol=0.05 * np.abs(theirs).max())
    assert linear.error(values.zeroVectors()) == pytest.approx(native.error(values), rel=0.05)


@pytest.mark.parametrize("loss", ["none", "huber", "geman-mcclure"])
def test_one_by_one_they_are_the_same(loss: str) -> None:
    """Factors of their own, as iSAM2 takes them: error and Jacobians as in the family, and by differences without a
    loss."""
    made, values = family(np.random.default_rng(3), unknown=True, loss=loss, scale=1.0)
    linear = gtsam.GaussianFactorGraph()
    made.linearize_into(linear, values)
    for k in range(2):
        factor = made.factor(k)
        jacobian, right = factor.linearize(values).jacobian()
        expected, error = linear.at(k).jacobian()
        np.testing.assert_allclose(jacobian, expected, atol=1e-12)
        np.testing.assert_allclose(right, error, atol=1e-12)
        if loss == "none":
            np.testing.assert_allclose(jacobian, factor_jacobian(factor, values), atol=1e-4)


def test_the_linear_error_is_that_of_the_loss() -> None:
    made, values = family(np.random.default_rng(4), unknown=False, loss="geman-mcclure", scale=2.0)
    linear = gtsam.GaussianFactorGraph()
    made.linearize_into(linear, values)
    ratio = (made.off(values) / 2.0) ** 2
    assert linear.error(values.zeroVectors()) == pytest.approx((2.0 * ratio / (1 + ratio)).sum())
