"""`SensorLog`: one recorded shift, frozen and columnar, one class per sensor.

Units and frames are in the field names (see `factors` for the conventions). Every class checks itself on
construction: finite numbers, ascending times, sigmas above zero, unit quaternions. Times are on one clock:
the reader has applied each sensor's offset.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from graphnav._schema import Array, Record, column, param
from graphnav.errors import LogError

_QUAT = ("qw", "qx", "qy", "qz")
_XYZ = ("x_m", "y_m", "z_m")
_UPPER_6X6 = tuple(f"c_{i}{j}" for i in range(6) for j in range(i, 6))


def unit_quaternion(record: Record, name: str) -> None:
    """Normalise quaternions of `record.name` in place of rounding; refuse what is no rotation."""
    quat = np.atleast_2d(getattr(record, name))
    norm = np.linalg.norm(quat, axis=1)
    wrong = np.abs(norm - 1) > 1e-3
    if wrong.any():
        row = int(np.argmax(wrong))
        raise record.error(
            f"quaternion of length {norm[row]:.6g}, expected 1 (order w, x, y, z)",
            row=row if record.TABLE else None,
            column=name,
        )
    # What is of unit length to rounding stays as it is, so that a log written and read again is unchanged.
    norm[np.abs(norm - 1) < 1e-12] = 1.0
    unit = (quat / norm[:, None]).reshape(getattr(record, name).shape)
    unit.flags.writeable = False
    object.__setattr__(record, name, unit)


@dataclass(frozen=True, eq=False)
class Frames(Record):
    """Origin of the navigation frame n (east, north, up; tangent plane)."""

    SECTION: ClassVar[str] = "frames"
    latitude_deg: float = param()
    longitude_deg: float = param(0.0)
    height_m: float = param(0.0)
    gravity_m_s2: float | None = param(None, positive=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if abs(self.latitude_deg) > 90:
            raise self.error(f"{self.latitude_deg}, expected -90 to 90", column="latitude_deg")
        if self.gravity_m_s2 is not None and not 9.7 < self.gravity_m_s2 < 9.9:
            raise self.error(f"{self.gravity_m_s2}, expected 9.7 to 9.9 m/s^2", column="gravity_m_s2")


@dataclass(frozen=True, eq=False, kw_only=True)
class InitialState(Record):
    """State at the start of the first IMU row's interval, with 1-sigma.

    Without `pos_n_m` and `pos_sigma_m` the position is unknown: zeros, with a sigma of 1000 m.
    """

    SECTION: ClassVar[str] = "initial"
    UNKNOWN_M: ClassVar[float] = 100.0
    pos_n_m: Array = param(None, shape=(3,))
    pos_sigma_m: Array = param(None, shape=(3,), positive=True)
    quat_nb_wxyz: Array = param(shape=(4,))
    att_sigma_deg: Array = param(shape=(3,), positive=True)
    vel_n_m_s: Array = param(shape=(3,))
    vel_sigma_m_s: Array = param(shape=(3,), positive=True)
    static_until_s: float | None = param(None)

    @property
    def pos_known(self) -> bool:
        """Whether the position is declared to better than 100 m; if not, measurements have to give it."""
        return bool((self.pos_sigma_m < self.UNKNOWN_M).all())

    def __post_init__(self) -> None:
        missing = [getattr(self, name) is None for name in ("pos_n_m", "pos_sigma_m")]
        if any(missing) and not all(missing):
            raise self.error("pos_n_m and pos_sigma_m belong together", fix="declare both, or neither")
        if all(missing):
            object.__setattr__(self, "pos_n_m", np.zeros(3))
            object.__setattr__(self, "pos_sigma_m", np.full(3, 1000.0))
        super().__post_init__()
        unit_quaternion(self, "quat_nb_wxyz")


@dataclass(frozen=True, eq=False)
class Imu(Record):
    """Gyro and accelerometer; row k is the mean over (t_k - dt, t_k], specific force +g upward at rest."""

    SECTION: ClassVar[str] = "imu"
    TABLE: ClassVar[str] = "imu"
    t_s: Array = column("t_s")
    gyro_b_rad_s: Array = column("gyro_x_rad_s", "gyro_y_rad_s", "gyro_z_rad_s")
    accel_b_m_s2: Array = column("accel_x_m_s2", "accel_y_m_s2", "accel_z_m_s2")
    gyro_bias_deg_h: float = param(positive=True)
    gyro_random_walk_deg_sqrt_h: float = param(positive=True)
    accel_bias_mg: float = param(positive=True)
    accel_random_walk_mg_sqrt_hz: float = param(positive=True)
    gyro_bias_walk_deg_h_sqrt_h: float = param(0.0, nonnegative=True)
    accel_bias_walk_mg_sqrt_h: float = param(0.0, nonnegative=True)
    gyro_matrix: Array | None = param(None, shape=(3, 3))
    accel_matrix: Array | None = param(None, shape=(3, 3))
    time_offset_s: float = param(0.0)

    @property
    def dt_s(self) -> float:
        """Nominal sampling interval: the median time step."""
        return float(np.median(np.diff(self.t_s)))

    @property
    def start_s(self) -> float:
        """Start of the first row's interval."""
        return float(self.t_s[0]) - self.dt_s

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.t_s) < 2:
            raise self.error("1 row, expected at least 2")


