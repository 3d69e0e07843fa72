"""The size of a log's images, which has to be the one that the camera was calibrated for."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from graphnav.errors import LogError
from graphnav.frontends.image_pairs import FIX_FOLDER, PairFiles, SkippedFrame, read_grey
from graphnav.log import Stereo

#: How far the principal point of a rectified pair is from the middle, as a share of width or height, without a word.
_OFF_CENTRE = 0.1
_FIX_SIZE = "give [stereo] the calibration of images of this size"


def image_size(files: Sequence[PairFiles], camera: Stereo) -> tuple[int, int]:
    """Width and height of the first image that can be read; the camera's principal point has to be inside.

    Raises
    ------
    LogError
        No image can be read, or the calibration is for images of another size.
    """
    for pair in files:
        for path in (pair.left, pair.right):
            try:
                image = read_grey(path)
            except SkippedFrame:
                continue
            size = (image.shape[1], image.shape[0])
            _check_size(camera, size, path)
            return size
    where = str(files[0].left) if files else "table stereo"
    raise LogError(f"none of {len(files)} image pairs can be read", where=where, fix=FIX_FOLDER)


def _check_size(camera: Stereo, size: tuple[int, int], path: Path) -> None:
    found = f"image of {size[0]} x {size[1]} pixels, but"
    if camera.size_px is not None and camera.size_px != size:
        declared = f"[stereo] is for {camera.size_px[0]} x {camera.size_px[1]}"
        raise LogError(f"{found} {declared} (width_px, height_px)", where=str(path), fix=_FIX_SIZE)
    if not (0 < camera.cx_px < size[0] and 0 < camera.cy_px < size[1]):
        centre = f"the principal point is at ({camera.cx_px:g}, {camera.cy_px:g})"
        raise LogError(f"{found} {centre}", where=str(path), fix=_FIX_SIZE)


def size_note(files: Sequence[PairFiles], camera: Stereo) -> str:
    """What is odd about the size of the images, where the camera declares none; empty when nothing is."""
    if camera.size_px is not None:
        return ""
    width, height = image_size(files, camera)
    across, down = camera.cx_px - (width - 1) / 2, camera.cy_px - (height - 1) / 2
    if abs(across) <= _OFF_CENTRE * width and abs(down) <= _OFF_CENTRE * height:
        return ""
    return (
        f"cx_px, cy_px of [stereo] are ({camera.cx_px:g}, {camera.cy_px:g}), far from the middle of images of"
        f" {width} x {height}: if the calibration is for another size, positions are wrong;"
        " if not, declare width_px and height_px"
    )
