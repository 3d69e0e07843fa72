"""Measures of image quality on images of which the answer is known."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.ndimage
from dusty_scenes import SHAPE, seen, texture

from graphnav.errors import GraphnavError
from graphnav.frontends import image_quality
from graphnav.frontends._opencv import Image
from graphnav.frontends.image_quality import Kind, Matches, matched

KINDS: tuple[Kind, ...] = ("sift", "orb", "sift-faint", "orb-faint")


def warped(image: Image, warp: np.ndarray) -> Image:
    import cv2

    found: Image = cv2.warpPerspective(image, warp, SHAPE[::-1], flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    return found


def turn(angle_deg: float, shift_px: tuple[float, float]) -> np.ndarray:
    cos, sin = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    centre = np.array([SHAPE[1], SHAPE[0]]) / 2
    rotation = np.array([[cos, -sin], [sin, cos]])
    warp = np.eye(3)
    warp[:2, :2], warp[:2, 2] = rotation, centre - rotation @ centre + shift_px
    return warp


# Matches ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_matches_of_a_known_warp_are_true(kind: Kind) -> None:
    warp, image = turn(2.0, (5.0, -3.0)), seen(220 * texture())
    found = matched(image, warped(image, warp), kind)
    assert found.motion == "homography"
    assert found.count > 100
    assert found.true_to(warp)[found.kept].mean() > 0.97  # an upper octave of ORB is known to four pixels only
    assert found.true_to(turn(2.0, (15.0, -3.0))).mean() < 0.02  # of another warp they are not


@pytest.mark.parametrize("kind", KINDS)
def test_the_count_is_the_same_in_every_run(kind: Kind) -> None:
    image, other = seen(220 * texture(), seed=1), seen(warped(seen(220 * texture()), turn(1.0, (2.0, 2.0))), seed=2)
    np.testing.assert_array_equal(matched(image, other, kind).kept, matched(image, other, kind).kept)


def test_two_depths_are_a_fundamental_matrix() -> None:
    """Two planes that move differently: no homography keeps both, an epipolar geometry does."""
    shift = [np.eye(3), np.eye(3)]
    shift[0][0, 2], shift[1][0, 2] = 4.0, 16.0
    image = seen(220 * texture())
    other = np.where(np.arange(SHAPE[1]) < 200, warped(image, shift[0]), warped(image, shift[1]))
    found = matched(image, other)
    near, far = (found.true_to(warp)[found.kept].sum() for warp in shift)
    assert found.motion == "fundamental"
    assert min(near, far) > 50
    planar = matched(image, other, motion="homography")
    assert planar.motion == "homography" and planar.count < 0.8 * found.count


def test_unlike_images_keep_next_to_nothing() -> None:
    """Nothing is common; what is kept are chance agreements, of some thousand features."""
    first, second = seen(220 * texture(1)), seen(220 * texture(2))
    for kind in KINDS:
        found = matched(first, second, kind, "homography")
        assert found.count < 15
        assert len(found.first_px) < 60  # best matches that are hardly better than the second best are none


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_to_see_is_no_error(kind: Kind) -> None:
    black, image = np.zeros(SHAPE, np.uint8), seen(220 * texture())
    for first, second in ((black, black), (black, image), (image, black)):
        found = matched(first, second, kind)
        assert (found.count, found.motion, found.first_px.shape) == (0, "none", (0, 2))
        assert found.true_to(np.eye(3)).shape == (0,)


def test_faint_detectors_find_more() -> None:
    dim = seen(60 + 12 * texture())
    shifted = warped(dim, turn(0.5, (2.0, 1.0)))
    for kind, faint in (("sift", "sift-faint"), ("orb", "orb-faint")):
        assert matched(dim, shifted, faint).count > 1.2 * matched(dim, shifted, kind).count


def test_unknown_kind_and_wrong_image() -> None:
    image = seen(220 * texture())
    with pytest.raises(GraphnavError, match="kind = 'surf', expected one of sift, orb"):
        matched(image, image, "surf")  # type: ignore[arg-type]
    with pytest.raises(GraphnavError, match=r"float64 \(240, 424\), expected uint8"):
        matched(image, image.astype(float))


def test_true_to_divides_by_the_third_coordinate() -> None:
    warp = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.001, 0.0, 1.0]])
    found = Matches(np.array([[100.0, 50.0]]), np.array([[100 / 1.1, 50 / 1.1]]), np.array([True]), "homography")
    assert found.true_to(warp).all() and not found.true_to(np.eye(3)).any()
    assert found.true_to(np.eye(3), reach_px=11.0).all()


# Spread -----------------------------------------------------------------------------------------------------


def test_spread_counts_cells() -> None:
    corners = np.array([[0.0, 0.0], [1.0, 1.0], [423.9, 239.9], [424.0, 240.0]])
    assert image_quality.image_spread(corners, SHAPE) == pytest.approx(2 / 60)
    assert image_quality.image_spread(corners, SHAPE, grid=(1, 1)) == 1.0
    assert image_quality.image_spread(np.empty((0, 2)), SHAPE) == 0.0
    across = np.column_stack([np.linspace(0, 423, 10), np.full(10, 120.0)])
    assert image_quality.image_spread(across, SHAPE) == pytest.approx(10 / 60)


def test_depth_spread_counts_steps_of_depth() -> None:
    """Eight steps from 1 to 64 pixels, each of a factor 64^(1/8)."""
    steps = 64 ** ((np.arange(8) + 0.5) / 8)
    assert image_quality.depth_spread(steps) == 1.0
    assert image_quality.depth_spread(np.repeat(steps[2], 50)) == pytest.approx(1 / 8)
    assert image_quality.depth_spread(np.array([0.5, 1.1, 64.0, 500.0])) == pytest.approx(2 / 8)
    assert image_quality.depth_spread(np.array([-3.0, 0.0, np.nan, np.inf])) == 0.0


# Contrast and entropy ---------------------------------------------------------------------------------------


def test_contrast_of_a_board() -> None:
    board = 100 * (np.indices(SHAPE).sum(axis=0) % 2).astype(np.uint8)
    assert image_quality.rms_contrast(board) == pytest.approx(50.0)
    assert image_quality.local_contrast(board) == pytest.approx(50.0, rel=0.01)
    halves = np.zeros(SHAPE, np.uint8)
    halves[:, 212:] = 100
    assert image_quality.rms_contrast(halves) == pytest.approx(50.0)  # the same; seen through windows nearly nothing
    assert image_quality.local_contrast(halves) < 2.0


def test_local_contrast_is_the_mean_deviation_of_windows() -> None:
    image = seen(200 * texture(shape=(40, 50)))
    expected = scipy.ndimage.generic_filter(image.astype(float), np.std, 15, mode="reflect").mean()
    assert image_quality.local_contrast(image) == pytest.approx(expected, rel=1e-6)


def test_entropy_in_bits() -> None:
    assert image_quality.entropy(np.zeros(SHAPE, np.uint8)) == 0.0
    assert image_quality.entropy(np.arange(256, dtype=np.uint8).reshape(16, 16)) == pytest.approx(8.0)
    assert image_quality.entropy(np.repeat(np.uint8([3, 7, 7, 7]), 9).reshape(6, 6)) == pytest.approx(
        0.811278, abs=1e-6
    )
