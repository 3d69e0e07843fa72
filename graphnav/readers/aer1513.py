"""UTIAS AER1513, "State Estimation for Robotics": a robot on wheels with a laser, under motion capture (T. Barfoot).

- **Dataset 1** (``dataset1.mat``): along a straight line, wheel speed and laser range to a cylinder on that line.
- **Dataset 2** (``dataset2.mat``, or its first half): on a floor among 17 tubes, speed and turn rate of the wheels,
  laser range and bearing to the tubes, told apart. The laser is `d` ahead of the axle, where the wheels roll to.
- **Dataset 3**: a stereo camera carried by hand, see `aer1513_stereo`.

The first two have 10 rows a second; row k of the speeds holds until row k+1. Noise is the files' own (`v_var`,
`om_var`, `r_var`, `b_var`). They name none sideways, where wheels slip by `_SIDE_M_S`. What is wrong for longer than
white noise shows between wheels and laser, without the motion capture: `CORRECTIONS`.

Axes: n is the motion capture's (x east, y north); b is at the middle of the axle, right-forward-up, and looks where
the laser does; s has b's axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from factors.increments import npt_int
from graphnav._schema import Array
from graphnav.errors import LogError
from graphnav.log import Frames, InitialState, Landmark, Lidar, LidarPoints, RelativePose, SensorLog, Truth
from graphnav.readers import aer1513_stereo
from graphnav.readers.mat_file import MatFile
from graphnav.readers.wheels import FLOOR_M, FLOOR_RAD, upright, wheel_motions

_NAMES = {1: ("dataset1.mat",), 2: ("dataset2.mat", "dataset2_first_half.mat"), 3: aer1513_stereo.NAMES}
#: Toronto; of no effect without an IMU.
_PLACE = Frames(latitude_deg=43.8)
_SIDE_M_S = 0.01
#: What the ranges may have wrong as a whole: a tube's centre is not what the laser hits.
_RANGE_BIAS_M, _RANGE_SCALE = 0.05, 0.02
#: A tube's place was surveyed by the motion capture.
_PLACE_SIGMA_M = 0.005
#: The cylinder of dataset 1 is straight ahead by the way the recording was made: no bearing is measured.
_NO_BEARING_DEG = 45.0


@dataclass(frozen=True)
class Corrections:
    """What a recording has wrong as a whole.

    Attributes
    ----------
    speed_at_rest_m_s, turn_at_rest_rad_s : what the wheels read while they stand.
    speed_scale, turn_scale : true speed and turn by those measured.
    wheels_yaw_rad : direction in which the wheels roll, counter-clockwise from the laser's.
    laser_delay_s : how much later than the wheels the laser is stamped.
    """

    speed_at_rest_m_s: float = 0.0
    turn_at_rest_rad_s: float = 0.0
    speed_scale: float = 1.0
    turn_scale: float = 1.0
    wheels_yaw_rad: float = 0.0
    laser_delay_s: float = 0.0


#: None of them.
AS_RECORDED = Corrections()
#: Found once in the first 200 s of each: what stands reads the same number in hundreds of rows; the rest by least
#: squares of wheels against laser among the known tubes. No truth was used (docs/real-data.md).
CORRECTIONS = {
    1: Corrections(speed_scale=0.94, laser_delay_s=-0.031),
    2: Corrections(-0.02214, 0.00056, speed_scale=0.94, turn_scale=0.953, wheels_yaw_rad=-0.0794, laser_delay_s=0.07),
}


def convert(
    source: str | Path | None,
    *,
    dataset: int = 2,
    landmarks: Literal["known", "unknown"] = "known",
    interval_s: float = 1.0,
    corrections: Corrections | None = None,
) -> SensorLog:
    """Convert a recording.

    Parameters
    ----------
    source : folder with ``dataset1.mat``, ``dataset2.mat`` or ``dataset2_first_half.mat``, or ``dataset3.mat``.
    dataset : 1, 2 or 3; what follows is for the laser of the first two.
    landmarks : "known" declares the file's places of the tubes as surveyed, "unknown" leaves them to be estimated.
    interval_s : least time between laser scans that are taken over. Scans less than a second apart repeat each other's
        errors (docs/real-data.md), which are declared as independent; 0.1 takes all.
    corrections : by default `CORRECTIONS`; `AS_RECORDED` for none, which declares no systematic errors of the laser's
        ranges either.

    Returns
    -------
    SensorLog
        Relative poses of the wheels, laser detections (with dataset 3 of the camera's rates, and stereo tracks), truth
        where it is valid; initial pose the truth's.

    Raises
    ------
    LogError
        A file is missing or damaged, or an option is none of those above.
    """
    if source is None:
        raise LogError("aer1513 needs a source folder", fix="pass the folder that holds the .mat files")
    if dataset not in _NAMES:
        raise LogError(f"dataset {dataset} of aer1513, expected 1, 2 or 3")
    if landmarks not in ("known", "unknown"):
        raise LogError(f'landmarks "{landmarks}", expected "known" or "unknown"')
    if not interval_s > 0:
        raise LogError(f"interval_s {interval_s}, expected a time above zero", fix="0.1 takes every scan")
    mat = MatFile.first_of(Path(source), _NAMES[dataset])
    if dataset == 3:
        return aer1513_stereo.stereo_log(mat, _PLACE)
    known = CORRECTIONS[dataset] if corrections is None else corrections
    parts = (_line if dataset == 1 else _floor)(mat, known, interval_s)
    systematic = known != AS_RECORDED and dataset == 2
    lidar = parts.lidar.replace(
        landmark=_surveyed(parts.places) if landmarks == "known" else (),
        range_bias_sigma_m=_RANGE_BIAS_M if systematic else None,
        range_scale_sigma=_RANGE_SCALE if systematic else None,
    )
    return SensorLog(
        name=f"aer1513-{dataset}",
        frames=_PLACE,
        initial=_initial(parts.truth),
        relative_pose=parts.motion,
        lidar=lidar,
        lidar_points=parts.points,
        truth=parts.truth,
    )


@dataclass(frozen=True)
class _Parts:
    """What a file holds; places (J, 2) of the landmarks."""

    motion: RelativePose
    points: LidarPoints
    lidar: Lidar
    places: Array
    truth: Truth


def _line(mat: MatFile, known: Corrections, interval_s: float) -> _Parts:
    """Dataset 1: eastward, where the cylinder stands."""
    t_s = mat.times("t")
    count, step = len(t_s), np.diff(t_s)
    speed, ranges, x = (mat.column(name, count) for name in ("v", "r", "x_true"))
    rows = _thinned(t_s, np.arange(count), interval_s)
    motion = wheel_motions(
        t_s,
        known.speed_scale * (speed[:-1] - known.speed_at_rest_m_s) * step,
        np.zeros(count - 1),
        sigma_forward_m=step * mat.sigma("v_var"),
        sigma_side_m=FLOOR_M,
        sigma_turn_rad=FLOOR_RAD,
    )
    return _Parts(
        motion,
        LidarPoints(
            t_s=t_s[rows] - known.laser_delay_s,
            feature=np.ones(len(rows), np.int64),
            range_m=ranges[rows],
            angle_rad=np.zeros(len(rows)),
        ),
        Lidar(range_sigma_m=mat.sigma("r_var"), angle_sigma_deg=_NO_BEARING_DEG),
        np.array([[mat.number("l"), 0.0]]),
        Truth(t_s=t_s, pos_n_m=np.column_stack([x, np.zeros((count, 2))]), quat_nb=upright(np.full(count, -np.pi / 2))),
    )


def _floor(mat: MatFile, known: Corrections, interval_s: float) -> _Parts:
    """Dataset 2."""
    t_s = mat.times("t")
    count, step = len(t_s), np.diff(t_s)
    speed, rate = (mat.column(name, count)[:-1] for name in ("v", "om"))
    motion = wheel_motions(
        t_s,
        known.speed_scale * (speed - known.speed_at_rest_m_s) * step,
        known.turn_scale * (rate - known.turn_at_rest_rad_s) * step,
        sigma_forward_m=step * mat.sigma("v_var"),
        sigma_side_m=step * _SIDE_M_S,
        sigma_turn_rad=step * mat.sigma("om_var"),
        yaw_rad=known.wheels_yaw_rad,
    )
    places = mat.array("l", (None, 2))
    ranges, bearings = (mat.array(name, (count, len(places))) for name in ("r", "b"))
    row, tube = np.nonzero(ranges > 0)
    taken = np.isin(row, _thinned(t_s, row, interval_s))
    row, tube = row[taken], tube[taken]
    to_laser = mat.number("d") * np.array([-np.sin(known.wheels_yaw_rad), np.cos(known.wheels_yaw_rad), 0.0])
    valid = mat.column("true_valid", count) > 0
    x, y, heading = (mat.column(name, count)[valid] for name in ("x_true", "y_true", "th_true"))
    return _Parts(
        motion,
        LidarPoints(
            t_s=t_s[row] - known.laser_delay_s,
            feature=tube + 1,
            range_m=ranges[row, tube],
            angle_rad=bearings[row, tube],
        ),
        Lidar(
            range_sigma_m=mat.sigma("r_var"),
            angle_sigma_deg=float(np.degrees(mat.sigma("b_var"))),
            T_bs_pos_m=to_laser,
        ),
        places,
        Truth(
            t_s=t_s[valid],
            pos_n_m=np.column_stack([x, y, np.zeros(len(x))]),
            quat_nb=upright(heading - np.pi / 2),
        ),
    )


def _initial(truth: Truth) -> InitialState:
    """The truth's first pose, to 1 cm and half a degree, on a level floor."""
    return InitialState(
        pos_n_m=truth.pos_n_m[0],
        pos_sigma_m=np.array([0.01, 0.01, 1e-3]),
        quat_nb_wxyz=truth.quat_nb[0],
        att_sigma_deg=np.array([0.05, 0.05, 0.5]),
        vel_n_m_s=np.zeros(3),
        vel_sigma_m_s=np.full(3, 0.02),
    )


def _surveyed(places: Array) -> tuple[Landmark, ...]:
    return tuple(
        Landmark(feature=number, pos_n_m=np.array([x, y, 0.0]), sigma_m=_PLACE_SIGMA_M)
        for number, (x, y) in enumerate(places, start=1)
    )


def _thinned(t_s: Array, rows: npt_int, interval_s: float) -> npt_int:
    """Those of ascending rows that are no closer to each other than `interval_s`."""
    kept: list[int] = []
    for row in np.unique(rows).tolist():
        if not kept or t_s[row] - t_s[kept[-1]] > interval_s - 1e-6:
            kept.append(row)
    return np.array(kept, np.int64)