@dataclass(frozen=True, eq=False)
class Odometer(Record):
    """Signed forward speed along the machine's y axis: ``measured = (1 + scale) * v_m[y] + noise``."""

    SECTION: ClassVar[str] = "odometer"
    TABLE: ClassVar[str] = "odometer"
    t_s: Array = column("t_s")
    speed_m_s: Array = column("speed_m_s")
    sigma_m_s: float = param(positive=True)
    slip_sigma_m_s: float = param(positive=True)
    scale_sigma: float = param(positive=True)
    mounting_sigma_deg: Array = param(shape=(3,), positive=True)
    lever_arm_b_m: Array = param((0.0, 0.0, 0.0), shape=(3,))
    time_offset_s: float = param(0.0)


@dataclass(frozen=True, eq=False)
class Face(Record):
    """The longwall face and what is known of its advance."""

    SECTION: ClassVar[str] = "face"
    length_m: float = param(positive=True)
    push_m: float = param(0.0)
    push_sigma_m: float = param(0.03, positive=True)
    along_sigma_m: float = param(0.03, positive=True)
    creep_m: float = param(0.0)
    creep_sigma_m: float = param(0.0, nonnegative=True)
    interval_m: float = param(2.0, positive=True)


@dataclass(frozen=True, eq=False)
class SurveyedPoint(Record):
    """A known position of the machine: at time `t_s`, or on its first arrival at an `end` of the face."""

    SECTION: ClassVar[str] = "surveyed"
    pos_n_m: Array = param(shape=(3,))
    sigma_m: float = param(positive=True)
    t_s: float | None = param(None)
    end: str | None = param(None, kind="str")

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.t_s is None) == (self.end is None):
            raise self.error("expected either t_s or end", column="t_s")
        if self.end not in (None, "far", "near"):
            raise self.error(f'"{self.end}", expected "far" or "near"', column="end")


@dataclass(frozen=True, eq=False)
class Events(Record):
    """Starts and ends of the cuts; cycles count from 1."""

    TABLE: ClassVar[str] = "events"
    STRICT: ClassVar[bool] = False
    t_s: Array = column("t_s")
    kind: Any = column("kind", kind="str")
    cycle: Any = column("cycle", kind="int")

    def __post_init__(self) -> None:
        super().__post_init__()
        for row, kind in enumerate(self.kind):
            if kind not in ("cut_start", "cut_end"):
                raise self.error(f'"{kind}", expected "cut_start" or "cut_end"', row=row, column="kind")


@dataclass(frozen=True, eq=False)
class Push(Record):
    """Measured advance of the conveyor at a face coordinate after a cycle."""

    TABLE: ClassVar[str] = "push"
    STRICT: ClassVar[bool] = False
    t_s: Array = column("t_s")
    cycle: Any = column("cycle", kind="int")
    s_m: Array = column("s_m")
    push_m: Array = column("push_m")


