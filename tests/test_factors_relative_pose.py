"""Relative poses: chains of motions, their covariances, and the native factor."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from jacobians import analytic, central, factor_jacobian, random_rotation

from factors import so3
from factors.relative_pose import Chain, Motions, adjoint, between_factor, relative, seen_from


def pose(rotation: np.ndarray, pos: np.ndarray) -> gtsam.Pose3:
    return gtsam.Pose3(gtsam.Rot3(rotation), pos)


def covariances(rng: np.random.Generator, count: int) -> np.ndarray:
    root = rng.normal(size=(count, 6, 6)) * 0.01
    return root @ np.swapaxes(root, 1, 2) + 1e-6 * np.eye(6)


def motions(rng: np.random.Generator, count: int, turn_rad: float = 0.3) -> Motions:
    return Motions(
        so3.exp(rng.normal(0, turn_rad, (count, 3))), rng.normal(0, 0.5, (count, 3)), covariances(rng, count)
    )


def chain(rng: np.random.Generator, count: int = 5) -> tuple[Chain, Motions]:
    steps = motions(rng, count)
    return Chain.of(np.cumsum(np.r_[3.0, rng.uniform(0.1, 0.5, count)]), steps), steps


def test_adjoint_is_that_of_gtsam() -> None:
    rng = np.random.default_rng(1)
    rotation, pos = random_rotation(rng), rng.normal(size=3)
    np.testing.assert_allclose(adjoint(rotation, pos), pose(rotation, pos).AdjointMap(), atol=1e-14)


def test_a_chain_lays_motions_one_behind_the_other() -> None:
    made, steps = chain(np.random.default_rng(2))
    at = gtsam.Pose3()
    for k in range(len(steps.pos)):
        at = at.compose(pose(steps.rotation[k], steps.pos[k]))
        np.testing.assert_allclose(made.rotation[k + 1], at.rotation().matrix(), atol=1e-12)
        np.testing.assert_allclose(made.pos[k + 1], at.translation(), atol=1e-12)
    rotation, pos = made.at(made.t_s)
    np.testing.assert_allclose(rotation, made.rotation, atol=1e-12)
    np.testing.assert_allclose(pos, made.pos, atol=1e-12)


def test_within_a_motion_the_velocity_is_constant() -> None:
    made, steps = chain(np.random.default_rng(3))
    for share in (0.2, 0.5, 0.9):
        rotation, pos = made.at(np.array([made.t_s[1] + share * (made.t_s[2] - made.t_s[1])]))
        part = gtsam.Pose3.Expmap(share * gtsam.Pose3.Logmap(pose(steps.rotation[1], steps.pos[1])))
        expected = pose(made.rotation[1], made.pos[1]).compose(part)
        np.testing.assert_allclose(rotation[0], expected.rotation().matrix(), atol=1e-12)
        np.testing.assert_allclose(pos[0], expected.translation(), atol=1e-12)


def test_covariance_of_several_motions_is_that_of_their_product() -> None:
    """Against differences: each motion perturbed on the right, the product's change read as a right perturbation."""
    made, steps = chain(np.random.default_rng(4))
    total = made.between(made.t_s[[0, 5]])
    mean = pose(total.rotation[0], total.pos[0])

    def change(delta: np.ndarray) -> np.ndarray:
        at = gtsam.Pose3()
        for k in range(5):
            wrong = gtsam.Pose3.Expmap(delta[6 * k : 6 * k + 6])
            at = at.compose(pose(steps.rotation[k], steps.pos[k])).compose(wrong)
        return gtsam.Pose3.Logmap(mean.inverse().compose(at))

    by_steps = central(change, 30)
    every = np.zeros((30, 30))
    for k in range(5):
        every[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] = steps.cov[k]
    np.testing.assert_allclose(total.cov[0], by_steps @ every @ by_steps.T, atol=1e-10)


def test_motions_between_any_times_make_the_whole() -> None:
    """Cut anywhere, also within motions: the parts multiply to the whole; on short motions their covariances do too."""
    rng = np.random.default_rng(5)
    small = Motions(so3.exp(rng.normal(0, 0.02, (40, 3))), rng.normal(0, 0.02, (40, 3)), covariances(rng, 40))
    made = Chain.of(0.1 * np.arange(41), small)
    cuts = np.sort(np.r_[0.0, 4.0, rng.uniform(0, 4, 7)])
    parts, whole = made.between(cuts), made.between(cuts[[0, -1]])
    again = Chain.of(cuts, parts)
    np.testing.assert_allclose(again.rotation[-1], whole.rotation[0], atol=1e-12)
    np.testing.assert_allclose(again.pos[-1], whole.pos[0], atol=1e-12)
    together = again.between(cuts[[0, -1]]).cov[0]
    np.testing.assert_allclose(together, whole.cov[0], atol=1e-2 * np.abs(whole.cov).max())
    assert np.linalg.eigvalsh(parts.cov).min() > 0


def test_motions_seen_from_another_body() -> None:
    rng = np.random.default_rng(6)
    steps = motions(rng, 4)
    mounting = pose(random_rotation(rng), rng.normal(size=3))
    seen = seen_from(steps, mounting.rotation().matrix(), mounting.translation())
    for k in range(4):
        step = pose(steps.rotation[k], steps.pos[k])
        expected = mounting.compose(step).compose(mounting.inverse())
        np.testing.assert_allclose(seen.rotation[k], expected.rotation().matrix(), atol=1e-12)
        np.testing.assert_allclose(seen.pos[k], expected.translation(), atol=1e-12)
        carried = mounting.AdjointMap()
        np.testing.assert_allclose(seen.cov[k], carried @ steps.cov[k] @ carried.T, atol=1e-12)


def test_factor_is_zero_at_the_measured_motion_and_whitens_by_its_covariance() -> None:
    rng = np.random.default_rng(7)
    step = motions(rng, 1)
    first = pose(random_rotation(rng), rng.normal(size=3))
    factor = between_factor(0, 1, step.rotation[0], step.pos[0], step.cov[0])
    assert isinstance(factor, gtsam.BetweenFactorPose3)
    values = gtsam.Values()
    values.insert(0, first)
    values.insert(1, first.compose(pose(step.rotation[0], step.pos[0])))
    assert factor.error(values) == pytest.approx(0.0, abs=1e-20)
    wrong = rng.normal(0, 0.01, 6)
    values.update(1, values.atPose3(1).compose(gtsam.Pose3.Expmap(wrong)))
    assert factor.error(values) == pytest.approx(0.5 * wrong @ np.linalg.solve(step.cov[0], wrong))
    white = np.linalg.cholesky(np.linalg.inv(step.cov[0])).T
    ours, native = white @ factor_jacobian(factor, values), analytic(factor, values)[0]
    np.testing.assert_allclose(ours.T @ ours, native.T @ native, rtol=1e-5, atol=1e-3)


def test_tiny_covariances_are_no_hard_constraint() -> None:
    factor = between_factor(0, 1, np.eye(3), np.zeros(3), 1e-18 * np.eye(6))
    assert not factor.noiseModel().isConstrained()


def test_relative_pose_of_two_poses() -> None:
    rng = np.random.default_rng(8)
    one, two = (pose(random_rotation(rng), rng.normal(size=3)) for _ in range(2))
    rotation, pos = relative(*(part for p in (one, two) for part in (p.rotation().matrix(), p.translation())))
    np.testing.assert_allclose(rotation, one.between(two).rotation().matrix(), atol=1e-12)
    np.testing.assert_allclose(pos, one.between(two).translation(), atol=1e-12)
