"""Places of small patches in an image to a fraction of a pixel, whatever the brightness.

A patch ``T`` around a feature's first sight is found in another image ``I`` by Gauss-Newton on ``I(x + W p) = a T(p) +
b + c . p`` over the pixels p of the patch: the shift x, with gain a, offset b and ramp c removed by projection, for a
headlight that moves with the camera brightens what it nears, and its nearer half more. `W` is how much larger the patch
appears now, and how it is turned and sheared. The gradients are the patch's own, so that they are computed once
(inverse composition; Baker and Matthews 2004).

A feature is always compared with its first sight and not with the frame before, so that errors do not add up along a
track. What is common to all its places is a matter of which point of the wall is meant, and harmless.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from graphnav.baselines._compiled import compiled
from graphnav.frontends._opencv import Image, opencv

#: Patches are 2 * HALF + 1 pixels wide; they are stored with one more on each side, for their gradients.
HALF = 5
_ITERATIONS = 12
_SMALL_STEP_PX = 0.01
#: The linear model of the image holds for about as far.
_LONGEST_STEP_PX = 2.0
#: Smoothing before interpolation: bilinear values between pixels are less sharp than at pixels, which draws places
#: towards whole pixels unless the image is smooth.
_BLUR_PX = 0.9

Floats = npt.NDArray[np.float32]
Places = npt.NDArray[np.float64]
Weights = npt.NDArray[np.float64]


class Aligned(NamedTuple):
    """Places ``(N, 2)`` and correlation coefficients ``(N,)`` there; the latter is -1 where a patch was lost."""

    uv_px: Places
    similarity: npt.NDArray[np.float64]


def smoothed(image: Image) -> Floats:
    """The image as the functions of this file want it."""
    return np.asarray(opencv().GaussianBlur(image.astype(np.float32), (0, 0), _BLUR_PX), np.float32)


def patches(smooth: Floats, uv_px: Places) -> Floats:
    """Patches ``(N, P, P)`` around places ``(N, 2)``; pixels outside the image repeat its border."""
    offsets = np.arange(-HALF - 1, HALF + 2)
    out = np.empty((len(uv_px), len(offsets), len(offsets)), np.float32)
    _sample_all(smooth, np.ascontiguousarray(uv_px, np.float64), out)
    return out


def aligned(template: Floats, smooth: Floats, start_px: Places, warp: Places, rows_fixed: bool = False) -> Aligned:
    """Find patches near where they are expected.

    Parameters
    ----------
    template : (N, P, P) from `patches`.
    smooth : the other image, from `smoothed`.
    start_px : (N, 2) expected places.
    warp : (N, 2, 2) where a step in the patch leads in the image.
    rows_fixed : look along the row alone (the other image of a rectified pair).
    """
    uv = np.array(start_px, np.float64, order="C")
    similarity = np.full(len(uv), -1.0)
    steps = np.ascontiguousarray(warp, np.float64)
    _align_all(template, smooth, uv, steps, rows_fixed, _ramps(template.shape[1] - 2), similarity)
    return Aligned(uv, similarity)


def _ramps(size: int) -> Weights:
    """What brightness may add to a patch: 1, x, y at its pixels, orthonormal; ``(3, M)``."""
    y, x = (np.indices((size, size)).reshape(2, -1) - size // 2).astype(np.float64)
    terms = np.stack([np.ones_like(x), x, y])
    return np.ascontiguousarray(terms / np.sqrt((terms**2).sum(axis=1, keepdims=True)))


@compiled
def _value(image: Floats, x: float, y: float) -> float:
    """Bilinear value; outside the image the border's."""
    height, width = image.shape
    x = min(max(x, 0.0), width - 1.001)
    y = min(max(y, 0.0), height - 1.001)
    i, j = int(y), int(x)
    f, g = y - i, x - j
    top = image[i, j] * (1 - g) + image[i, j + 1] * g
    low = image[i + 1, j] * (1 - g) + image[i + 1, j + 1] * g
    value: float = top * (1 - f) + low * f
    return value


@compiled
def _sample_all(image: Floats, uv: Places, out: Floats) -> None:
    half = out.shape[1] // 2
    for k in range(len(uv)):
        for i in range(out.shape[1]):
            for j in range(out.shape[2]):
                out[k, i, j] = _value(image, uv[k, 0] + j - half, uv[k, 1] + i - half)


