"""The motion between two stereo pairs: alignment, bundle, consistency, wrong matches, what is refused."""

from __future__ import annotations

import numpy as np
import pytest
import stereo_scene as scene
from jacobians import ANGLES, central, moved, random_rotation
from scipy.stats import chi2

from factors import so3, stereo
from graphnav.config import StereoMotionsConfig
from graphnav.frontends import stereo_transfer
from graphnav.frontends.stereo_alignment import aligned
from graphnav.frontends.stereo_bundle import RotationPrior, adjusted
from graphnav.frontends.stereo_motion import MotionFailure, StereoMotion, stereo_motion

SEED = 66
SETTINGS = StereoMotionsConfig()
TURN, WAY = so3.exp(np.array([0.01, 0.05, -0.02])), np.array([0.05, 0.02, 0.4])


def carried(rotation: np.ndarray, pos: np.ndarray, reading: np.ndarray) -> tuple[bool, *tuple[np.ndarray, ...]]:
    seen, by_reading, by_motion = np.zeros(3), np.zeros((3, 3)), np.zeros((3, 6))
    lens = stereo_transfer.lens_of(scene.CAMERA)
    front = stereo_transfer.carry(lens, np.ascontiguousarray(rotation), pos, reading, seen, by_reading, by_motion)
    return front, seen, by_reading, by_motion


def solved(first: np.ndarray, second: np.ndarray, **settings: object) -> StereoMotion | MotionFailure:
    return stereo_motion(scene.CAMERA, scene.matches(first, second), SETTINGS.model_copy(update=settings))


def nees(found: StereoMotion, rotation: np.ndarray = TURN, pos: np.ndarray = WAY) -> float:
    error = scene.error_of(found.rotation, found.pos_m, rotation, pos)
    return float(error @ np.linalg.solve(found.cov, error))


# Pixels carried over a motion -------------------------------------------------------------------------------


def test_carried_pixels_are_those_of_the_point() -> None:
    rng = np.random.default_rng(SEED)
    first, second = scene.matched(rng, TURN, WAY, (1.0, 10.0), 30, sigma_px=0.0)
    for a, b in zip(first, second, strict=True):
        front, seen, _, _ = carried(TURN, WAY, a)
        assert front
        np.testing.assert_allclose(seen, b, atol=1e-9)


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("disparity", [8.0, 1.0, 0.0, -0.5])
def test_jacobians_of_carried_pixels(angle: float, disparity: float) -> None:
    """Also at infinity and beyond it. A camera that has turned by more than a right angle has to look back."""
    rng = np.random.default_rng([SEED, round(angle * 1e6)])
    reading = np.array([230.0, 230.0 - disparity, 100.0])
    slope, _ = stereo_transfer.homogeneous(scene.CAMERA, reading)
    rotation = so3.exp(slope / np.linalg.norm(slope) * angle)  # about the ray, which stays in view
    pos = rng.normal(0, 0.2, 3)
    front, _, by_reading, by_motion = carried(rotation, pos, reading)
    assert front
    numeric = central(lambda d: carried(rotation, pos, reading + d)[1], 3)
    np.testing.assert_allclose(by_reading, numeric, atol=1e-6)
    numeric = central(lambda d: carried(*moved(rotation, pos, d), reading)[1], 6)
    np.testing.assert_allclose(by_motion, numeric, atol=1e-6 * np.abs(numeric).max())


def test_a_point_behind_is_told_apart() -> None:
    assert not carried(np.eye(3), np.array([0.0, 0.0, 3.0]), np.array([212.0, 202.0, 120.0]))[0]


# Closed form ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", ANGLES)
def test_alignment_is_exact_without_noise(angle: float) -> None:
    rng = np.random.default_rng([SEED, round(angle * 1e6)])
    rotation, pos = random_rotation(rng, angle), rng.normal(size=3)
    points = rng.normal(size=(4, 5, 3))
    found, shift = aligned(points @ rotation.T + pos, points, rng.uniform(1, 9, (4, 5)))
    np.testing.assert_allclose(found, np.broadcast_to(rotation, (4, 3, 3)), atol=1e-7)
    np.testing.assert_allclose(shift, np.broadcast_to(pos, (4, 3)), atol=1e-7)


def test_alignment_of_three_points_never_mirrors() -> None:
    rng = np.random.default_rng(SEED)
    rotation, _ = aligned(rng.normal(size=(50, 3, 3)), rng.normal(size=(50, 3, 3)), np.ones((50, 3)))
    np.testing.assert_allclose(np.linalg.det(rotation), 1.0, atol=1e-12)


# The bundle -------------------------------------------------------------------------------------------------

#: Disparities in px, points.
CASES = [((1.0, 3.0), 200), ((1.0, 10.0), 100), ((2.0, 6.0), 60), ((4.0, 10.0), 200)]


