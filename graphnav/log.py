"""`SensorLog`: one recorded shift, frozen and columnar, one class per sensor.

Units and frames are in the field names (see `factors` for the conventions). Every class checks itself on
construction: finite numbers, ascending times, sigmas above zero, unit quaternions. Times are on one clock:
the reader has applied each sensor's offset.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

from graphnav._schema import Record
from graphnav.errors import LogError
from graphnav.records.face import Events, Face, Push
from graphnav.records.inertial import Imu, Odometer
from graphnav.records.lidar import Landmark, Lidar, LidarPoints, LidarScans
from graphnav.records.place import Frames, InitialState, Position, SurveyedPoint, Truth
from graphnav.records.stereo import RelativePose, Stereo, StereoPairs, StereoTracks
from graphnav.records.uwb import Uwb, UwbAnchor, UwbTag

__all__ = [
    "SECTIONS",
    "TABLES",
    "Events",
    "Face",
    "Frames",
    "Imu",
    "InitialState",
    "Landmark",
    "Lidar",
    "LidarPoints",
    "LidarScans",
    "Odometer",
    "Position",
    "Push",
    "RelativePose",
    "SensorLog",
    "Stereo",
    "StereoPairs",
    "StereoTracks",
    "SurveyedPoint",
    "Truth",
    "Uwb",
    "UwbAnchor",
    "UwbTag",
]


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
