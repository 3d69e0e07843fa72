"""Textures reduced in each direction on its own, so that a wall seen at a grazing angle neither aliases nor blurs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

ALONG_LEVELS, ACROSS_LEVELS = 8, 6


class Ripmap(NamedTuple):
    """All reductions of all textures, one after another, as plain arrays for compiled code.

    Attributes
    ----------
    texels : 8-bit shares of light.
    place : ``(surfaces, ALONG_LEVELS, ACROSS_LEVELS, 3)`` start, rows and columns of the reduction by two to the power
        of each level.
    """

    texels: npt.NDArray[np.uint8]
    place: npt.NDArray[np.int64]


def ripmap(images: Sequence[npt.NDArray[np.float32]]) -> Ripmap:
    """Every reduction of `images`, whose values lie between 0 and 1."""
    place = np.zeros((len(images), ALONG_LEVELS, ACROSS_LEVELS, 3), np.int64)
    parts: list[npt.NDArray[np.uint8]] = []
    total = 0
    for surface, image in enumerate(images):
        for along in range(ALONG_LEVELS):
            reduced = image
            for across in range(ACROSS_LEVELS):
                place[surface, along, across] = total, *reduced.shape
                parts.append(np.rint(255 * reduced).astype(np.uint8).ravel())
                total += reduced.size
                reduced = _halved(reduced)
            image = _halved(image.T).T
    return Ripmap(np.concatenate(parts), place)


def _halved(image: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Mean of neighbouring rows; an odd last row stands for its neighbour too."""
    if len(image) % 2:
        image = np.vstack([image, image[-1:]])
    return (image[0::2] + image[1::2]) / np.float32(2)
