"""Features tracked in 135 stereo pairs of a KITTI drive, in GTSAM's example data, converted to a `SensorLog`.

125 m through a town, 0.5-1 m from pair to pair; read where GTSAM finds it: nothing is copied.

- *Features* (``VO_stereo_factors00.txt``: pair, feature, u_left, u_right, v, and the point these make) become the table
  `stereo_tracks`.
- *Times*: none are in the files. Pairs are numbered, with every other one left out where the car is slow; KITTI's
  cameras take 10 a second, so a pair's time is a tenth of its number.
- *Poses* (``VO_camera_poses00.txt``) are **no reference** but a visual odometry of these very features, so the log has
  no truth; `estimated_poses` gives them for comparison.
- *Start*: the first pair is the origin, with the body's axes for east, north, up.

Declared: 0.5 px for a feature's column or row.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from factors.so3 import Array
from graphnav.errors import LogError
from graphnav.log import Frames, InitialState, SensorLog, Stereo, StereoTracks

TRACK_FILE, POSE_FILE, CAMERA_FILE = "VO_stereo_factors00.txt", "VO_camera_poses00.txt", "VO_calibration00.txt"
#: Pairs a second.
_RATE_HZ = 10.0
_SIGMA_PX = 0.5
#: The first pose is the origin by definition; the speed of a car is not known.
_POS_SIGMA_M, _ATT_SIGMA_DEG, _VEL_SIGMA_M_S = 1e-3, 1e-3, 20.0


def convert(source: str | Path | None = None) -> SensorLog:
    """Convert the drive.

    Parameters
    ----------
    source : folder with the files; None finds them with ``gtsam.findExampleDataFile``.

    Returns
    -------
    SensorLog
        Tracked features of a camera at the body's origin; no truth.

    Raises
    ------
    LogError
        A file is missing or not as expected.
    """
    lens = _table(_find(source, CAMERA_FILE), 6)
    rows = _table(_find(source, TRACK_FILE), 8)
    if len(lens) != 1 or lens[0, 2] != 0:
        raise LogError("expected one line, without skew", where=CAMERA_FILE, fix="fetch it again")
    fx, fy, _, cx, cy, baseline = lens[0]
    rows = rows[np.lexsort([rows[:, 1], rows[:, 0]])]
    return SensorLog(
        name="kitti-tracks",
        frames=Frames(latitude_deg=49.0, longitude_deg=8.4, height_m=115.0),  # Karlsruhe; of no effect without an IMU
        initial=InitialState(
            pos_n_m=np.zeros(3),
            pos_sigma_m=np.full(3, _POS_SIGMA_M),
            quat_nb_wxyz=np.array([1.0, 0.0, 0.0, 0.0]),
            att_sigma_deg=np.full(3, _ATT_SIGMA_DEG),
            vel_n_m_s=np.zeros(3),
            vel_sigma_m_s=np.full(3, _VEL_SIGMA_M_S),
        ),
        stereo=Stereo(fx_px=fx, fy_px=fy, cx_px=cx, cy_px=cy, baseline_m=baseline, sigma_px=_SIGMA_PX),
        stereo_tracks=StereoTracks(
            t_s=rows[:, 0] / _RATE_HZ,
            track=rows[:, 1].astype(np.int64),
            u_left_px=rows[:, 2],
            u_right_px=rows[:, 3],
            v_px=rows[:, 4],
        ),
    )


def estimated_poses(source: str | Path | None = None) -> tuple[Array, Array, Array]:
    """Times (N,), rotations (N, 3, 3) and positions (N, 3) of the camera in its first pose, as the files give them."""
    table = _table(_find(source, POSE_FILE), 17)
    poses = table[:, 1:].reshape(-1, 4, 4)
    return table[:, 0] / _RATE_HZ, poses[:, :3, :3], poses[:, :3, 3]


def _find(source: str | Path | None, name: str) -> Path:
    if source is not None:
        path = Path(source) / name
        if not path.is_file():
            raise LogError("no such file", where=str(path), fix=f"pass the folder that holds {TRACK_FILE}, or none")
        return path
    import gtsam

    return Path(gtsam.findExampleDataFile(name))  # type: ignore[no-untyped-call]


def _table(path: Path, columns: int) -> Array:
    """All numbers of a text file (N, columns)."""
    try:
        table = np.loadtxt(path, ndmin=2)
    except ValueError as error:
        raise LogError(f"no table of numbers ({error})", where=str(path), fix="fetch it again") from None
    if table.shape[1] != columns or not np.isfinite(table).all():
        raise LogError(f"expected {columns} columns of finite numbers", where=str(path), fix="fetch it again")
    return np.asarray(table, float)
