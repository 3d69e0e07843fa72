"""Planar motion of the LiDAR by dead reckoning: where legs at rest must appear in the next scan.

Only steps between neighbouring scans are used, so biases and drift of the sensors do not matter; rest is not needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors import so3
from graphnav._schema import Array
from graphnav.frontends.motion_chain import body_motions
from graphnav.log import RelativePose, SensorLog, Stereo

#: Without a sensor that turns are measured with, the machine may turn as fast as this (1-sigma; chosen: a shearer).
_UNKNOWN_TURN_RAD_S = 0.02
_UNKNOWN_SPEED_M_S = 0.2
_STEP_SIGMA_M, _STEP_SIGMA_RAD = 2e-3, 1e-3


@dataclass(frozen=True)
class PlanarMotion:
    """Steps of s between scans, in its own plane.

    Attributes
    ----------
    t_s : (S,) times of the scans.
    step_s_m : (S, 2) right, forward: where s at this scan is, seen from s at the scan before; zero for the first.
    turn_rad : (S,) how far it has turned since the scan before, counter-clockwise.
    random_m, systematic_m : (S,) 1-sigma of the step: what differs from step to step, and what adds up (scale,
        mounting).
    sigma_rad : (S,) of the turn.
    rate_s_m_s, turn_rate_rad_s : (S, 2), (S,) velocity of s and rate of turn at the scan.
    """

    t_s: Array
    step_s_m: Array
    turn_rad: Array
    random_m: Array
    systematic_m: Array
    sigma_rad: Array
    rate_s_m_s: Array
    turn_rate_rad_s: Array

    @property
    def sigma_m(self) -> Array:
        """(S,) of the step, each axis."""
        return _STEP_SIGMA_M + self.random_m + self.systematic_m


def planar_motion(log: SensorLog, t_s: Array) -> PlanarMotion:
    """Motion between scans from what the log has.

    A `relative_pose` table gives step and turn alone. Otherwise the odometer gives the step and the gyro the turn; what
    is missing counts as zero within wide sigmas (0.2 m/s, 0.02 rad/s).

    Parameters
    ----------
    log : with a LiDAR; its mounting about up turns the step into s, its lever arm adds the swing of a turn.
    t_s : (S,) ascending times of the scans.

    Returns
    -------
    PlanarMotion
        In s, whose tilt against b is left out.
    """
    pose_b = _relative_poses(log.relative_pose, log.stereo, t_s) if log.relative_pose is not None else None
    dt = np.diff(t_s, prepend=t_s[0])
    if pose_b is not None:
        path, heading = pose_b
        random_m, systematic_m, sigma_rad = np.full((3, len(t_s)), [[5e-3], [5e-3], [10 * _STEP_SIGMA_RAD]])
    else:
        path, heading, random_m, systematic_m, sigma_rad = _odometer_and_gyro(log, t_s, dt)
    arm, yaw = _mounting(log)
    path = path + _turned(heading, np.broadcast_to(arm, path.shape))
    step = _turned(-(heading - np.diff(heading, prepend=heading[0])) - yaw, np.diff(path, axis=0, prepend=path[:1]))
    turn = np.diff(heading, prepend=heading[0])
    safe = np.where(dt > 0, dt, 1.0)
    rate, turn_rate = step / safe[:, None], turn / safe
    if len(t_s) > 1:
        rate[0], turn_rate[0] = rate[1], turn_rate[1]
    return PlanarMotion(t_s, step, turn, random_m, systematic_m, sigma_rad, rate, turn_rate)


def undistorted(pos_s_m: Array, since_s: Array, rate_s_m_s: Array, turn_rate_rad_s: Array) -> Array:
    """Points of a scan as they would be seen from where s is at the scan's stamp.

    Parameters
    ----------
    pos_s_m : (K, 2) right and forward of s at the time of the point's own beam.
    since_s : (K,) time of that beam after the stamp.
    rate_s_m_s : (K, 2) or (2,) velocity of s, in s.
    turn_rate_rad_s : (K,) or scalar, counter-clockwise.

    Returns
    -------
    array (K, 2)
        In s at the stamp. Speed and rate are taken as constant within a scan: at 1 m/s^2 and 40 ms that leaves
        0.8 mm.
    """
    since = np.asarray(since_s, float)
    turned = _turned(np.asarray(turn_rate_rad_s) * since, np.asarray(pos_s_m, float))
    # velocity in s at the stamp; turning on the way bends the step by half the turn
    moved: Array = np.asarray(rate_s_m_s, float) * since[:, None]
    return turned + _turned(np.asarray(turn_rate_rad_s) * since / 2, moved)


def _turned(angle_rad: Array, vectors: Array) -> Array:
    """Vectors (right, forward) rotated counter-clockwise."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.stack([c * vectors[..., 0] - s * vectors[..., 1], s * vectors[..., 0] + c * vectors[..., 1]], axis=-1)


