"""STAR-loc: a rig carried by hand with an IMU and UWB tags, under motion capture (arXiv:2309.05518).

Two recordings: **loop-2d-fast_s1** (34 s, 38 m, two tags and eight anchors, 222 ranges a second) and **loop-3d_s5**
(35 s, 26 m, one tag and four anchors, 40 a second). Ranges are the column `range`, raw; `range_calib` is not read.

What is taken from where:

- *Ranges, gyro, accelerometer*: as recorded.
- *Anchors, tags on the rig*: the motion capture's survey, made with the recording. The files of the first recording
  number its anchors in two ways: `_Setup.anchors` is what its `gt_range` agrees with, to rounding. The constant error
  of a range is that of the antennas at both ends, and the two tags differ by 0.1 m: every pair of tag and anchor is an
  anchor of the log, named "anchor-tag", so that it has a constant of its own.
- *Clocks*: the two tables have time zeros of their own. Both hold the rig's pose; the offset at which these agree (to
  2 mm) is `ranges_later_s`. Stamps of the IMU are early: its rates agree best with those of the poses 32 ms later
  (25 to 35 ms by their sum of squares), which is added. Time is that of ``imu.csv``.
- *IMU on the rig*: ``calib.json`` and the README contradict the data. Turn and place are those by which rates and
  accelerations agree with the poses (`_Setup.quat_rig_imu`, to half a degree, `imu_rig_m`, to 2 cm): a calibration.
- *Up*: the room's z axis of the first recording is 1.3 deg off the vertical that the accelerometer shows; n is level.
- *Start*: tilt from the first half second of the accelerometer, within 5 deg; velocity zero within 1 m/s; position and
  heading unknown, as ranges show both once the rig moves. Filters that linearize along the way need a heading to begin
  with: with `heading_sigma_deg` **it is the reference's**, and nothing else an estimator sees is.
- *Truth*: the motion capture's pose at the rows of ``imu.csv``, for judging alone. Rows that are nearer than 60 ms to
  a jump (3 m/s or 4 rad/s) are left out: 24 % and 2 %.

Body axes right, forward, up are the rig's -y, x, z; the origin is the IMU. Its rows come at 202 Hz with one to six
missing at a time (117 Hz in the mean): the log has a regular grid, each row the value of the straight lines between
samples in the middle of its interval. Holes are bridged by lines and not by steps, since a hand moves slower than they
last.

Declared noise is the same for both: that of the IMU from the differences of neighbouring samples, rounded up; that of
the ranges from what such radios are known for, 5 cm white, 30 cm constant for an uncalibrated anchor, and 10 cm
that changes with the direction in which the rig is seen, within half a second.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from factors import so3
from factors.so3 import Array
from graphnav.errors import LogError
from graphnav.log import Frames, Imu, InitialState, SensorLog, Truth, Uwb, UwbAnchor, UwbTag
from graphnav.readers.named_csv import NamedCsv
from graphnav.readers.starloc_stereo import tag_tracks

#: Vectors in the rig's axes (forward, left, up) -> right, forward, up.
_RFU_FROM_RIG = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
#: University of Toronto.
_PLACE = Frames(latitude_deg=43.8, longitude_deg=-79.5, height_m=200.0)
_IMU_LATER_S = 0.032
_NOISE: dict[str, Any] = {
    "gyro_bias_deg_h": 1080.0,
    "gyro_random_walk_deg_sqrt_h": 4.0,
    "accel_bias_mg": 30.0,
    "accel_random_walk_mg_sqrt_hz": 1.0,
}
_RANGES: dict[str, Any] = {"sigma_m": 0.05, "bias_sigma_m": 0.3, "markov_sigma_m": 0.1, "markov_time_s": 0.5}
_ANCHOR_SIGMA_M = 0.01
#: Poses that are further apart than these rates, and those near them in time, are jumps of the motion capture.
_JUMP_M_S, _JUMP_RAD_S, _NEAR_S = 3.0, 4.0, 0.06
#: Sigma of a heading that nothing is known of.
UNKNOWN_HEADING_DEG = 120.0
_TILT_S, _TILT_SIGMA_DEG = 0.5, 5.0


@dataclass(frozen=True)
class _Setup:
    """What is fixed in a recording.

    Attributes
    ----------
    markers : file of the anchors; anchors : id in the ranges -> id in that file.
    tags_rig_m : tag -> place in the rig's axes.
    quat_rig_imu : turn of the IMU on the rig (w, x, y, z); imu_rig_m : its place.
    up_room : the vertical in the room's axes.
    ranges_later_s, images_later_s : time of the ranges, of the images + this = time of ``imu.csv``.
    """

    markers: str
    anchors: dict[str, str]
    tags_rig_m: dict[str, tuple[float, float, float]]
    quat_rig_imu: tuple[float, float, float, float]
    imu_rig_m: tuple[float, float, float]
    up_room: tuple[float, float, float]
    ranges_later_s: float
    images_later_s: float


_SETUPS = {
    "loop-2d-fast_s1": _Setup(
        markers="uwb_markers_v1.csv",
        anchors={"4": "12", "5": "15", "6": "16", "7": "11", "9": "9", "10": "13", "11": "10", "12": "6"},
        tags_rig_m={"1": (-0.085, -0.207, 0.069), "2": (-0.085, 0.0, 0.069)},
        quat_rig_imu=(0.004721, 0.997126, 0.000389, 0.075612),
        imu_rig_m=(-0.029, -0.158, -0.039),
        up_room=(-0.0188, -0.0146, 0.99972),
        ranges_later_s=1.425,
        images_later_s=1.480,
    ),
    "loop-3d_s5": _Setup(
        markers="uwb_markers_v3.csv",
        anchors={name: name for name in ("4", "9", "11", "12")},
        tags_rig_m={"1": (-0.186, -0.113, 0.098)},
        quat_rig_imu=(0.014061, 0.999810, 0.007133, -0.011448),
        imu_rig_m=(-0.016, -0.112, -0.036),
        up_room=(0.0, 0.0, 1.0),
        ranges_later_s=1.433,
        images_later_s=1.486,
    ),
}


def convert(source: str | Path | None, *, heading_sigma_deg: float | None = None, stereo: bool = False) -> SensorLog:
    """Convert a recording.

    Parameters
    ----------
    source : folder ``loop-2d-fast_s1`` or ``loop-3d_s5``, beside the folder ``mocap``.
    heading_sigma_deg : declared sigma of the heading at the start, which then is the reference's; None leaves it
        unknown.
    stereo : with the camera and what it sees of AprilTags, see `starloc_stereo`.

    Returns
    -------
    SensorLog
        IMU, raw ranges with tags and anchors, truth; on demand the camera's tracks.

    Raises
    ------
    LogError
        A file or column is missing or damaged, or the folder is neither of these.
    """
    if source is None:
        raise LogError("starloc needs a source folder", fix="pass the folder loop-2d-fast_s1 or loop-3d_s5")
    if heading_sigma_deg is not None and not heading_sigma_deg > 0:
        raise LogError(f"heading_sigma_deg {heading_sigma_deg}, expected above zero")
    folder = Path(source).resolve()
    setup = _SETUPS.get(folder.name)
    if setup is None:
        raise LogError(f"folder {folder.name}, expected {' or '.join(_SETUPS)}", where=str(source))
    table = NamedCsv(folder / "imu.csv")
    level = _level(np.array(setup.up_room))
    truth = _truth(table, setup, level)
    imu = _imu(table, setup)
    camera, tracks = tag_tracks(folder, _to_body(setup), setup.images_later_s) if stereo else (None, None)
    return SensorLog(
        name=f"starloc-{folder.name}",
        frames=_PLACE,
        initial=_initial(imu, truth, heading_sigma_deg),
        imu=imu,
        uwb=_ranges(folder, setup, level),
        stereo=camera,
        stereo_tracks=tracks,
        truth=truth,
    )


def _level(up_room: Array) -> Array:
    """Rotation (3, 3) by the least angle that takes `up_room` to the z axis."""
    up = up_room / np.linalg.norm(up_room)
    axis = np.cross(up, [0.0, 0.0, 1.0])
    sine = float(np.linalg.norm(axis))
    return so3.exp(axis * (np.arcsin(sine) / sine if sine > 0 else 0.0))


def _to_body(setup: _Setup) -> Array:
    """Rotation (3, 3) of the IMU's axes into the body's."""
    return _RFU_FROM_RIG @ so3.from_quaternion(np.array(setup.quat_rig_imu))


def _imu(table: NamedCsv, setup: _Setup) -> Imu:
    """Rows on a regular grid, in the body's axes."""
    t_s = table.times("time_s") + _IMU_LATER_S
    step = float(np.median(np.diff(t_s)))
    edges = np.arange(t_s[0], t_s[-1], step)
    to_body = _to_body(setup)
    found = {
        name: np.column_stack([np.interp(edges[1:] - step / 2, t_s, table.column(f"{name}_{axis}")) for axis in "xyz"])
        for name in ("angular_velocity", "linear_acceleration")
    }
    return Imu(
        t_s=edges[1:],
        gyro_b_rad_s=found["angular_velocity"] @ to_body.T,
        accel_b_m_s2=found["linear_acceleration"] @ to_body.T,
        **_NOISE,
    )


