"""Image pairs of a log: found, read, made grey, and refused or skipped where they are of no use.

A file that is missing or cannot be read, and an image without contrast (all black, a covered lens), cost their frame.
An image of another size than the rest contradicts the calibration, and is an error.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from graphnav.errors import LogError
from graphnav.frontends._opencv import Image, opencv
from graphnav.log import SensorLog, StereoPairs

#: Grey levels between the darkest and the brightest hundredth, below which an image shows nothing but noise.
_LEAST_CONTRAST = 6.0
#: What to do where images are not found.
FIX_FOLDER = "put the images where the stereo table says, relative to the log folder"


class SkippedFrame(Exception):
    """A frame that cannot be used; its text is the reason, the same for frames with the same fault."""


@dataclass(frozen=True)
class PairFiles:
    """Files of one pair and its time."""

    t_s: float
    left: Path
    right: Path


def pair_files(log: SensorLog) -> list[PairFiles]:
    """Files of every pair of the log.

    Raises
    ------
    LogError
        The log has no pairs or no camera, or was not read from a folder.
    """
    pairs = log.stereo_pairs
    if pairs is None or log.stereo is None:
        missing = "table stereo (image pairs)" if pairs is None else "section [stereo] (the camera)"
        raise LogError(f"no {missing}", where=log.name, fix="features are tracked in the image pairs of a camera")
    folder = _folder(pairs, log.name)
    rows = zip(pairs.t_s, pairs.left, pairs.right, strict=True)
    return [PairFiles(float(t_s), folder / left, folder / right) for t_s, left, right in rows]


def _folder(pairs: StereoPairs, name: str) -> Path:
    if pairs.folder is None:
        raise LogError(
            "image pairs of a log that was not read from a folder",
            where=name,
            fix="read the log from its folder, or set stereo_pairs.folder",
        )
    return Path(pairs.folder)


def read_grey(path: Path) -> Image:
    """A grey image from a file, colours converted.

    Raises
    ------
    SkippedFrame
        The file is missing, or no image.
    """
    import numpy as np

    cv2 = opencv()
    try:
        content = np.fromfile(path, np.uint8)
    except OSError as error:
        raise SkippedFrame(f"file: {error.strerror or 'cannot be read'}") from None
    # decoded from memory: imread warns on standard error about a damaged file, and takes no path of other letters
    image = cv2.imdecode(content, cv2.IMREAD_GRAYSCALE) if len(content) else None
    if image is None:
        raise SkippedFrame("file: no image, or a damaged one")
    return np.asarray(image, np.uint8)


def read_pair(files: PairFiles, size: tuple[int, int]) -> tuple[Image, Image]:
    """Left and right image.

    Raises
    ------
    SkippedFrame
        A file is missing or damaged, or an image shows nothing.
    LogError
        An image is of another size than `size`, width and height.
    """
    found = []
    for side, path in (("left", files.left), ("right", files.right)):
        try:
            image = read_grey(path)
        except SkippedFrame as reason:
            raise SkippedFrame(f"{side} image {reason}") from None
        if (image.shape[1], image.shape[0]) != size:
            raise LogError(
                f"{side} image of {image.shape[1]} x {image.shape[0]} pixels, expected {size[0]} x {size[1]}",
                where=str(path),
                fix="all images, left and right, are of the size that was calibrated",
            )
        if contrast(image) < _LEAST_CONTRAST:
            raise SkippedFrame(f"{side} image without contrast (dark, or the lens covered)")
        found.append(image)
    return found[0], found[1]


def contrast(image: Image) -> float:
    """Grey levels between the darkest and the brightest hundredth of the pixels."""
    import numpy as np

    counts = np.bincount(image[::2, ::2].ravel(), minlength=256).cumsum()
    low, high = np.searchsorted(counts, [0.01 * counts[-1], 0.99 * counts[-1]])
    return float(high - low)