def _mounting(log: SensorLog) -> tuple[Array, float]:
    """Lever arm of s in b (right, forward) and its angle about up."""
    if log.lidar is None:
        return np.zeros(2), 0.0
    forward = so3.from_quaternion(log.lidar.T_bs_quat_wxyz)[:, 1]
    return log.lidar.T_bs_pos_m[:2], float(np.arctan2(-forward[0], forward[1]))


def _odometer_and_gyro(log: SensorLog, t_s: Array, dt: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Path (S, 2) and heading (S,) of b in an arbitrary frame; sigmas of their steps as in `PlanarMotion`."""
    heading, sigma_rad = np.zeros(len(t_s)), _STEP_SIGMA_RAD + _UNKNOWN_TURN_RAD_S * dt
    if log.imu is not None:
        stamps = np.concatenate([[log.imu.start_s], log.imu.t_s])
        rate = log.imu.gyro_b_rad_s[:, 2]
        angle = np.concatenate([[0.0], np.cumsum(rate * np.diff(stamps))])
        heading = np.interp(t_s, stamps, angle)
        bias = np.radians(log.imu.gyro_bias_deg_h) / 3600
        noise = np.radians(log.imu.gyro_random_walk_deg_sqrt_h) / 60
        sigma_rad = _STEP_SIGMA_RAD + bias * dt + noise * np.sqrt(dt)
    odometer = log.odometer
    if odometer is None:
        return np.zeros((len(t_s), 2)), heading, np.zeros(len(t_s)), _UNKNOWN_SPEED_M_S * dt, sigma_rad
    between = np.diff(odometer.t_s) * (odometer.speed_m_s[1:] + odometer.speed_m_s[:-1]) / 2
    gone = np.interp(t_s, odometer.t_s, np.concatenate([[0.0], np.cumsum(between)]))
    forward = np.diff(gone, prepend=gone[0])
    # right and forward of b half-way through the step's turn
    middle = heading - np.diff(heading, prepend=heading[0]) / 2
    path = np.cumsum(_turned(middle, np.column_stack([np.zeros_like(forward), forward])), axis=0)
    # slip is independent each second, noise from sample to sample
    sample_s = float(np.median(np.diff(odometer.t_s))) if len(odometer.t_s) > 1 else 1.0
    slip = np.hypot(odometer.slip_sigma_m_s, odometer.sigma_m_s * np.sqrt(sample_s)) * np.sqrt(dt)
    tilt = np.radians(np.max(odometer.mounting_sigma_deg))
    systematic = np.hypot(odometer.scale_sigma, tilt) * np.abs(forward)
    return path, heading, slip, systematic, sigma_rad


def _relative_poses(poses: RelativePose, stereo: Stereo | None, t_s: Array) -> tuple[Array, Array]:
    """Path and heading of b at the times of the scans, from chained motions of the camera frame c."""
    step_b = body_motions(poses, stereo)
    turn = np.arctan2(step_b.rotation[:, 1, 0], step_b.rotation[:, 0, 0])
    heading = np.concatenate([[0.0], np.cumsum(turn)])
    path = np.concatenate([np.zeros((1, 2)), np.cumsum(_turned(heading[:-1], step_b.pos[:, :2]), axis=0)])
    stamps = np.concatenate([poses.t_from_s[:1], poses.t_to_s])
    at = np.column_stack([np.interp(t_s, stamps, axis) for axis in path.T])
    return at, np.interp(t_s, stamps, heading)