def _truth(table: NamedCsv, setup: _Setup, level: Array) -> Truth:
    """Poses of the body without those near a jump."""
    t_s, pos = table.times("time_s"), table.columns("x", "y", "z")
    rotation = so3.from_quaternion(table.columns("w", "rot_x", "rot_y", "rot_z"))
    step = np.diff(t_s)
    turned = so3.log(so3.transpose(rotation[:-1]) @ rotation[1:])
    jump = np.linalg.norm(np.diff(pos, axis=0), axis=1) > _JUMP_M_S * step
    jump |= np.linalg.norm(turned, axis=1) > _JUMP_RAD_S * step
    away = np.abs(t_s[:, None] - t_s[:-1][jump]).min(axis=1, initial=np.inf)
    kept = away >= _NEAR_S
    imu_n = (pos + rotation @ np.array(setup.imu_rig_m)) @ level.T
    return Truth(
        t_s=t_s[kept], pos_n_m=imu_n[kept], quat_nb=so3.to_quaternion(level @ rotation[kept] @ _RFU_FROM_RIG.T)
    )


def _initial(imu: Imu, truth: Truth, heading_sigma_deg: float | None) -> InitialState:
    """Level by the accelerometer, heading unknown or that of the reference's first pose, place unknown."""
    up_b = imu.accel_b_m_s2[imu.t_s < imu.start_s + _TILT_S].mean(axis=0)
    levelled = _level(up_b)
    # the turn about up that brings the levelled forward axis to north, or to the reference's
    seen = levelled[:2, 1]
    wanted = np.array([0.0, 1.0]) if heading_sigma_deg is None else so3.from_quaternion(truth.quat_nb[0])[:2, 1]
    heading = np.arctan2(wanted[1], wanted[0]) - np.arctan2(seen[1], seen[0])
    return InitialState(
        pos_n_m=np.zeros(3),
        pos_sigma_m=np.full(3, 1000.0),
        quat_nb_wxyz=so3.to_quaternion(so3.exp(np.array([0.0, 0.0, heading])) @ levelled),
        att_sigma_deg=np.array([_TILT_SIGMA_DEG, _TILT_SIGMA_DEG, heading_sigma_deg or UNKNOWN_HEADING_DEG]),
        vel_n_m_s=np.zeros(3),
        vel_sigma_m_s=np.ones(3),
    )


def _ranges(folder: Path, setup: _Setup, level: Array) -> Uwb:
    """Raw ranges, tags about the IMU, anchors in n."""
    table = NamedCsv(folder / "uwb.csv")
    places = NamedCsv(folder.parent / "mocap" / setup.markers)
    surveyed = dict(zip(places.names(""), places.columns("x", "y", "z") @ level.T, strict=True))
    return Uwb(
        t_s=table.times("time_s", apart=False) + setup.ranges_later_s,
        tag_id=table.names("from_id"),
        anchor_id=table.names("to_id") + "-" + table.names("from_id"),
        range_m=table.column("range"),
        tag=tuple(
            UwbTag(id=name, lever_arm_b_m=_RFU_FROM_RIG @ (np.array(place) - setup.imu_rig_m))
            for name, place in setup.tags_rig_m.items()
        ),
        anchor=tuple(
            UwbAnchor(id=f"{name}-{tag}", pos_n_m=surveyed[marker], sigma_m=_ANCHOR_SIGMA_M)
            for name, marker in setup.anchors.items()
            for tag in setup.tags_rig_m
        ),
        **_RANGES,
    )
