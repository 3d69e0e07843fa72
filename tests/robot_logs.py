"""A simulated robot on wheels among legs, without an IMU: every error drawn from the declared sigmas."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np

from factors import so3
from graphnav.frontends.motion_chain import body_motions
from graphnav.log import Frames, InitialState, Landmark, Lidar, LidarPoints, SensorLog, Truth
from graphnav.readers.wheels import wheel_motions

STEP_S, SECONDS = 0.1, 40.0
FORWARD, SIDE, TURN = 0.005, 0.001, 0.005
RANGE_M, ANGLE_RAD, PLACE_M, BIAS_M = 0.02, 0.01, 0.01, 0.03
LEGS = np.array([[3.0, 0.0], [0.0, 3.0], [-3.0, 1.0], [1.0, -3.0], [-2.0, -2.0], [4.0, 4.0]])
SCANNER_B = np.array([0.05, 0.2, 0.0])


def robot_log(seed: int, *, legs: str = "known", scan_s: float = 1.0, seconds: float = SECONDS) -> SensorLog:
    """Wheels along a wandering path; `legs` "known", "unknown" or "none"."""
    rng = np.random.default_rng(seed)
    t_s = np.round(np.arange(0, seconds + STEP_S / 2, STEP_S), 6)
    count = len(t_s) - 1
    turn = 0.5 * np.sin(0.3 * t_s[:-1]) * STEP_S + 0.03 * STEP_S
    motion = wheel_motions(
        t_s, np.full(count, 0.3 * STEP_S), turn, sigma_forward_m=FORWARD, sigma_side_m=SIDE, sigma_turn_rad=TURN
    )
    initial = InitialState(
        pos_n_m=np.zeros(3),
        pos_sigma_m=np.array([0.02, 0.02, 1e-3]),
        quat_nb_wxyz=np.array([1.0, 0, 0, 0]),
        att_sigma_deg=np.array([0.05, 0.05, 2.0]),
        vel_n_m_s=np.zeros(3),
        vel_sigma_m_s=np.full(3, 0.02),
    )
    rotation, pos = _true_path(rng, body_motions(motion, None), initial)
    log = SensorLog(
        name="robot",
        frames=Frames(latitude_deg=45.0),
        initial=initial,
        relative_pose=motion,
        truth=Truth(t_s=t_s, pos_n_m=pos, quat_nb=so3.to_quaternion(rotation)),
    )
    if legs == "none":
        return log
    marks = tuple(
        Landmark(feature=j, pos_n_m=np.r_[place + rng.normal(0, PLACE_M, 2), 0.0], sigma_m=PLACE_M)
        for j, place in enumerate(LEGS, start=1)
    )
    lidar = Lidar(
        range_sigma_m=RANGE_M,
        angle_sigma_deg=float(np.degrees(ANGLE_RAD)),
        T_bs_pos_m=SCANNER_B,
        range_bias_sigma_m=BIAS_M,
        landmark=marks if legs == "known" else (),
    )
    rows = np.arange(0, len(t_s), round(scan_s / STEP_S))
    return replace(log, lidar=lidar, lidar_points=_seen(rng, t_s[rows], rotation[rows], pos[rows]))


def _true_path(rng: np.random.Generator, motion, initial: InitialState) -> tuple[np.ndarray, np.ndarray]:
    """Poses whose motions differ from the measured ones by draws of their covariances, in the plane alone."""
    heading = np.radians(initial.att_sigma_deg[2]) * rng.normal()
    at = gtsam.Pose3(gtsam.Rot3.Rz(heading), np.r_[initial.pos_sigma_m[:2] * rng.normal(size=2), 0.0])
    poses = [at]
    for rotation, pos, cov in zip(motion.rotation, motion.pos, motion.cov, strict=True):
        error = np.sqrt(np.diag(cov)) * rng.normal(size=6) * [0, 0, 1, 1, 1, 0]
        at = at.compose(gtsam.Pose3(gtsam.Rot3(rotation), pos)).compose(gtsam.Pose3.Expmap(error))
        poses.append(at)
    return np.array([p.rotation().matrix() for p in poses]), np.array([p.translation() for p in poses])


def _seen(rng: np.random.Generator, t_s: np.ndarray, rotation: np.ndarray, pos: np.ndarray) -> LidarPoints:
    """Readings of all legs, of a scanner whose range is wrong by a drawn constant."""
    scanner = pos + rotation @ SCANNER_B
    away = np.concatenate([LEGS[None] - scanner[:, None, :2], np.zeros((len(t_s), len(LEGS), 1))], axis=-1)
    x, y, _ = np.moveaxis(np.einsum("kji,klj->kli", rotation, away), -1, 0)
    shape = x.shape
    bias = BIAS_M * rng.normal()
    return LidarPoints(
        t_s=np.repeat(t_s, len(LEGS)),
        feature=np.tile(np.arange(1, len(LEGS) + 1), len(t_s)),
        range_m=(np.hypot(x, y) + bias + RANGE_M * rng.normal(size=shape)).ravel(),
        angle_rad=(np.arctan2(-x, y) + ANGLE_RAD * rng.normal(size=shape)).ravel(),
    )
