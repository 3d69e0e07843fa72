"""Features, their matches and their places to a fraction of a pixel, on drawn images with known shifts."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("cv2")
from drawn_pairs import SIZE, Wall, moved

from graphnav.frontends.patch_alignment import HALF, aligned, patches, smoothed
from graphnav.frontends.stereo_features import CELLS, Features, cell_of, detected, most_per_cell, spread_rows
from graphnav.frontends.stereo_linking import free_rows
from graphnav.frontends.stereo_matching import Window, matches, rectified_matches
from graphnav.frontends.stereo_sides import LEAST_SIMILARITY, MOST_SHIFT_PX

KINDS = ("orb", "sift")


def sigma(errors: np.ndarray) -> np.ndarray:
    """Robust, per column."""
    return 1.4826 * np.median(np.abs(errors - np.median(errors, axis=0)), axis=0)


def grid() -> np.ndarray:
    """Places away from the border, at all fractions of a pixel."""
    rng = np.random.default_rng(5)
    return rng.uniform([20, 20], [SIZE[0] - 20, SIZE[1] - 20], (150, 2))


def even(uv: np.ndarray) -> np.ndarray:
    """The warp of patches that keep shape and size."""
    return np.tile(np.eye(2), (len(uv), 1, 1))


# Features ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_places_are_those_of_pixel_centres(kind: str) -> None:
    """A mirrored image has its features at mirrored places: a bias to one side would show twice.

    Places as they come from OpenCV are off by 0.25 px (SIFT) and up to a pixel (ORB, in the smaller images).
    """
    image = Wall(1).seen((0, 0))
    here, mirrored = detected(image, kind, 400), detected(image[:, ::-1].copy(), kind, 400)
    back = mirrored.uv_px * [-1, 1] + [SIZE[0] - 1, 0]
    apart = np.linalg.norm(here.uv_px[:, None] - back, axis=2)
    apart[(here.scale[:, None] != mirrored.scale) | (here.scale[:, None] < (1.4 if kind == "orb" else 0))] = np.inf
    one = np.flatnonzero(apart.min(axis=1) < 1.5)
    shift = (here.uv_px[one] - back[apart[one].argmin(axis=1)])[:, 0]
    assert len(shift) > 20
    assert abs(np.median(shift)) < 0.15


@pytest.mark.parametrize("kind", KINDS)
def test_no_cell_holds_more_than_its_share(kind: str) -> None:
    found = detected(Wall(2).seen((0, 0)), kind, 60)
    assert 30 < len(found) <= 60
    assert np.bincount(cell_of(found.uv_px, SIZE), minlength=CELLS[0] * CELLS[1]).max() <= most_per_cell(60)
    assert len(detected(Wall(2).seen((0, 0)), kind, 60, spread=False)) > len(found)


def test_features_spread() -> None:
    """A half of the image with strong features does not take all of them, as it would by strength alone."""
    rng = np.random.default_rng(3)
    uv = rng.uniform([0, 0], SIZE, (800, 2))
    strong = uv[:, 0] > SIZE[0] / 2
    kept = spread_rows(uv, rng.uniform(1, 2, len(uv)) + 5 * strong, SIZE, 60)
    assert len(kept) == 60
    assert strong[kept].sum() == 36  # one of each of the 48 cells, and 12 more that are all strong


@pytest.mark.parametrize("kind", KINDS)
def test_an_image_without_features(kind: str) -> None:
    found = detected(np.full((SIZE[1], SIZE[0]), 40, np.uint8), kind, 50)
    assert len(found) == 0
    assert len(rectified_matches(found, found, 30.0)[0]) == 0


def test_new_features_only_where_there_is_room() -> None:
    offered = np.array([[30.0, 30.0], [31.0, 31.0], [100.0, 60.0], [150.0, 90.0]])
    seen = np.array([[100.5, 60.5]])
    assert free_rows(seen, offered, SIZE, 50).tolist() == [0, 3]
    assert free_rows(seen, offered, SIZE, 2).tolist() == [0]
    full = np.tile([[20.0, 30.0]], (most_per_cell(50), 1)) + np.arange(most_per_cell(50))[:, None] * [2.0, 0.0]
    assert 0 not in free_rows(full, np.array([[12.0, 22.0]]), SIZE, 50)


# Matches ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_left_and_right_are_matched_along_the_row(kind: str) -> None:
    wall = Wall(3)
    left, right = (detected(wall.seen((shift, 0)), kind, 200) for shift in (0.0, -6.4))
    rows, others = rectified_matches(left, right, 20.0)
    disparity = left.uv_px[rows, 0] - right.uv_px[others, 0]
    right_count = len(rows)
    assert right_count > 40
    assert np.mean(np.abs(disparity - 6.4) < 1.5) > 0.9
    assert disparity.min() >= 0
    assert len(set(others.tolist())) == len(others)
    rows, _ = rectified_matches(right, left, 20.0)  # swapped: nothing lies farther right
    assert len(rows) < 0.25 * right_count


def test_matches_are_mutual_and_near_enough() -> None:
    words = np.zeros((3, 4), np.uint64)
    words[1, 0], words[2] = 0b111, 2**63 - 1
    one = Features(np.zeros((2, 2)), np.ones(2), words[[0, 2]])
    other = Features(np.ones((2, 2)), np.ones(2), words[[1, 0]])
    window = Window((-2, -2), (2, 2))
    rows, others = matches(one, other, window)
    assert (rows.tolist(), others.tolist()) == ([0], [1])  # the other has no partner within 60 bits
    assert len(matches(one, other, Window((-2, -2), (0.5, 2)))[0]) == 0


# Places to a fraction of a pixel ----------------------------------------------------------------------------


@pytest.mark.parametrize("gain", [1.0, 0.6, 1.3])
@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.25, -0.4), (0.5, 0.5), (-0.7, 0.1)])
def test_shift_of_patches(shift: tuple[float, float], gain: float) -> None:
    """Noise of one grey level on contrast of 30: places to 0.03 px, without bias at any fraction of a pixel."""
    wall, uv = Wall(4), grid()
    template = patches(smoothed(wall.seen((0, 0))), uv)
    found = aligned(template, smoothed(wall.seen(shift, gain=gain)), uv + np.round(shift), even(uv))
    errors = found.uv_px - moved(uv, shift)
    assert (found.similarity > 0.9).mean() > 0.95
    assert np.abs(np.median(errors, axis=0)).max() < 0.015
    assert sigma(errors).max() < 0.04


def test_patches_that_grew() -> None:
    wall, uv, grown = Wall(5), grid(), 1.3
    uv = uv[np.abs(uv - (np.array(SIZE) - 1) / 2).max(axis=1) < 35]
    template = patches(smoothed(wall.seen((0, 0))), uv)
    image, start = smoothed(wall.seen((0.3, 0.2), grown)), moved(uv, (0.0, 0.0), grown)
    told, not_told = (aligned(template, image, start, scale * even(uv)) for scale in (grown, 1.0))
    errors = told.uv_px - moved(uv, (0.3, 0.2), grown)
    assert sigma(errors).max() < 0.08
    assert 1 - np.median(told.similarity) < 0.3 * (1 - np.median(not_told.similarity))


def test_rows_can_be_kept() -> None:
    wall, uv = Wall(6), grid()
    template = patches(smoothed(wall.seen((0, 0))), uv)
    found = aligned(template, smoothed(wall.seen((-0.4, 0.0))), uv, even(uv), rows_fixed=True)
    np.testing.assert_array_equal(found.uv_px[:, 1], uv[:, 1])
    assert abs(np.median(found.uv_px[:, 0] - uv[:, 0] + 0.4)) < 0.015


def test_patches_that_are_not_there() -> None:
    """Another wall, one without contrast, a place outside the image: nothing that would pass for a match."""
    uv = grid()
    template = patches(smoothed(Wall(7).seen((0, 0))), uv)
    other = aligned(template, smoothed(Wall(8).seen((0, 0))), uv, even(uv))
    near = np.abs(other.uv_px - uv).max(axis=1) < MOST_SHIFT_PX
    assert np.mean(near & (other.similarity > LEAST_SIMILARITY)) < 0.02
    flat = smoothed(np.full((SIZE[1], SIZE[0]), 50, np.uint8))
    assert aligned(patches(flat, uv), flat, uv, even(uv)).similarity.max() == -1
    outside = aligned(template, smoothed(Wall(7).seen((0, 0))), uv + 1000.0, even(uv))
    assert outside.similarity.max() < LEAST_SIMILARITY
    assert patches(flat, uv).shape == (len(uv), 2 * HALF + 3, 2 * HALF + 3)