@dataclass(frozen=True, eq=False)
class Position(Record):
    """Absolute positions in n (GNSS, total station), each with its own sigmas."""

    TABLE: ClassVar[str] = "position"
    t_s: Array = column("t_s")
    pos_n_m: Array = column(*_XYZ)
    sigma_n_m: Array = column("sigma_x_m", "sigma_y_m", "sigma_z_m", positive=True)


@dataclass(frozen=True, eq=False)
class Truth(Record):
    """Reference trajectory; for evaluation alone, never for an estimator."""

    TABLE: ClassVar[str] = "truth"
    t_s: Array = column("t_s")
    pos_n_m: Array = column(*_XYZ)
    quat_nb: Array = column(*_QUAT)
    vel_n_m_s: Array | None = column("vx_m_s", "vy_m_s", "vz_m_s", optional=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        unit_quaternion(self, "quat_nb")


@dataclass(frozen=True, eq=False)
class LidarPoints(Record):
    """Detected point features with data association; angle from s's forward axis, counter-clockwise."""

    TABLE: ClassVar[str] = "lidar_points"
    STRICT: ClassVar[bool] = False
    t_s: Array = column("t_s")
    feature: Any = column("feature", kind="int")
    range_m: Array = column("range_m", positive=True)
    angle_rad: Array = column("angle_rad")


@dataclass(frozen=True, eq=False)
class LidarScans(Record):
    """Raw planar scans."""

    TABLE: ClassVar[str] = "lidar_scans"
    t_s: Array = column("t_s")
    angle_min_rad: Array = column("angle_min_rad")
    angle_step_rad: Array = column("angle_step_rad")
    ranges_m: Any = column("ranges_m", kind="list")


@dataclass(frozen=True, eq=False)
class Landmark(Record):
    """A surveyed point of the leg that `feature` stands for; the sigma is that of east and of north."""

    SECTION: ClassVar[str] = "lidar.landmark"
    feature: int = param(kind="int")
    pos_n_m: Array = param(shape=(3,))
    sigma_m: float = param(positive=True)


@dataclass(frozen=True, eq=False)
class Lidar(Record):
    """Declared geometry and errors of the LiDAR."""

    SECTION: ClassVar[str] = "lidar"
    range_sigma_m: float = param(positive=True)
    angle_sigma_deg: float = param(positive=True)
    T_bs_pos_m: Array = param((0.0, 0.0, 0.0), shape=(3,))
    T_bs_quat_wxyz: Array = param((1.0, 0.0, 0.0, 0.0), shape=(4,))
    mounting_sigma_deg: Array | None = param(None, shape=(3,), positive=True)
    range_scale_sigma: float | None = param(None, positive=True)
    range_bias_sigma_m: float | None = param(None, positive=True)
    angle_bias_sigma_deg: float | None = param(None, positive=True)
    angle_scale_sigma: float | None = param(None, positive=True)
    angle_quadratic_sigma_per_deg: float | None = param(None, positive=True)
    feature_spacing_m: float | None = param(None, positive=True)
    leg_diameter_m: float | None = param(None, positive=True)
    landmark: tuple[Landmark, ...] = param((), items=Landmark)
    time_offset_s: float = param(0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        unit_quaternion(self, "T_bs_quat_wxyz")
        seen: set[int] = set()
        for mark in self.landmark:
            if mark.feature in seen:
                raise self.error(f"feature {mark.feature} is there twice", column="landmark", fix="keep one of them")
            seen.add(mark.feature)


@dataclass(frozen=True, eq=False)
class UwbTag(Record):
    """A UWB tag on the machine."""

    SECTION: ClassVar[str] = "uwb.tag"
    id: str = param(kind="str")
    lever_arm_b_m: Array = param((0.0, 0.0, 0.0), shape=(3,))


@dataclass(frozen=True, eq=False)
class UwbAnchor(Record):
    """A UWB anchor, surveyed or, in a `group`, known but for a rigid displacement of all anchors of that group.

    `bias_sigma_m` is the sigma of its constant error where that is not the one of all anchors.
    """

    SECTION: ClassVar[str] = "uwb.anchor"
    id: str = param(kind="str")
    pos_n_m: Array = param(shape=(3,))
    sigma_m: float = param(positive=True)
    group: str | None = param(None, kind="str")
    bias_sigma_m: float | None = param(None, positive=True)


@dataclass(frozen=True, eq=False)
class Uwb(Record):
    """UWB ranges with their tags and anchors.

    A range is the distance plus its anchor's constant, a first-order Markov process of its own, and white noise;
    `rest_factor` times the latter two while the machine stands. With `scale_sigma` the distance counts times one plus
    an unknown that all ranges share (estimated where relative poses carry the state, not yet beside an IMU).

    The anchors of a group stand on one body: truly they are where they are declared (each to its own sigma), turned
    together about up, about the mean of their declared positions, and then moved together. Sigma of the turn (None: no
    turn) and of each axis of the move, both drawn anew for every group.
    """

    SECTION: ClassVar[str] = "uwb"
    TABLE: ClassVar[str] = "uwb"
    STRICT: ClassVar[bool] = False
    t_s: Array = column("t_s")
    tag_id: Any = column("tag", kind="str")
    anchor_id: Any = column("anchor", kind="str")
    range_m: Array = column("range_m", positive=True)
    rssi_db: Array | None = column("rssi_db", optional=True)
    sigma_m: float = param(0.1, positive=True)
    bias_sigma_m: float | None = param(None, positive=True)
    markov_sigma_m: float | None = param(None, positive=True)
    markov_time_s: float | None = param(None, positive=True)
    rest_factor: float = param(1.0, positive=True)
    group_sigma_m: float | None = param(None, positive=True)
    group_turn_sigma_deg: float | None = param(None, positive=True)
    scale_sigma: float | None = param(None, positive=True)
    tag: tuple[UwbTag, ...] = param((), items=UwbTag)
    anchor: tuple[UwbAnchor, ...] = param((), items=UwbAnchor)
    time_offset_s: float = param(0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, used, declared in (("tag", self.tag_id, self.tag), ("anchor", self.anchor_id, self.anchor)):
            known = sorted({item.id for item in declared})
            wrong = np.flatnonzero(~np.isin(used, known))
            if len(wrong):
                raise self.error(
                    f'unknown {name} "{used[wrong[0]]}", log.toml declares {known}',
                    row=int(wrong[0]),
                    column=name,
                    fix=f"add a [[uwb.{name}]] section for it",
                )
        if (self.markov_sigma_m is None) != (self.markov_time_s is None):
            raise self.error("markov_sigma_m and markov_time_s belong together", fix="declare both, or neither")
        if self.group_sigma_m is None and any(anchor.group is not None for anchor in self.anchor):
            raise self.error("anchors in groups without group_sigma_m", fix="declare how far a group may have moved")

    @property
    def constant_sigma_m(self) -> Array:
        """(A,) sigma of each anchor's constant error; zero where none is declared."""
        own = (self.bias_sigma_m if a.bias_sigma_m is None else a.bias_sigma_m for a in self.anchor)
        return np.array([sigma or 0.0 for sigma in own])


@dataclass(frozen=True, eq=False)
class Stereo(Record):
    """The rectified stereo camera; its left camera is c.

    `sigma_px` is the 1-sigma error of a feature's column or row in one image, `disparity_sigma_px` of what all
    disparities are too large by (the angle between the two cameras). The camera sits in the body as declared but for
    errors of `T_bc_pos_sigma_m` (b) and angles of `mounting_sigma_deg` (``R_bc = R(T_bc_quat) Exp(angles)``,
    about c's axes); zero: as declared.
    """

    SECTION: ClassVar[str] = "stereo"
    fx_px: float = param(positive=True)
    fy_px: float = param(positive=True)
    cx_px: float = param()
    cy_px: float = param()
    baseline_m: float = param(positive=True)
    sigma_px: float = param(0.5, positive=True)
    disparity_sigma_px: float = param(0.0, nonnegative=True)
    T_bc_pos_m: Array = param((0.0, 0.0, 0.0), shape=(3,))
    T_bc_quat_wxyz: Array = param((0.7071067811865476, -0.7071067811865476, 0.0, 0.0), shape=(4,))
    T_bc_pos_sigma_m: Array = param((0.0, 0.0, 0.0), shape=(3,), nonnegative=True)
    mounting_sigma_deg: Array = param((0.0, 0.0, 0.0), shape=(3,), nonnegative=True)
    time_offset_s: float = param(0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        unit_quaternion(self, "T_bc_quat_wxyz")


@dataclass(frozen=True, eq=False)
class StereoPairs(Record):
    """Rectified image pairs: paths relative to `folder`, that of the log (None: a log that was not read from one)."""

    TABLE: ClassVar[str] = "stereo"
    FIELD: ClassVar[str] = "stereo_pairs"
    t_s: Array = column("t_s")
    left: Any = column("left", kind="str")
    right: Any = column("right", kind="str")
    folder: Path | None = field(default=None, compare=False)  # where it was read from, no part of what it says


@dataclass(frozen=True, eq=False)
class StereoTracks(Record):
    """Places of features in rectified image pairs; `track` is an integer that stands for one point at rest."""

    TABLE: ClassVar[str] = "stereo_tracks"
    STRICT: ClassVar[bool] = False
    t_s: Array = column("t_s")
    track: Any = column("track", kind="int")
    u_left_px: Array = column("u_left_px")
    u_right_px: Array = column("u_right_px")
    v_px: Array = column("v_px")


@dataclass(frozen=True, eq=False)
class RelativePose(Record):
    """Camera motions ``T_c_from_c_to`` from any odometry, with two sigmas or a full covariance."""

    TABLE: ClassVar[str] = "relative_pose"
    STRICT: ClassVar[bool] = False
    TIME: ClassVar[str] = "t_from_s"
    t_from_s: Array = column("t_from_s")
    t_to_s: Array = column("t_to_s")
    pos_m: Array = column(*_XYZ)
    quat: Array = column(*_QUAT)
    sigma_m: Array | None = column("sigma_m", positive=True, optional=True)
    sigma_rad: Array | None = column("sigma_rad", positive=True, optional=True)
    cov_upper: Array | None = column(*_UPPER_6X6, optional=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        unit_quaternion(self, "quat")
        if (self.sigma_m is None or self.sigma_rad is None) and self.cov_upper is None:
            raise self.error("no uncertainty", fix="add sigma_m and sigma_rad, or the 21 columns c_00 ... c_55")


@dataclass(frozen=True)
class SensorLog:
    """Everything recorded in one shift. Sensors that were not recorded are None."""

    name: str
    frames: Frames
    epoch: str | None = None
    initial: InitialState | None = None
    imu: Imu | None = None
    odometer: Odometer | None = None
    face: Face | None = None
    surveyed: tuple[SurveyedPoint, ...] = field(default=())
    events: Events | None = None
    push: Push | None = None
    position: Position | None = None
    lidar: Lidar | None = None
    lidar_points: LidarPoints | None = None
    lidar_scans: LidarScans | None = None
    uwb: Uwb | None = None
    stereo: Stereo | None = None
    stereo_pairs: StereoPairs | None = None
    stereo_tracks: StereoTracks | None = None
    relative_pose: RelativePose | None = None
    truth: Truth | None = None

    MOTION: ClassVar[tuple[str, ...]] = (
        "imu",
        "odometer",
        "relative_pose",
        "lidar_points",
        "lidar_scans",
        "uwb",
        "stereo_pairs",
        "stereo_tracks",
        "position",
    )

    def __post_init__(self) -> None:
        if all(getattr(self, sensor) is None for sensor in self.MOTION):
            raise LogError(
                "no motion sensor",
                where=f"log {self.name}",
                fix="add at least one of the tables imu, odometer, position, ...",
            )

    def tables(self) -> dict[str, Record]:
        """The tables that this log has, by name."""
        records = {name: getattr(self, cls.field_name()) for name, cls in TABLES.items()}
        return {name: record for name, record in records.items() if record is not None}


#: Table name -> class, in the order of the log format.
TABLES: dict[str, type[Record]] = {
    cls.TABLE: cls
    for cls in (
        Imu, Odometer, Events, Push, LidarPoints, LidarScans, Uwb, StereoPairs, StereoTracks, RelativePose, Position,
        Truth,
    )
}  # fmt: skip

#: log.toml section -> class, for the sections that stand without a table.
SECTIONS: dict[str, type[Record]] = {cls.SECTION: cls for cls in (Frames, InitialState, Face, Lidar, Stereo)}