@pytest.mark.parametrize(("disparity", "count"), CASES)
def test_consistent(disparity: tuple[float, float], count: int) -> None:
    """Sum of NEES of 60 draws within the chi-square interval of 360 degrees of freedom; false alarms 1e-4 each."""
    rng = np.random.default_rng([SEED, count])
    total = []
    for _ in range(60):
        found = solved(*scene.matched(rng, TURN, WAY, disparity, count))
        assert isinstance(found, StereoMotion)
        total.append(nees(found))
    low, high = chi2.ppf([5e-5, 1 - 5e-5], 360)
    assert low < sum(total) < high


def test_points_as_unknowns_take_the_bias_away() -> None:
    """Reprojection of triangulated points shortens the way along the axis at small disparities; the bundle does not.

    Mean of 100 draws in its own standard errors: the bundle's within 4 (false alarms 6e-5), the other's beyond 10.
    """
    rng = np.random.default_rng(SEED)
    ways = []
    for _ in range(100):
        first, second = scene.matched(rng, TURN, WAY, (1.0, 4.0), 150)
        found = adjusted(scene.CAMERA, scene.matches(first, second), TURN, WAY, 4.0)
        ways.append([found.pos_m[2], reprojected(first, second)[2]])
    away = np.array(ways) - WAY[2]
    errors = away.mean(axis=0) / (away.std(axis=0) / 10)
    assert abs(errors[0]) < 4.0
    assert errors[1] < -10.0


