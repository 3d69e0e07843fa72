"""Images of dark and dusty roadways made fit for feature matching: retinex, dust removal, and their fusion.

Source: the roadheader's stereo paper ("Position and attitude perception of a roadheader by stereo vision and SINS"),
section 4.1.1-4.1.2, equations 1 to 9. Every function takes and gives uint8 grey ``(H, W)`` and can be used alone.

The equations say nothing of noise, of the range of what they give, or of an image that is constant. What was added so
that they can be used, each with its setting in `EnhancementSettings`:

1. Equation 2 has no logarithm of zero, and next to it one grey level is a factor of two. `dark_grey` is added to S and
   to L: details fainter than that are left faint.
2. log R has no bounds. It is shown as ``128 + gain log R``, cut at 0 and 255: a fixed scale, since one by the image's
   own extremes would flicker from frame to frame.
3. Equation 6 weighs by the *relative* contrast sigma / mu, equation 8 by sigma alone; they cannot both come from
   equation 4, and `omega` is there for the first while `dedusted` follows equation 8. Its ``P_min`` is read as
   ``S_min``: equation 7 has just set ``P_min`` to zero.
4. Equation 8 divides by sigma, which in an even dark patch is that of the sensor's noise. The gain
   ``max(sigma) / sigma`` is multiplied by the share of sigma^2 that is not noise, ``sigma^2 / (sigma^2 +
   noise_grey^2)``, as Wiener's filter has it, and held between 1 and `most_gain`.
5. max(sigma), one window of the image, jumps when a lamp enters it: the `contrast_quantile` of sigma stands for it. In
   a frame that is dark all over it is small and equation 8 raises nothing, though P is meant to be the scene "under
   sufficient and uniform illumination": it is taken to be at least `lit_grey`.
6. S_min of a square window has square edges that are no edges of the scene. The erosion is averaged over the window,
   which keeps it at or below S.
7. P is cut at 255.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphnav.errors import ConfigError, GraphnavError
from graphnav.frontends._opencv import Image, opencv, require_image

#: The paper's size (width, height), pixels.
SIZE = (424, 240)


@dataclass(frozen=True)
class EnhancementSettings:
    """What the equations leave open. The defaults suit 424 x 240 pixels of 8 bits.

    Attributes
    ----------
    surround_px : sigma of the Gaussian surround G, equation 3: the illumination's smallest detail.
    dark_grey : added to S and to L before the logarithm, grey levels. At eight times the read noise a frame of nothing
        but that noise has no more features than before (tested); the default is for up to 2 grey levels of it.
    log_gain : grey levels of the reflection for each unit of log R; 64 shows R from exp(-2) to exp(2).
    window_px : side of the window of mu, sigma and the dark channel, equations 5 to 8; odd.
    noise_grey : sigma at which half of a window's variance is taken for noise, grey levels; twice the read noise.
    most_gain : greatest gain in equation 8.
    contrast_quantile : share of the windows whose sigma is below what stands for max(sigma).
    lit_grey : least max(sigma) in equation 8, grey levels: the contrast of a texture that is well lit.
    clahe_clip, clahe_tiles : clip limit, and tiles along each side, of the common alternative.
    """

    surround_px: float = 40.0
    dark_grey: float = 16.0
    log_gain: float = 64.0
    window_px: int = 15
    noise_grey: float = 4.0
    most_gain: float = 8.0
    contrast_quantile: float = 0.99
    lit_grey: float = 60.0
    clahe_clip: float = 3.0
    clahe_tiles: int = 8

    def __post_init__(self) -> None:
        """Refuse what no equation can be computed with."""
        for name in ("surround_px", "dark_grey", "log_gain", "noise_grey", "lit_grey", "clahe_clip"):
            self._require(name, getattr(self, name) > 0, "more than 0")
        self._require("window_px", self.window_px >= 3 and self.window_px % 2 == 1, "an odd number from 3 on")
        self._require("most_gain", self.most_gain >= 1, "1 or more")
        self._require("contrast_quantile", 0 < self.contrast_quantile <= 1, "more than 0, at most 1")
        self._require("clahe_tiles", self.clahe_tiles >= 1, "1 or more")

    def _require(self, name: str, fits: bool, expected: str) -> None:
        if not fits:
            raise ConfigError(f"EnhancementSettings: {name} = {getattr(self, name)}, expected {expected}")


DEFAULTS = EnhancementSettings()


def grey(image: NDArray[np.uint8]) -> Image:
    """Grey image of a colour one (blue, green, red, and perhaps alpha: OpenCV's order); a grey one as it is.

    Raises
    ------
    GraphnavError
        Neither.
    """
    if isinstance(image, np.ndarray) and image.ndim == 3 and image.dtype == np.uint8 and image.shape[2] in (3, 4):
        found: Image = opencv().cvtColor(image[..., :3], opencv().COLOR_BGR2GRAY)
        return found
    return require_image(image, "grey")


def resized(image: Image, size: tuple[int, int] = SIZE) -> Image:
    """The image at the paper's size: averaged over areas where it shrinks, interpolated where it grows."""
    cv2 = opencv()
    height, width = require_image(image, "resized").shape
    shrinks = size[0] <= width and size[1] <= height
    found: Image = cv2.resize(image, size, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
    return found


def reflection(image: Image, settings: EnhancementSettings = DEFAULTS) -> Image:
    """Equations 1 to 3: the logarithm of R = S / L, as grey levels about 128.

    Parameters
    ----------
    image : S.
    settings : `surround_px`, `dark_grey` and `log_gain` count.
    """
    cv2 = opencv()
    log_s = cv2.LUT(require_image(image, "reflection"), _log_table(settings.dark_grey, settings.log_gain))
    return _to_grey(cv2.subtract(log_s, _log_illumination(image, settings), dst=log_s))


def _log_illumination(image: Image, settings: EnhancementSettings) -> Any:
    """``gain log(L + dark) - 128``: S * G on a coarser grid, where a wide Gaussian loses nothing."""
    cv2 = opencv()
    height, width = image.shape
    step = max(1, int(settings.surround_px // 4))
    coarse = (max(1, width // step), max(1, height // step))
    small = cv2.resize(image, coarse, interpolation=cv2.INTER_AREA).astype(np.float32)
    sigma_x, sigma_y = (settings.surround_px * few / many for few, many in zip(coarse, (width, height), strict=True))
    light = cv2.GaussianBlur(small, (0, 0), sigma_x, sigmaY=sigma_y, borderType=cv2.BORDER_REFLECT)
    log_l = settings.log_gain * np.log(light + settings.dark_grey) - 128.0
    return cv2.resize(log_l, (width, height), interpolation=cv2.INTER_LINEAR)


@lru_cache(maxsize=16)
def _log_table(dark_grey: float, gain: float) -> NDArray[np.float32]:
    found: NDArray[np.float32] = (gain * np.log(np.arange(256) + dark_grey)).astype(np.float32)
    return found


def dedusted(image: Image, settings: EnhancementSettings = DEFAULTS) -> Image:
    """Equation 8: P, what the scattering would leave of the image if it were not there.

    Parameters
    ----------
    image : S.
    settings : all of equation 8's count, from `window_px` to `lit_grey`.
    """
    cv2 = opencv()
    _, variance = _window_moments(require_image(image, "dedusted"), settings.window_px)
    sigma = cv2.sqrt(variance)
    most = max(_largest(sigma, settings.contrast_quantile), settings.lit_grey)
    # in place: memory given back to the system and fetched again costs more than the arithmetic
    cv2.add(variance, settings.noise_grey**2, dst=variance)
    gain = cv2.divide(sigma, variance, dst=sigma, scale=most)
    cv2.min(cv2.max(gain, 1.0, dst=gain), settings.most_gain, dst=gain)
    least = scattering(image, settings)
    above = cv2.subtract(image, least, dst=least, dtype=cv2.CV_32F)
    return _to_grey(cv2.multiply(above, gain, dst=above))


def omega(image: Image, settings: EnhancementSettings = DEFAULTS) -> NDArray[np.float32]:
    """Equation 6: share of the reflected light in what is seen, by window; 1 in the window of the greatest contrast.

    Equation 4 allows no more than 1, which equation 6 gives where a window is dark and rich in contrast: it is cut.
    """
    mu, variance = _window_moments(require_image(image, "omega"), settings.window_px)
    sigma = np.sqrt(variance)
    most = max(float(sigma.max()), settings.noise_grey)
    ratio = sigma * float(mu.max()) / (np.maximum(mu, 1.0) * most)
    found: NDArray[np.float32] = np.minimum(ratio, 1.0).astype(np.float32)
    return found


def scattering(image: Image, settings: EnhancementSettings = DEFAULTS) -> NDArray[np.float32]:
    """Equation 7: S_min = (1 - omega) Q, the least grey level of each window, its square edges averaged away."""
    cv2 = opencv()
    window = (settings.window_px, settings.window_px)
    least = cv2.erode(require_image(image, "scattering"), np.ones(window, np.uint8))
    found: NDArray[np.float32] = cv2.boxFilter(least, cv2.CV_32F, window, borderType=cv2.BORDER_REFLECT)
    return found


def _window_moments(image: Image, window_px: int) -> tuple[Any, Any]:
    """Of equation 5: mu and sigma^2, float32 ``(H, W)`` each."""
    cv2 = opencv()
    window = (window_px, window_px)
    mu = cv2.boxFilter(image, cv2.CV_32F, window, borderType=cv2.BORDER_REFLECT)
    square = cv2.sqrBoxFilter(image, cv2.CV_32F, window, borderType=cv2.BORDER_REFLECT)
    cv2.subtract(square, cv2.multiply(mu, mu), dst=square)
    return mu, cv2.max(square, 0.0, dst=square)


def _largest(sigma: Any, quantile: float) -> float:
    """max(sigma), of every fourth window each way: neighbours have nearly all their pixels in common."""
    some = sigma[::4, ::4].ravel()
    place = min(int(quantile * len(some)), len(some) - 1)
    return float(np.partition(some, place)[place])


def weights(reflected: Image, restored: Image) -> tuple[float, float]:
    """W1 and W2 of equation 9; one half each for two black images."""
    first, second = (float(opencv().mean(image)[0]) for image in (reflected, restored))
    return (first / (first + second), second / (first + second)) if first + second > 0 else (0.5, 0.5)


def fused(reflected: Image, restored: Image) -> Image:
    """Equation 9: R and P weighted by their mean grey levels."""
    if require_image(reflected, "fused").shape != require_image(restored, "fused").shape:
        raise GraphnavError(f"fused: images of {reflected.shape} and {restored.shape} pixels, expected two of one size")
    first, second = weights(reflected, restored)
    found: Image = opencv().addWeighted(reflected, first, restored, second, 0.0)
    return found


def enhanced(image: Image, settings: EnhancementSettings = DEFAULTS) -> Image:
    """Equations 1 to 9: the fusion of `reflection` and `dedusted`. Of the image's own size: see `resized`."""
    return fused(reflection(image, settings), dedusted(image, settings))


def clahe(image: Image, settings: EnhancementSettings = DEFAULTS) -> Image:
    """Contrast-limited adaptive histogram equalisation: the common alternative."""
    tiles = (settings.clahe_tiles, settings.clahe_tiles)
    maker = opencv().createCLAHE(clipLimit=settings.clahe_clip, tileGridSize=tiles)
    found: Image = maker.apply(require_image(image, "clahe"))
    return found


def _to_grey(values: Any) -> Image:
    """Rounded, and cut at 0 and 255."""
    found: Image = opencv().add(values, 0.0, dtype=opencv().CV_8U)
    return found


def _none(image: Image) -> Image:
    return require_image(image, "none")


#: What a configuration may name: name -> image to image, with the default settings.
ENHANCERS: Mapping[str, Callable[[Image], Image]] = MappingProxyType(
    {"none": _none, "clahe": clahe, "retinex-dust": enhanced}
)
