"""What averaging detections of a leg makes of the scanner's errors: `graphnav.leg_means.spread` and its use."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from factors.legs import LegFamily
from graphnav.config import Config
from graphnav.legs import LegReadings, gathered
from graphnav.log import Frames, Lidar, LidarPoints, SensorLog
from graphnav.problem import D, L, X
from graphnav.simulation.lidar import LidarErrors, cut_of_leg, range_and_bearing
from graphnav.trajectory import Trajectory

#: Errors of the size that shearer-lidar draws: range scale and bias, angle bias, scale and quadratic, mounting.
ERRORS = np.array([6e-4, 0.035, 2e-3, -0.0075, 2e-3, -2e-4, 1e-4, 7e-3])
#: East and north of each leg at the scanner's height, and its lean.
LEGS = np.array([[-4.0, 9.0, -0.14, 0.03], [-4.1, 0.3, -0.12, -0.02], [-3.9, -9.5, -0.15, 0.01]])


def tilting(rng: np.random.Generator) -> Trajectory:
    """Five seconds at 0.1 m/s, 25 poses a second, with slow tilts and turns of a centiradian, about a mean tilt."""
    t_s = np.arange(126) / 25
    phase, period = rng.uniform(0, 2 * np.pi, 3), np.array([3.0, 4.0, 5.0])
    angles = 0.01 * np.sin(2 * np.pi * t_s[:, None] / period + phase) + [0.02, -0.015, 0.3]
    pos_n = np.column_stack([0.01 * t_s, 0.1 * t_s, 0.002 * t_s])
    quat = Rotation.from_rotvec(angles).as_quat(scalar_first=True)
    return Trajectory(t_s, pos_n, quat, np.gradient(pos_n, t_s, axis=0))


def seen(way: Trajectory, rotation_bs: np.ndarray) -> LegReadings:
    """Detections without noise by a scanner with `ERRORS`, brought together at the middle of the way."""
    d = ERRORS
    errors = LidarErrors(d[5:], d[0], d[1], np.radians(d[4]), d[3], np.degrees(d[2]))
    rot_ns = way.rotation_nb @ Rotation.from_rotvec(d[5:]).as_matrix() @ rotation_bs
    place = np.column_stack([LEGS[:, :2], np.zeros(3)])
    range_m, angle = range_and_bearing(cut_of_leg(way.pos_n, rot_ns, place, np.column_stack([LEGS[:, 2:], np.ones(3)])))
    t_s = np.repeat(way.t_s, 3)
    points = LidarPoints(
        t_s,
        np.tile([1, 2, 3], len(way.t_s)),
        errors.measured_range(range_m).ravel(),
        errors.measured_angle(angle).ravel(),
    )
    quat = Rotation.from_matrix(rotation_bs).as_quat(scalar_first=True)
    lidar = Lidar(range_sigma_m=0.01, angle_sigma_deg=0.05, T_bs_quat_wxyz=quat)
    log = SensorLog(name="tilting", frames=Frames(35.0), lidar_points=points, lidar=lidar)
    return gathered(log, Config(), way, np.array([len(way.t_s) // 2]))


def off(readings: LegReadings, way: Trajectory, rotation_bs: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Errors (3, 2) of the readings at the true states, m at the leg."""
    values = gtsam.Values()
    values.insert(D(0), ERRORS)
    for j, leg in enumerate(LEGS):
        values.insert(L(j), leg)
    for i in np.unique(readings.keyframe).tolist():
        values.insert(X(i), gtsam.Pose3(gtsam.Rot3(way.rotation_nb[i]), way.pos_n[i]))
    family = LegFamily(
        X(0) + readings.keyframe, L(0) + readings.leg, np.full(3, D(0)), readings.turn_b, readings.shift_n,
        readings.range_m, readings.angle_rad, np.zeros(3), readings.off_plane_m, spread, np.ones((3, 2)),
        rotation_bs, np.zeros(3),
    )  # fmt: skip
    error, *_ = family.residuals(values)
    return error * np.column_stack([np.ones(3), readings.range_m])


@pytest.mark.parametrize("turn", [0.0, 0.3])
def test_mean_of_a_tilting_scanner_is_read_back_right(turn: float) -> None:
    """Without noise the residuals vanish but for what is of second order; without the spread they do not.

    The tilt at the mean time is not the mean tilt: what an error of the angle lifts off the plane then moves the cut of
    a leaning leg, by a tenth of a millimetre. Over a shift that told the heading wrong by 10 sigma.
    """
    rotation_bs = Rotation.from_rotvec([turn, -turn / 2, turn]).as_matrix()
    way = tilting(np.random.default_rng(4))
    readings = seen(way, rotation_bs)
    assert np.array_equal(readings.count, [len(way.t_s)] * 3)
    told = np.abs(off(readings, way, rotation_bs, readings.spread)).max()
    in_plane = np.concatenate([readings.spread[:, :2], 0 * readings.spread[:, 2:]], axis=1)
    assert told < 2e-6
    assert np.abs(off(readings, way, rotation_bs, in_plane)).max() > 1e-4
    assert np.abs(off(readings, way, rotation_bs, 0 * readings.spread)).max() > 1e-4
