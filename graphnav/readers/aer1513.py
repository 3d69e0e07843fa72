"""UTIAS AER1513, "State Estimation for Robotics": a robot on wheels with a laser, under motion capture (T. Barfoot).

- **Dataset 1** (``dataset1.mat``): along a straight line, wheel speed and laser range to a cylinder on that line.
- **Dataset 2** (``dataset2.mat``, or its first half): on a floor among 17 tubes, speed and turn rate of the wheels,
  laser range and bearing to the tubes, told apart. The laser is `d` ahead of the axle.

Both have 10 rows a second; row k of the speeds holds until row k+1. Noise is the files' own (`v_var`, `om_var`,
`r_var`, `b_var`), white in time. They name none sideways: wheels do not slip by more than `_SIDE_M_S`.

Axes: n is the motion capture's (x east, y north); b is at the middle of the axle, right-forward-up; s has b's axes.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Literal

import numpy as np

from factors.increments import npt_int
from graphnav._schema import Array
from graphnav.errors import LogError
from graphnav.log import Frames, InitialState, Landmark, Lidar, LidarPoints, RelativePose, SensorLog, Truth
from graphnav.readers.wheels import FLOOR_M, FLOOR_RAD, upright, wheel_motions

_NAMES = {1: ("dataset1.mat",), 2: ("dataset2.mat", "dataset2_first_half.mat")}
_SIDE_M_S = 0.01
#: A tube's place was surveyed by the motion capture.
_PLACE_SIGMA_M = 0.005
#: The cylinder of dataset 1 is straight ahead by the way the recording was made: no bearing is measured.
_NO_BEARING_DEG = 45.0


def convert(
    source: str | Path | None,
    *,
    dataset: int = 2,
    landmarks: Literal["known", "unknown"] = "known",
    interval_s: float | None = None,
) -> SensorLog:
    """Convert a recording.

    Parameters
    ----------
    source : folder with ``dataset1.mat``, or ``dataset2.mat`` or ``dataset2_first_half.mat``.
    dataset : 1 or 2.
    landmarks : "known" declares the file's places of the tubes as surveyed, "unknown" leaves them to be estimated.
    interval_s : least time between laser scans that are taken over; None takes all.

    Returns
    -------
    SensorLog
        Relative poses of the wheels, laser detections, truth where it is valid; initial pose the truth's.

    Raises
    ------
    LogError
        A file is missing or damaged, or an option is none of those above.
    """
    if source is None:
        raise LogError("aer1513 needs a source folder", fix="pass the folder that holds the .mat files")
    if dataset not in _NAMES:
        raise LogError(f"dataset {dataset} of aer1513, expected 1 or 2", fix="dataset 3 is stereo, not read")
    if landmarks not in ("known", "unknown"):
        raise LogError(f'landmarks "{landmarks}", expected "known" or "unknown"')
    if interval_s is not None and not interval_s > 0:
        raise LogError(f"interval_s {interval_s}, expected a time above zero")
    mat = _Mat.open(Path(source), _NAMES[dataset])
    return (_line if dataset == 1 else _floor)(mat, landmarks == "known", interval_s)


def _line(mat: _Mat, known: bool, interval_s: float | None) -> SensorLog:
    t_s = mat.times()
    count = len(t_s)
    ranges, place = mat.column("r", count), mat.number("l")
    step = np.diff(t_s)
    x = mat.column("x_true", count)
    east = np.full(count, -np.pi / 2)
    rows = _thinned(t_s, np.arange(count), interval_s)
    return _log(
        "aer1513-1",
        wheel_motions(
            t_s,
            mat.column("v", count)[:-1] * step,
            np.zeros(count - 1),
            sigma_forward_m=step * mat.sigma("v_var"),
            sigma_side_m=FLOOR_M,
            sigma_turn_rad=FLOOR_RAD,
        ),
        LidarPoints(
            t_s=t_s[rows],
            feature=np.ones(len(rows), np.int64),
            range_m=ranges[rows],
            angle_rad=np.zeros(len(rows)),
        ),
        Lidar(
            range_sigma_m=mat.sigma("r_var"), angle_sigma_deg=_NO_BEARING_DEG, landmark=_places([[place, 0.0]], known)
        ),
        Truth(t_s=t_s, pos_n_m=np.column_stack([x, np.zeros((count, 2))]), quat_nb=upright(east)),
    )


def _floor(mat: _Mat, known: bool, interval_s: float | None) -> SensorLog:
    t_s = mat.times()
    count = len(t_s)
    places = mat.array("l", (None, 2))
    ranges, bearings = (mat.array(name, (count, len(places))) for name in ("r", "b"))
    valid = mat.column("true_valid", count) > 0
    x, y, heading = (mat.column(name, count)[valid] for name in ("x_true", "y_true", "th_true"))
    step = np.diff(t_s)
    row, tube = np.nonzero(ranges > 0)
    kept = np.isin(row, _thinned(t_s, row, interval_s))
    row, tube = row[kept], tube[kept]
    return _log(
        "aer1513-2",
        wheel_motions(
            t_s,
            mat.column("v", count)[:-1] * step,
            mat.column("om", count)[:-1] * step,
            sigma_forward_m=step * mat.sigma("v_var"),
            sigma_side_m=step * _SIDE_M_S,
            sigma_turn_rad=step * mat.sigma("om_var"),
        ),
        LidarPoints(t_s=t_s[row], feature=tube + 1, range_m=ranges[row, tube], angle_rad=bearings[row, tube]),
        Lidar(
            range_sigma_m=mat.sigma("r_var"),
            angle_sigma_deg=float(np.degrees(mat.sigma("b_var"))),
            T_bs_pos_m=np.array([0.0, mat.number("d"), 0.0]),
            landmark=_places(places, known),
        ),
        Truth(
            t_s=t_s[valid],
            pos_n_m=np.column_stack([x, y, np.zeros(len(x))]),
            quat_nb=upright(heading - np.pi / 2),
        ),
    )


def _log(name: str, motion: RelativePose, points: LidarPoints, lidar: Lidar, truth: Truth) -> SensorLog:
    """The log, which starts at the truth to 1 cm and half a degree, level."""
    initial = InitialState(
        pos_n_m=truth.pos_n_m[0],
        pos_sigma_m=np.array([0.01, 0.01, 1e-3]),
        quat_nb_wxyz=truth.quat_nb[0],
        att_sigma_deg=np.array([0.05, 0.05, 0.5]),
        vel_n_m_s=np.zeros(3),
        vel_sigma_m_s=np.full(3, 0.02),
    )
    # Toronto; of no effect without an IMU
    return SensorLog(
        name=name, frames=Frames(latitude_deg=43.8), initial=initial, relative_pose=motion, lidar_points=points,
        lidar=lidar, truth=truth,
    )  # fmt: skip


def _places(places: Any, known: bool) -> tuple[Landmark, ...]:
    if not known:
        return ()
    return tuple(
        Landmark(feature=number, pos_n_m=np.array([x, y, 0.0]), sigma_m=_PLACE_SIGMA_M)
        for number, (x, y) in enumerate(places, start=1)
    )


def _thinned(t_s: Array, rows: npt_int, interval_s: float | None) -> npt_int:
    """Those of ascending rows that are no closer to each other than `interval_s`."""
    kept: list[int] = []
    for row in np.unique(rows).tolist():
        if interval_s is None or not kept or t_s[row] - t_s[kept[-1]] > interval_s - 1e-6:
            kept.append(row)
    return np.array(kept, np.int64)


class _Mat:
    """Variables of a MATLAB file, checked as they are taken."""

    def __init__(self, path: Path, variables: dict[str, Any]) -> None:
        self.path, self.variables = path, variables

    @classmethod
    def open(cls, folder: Path, names: tuple[str, ...]) -> _Mat:
        from scipy.io import loadmat

        path = next((folder / name for name in names if (folder / name).is_file()), None)
        if path is None:
            raise LogError("no such file", where=str(folder / names[0]), fix="pass the folder of the recording")
        try:
            return cls(path, loadmat(str(path)))
        except Exception as error:  # whatever the parser stumbles over
            raise LogError(f"not a MATLAB file ({error})", where=str(path), fix="fetch it again") from None

    def array(self, name: str, shape: tuple[int | None, ...]) -> Array:
        """A variable of numbers; None in the shape is any length."""
        if name not in self.variables:
            raise LogError("missing variable", where=str(self.path), column=name, fix="fetch it again")
        value = np.asarray(self.variables[name])
        if value.dtype.kind not in "fiu":
            raise LogError("not numeric", where=str(self.path), column=name, fix="fetch it again")
        fits = value.ndim == len(shape) and all(n in (None, m) for n, m in zip(shape, value.shape, strict=True))
        if not fits:
            wanted = " x ".join("n" if n is None else str(n) for n in shape)
            found = " x ".join(map(str, value.shape))
            raise LogError(f"{found} numbers, expected {wanted}", where=str(self.path), column=name)
        bad = ~np.isfinite(value)
        if bad.any():
            row = int(np.argwhere(bad)[0][0])
            raise LogError("not a finite number", where=str(self.path), row=row, column=name, fix="fetch it again")
        return value.astype(float)

    def column(self, name: str, count: int) -> Array:
        return self.array(name, (count, 1))[:, 0]

    def number(self, name: str) -> float:
        return float(self.array(name, (1, 1))[0, 0])

    def sigma(self, name: str) -> float:
        value = self.number(name)
        if value <= 0:
            raise LogError(f"variance {value:g}, expected above zero", where=str(self.path), column=name)
        return math.sqrt(value)

    def times(self) -> Array:
        t_s = self.array("t", (None, 1))[:, 0]
        wrong = np.flatnonzero(np.diff(t_s) <= 0)
        if len(t_s) < 2:
            raise LogError(f"{len(t_s)} rows, expected at least 2", where=str(self.path), column="t")
        if len(wrong):
            where = str(self.path)
            raise LogError("time does not ascend", where=where, row=int(wrong[0]) + 1, column="t", fix="fetch it again")
        return t_s
