"""OpenCV, imported where it is used: 0.2 GB on disk, and not everybody has a camera."""

from __future__ import annotations

import importlib
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphnav.errors import GraphnavError

#: Grey values ``(H, W)`` of one image.
Image = NDArray[np.uint8]


@cache
def opencv() -> Any:
    """The package cv2.

    Raises
    ------
    GraphnavError
        It is not installed, or one of its libraries is missing.
    """
    try:
        return importlib.import_module("cv2")
    except ModuleNotFoundError as error:
        raise GraphnavError(f"{error}, which images need; pip install 'graphnav[vision]'") from error
    except ImportError as error:
        raise GraphnavError(f"OpenCV cannot be loaded: {error}; pip install opencv-python-headless") from error


def require_image(image: object, where: str, *, smallest: tuple[int, int] = (1, 1)) -> Image:
    """The image itself, once it is known to be grey, uint8 and large enough.

    Parameters
    ----------
    image : what the caller was given.
    where : the function, for the message.
    smallest : least width and height, pixels.

    Raises
    ------
    GraphnavError
        It is none.
    """
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.ndim != 2:
        found = f"{image.dtype} {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
        raise GraphnavError(
            f"{where}: an image of {found}, expected uint8 (H, W); use graphnav.frontends.enhancement.grey"
        )
    if image.shape[1] < smallest[0] or image.shape[0] < smallest[1]:
        raise GraphnavError(
            f"{where}: an image of {image.shape[1]} x {image.shape[0]} pixels, expected at least"
            f" {smallest[0]} x {smallest[1]}"
        )
    return image
