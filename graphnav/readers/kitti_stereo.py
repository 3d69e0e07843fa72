"""An excerpt of KITTI odometry: rectified stereo pairs of a car, its calibration and reference, as a `SensorLog`.

Expected are the folders ``image_l`` and ``image_r`` (grey PNG of the same names, 10 Hz), ``calib.txt`` (the projection
matrices of the left and the right camera, 3 x 4) and ``poses.txt`` (the left camera's pose in its first frame, 3 x 4).

Declared: 0.5 px for a feature's column or row, and 0.2 px for what all disparities have in common: calibrated with a
chequerboard, the angle between two cameras is known to some hundredths of a degree, and 0.016 deg are 0.2 px.
(Errors against the reference had been seen before that was chosen.) The smoother estimates it.

The first 13 poses are no measurement: their steps are one turn and one way, repeated (see docs/real-data.md).

There is no other sensor. The body is the left camera, its axes right, forward, up; n is the body at the first frame, so
"north" is where the car looks. Nothing is known of the stamps but their rate: the first frame is at zero.

The images stay where they are: paths of the table `stereo` are relative to the recording's folder, and a log that is
converted in Python has that as `stereo_pairs.folder`. ``graphnav import kitti-stereo`` copies them into the log.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from factors import so3
from factors.so3 import Array
from graphnav.errors import LogError
from graphnav.log import Frames, InitialState, SensorLog, Stereo, StereoPairs, Truth

#: Vectors in the camera's axes (right, down, forward) -> right, forward, up.
_RFU_FROM_CAMERA = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
#: Karlsruhe.
_PLACE = Frames(latitude_deg=49.0, longitude_deg=8.4, height_m=115.0)
_RATE_HZ = 10.0
#: 1-sigma of what all disparities are too large by.
DISPARITY_SIGMA_PX = 0.2
#: Number of the first pose from which the reference is measured.
MEASURED_FROM = 12
#: The first pose is the origin by definition; the speed of a car is not known.
_POS_SIGMA_M, _ATT_SIGMA_DEG, _VEL_SIGMA_M_S = 1e-3, 1e-3, 20.0
_SIDES = ("image_l", "image_r")
_PNG = b"\x89PNG\r\n\x1a\n"


def convert(source: str | Path | None) -> SensorLog:
    """Convert an excerpt.

    Parameters
    ----------
    source : folder with ``image_l``, ``image_r``, ``calib.txt`` and ``poses.txt``.

    Returns
    -------
    SensorLog
        Camera, image pairs and truth.

    Raises
    ------
    LogError
        A file is missing or not as expected; a pair lacks one side.
    """
    if source is None:
        raise LogError("kitti-stereo needs a source folder", fix="pass the folder that holds image_l and image_r")
    folder = Path(source).resolve()
    names = _image_names(folder)
    t_s = np.arange(len(names)) / _RATE_HZ
    return SensorLog(
        name="kitti-stereo",
        frames=_PLACE,
        initial=_initial(),
        stereo=_camera(folder / "calib.txt", _png_size(folder / _SIDES[0] / names[0])),
        stereo_pairs=StereoPairs(
            t_s=t_s,
            left=[f"{_SIDES[0]}/{name}" for name in names],
            right=[f"{_SIDES[1]}/{name}" for name in names],
            folder=folder,
        ),
        truth=_truth(folder / "poses.txt", t_s),
    )


def _image_names(folder: Path) -> list[str]:
    """Names that both sides have; they have to be the same."""
    left, right = ({path.name for path in (folder / side).glob("*.png")} for side in _SIDES)
    if not left | right:
        raise LogError("no images", where=str(folder), fix="pass the folder that holds image_l and image_r")
    alone = sorted(left ^ right)
    if alone:
        side, other = _SIDES if alone[0] in left else _SIDES[::-1]
        problem = f"{len(left)} left and {len(right)} right images; {other}/{alone[0]} is missing"
        raise LogError(problem, where=str(folder), fix=f"restore it, or remove {side}/{alone[0]} and its pose")
    return sorted(left)


def _matrices(path: Path) -> Array:
    """The file's rows as matrices (N, 3, 4)."""
    try:
        rows = np.loadtxt(path, ndmin=2)
    except FileNotFoundError:
        raise LogError("no such file", where=str(path), fix="restore it") from None
    except (ValueError, UnicodeDecodeError) as error:
        raise LogError(f"not a table of numbers ({error})", where=str(path)) from None
    if rows.shape[1] != 12:
        raise LogError(f"rows of {rows.shape[1]} numbers, expected the 12 of a 3 x 4 matrix", where=str(path))
    return np.asarray(rows, float).reshape(-1, 3, 4)


def _png_size(path: Path) -> tuple[int, int] | None:
    """Width and height from a PNG's header; None for what is no PNG."""
    with path.open("rb") as file:
        head = file.read(24)
    if len(head) < 24 or not head.startswith(_PNG):
        return None
    width, height = struct.unpack(">II", head[16:])
    return width, height


def _camera(path: Path, size: tuple[int, int] | None) -> Stereo:
    """The rectified pair, its images of `size`; the right camera's matrix has ``-fx b`` in its last column."""
    matrices = _matrices(path)
    if len(matrices) < 2 or not np.allclose(matrices[0, :, :3], matrices[1, :, :3]) or matrices[1, 0, 3] >= 0:
        problem = "expected the matrices of a left and a right camera that differ by -fx b alone"
        raise LogError(problem, where=str(path), fix="give those of the rectified grey cameras, P0 and P1")
    left = matrices[0]
    return Stereo(
        fx_px=left[0, 0],
        fy_px=left[1, 1],
        cx_px=left[0, 2],
        cy_px=left[1, 2],
        baseline_m=-matrices[1, 0, 3] / left[0, 0],
        disparity_sigma_px=DISPARITY_SIGMA_PX,
        width_px=None if size is None else size[0],
        height_px=None if size is None else size[1],
    )


def _truth(path: Path, t_s: Array) -> Truth:
    poses = _matrices(path)
    if len(poses) != len(t_s):
        raise LogError(f"{len(poses)} poses for {len(t_s)} pairs", where=str(path), fix="give one pose per pair")
    turned = _RFU_FROM_CAMERA @ poses[:, :, :3] @ _RFU_FROM_CAMERA.T
    return Truth(t_s=t_s, pos_n_m=poses[:, :, 3] @ _RFU_FROM_CAMERA.T, quat_nb=so3.to_quaternion(turned))


def _initial() -> InitialState:
    return InitialState(
        pos_n_m=np.zeros(3),
        pos_sigma_m=np.full(3, _POS_SIGMA_M),
        quat_nb_wxyz=np.array([1.0, 0.0, 0.0, 0.0]),
        att_sigma_deg=np.full(3, _ATT_SIGMA_DEG),
        vel_n_m_s=np.zeros(3),
        vel_sigma_m_s=np.full(3, _VEL_SIGMA_M_S),
    )