@compiled
def _normal(template: Floats, ramps: Weights, basis: Weights) -> float:
    """Fill `basis` (3, M): the patch less its ramp and of unit length, its gradients less their share of both.

    Returns the length that was divided by; zero for a patch without contrast.
    """
    size = template.shape[0] - 2
    for i in range(size):
        for j in range(size):
            m = i * size + j
            basis[0, m] = template[i + 1, j + 1]
            basis[1, m] = 0.5 * (template[i + 1, j + 2] - template[i + 1, j])
            basis[2, m] = 0.5 * (template[i + 2, j + 1] - template[i, j + 1])
    for r in range(3):
        for k in range(3):
            basis[r] -= ramps[k] * (ramps[k] * basis[r]).sum()
    length: float = np.sqrt((basis[0] * basis[0]).sum())
    if length > 1e-6:
        basis[0] /= length
        for r in range(1, 3):
            basis[r] -= basis[0] * (basis[0] * basis[r]).sum()
    return length


@compiled
def _align_all(
    templates: Floats, image: Floats, uv: Places, warp: Places, rows_fixed: bool, ramps: Weights, similarity: Places
) -> None:
    size = templates.shape[1] - 2
    basis, sums = np.empty((3, size * size)), np.empty(4)
    for k in range(len(uv)):
        length = _normal(templates[k], ramps, basis)
        if length > 1e-6:
            similarity[k] = _align(basis, length, image, uv[k], warp[k], rows_fixed, ramps, sums)


@compiled
def _align(
    basis: Weights,
    length: float,
    image: Floats,
    uv: Places,
    warp: Places,
    rows_fixed: bool,
    ramps: Weights,
    sums: Places,
) -> float:
    """Move `uv` (2,) until the step is small; returns the correlation there, -1 where it got lost."""
    a = (basis[1] * basis[1]).sum()
    b = (basis[1] * basis[2]).sum()
    c = (basis[2] * basis[2]).sum()
    size = warp[0, 0] * warp[1, 1] - warp[0, 1] * warp[1, 0]
    if size < 1e-3:
        return -1.0
    # a step along the row of the image, in the patch
    ex, ey = warp[1, 1] / size, -warp[1, 0] / size
    det = ex * ex * a + 2 * ex * ey * b + ey * ey * c if rows_fixed else a * c - b * b
    if det < 1e-9:
        return -1.0
    for _ in range(_ITERATIONS):
        _look(image, uv, warp, basis, ramps, sums)
        if sums[0] <= 0:
            return -1.0
        p, q = sums[1] * length / sums[0], sums[2] * length / sums[0]
        if rows_fixed:
            along = (ex * p + ey * q) / det
            dx, dy = ex * along, ey * along
        else:
            dx, dy = (c * p - b * q) / det, (a * q - b * p) / det
        reach = max(abs(dx), abs(dy))
        shrunk = min(1.0, _LONGEST_STEP_PX / max(reach, 1e-12))
        uv[0] -= (warp[0, 0] * dx + warp[0, 1] * dy) * shrunk
        if not rows_fixed:
            uv[1] -= (warp[1, 0] * dx + warp[1, 1] * dy) * shrunk
        if reach < _SMALL_STEP_PX:
            break
    correlation: float = sums[0] / sums[3]
    return correlation


@compiled
def _look(image: Floats, uv: Places, warp: Places, basis: Weights, ramps: Weights, sums: Places) -> None:
    """Products of the image around `uv` with the basis (three) and its length without its ramp, into `sums` (4,).

    The basis has no ramp, so that the image's need not be taken off for the products.
    """
    size = int(np.sqrt(basis.shape[1]))
    half = size // 2
    m, square, flat, right, down, s0, s1, s2 = 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(size):
        x, y = uv[0] + warp[0, 1] * (i - half), uv[1] + warp[1, 1] * (i - half)
        for j in range(size):
            seen = _value(image, x + warp[0, 0] * (j - half), y + warp[1, 0] * (j - half))
            square += seen * seen
            flat += seen * ramps[0, m]
            right += seen * ramps[1, m]
            down += seen * ramps[2, m]
            s0 += seen * basis[0, m]
            s1 += seen * basis[1, m]
            s2 += seen * basis[2, m]
            m += 1
    sums[0], sums[1], sums[2] = s0, s1, s2
    sums[3] = np.sqrt(max(square - flat * flat - right * right - down * down, 1e-12))
