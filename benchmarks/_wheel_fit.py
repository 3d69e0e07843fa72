"""What wheels and laser of AER1513 dataset 2 show of each other: the importer's corrections, found without truth.

Each set of corrections makes a smoothing problem of the first 200 s with known tubes; the best set has the smallest
error, half the sum of all squared whitened residuals, and its curvature there is the information on them.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

import graphnav as gn
from factors.so3 import Array
from graphnav.log import SensorLog
from graphnav.readers import aer1513
from graphnav.readers.aer1513 import CORRECTIONS, Corrections

FITTED_S = 200.0
#: What is fitted, and the step of the differences: about two sigmas.
STEPS = {
    "speed_at_rest_m_s": 0.005, "speed_scale": 0.02, "turn_scale": 0.02, "wheels_yaw_rad": 0.005, "laser_delay_s": 0.02,
}  # fmt: skip


def cost(folder: Path, known: Corrections) -> float:
    """Error of the solved problem."""
    log = beginning(aer1513.convert(folder, corrections=known), known.laser_delay_s)
    return float(gn.smooth(log).diagnostics.history[-1]["error"])


def beginning(log: SensorLog, delay_s: float) -> SensorLog:
    """The first 200 s without truth, and the scans a second within them whatever their delay."""
    poses, points = log.relative_pose, log.lidar_points
    assert poses is not None and points is not None
    early = poses.t_to_s < FITTED_S
    inside = (points.t_s + delay_s > 1.0) & (points.t_s + delay_s < FITTED_S - 1.0)
    return dataclasses.replace(
        log,
        truth=None,
        relative_pose=poses.replace(**{name: getattr(poses, name)[early] for name in _POSES}),
        lidar_points=points.replace(**{name: getattr(points, name)[inside] for name in _POINTS}),
    )


_POSES = ("t_from_s", "t_to_s", "pos_m", "quat", "cov_upper")
_POINTS = ("t_s", "feature", "range_m", "angle_rad")


def best_corrections(folder: Path) -> dict[str, tuple[float, float]]:
    """Value and sigma of each: one Newton step from those of the importer, by second differences."""
    steps = np.diag(list(STEPS.values()))

    def moved(by: Array) -> float:
        start = CORRECTIONS[2]
        changes = {name: getattr(start, name) + float(d) for name, d in zip(STEPS, by, strict=True)}
        return cost(folder, dataclasses.replace(start, **changes))

    here = moved(np.zeros(len(STEPS)))
    up, down = (np.array([moved(sign * step) for step in steps]) for sign in (1, -1))
    curvature = np.diag(up - 2 * here + down)
    for i, j in zip(*np.tril_indices(len(STEPS), -1), strict=True):
        curvature[i, j] = curvature[j, i] = moved(steps[i] + steps[j]) - up[i] - up[j] + here
    cov = steps @ np.linalg.inv(curvature) @ steps
    best = -steps @ np.linalg.solve(curvature, (up - down) / 2)
    return {
        name: (getattr(CORRECTIONS[2], name) + float(best[k]), float(np.sqrt(cov[k, k])))
        for k, name in enumerate(STEPS)
    }
