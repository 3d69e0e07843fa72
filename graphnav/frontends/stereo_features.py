"""Point features of an image, ORB or SIFT: detected, thinned out so that they spread, and described.

Places are those of pixel centres. ORB finds features in smaller and smaller images and multiplies places there by the
scale. But a pixel's centre at x of an image s times smaller is at ``s (x + 1/2) - 1/2``, and as images are of whole
pixels, s is not quite what was asked for: together up to a pixel, which is put right here. SIFT doubles its first image
and is off by 0.25 px unless told to take care.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from graphnav.frontends._opencv import Image, opencv

Kind = Literal["orb", "sift"]
Places = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]

_ORB_SCALE = 1.2
_ORB_LEVELS = 6
#: Least step in grey levels of a corner: low, for dark images; thinning out keeps the best.
_ORB_STEP = 5
_SIFT_CONTRAST = 0.008
#: Cells of the grid, across and down, over which features are spread; and how many times an even share one may hold.
CELLS = (8, 6)
_SHARES = 2.0
#: Detected by ORB for one that is kept; SIFT detects all there are.
_SPARE = 4


@dataclass(frozen=True)
class Features:
    """Features of one image.

    Attributes
    ----------
    uv_px : (N, 2) places.
    scale : (N,) size of the pixels in which it was found, in pixels of the image.
    descriptor : (N, 4) uint64, 256 bits (ORB), or (N, 128) float32 (SIFT).
    """

    uv_px: Places
    scale: Places
    descriptor: npt.NDArray[Any]

    def __len__(self) -> int:
        return len(self.uv_px)

    def take(self, rows: npt.NDArray[Any]) -> Features:
        """Some of them."""
        return Features(self.uv_px[rows], self.scale[rows], self.descriptor[rows])


def detected(image: Image, kind: Kind, count: int, spread: bool = True) -> Features:
    """Features of an image.

    Parameters
    ----------
    image : grey.
    kind : "orb" or "sift".
    count : how many at most.
    spread : thin out to `count` so that no part of the image has all of them; else more than `count`: the strongest
        `_SPARE` times as many (ORB), or all (SIFT).
    """
    size = (image.shape[1], image.shape[0])
    found, described = _detector(kind, _SPARE * count).detectAndCompute(image, None)
    features = _features(found, described, kind, size)
    if not spread:
        return features
    return features.take(spread_rows(features.uv_px, np.array([k.response for k in found]), size, count))


def _features(found: Any, described: Any, kind: Kind, size: tuple[int, int]) -> Features:
    uv = np.array([k.pt for k in found], float).reshape(-1, 2)
    octave = np.array([k.octave for k in found], np.int64)
    if described is None:
        described = np.empty((0, 32 if kind == "orb" else 128))
    if kind == "orb":
        scale = np.asarray(_ORB_SCALE**octave, np.float64)
        bits = np.ascontiguousarray(described, np.uint8).view(np.uint64)
        return Features(_of_pixel_centres(uv, scale, size), scale, bits)
    octave = octave & 255  # the lowest byte, signed: -1 is the doubled image
    octave = np.where(octave > 127, octave - 256, octave)
    return Features(uv, np.asarray(2.0**octave, np.float64), np.ascontiguousarray(described, np.float32))


def _of_pixel_centres(uv: Places, scale: Places, size: tuple[int, int]) -> Places:
    """Places in the image (N, 2) of what ORB found in one `scale` (N,) times smaller, rounded to whole pixels."""
    smaller = np.rint(np.array(size) / scale[:, None])
    return np.asarray((uv / scale[:, None] + 0.5) * size / smaller - 0.5)


@cache
def _detector(kind: Kind, count: int) -> Any:
    cv2 = opencv()
    if kind == "orb":
        return cv2.ORB_create(count, _ORB_SCALE, _ORB_LEVELS, edgeThreshold=15, patchSize=25, fastThreshold=_ORB_STEP)
    return cv2.SIFT_create(0, contrastThreshold=_SIFT_CONTRAST, enable_precise_upscale=True)


def cell_of(uv_px: Places, size: tuple[int, int]) -> Whole:
    """Number of the grid's cell (N,) for each place."""
    column, row = (np.clip(uv_px[:, k] * CELLS[k] / size[k], 0, CELLS[k] - 1).astype(np.int64) for k in (0, 1))
    return np.asarray(row * CELLS[0] + column, np.int64)


def most_per_cell(count: int) -> int:
    """How many of `count` features one cell may hold."""
    return int(np.ceil(_SHARES * count / (CELLS[0] * CELLS[1])))


def spread_rows(uv_px: Places, response: Places, size: tuple[int, int], count: int) -> Whole:
    """Rows of at most `count` features: the strongest of every cell first, then the second of every cell, and so on."""
    rank = rank_within(cell_of(uv_px, size), -response)
    allowed = np.flatnonzero(rank < most_per_cell(count))
    order = np.lexsort([-response[allowed], rank[allowed]])
    return np.sort(allowed[order[:count]])


def rank_within(group: Whole, key: npt.NDArray[Any]) -> Whole:
    """Rank (N,) of each by `key` among those of its group, the smallest first."""
    order = np.lexsort([key, group])
    first = np.searchsorted(group[order], group[order])
    rank = np.empty(len(group), np.int64)
    rank[order] = np.arange(len(group)) - first
    return rank
