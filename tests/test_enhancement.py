"""Image enhancement: the equations on scenes whose light, dust and reflectance are known, and what noise becomes."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import scipy.ndimage
from dusty_scenes import SHAPE, clear_share, correlation, headlight, seen, texture

from graphnav.errors import ConfigError, GraphnavError
from graphnav.frontends import enhancement
from graphnav.frontends._opencv import Image
from graphnav.frontends.enhancement import DEFAULTS, ENHANCERS, EnhancementSettings
from graphnav.frontends.image_quality import local_contrast

STAGES: dict[str, Callable[[Image], Image]] = {
    **ENHANCERS,
    "reflection": enhancement.reflection,
    "dedusted": enhancement.dedusted,
    "resized": enhancement.resized,
    "grey": enhancement.grey,
}


# Equations 1 to 3 -------------------------------------------------------------------------------------------


def test_retinex_removes_the_light_and_keeps_the_reflectance() -> None:
    reflectance, light = 0.2 + 0.8 * texture(), headlight()
    raw = seen(light * reflectance)
    found = enhancement.reflection(raw)
    bright = light > 30  # elsewhere a grey level is a large part of what is seen
    known, shown = (correlation(np.log(reflectance[bright]), image[bright]) for image in (np.log1p(raw), found))
    assert shown > 0.9 > 0.65 > known
    lit, left = (correlation(np.log(light[bright]), image[bright]) for image in (np.log1p(raw), found))
    assert abs(left) < 0.3 < 0.8 < lit  # what is left is light that changes within the surround


def test_reflection_is_the_logarithm_of_s_by_its_blurred_self() -> None:
    """Equation 3 written out at full size; the coarse grid of the surround costs two grey levels at most."""
    raw = seen(headlight() * texture())
    light = scipy.ndimage.gaussian_filter(raw.astype(float), DEFAULTS.surround_px, mode="reflect")
    log_r = np.log(raw + DEFAULTS.dark_grey) - np.log(light + DEFAULTS.dark_grey)
    expected = np.clip(128 + DEFAULTS.log_gain * log_r, 0, 255)
    off = np.abs(enhancement.reflection(raw) - expected)
    assert off.max() < 4.0 and off.mean() < 1.0


def test_reflection_of_an_even_image_is_the_middle_grey() -> None:
    for level in (0, 1, 128, 255):
        np.testing.assert_array_equal(enhancement.reflection(np.full(SHAPE, level, np.uint8)), 128)


# Equations 4 to 8 -------------------------------------------------------------------------------------------


def dusty(dust_grey: float) -> tuple[np.ndarray, np.ndarray, Image]:
    """P in grey levels, omega, and S of equation 4."""
    clean, share = 160.0 * texture(), clear_share()
    return clean, share, seen(clean * share + dust_grey * (1 - share))


def test_dust_removal_restores_what_scattering_took() -> None:
    clean, _, raw = dusty(dust_grey=180.0)
    found = enhancement.dedusted(raw)
    assert correlation(clean, found) > 0.9 > 0.8 > correlation(clean, raw)

    def dusty_by_clear(image: np.ndarray) -> float:
        return float(image[:, -60:].std() / image[:, :60].std())

    assert dusty_by_clear(raw) < 0.45
    assert dusty_by_clear(found) == pytest.approx(dusty_by_clear(clean), rel=0.15)


def test_omega_is_the_share_that_was_clear() -> None:
    """Equation 6 holds where all windows are alike and dust is as bright as their mean: mu then says nothing of it."""
    board, share = 160.0 * (np.indices(SHAPE).sum(axis=0) % 2), clear_share()
    np.testing.assert_allclose(enhancement.omega(seen(board * share + 80 * (1 - share))), share, atol=0.03)


def test_omega_is_cut_at_one_and_finite_on_black() -> None:
    raw = np.zeros(SHAPE, np.uint8)
    np.testing.assert_array_equal(enhancement.omega(raw), 0.0)
    raw[:, :200] = seen(200 + 55 * texture())[:, :200]  # bright and even: max(mu)
    raw[:, 210:] = seen(40 * texture())[:, 210:]  # dark and rich: max(sigma) / mu far above it
    assert enhancement.omega(raw).max() == 1.0


def test_scattering_is_below_every_grey_level_and_near_what_was_added() -> None:
    _, share, raw = dusty(dust_grey=180.0)
    found = enhancement.scattering(raw)
    assert (found <= raw + 1e-3).all()
    added = 180.0 * (1 - share)
    assert np.abs(found - added).mean() < 0.15 * added.max()


def test_dedusted_is_equation_8() -> None:
    """Written out with other filters, without noise, ceiling or quantile."""
    settings = EnhancementSettings(contrast_quantile=1.0, most_gain=100.0, noise_grey=1e-3, lit_grey=1e-3)
    raw = seen(60 + 60 * clear_share() * texture())
    levels, window = raw.astype(float), settings.window_px
    mean = scipy.ndimage.uniform_filter(levels, window, mode="reflect")
    sigma = np.sqrt(scipy.ndimage.uniform_filter(levels**2, window, mode="reflect") - mean**2)
    least = scipy.ndimage.uniform_filter(scipy.ndimage.minimum_filter(levels, window), window, mode="reflect")
    expected = (levels - least) * sigma[::4, ::4].max() / sigma
    np.testing.assert_allclose(enhancement.dedusted(raw, settings), np.clip(expected, 0, 255), atol=0.6)


def test_gain_counts_noise_out_and_has_a_ceiling() -> None:
    """An even patch with one brighter pixel in each window, beside a texture: sigma is known."""
    raw = np.full(SHAPE, 20, np.uint8)
    raw[7::15, 7::15] = 140
    sigma = 120 * np.sqrt(1 / 225 - 1 / 225**2)  # 7.98
    for noise, ceiling in ((1e-3, 100.0), (4.0, 100.0), (12.0, 100.0), (1e-3, 1.5)):
        settings = replace(DEFAULTS, noise_grey=noise, most_gain=ceiling, lit_grey=14.0)
        gain = min(14.0 * sigma / (sigma**2 + noise**2), ceiling)
        found = enhancement.dedusted(raw, settings)
        assert found[112, 202] == pytest.approx(120 * max(gain, 1.0), abs=1)


def test_a_frame_dark_all_over_is_raised_to_a_lit_contrast() -> None:
    faint = seen(10 + 40 * texture())
    least = replace(DEFAULTS, lit_grey=1.0)
    assert local_contrast(enhancement.dedusted(faint)) > 3 * local_contrast(enhancement.dedusted(faint, least))


# Equation 9 -------------------------------------------------------------------------------------------------


def test_weights_are_the_shares_of_the_means() -> None:
    first, second = (np.full((8, 9), level, np.uint8) for level in (150, 50))
    assert enhancement.weights(first, second) == pytest.approx((0.75, 0.25))
    np.testing.assert_array_equal(enhancement.fused(first, second), 125)
    black = np.zeros_like(first)
    assert enhancement.weights(black, black) == (0.5, 0.5)
    np.testing.assert_array_equal(enhancement.fused(black, black), 0)


def test_enhanced_is_the_fusion_of_both_parts() -> None:
    raw = seen(headlight() * texture(), seed=3)
    parts = enhancement.reflection(raw).astype(float), enhancement.dedusted(raw).astype(float)
    means = np.array([part.mean() for part in parts])
    expected = (means[0] * parts[0] + means[1] * parts[1]) / means.sum()
    np.testing.assert_allclose(enhancement.enhanced(raw), expected, atol=0.51)


def test_two_sizes_are_not_fused() -> None:
    with pytest.raises(GraphnavError, match=re.escape("(4, 5) and (4, 6)")):
        enhancement.fused(np.zeros((4, 5), np.uint8), np.zeros((4, 6), np.uint8))


# Any image --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", STAGES)
@pytest.mark.parametrize("shape", [SHAPE, (101, 57), (1, 1), (2, 300)])
def test_grey_to_grey_of_one_size_and_the_input_left_alone(name: str, shape: tuple[int, int]) -> None:
    raw = np.random.default_rng(0).integers(0, 256, shape, np.uint8)
    before = raw.copy()
    found = STAGES[name](raw)
    assert found.dtype == np.uint8
    assert found.shape == (SHAPE if name == "resized" else shape)
    np.testing.assert_array_equal(raw, before)
    np.testing.assert_array_equal(found, STAGES[name](raw))


@pytest.mark.parametrize("name", STAGES)
@pytest.mark.parametrize(
    "image", [np.zeros((4, 5)), np.zeros((4, 5, 2), np.uint8), np.zeros(4, np.uint8), np.zeros((0, 5), np.uint8), None]
)
def test_anything_else_is_refused(name: str, image: object) -> None:
    with pytest.raises(GraphnavError, match=f"{'|'.join((name, 'reflection'))}: .*expected"):
        STAGES[name](image)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ENHANCERS)
@pytest.mark.parametrize("level", [0, 7, 255])
def test_an_even_image_stays_even(name: str, level: int) -> None:
    assert np.ptp(ENHANCERS[name](np.full(SHAPE, level, np.uint8))) == 0


@pytest.mark.parametrize("kind", ["sift", "orb"])
@pytest.mark.parametrize(("level", "read"), [(0, 1.0), (0, 2.0), (5, 1.0), (5, 2.0)])
def test_noise_alone_does_not_become_features(kind: str, level: float, read: float) -> None:
    """A covered lens, with up to two grey levels of noise: at most a handful of the two thousand features allowed."""
    raw = seen(np.full(SHAPE, level), seed=1, read=read)
    assert found_in(enhancement.enhanced(raw), kind) <= 20


@pytest.mark.parametrize("level", [0, 5])
def test_it_is_the_dark_level_that_holds_noise_down(level: float) -> None:
    raw = seen(np.full(SHAPE, level), seed=1, read=2.0)
    assert found_in(enhancement.enhanced(raw, replace(DEFAULTS, dark_grey=2.0)), "orb") > 200


def found_in(image: Image, kind: str) -> int:
    import cv2

    maker = cv2.SIFT_create() if kind == "sift" else cv2.ORB_create(nfeatures=2000)
    return len(maker.detect(image, None))


def test_a_dark_scene_has_its_contrast_raised_most_where_it_is_darkest() -> None:
    raw = seen(headlight(brightest=40.0, darkest=12.0) * texture(), seed=2)
    found = enhancement.enhanced(raw)
    raised = [local_contrast(found[:, c]) / local_contrast(raw[:, c]) for c in (slice(0, 150), slice(274, 424))]
    assert 1.5 < raised[0] < raised[1]


def test_colour_becomes_grey_and_grey_stays() -> None:
    colour = np.zeros((3, 4, 3), np.uint8)
    colour[..., 1] = 100
    np.testing.assert_array_equal(enhancement.grey(colour), 59)  # 0.587 of the green
    np.testing.assert_array_equal(enhancement.grey(np.dstack([colour, np.full((3, 4), 9, np.uint8)])), 59)
    raw = seen(100 * texture())
    assert enhancement.grey(raw) is raw


def test_resizing_averages() -> None:
    board = 200 * (np.indices((480, 848)).sum(axis=0) % 2).astype(np.uint8)
    found = enhancement.resized(board)
    assert found.shape == SHAPE
    np.testing.assert_array_equal(found, 100)
    assert enhancement.resized(board, (100, 50)).shape == (50, 100)


@pytest.mark.parametrize(
    "wrong",
    [
        {"window_px": 4}, {"window_px": 1}, {"dark_grey": 0.0}, {"surround_px": -1.0}, {"most_gain": 0.5},
        {"contrast_quantile": 1.5}, {"noise_grey": float("nan")}, {"clahe_tiles": 0},
    ],
)  # fmt: skip
def test_settings_out_of_range(wrong: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match=f"{next(iter(wrong))} = .*, expected"):
        EnhancementSettings(**wrong)  # type: ignore[arg-type]


def test_names_are_those_of_the_configuration() -> None:
    assert list(ENHANCERS) == ["none", "clahe", "retinex-dust"]
    raw = seen(100 * texture())
    assert ENHANCERS["none"](raw) is raw
