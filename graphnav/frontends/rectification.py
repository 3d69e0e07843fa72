"""Two calibrated cameras made a rectified pair: one `Stereo` camera, and images in which rows agree.

Both images are turned (in thought, about their own centres) until they look square to the baseline, and their lens
distortion is removed. What is then needed of a recording is what `[stereo]` has: one focal length, one principal point,
the baseline.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from factors import so3
from factors.so3 import Array
from graphnav.errors import GraphnavError
from graphnav.frontends._opencv import Image, opencv
from graphnav.log import Stereo


@dataclass(frozen=True)
class Pinhole:
    """One camera with lens distortion.

    Attributes
    ----------
    matrix : (3, 3) focal lengths and principal point.
    distortion : (4,), (5,) or (8,) radial-tangential coefficients k1, k2, p1, p2, ...
    size : width and height of its images, px.
    rotation_bc, pos_bc_m : (3, 3) and (3,) its place in the body.
    """

    matrix: Array
    distortion: Array
    size: tuple[int, int]
    rotation_bc: Array
    pos_bc_m: Array


@dataclass(frozen=True)
class Rectification:
    """How the images of two cameras become those of `camera`.

    Attributes
    ----------
    camera : the rectified camera, c being the left one turned.
    maps : per side, columns and rows of the recorded image for every pixel of the new one.
    """

    camera: Stereo
    size: tuple[int, int]
    maps: tuple[tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]], ...]

    def images(self, left: Image, right: Image) -> tuple[Image, Image]:
        """Rectified images of a recorded pair; what the cameras did not see is black."""
        one, other = (self._image(image, side) for side, image in enumerate((left, right)))
        return one, other

    def _image(self, image: Image, side: int) -> Image:
        if (image.shape[1], image.shape[0]) != self.size:
            found = f"{('left', 'right')[side]} image of {image.shape[1]} x {image.shape[0]} pixels"
            raise GraphnavError(f"{found}, calibrated were {self.size[0]} x {self.size[1]}; use images of this size")
        cv2 = opencv()
        return np.asarray(cv2.remap(image, *self.maps[side], cv2.INTER_LINEAR), np.uint8)


def rectification(left: Pinhole, right: Pinhole) -> Rectification:
    """The rectification of two cameras, after Bouguet; only what both see whole is kept in view.

    Raises
    ------
    GraphnavError
        The cameras' images differ in size, or the right one does not stand to the right of the left one.
    """
    if left.size != right.size:
        raise GraphnavError(f"images of {left.size} and {right.size} pixels; both cameras need the same size")
    rotation = right.rotation_bc.T @ left.rotation_bc  # left's axes -> right's
    shift = right.rotation_bc.T @ (left.pos_bc_m - right.pos_bc_m)
    if -shift[0] <= max(abs(shift[1]), abs(shift[2])):
        raise GraphnavError(f"the right camera sees the left one at {shift} m, expected along -x; check their order")
    cv2 = opencv()
    turns = cv2.stereoRectify(
        left.matrix, left.distortion, right.matrix, right.distortion, left.size, rotation, shift[:, None],
        flags=cv2.CALIB_ZERO_DISPARITY, alpha=0,
    )  # fmt: skip
    new: tuple[Any, Any] = (turns[2], turns[3])
    maps = tuple(
        cv2.initUndistortRectifyMap(side.matrix, side.distortion, turns[k], new[k][:, :3], side.size, cv2.CV_32FC1)
        for k, side in enumerate((left, right))
    )
    return Rectification(_camera(left, np.asarray(turns[0]), new), left.size, maps)


def _camera(left: Pinhole, turn: Array, new: tuple[Any, Any]) -> Stereo:
    """The left camera turned, with the new projection matrices' figures."""
    projection = np.asarray(new[0])
    return Stereo(
        fx_px=projection[0, 0],
        fy_px=projection[1, 1],
        cx_px=projection[0, 2],
        cy_px=projection[1, 2],
        baseline_m=-float(new[1][0, 3]) / projection[0, 0],
        T_bc_pos_m=left.pos_bc_m,
        T_bc_quat_wxyz=so3.to_quaternion(left.rotation_bc @ turn.T),
        width_px=left.size[0],
        height_px=left.size[1],
    )
