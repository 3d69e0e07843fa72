"""The LiDAR of a simulated shift: its world, its errors and the tables that it records."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from graphnav.simulation.lidar import PointRecorder, declared, draw_lidar_errors
from graphnav.simulation.lidar_figures import LidarSpec
from graphnav.simulation.scans import ScanRecorder
from graphnav.simulation.supports import build_supports
from graphnav.simulation.world import Streams, World

Array = npt.NDArray[np.float64]


class Scanner:
    """Records point features, and raw scans if they are wanted, while a shift is worked through in blocks.

    Parameters
    ----------
    world : the shift.
    spec : the LiDAR.
    of : the log's random streams.
    on : factor on reading errors and noise.

    Attributes
    ----------
    every : IMU samples between two scans.
    """

    def __init__(self, world: World, spec: LidarSpec, of: Streams, on: float) -> None:
        self.every = world.spec.imu_rate_hz // spec.rate_hz
        self._spec = spec
        supports = build_supports(world, of.supports)
        errors = draw_lidar_errors(spec, of.lidar, on)
        self._points = PointRecorder(spec, supports, errors, of.points, on)
        self._scans = ScanRecorder(world, spec, supports, errors, of.roadways, of.scans, on) if spec.scans else None

    def add(self, t_s: Array, pos_n: Array, rot_nb: Rotation) -> None:
        """Scan once at each of the times, ``(N,)``, positions ``(N, 3)`` and N attitudes of the body."""
        if len(t_s):
            self._points.add(t_s, pos_n, rot_nb)
            if self._scans is not None:
                self._scans.add(t_s, pos_n, rot_nb)

    def tables(self) -> dict[str, Any]:
        """The parts of a `SensorLog` that the LiDAR fills."""
        scans = None if self._scans is None else self._scans.table()
        return {"lidar": declared(self._spec), "lidar_points": self._points.table(), "lidar_scans": scans}
