"""The two cameras of a EuRoC sequence: calibration from ``sensor.yaml``, image files, and their rectification.

The images are recorded as the lenses draw them, and a log's pairs are rectified: `rectified_into` writes the latter.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from factors.so3 import Array
from graphnav.errors import LogError
from graphnav.frontends._opencv import opencv
from graphnav.frontends.image_pairs import PairFiles, read_grey
from graphnav.frontends.rectification import Pinhole, Rectification, rectification
from graphnav.log import Stereo, StereoPairs
from graphnav.readers.euroc import RFU_FROM_IMU

_FIX = "restore it"


def cameras(mav: Path) -> Rectification:
    """The rectification of ``cam0`` (left) and ``cam1`` by their calibration."""
    return rectification(*(_camera(mav / name / "sensor.yaml") for name in ("cam0", "cam1")))


def pairs(mav: Path) -> Iterator[PairFiles]:
    """Image files that both cameras have of one stamp; times in seconds from the first IMU sample."""
    with (mav / "imu0" / "data.csv").open(encoding="utf-8") as file:
        zero = int(next(line for line in file if not line.startswith("#")).split(",")[0])
    left, right = ({p.name: p for p in (mav / name / "data").glob("*.png")} for name in ("cam0", "cam1"))
    for name in sorted(left.keys() & right.keys(), key=lambda name: int(Path(name).stem)):
        yield PairFiles((int(Path(name).stem) - zero) * 1e-9, left[name], right[name])


def rectified_into(mav: Path, folder: Path) -> tuple[Stereo, StereoPairs]:
    """Write rectified pairs to ``left`` and ``right`` in `folder`; the camera and the table that go with them."""
    turned, names, times = cameras(mav), list[str](), list[float]()
    for side in ("left", "right"):
        (folder / side).mkdir(parents=True, exist_ok=True)
    for number, pair in enumerate(pairs(mav)):
        images = turned.images(read_grey(pair.left), read_grey(pair.right))
        names.append(f"{number:06d}.png")
        times.append(pair.t_s)
        for side, image in zip(("left", "right"), images, strict=True):
            opencv().imwrite(str(folder / side / names[-1]), image)
    if not names:
        raise LogError("no image pairs", where=str(mav), fix="restore cam0/data and cam1/data")
    left, right = ([f"{side}/{name}" for name in names] for side in ("left", "right"))
    return turned.camera, StereoPairs(t_s=np.array(times), left=left, right=right, folder=folder)


def _camera(path: Path) -> Pinhole:
    """One camera; its place is about the IMU, in the log's axes."""
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise LogError("no such file", where=str(path), fix=_FIX) from None
    fu, fv, cu, cv = _numbers(text, "intrinsics", 4, path)
    width, height = _numbers(text, "resolution", 2, path)
    pose = _numbers(text.partition("T_BS")[2], "data", 16, path).reshape(4, 4)
    return Pinhole(
        matrix=np.array([[fu, 0, cu], [0, fv, cv], [0, 0, 1.0]]),
        distortion=_numbers(text, "distortion_coefficients", 4, path),
        size=(int(width), int(height)),
        rotation_bc=RFU_FROM_IMU @ _orthogonal(pose[:3, :3]),
        pos_bc_m=RFU_FROM_IMU @ pose[:3, 3],
    )


def _numbers(text: str, key: str, count: int, path: Path) -> Array:
    match = re.search(rf"\b{key}:\s*\[([^\]]*)\]", text)
    try:
        values = np.array([float(value) for value in match.group(1).split(",")]) if match else np.empty(0)
    except ValueError:
        values = np.empty(0)
    if len(values) != count:
        raise LogError(f"expected a list of {count} numbers", where=str(path), column=key, fix=_FIX)
    return values


def _orthogonal(matrix: Array) -> Array:
    """The nearest rotation: the file's digits are few."""
    u, _, vt = np.linalg.svd(matrix)
    return np.asarray(u @ vt)