def reprojected(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Position by least reprojection of the first pair's triangulated points in the second, from the truth on."""
    lens, rotation, pos = stereo_transfer.lens_of(scene.CAMERA), TURN, WAY
    for _ in range(10):
        error, _, _, by_motion, squared = stereo_transfer.eliminate(lens, rotation, pos, first, second, first)
        near = np.isfinite(squared) & (np.abs(error) < 20).all(axis=1)
        step = np.linalg.lstsq(by_motion[near].reshape(-1, 6), error[near].reshape(-1))[0]
        rotation, pos = rotation @ so3.exp(step[:3]), pos + rotation @ step[3:]
    return pos


def test_larger_errors_than_declared_make_the_covariance_larger() -> None:
    rng = np.random.default_rng(SEED)
    first, second = scene.matched(rng, TURN, WAY, (3.0, 10.0), 300, sigma_px=0.75)
    larger = solved(first, second)
    assert isinstance(larger, StereoMotion)
    # 1.5, less what the gate of 4 declared sigmas cuts off; sigma of a ratio of 900 degrees of freedom: 2.4 %
    assert larger.scale == pytest.approx(1.42, rel=0.1)
    assert nees(larger) < chi2.isf(1e-4, 6)
    smaller = solved(*scene.matched(rng, TURN, WAY, (3.0, 10.0), 300, sigma_px=0.25))
    declared = solved(*scene.matched(rng, TURN, WAY, (3.0, 10.0), 300))
    assert isinstance(smaller, StereoMotion) and isinstance(declared, StereoMotion)
    assert smaller.scale < 0.6
    np.testing.assert_allclose(np.trace(smaller.cov), np.trace(declared.cov), rtol=0.3)


# Wrong matches ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.1, 0.6])
def test_wrong_matches(share: float) -> None:
    """Mean NEES of 20 draws with random matches among them; false alarms 1e-4."""
    rng = np.random.default_rng([SEED, round(share * 10)])
    total = 0.0
    for _ in range(20):
        first, second = scene.matched(rng, TURN, WAY, (2.0, 10.0), 250)
        second, wrong = scene.mistaken(rng, second, share)
        found = solved(first, second)
        assert isinstance(found, StereoMotion)
        assert found.inlier[~wrong].mean() > 0.98 and found.inlier[wrong].mean() < 0.05
        total += nees(found)
    assert total < chi2.isf(1e-4, 120)


def test_a_moving_object_is_left_out() -> None:
    rng = np.random.default_rng(SEED)
    rock = scene.matched(rng, TURN, WAY, (2.0, 10.0), 200)
    machine = scene.matched(rng, so3.exp(np.array([0.0, -0.1, 0.0])), np.array([0.3, 0.0, -0.2]), (4.0, 6.0), 80)
    found = solved(*(np.concatenate(both) for both in zip(rock, machine, strict=True)))
    assert isinstance(found, StereoMotion)
    assert found.inlier[:200].mean() > 0.98 and found.inlier[200:].mean() < 0.05
    assert nees(found) < chi2.isf(1e-4, 6)


def test_two_motions_as_strong_as_each_other_are_refused() -> None:
    rng = np.random.default_rng(SEED)
    rock = scene.matched(rng, TURN, WAY, (2.0, 10.0), 150)
    machine = scene.matched(rng, so3.exp(np.array([0.0, -0.1, 0.0])), np.array([0.3, 0.0, -0.2]), (4.0, 6.0), 120)
    found = solved(*(np.concatenate(both) for both in zip(rock, machine, strict=True)))
    assert isinstance(found, MotionFailure) and "two motions" in found.reason


def beside_an_object(trial: int) -> tuple[StereoMotion | MotionFailure, float]:
    """Rock at 2 m and beyond, random matches and an object that moves: the motion found, and its NEES."""
    rng = np.random.default_rng([SEED, 9, trial])
    rotation, pos = so3.exp(rng.normal(0, 0.05, 3)), rng.normal(0, 0.2, 3)
    first, second = scene.matched(rng, rotation, pos, (0.5, rng.uniform(5, 10)), rng.choice([60, 120, 240]))
    second, wrong = scene.mistaken(rng, second, rng.choice([0.0, 0.3, 0.6]))
    many = int((~wrong).sum() * rng.uniform(0.1, 1.2))
    machine = scene.matched(rng, so3.exp(rng.normal(0, 0.05, 3)), rng.normal(0, 0.2, 3), (3.0, 5.0), many)
    found = solved(*(np.concatenate(both) for both in zip((first, second), machine, strict=True)))
    return found, nees(found, rotation, pos) if isinstance(found, StereoMotion) else 0.0


def test_never_a_wrong_motion_with_a_small_covariance() -> None:
    """A motion within its covariance, or none.

    Each of at most 80 motions passes the chi-square's 1e-6 point; false alarms 8e-5 together.
    """
    scenes = [beside_an_object(trial) for trial in range(80)]
    given = [isinstance(found, StereoMotion) for found, _ in scenes]
    assert all(error < chi2.isf(1e-6, 6) for _, error in scenes)
    assert all(found.reason for found, _ in scenes if isinstance(found, MotionFailure))
    assert 20 < sum(given) < 60


@pytest.mark.parametrize("trial", [96, 344, 360, 453, 505, 620, 778, 1351])
def test_a_motion_between_two_is_refused(trial: int) -> None:
    """All of 1,500 such scenes in which one motion fits rock and object, with errors 1.2 to 1.6 times the declared."""
    found, _ = beside_an_object(trial)
    assert isinstance(found, MotionFailure) and "two motions" in found.reason


def test_noise_declared_too_small_is_not_taken_for_two_motions() -> None:
    """Errors 1.5 times the declared ones, 20 draws at small and at large disparities."""
    for trial in range(20):
        rng = np.random.default_rng([SEED, 2, trial])
        disparity = ((1.0, 4.0), (3.0, 10.0))[trial % 2]
        assert isinstance(solved(*scene.matched(rng, TURN, WAY, disparity, 150, sigma_px=0.75)), StereoMotion)


def test_a_moving_object_before_a_far_wall_is_not_taken_for_the_wall() -> None:
    """The wall's points are too far to draw samples from; the object's are not."""
    rng = np.random.default_rng(SEED)
    wall = scene.matched(rng, TURN, WAY, (0.3, 0.9), 150)
    machine = scene.matched(rng, so3.exp(np.array([0.0, 0.0, 0.2])), np.array([0.0, 0.5, 0.0]), (4.0, 6.0), 60)
    found = solved(*(np.concatenate(both) for both in zip(wall, machine, strict=True)))
    assert isinstance(found, MotionFailure) and "two motions" in found.reason


# What is refused --------------------------------------------------------------------------------------------


def test_random_matches_are_refused() -> None:
    rng = np.random.default_rng(SEED)
    first, _ = scene.matched(rng, TURN, WAY, (2.0, 10.0), 300)
    second, _ = scene.mistaken(rng, first, 1.0)
    found = solved(first, second)
    assert isinstance(found, MotionFailure) and "agree on a motion" in found.reason


def test_few_matches_are_refused() -> None:
    found = solved(*scene.matched(np.random.default_rng(SEED), TURN, WAY, (2.0, 10.0), 12))
    assert isinstance(found, MotionFailure) and found.reason == "12 matches, 20 are needed"


def test_swapped_cameras_are_told() -> None:
    first, second = scene.matched(np.random.default_rng(SEED), TURN, WAY, (4.0, 10.0), 100)
    found = solved(first[:, [1, 0, 2]], second[:, [1, 0, 2]])
    assert isinstance(found, MotionFailure) and "swapped" in found.reason


@pytest.mark.parametrize("count", [40, 400])
def test_points_on_a_line_are_refused(count: int) -> None:
    """Noise makes a line look as if it had a width, the more the more points there are."""
    rng = np.random.default_rng([SEED, count])
    points = np.array([-1.0, -0.5, 3.0]) + rng.uniform(0, 1, (count, 1)) * np.array([2.0, 0.8, 1.5])
    both = stereo.project(scene.CAMERA, points), stereo.project(scene.CAMERA, (points - WAY) @ TURN)
    found = solved(*(pixels + rng.normal(0, scene.SIGMA_PX, pixels.shape) for pixels in both))
    assert isinstance(found, MotionFailure) and "line" in found.reason


def before_a_wall(
    rng: np.random.Generator, changes_px: float, stays_px: float = 0.0, half_m: float = 1.3
) -> StereoMotion | MotionFailure:
    """The motion before 250 points of a wall 3.6 m ahead, with errors of either pair and errors that both have."""
    points = np.column_stack([rng.uniform(-half_m, half_m, (250, 2)), 3.6 + rng.uniform(-0.06, 0.06, 250)])
    both = stereo.project(scene.CAMERA, points), stereo.project(scene.CAMERA, (points - WAY) @ TURN)
    stays = rng.normal(0, stays_px, both[0].shape)
    first, second = (pixels + stays + rng.normal(0, changes_px, pixels.shape) for pixels in both)
    return solved(first, second)


def test_before_a_wall_the_noise_there_is_decides_and_not_the_declared_one() -> None:
    """At one depth a turn and a shift look nearly alike: 0.5 px drown the difference, 0.06 px as of patches do not.

    Of 20 walls each. The covariance stays that of the declared noise, so that NEES is far below 1.
    """
    noisy, quiet = ([before_a_wall(np.random.default_rng([SEED, k]), px) for k in range(20)] for px in (0.5, 0.06))
    assert sum(isinstance(found, MotionFailure) and "line" in found.reason for found in noisy) > 3
    assert sum(isinstance(found, StereoMotion) for found in quiet) == 20
    assert sum(nees(found) for found in quiet) < 0.1 * 120


@pytest.mark.parametrize("half_m", [1.3, 0.2])
def test_errors_that_stay_with_the_points_make_no_wrong_motion(half_m: float) -> None:
    """Three times as large as those that change, they do not show, and make the motion too short: told, or refused.

    Each of at most 40 motions passes the chi-square's 1e-6 point; false alarms 4e-5 together.
    """
    found = [before_a_wall(np.random.default_rng([SEED, k]), 0.03, 0.1, half_m) for k in range(40)]
    given = [motion for motion in found if isinstance(motion, StereoMotion)]
    assert all(nees(motion) < chi2.isf(1e-6, 6) for motion in given)
    assert len(given) > 20 if half_m > 1 else not given


def test_far_points_are_refused() -> None:
    found = solved(*scene.matched(np.random.default_rng(SEED), TURN, WAY, (0.1, 0.4), 200))
    assert isinstance(found, MotionFailure) and "near enough" in found.reason


# The rotation of an IMU -------------------------------------------------------------------------------------


def prior(angle_rad: float, sigma_rad: float = 1e-3) -> RotationPrior:
    return RotationPrior(TURN @ so3.exp(np.array([0.0, angle_rad, 0.0])), np.eye(3) * sigma_rad**2)


def with_prior(mode: str, given: RotationPrior) -> StereoMotion | MotionFailure:
    first, second = scene.matched(np.random.default_rng(SEED), TURN, WAY, (2.0, 8.0), 150)
    settings = SETTINGS.model_copy(update={"rotation_prior": mode})
    return stereo_motion(scene.CAMERA, scene.matches(first, second), settings, given)


def test_gate_rejects_and_changes_nothing_else() -> None:
    off, gated = with_prior("off", prior(0.0)), with_prior("gate", prior(1e-3))
    assert isinstance(off, StereoMotion) and isinstance(gated, StereoMotion)
    np.testing.assert_array_equal(off.cov, gated.cov)
    np.testing.assert_array_equal(off.pos_m, gated.pos_m)
    refused = with_prior("gate", prior(0.05))
    assert isinstance(refused, MotionFailure) and "sigmas from that of the IMU" in refused.reason


def test_fused_prior_improves() -> None:
    off, fused = with_prior("off", prior(0.0)), with_prior("fuse", prior(0.0, 1e-4))
    assert isinstance(off, StereoMotion) and isinstance(fused, StereoMotion)
    assert np.sqrt(np.diag(fused.cov))[:3].max() < 1.01e-4
    assert (np.diag(fused.cov) < 1.02 * np.diag(off.cov)).all()
    assert fused.cov[3, 3] < 0.5 * off.cov[3, 3]  # the turn about y no longer hides the way to the right
    assert np.linalg.norm(so3.log(TURN.T @ fused.rotation)) < 5e-4
    assert nees(fused) < chi2.isf(1e-4, 6)
