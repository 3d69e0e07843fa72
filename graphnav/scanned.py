"""A log with raw scans and no detections: its legs are found before it is smoothed."""

from __future__ import annotations

from graphnav.config import Config
from graphnav.log import SensorLog


def with_scanned_legs(log: SensorLog, config: Config) -> tuple[SensorLog, tuple[str, ...]]:
    """The log with the legs in its scans as `lidar_points`, and what the user should know of them, one line each.

    As it is where it has detections already, where legs are not to be used, and where it has no scans.

    Raises
    ------
    LogError : scans that cannot be read.
    """
    if log.lidar_scans is None or log.lidar_points is not None or not config.lidar.use:
        return log, ()
    unused = "the table lidar_scans is not used"
    if log.lidar is None:
        return log, (f"{unused}: declare the scanner in a section [lidar]",)
    if log.lidar.leg_diameter_m is None:
        return log, (f"{unused}: declare lidar.leg_diameter_m, by which legs are told from all else",)
    from graphnav.frontends.legs import legs, with_legs

    found = legs(log, side=None if config.lidar.side == "both" else config.lidar.side)
    if found.points is None:
        return log, (*found.warnings, f"{unused}: no leg was found on the side that lidar.side names")
    return with_legs(log, found), found.warnings
