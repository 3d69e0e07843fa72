"""Small logs with a camera's motions: a machine that stands, drives forward and turns, its errors drawn at random."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from factors import so3
from factors.earth import earth_rate_n
from factors.relative_pose import Motions, relative, seen_from
from graphnav.frontends.motion_chain import camera_mounting
from graphnav.log import Frames, Imu, InitialState, RelativePose, SensorLog, Stereo, Truth

LATITUDE, GRAVITY, RATE = 35.0, 9.7973, 100.0
_UPPER = np.triu_indices(6)


@dataclass(frozen=True)
class Errors:
    """1-sigma errors of the drawn sensors; of a motion over one step: `turn_rad` and `way_m` on each axis."""

    turn_rad: float = 5e-4
    way_m: float = 2e-3
    gyro_bias_deg_h: float = 3.5
    gyro_walk_deg_sqrt_h: float = 0.05
    accel_bias_mg: float = 0.5
    accel_walk_mg_sqrt_hz: float = 0.05


#: Sensors without errors, declared as good as a log may say.
PERFECT = Errors(1e-7, 1e-7, 0.0, 0.0, 0.0, 0.0)


def driving(
    seed: int = 0,
    errors: Errors = Errors(),
    seconds: float = 80.0,
    rest_s: float = 20.0,
    step_s: float = 0.5,
    stereo: Stereo | None = None,
) -> SensorLog:
    """Rest, then 0.1 m/s with a bend to either side; 100 Hz IMU, a camera motion every `step_s`."""
    rng = np.random.default_rng(seed)
    truth = _path(seconds, rest_s)
    return SensorLog(
        "driving", Frames(latitude_deg=LATITUDE, gravity_m_s2=GRAVITY), initial=_initial(rng, truth, rest_s),
        imu=_imu(rng, errors, truth), relative_pose=_motions(rng, errors, truth, step_s, stereo), stereo=stereo,
        truth=truth,
    )  # fmt: skip


def _path(seconds: float, rest_s: float) -> Truth:
    """Speed rises over 2 s, so that the specific force stays finite; it pitches a little as it bends."""
    t = np.arange(int(seconds * RATE) + 1) / RATE
    part = np.clip((t - rest_s) / 2.0, 0.0, 1.0)
    speed = 0.1 * part**2 * (3 - 2 * part)
    driven = np.maximum(t - rest_s, 0.0)
    yaw = 0.5 * np.sin(0.1 * driven) ** 2 * np.sign(np.sin(0.1 * driven))
    quat = so3.to_quaternion(_turns(yaw, 2) @ _turns(0.05 * np.sin(0.2 * driven) ** 2, 0))
    vel = so3.from_quaternion(quat)[:, :, 1] * speed[:, None]
    pos = np.concatenate([np.zeros((1, 3)), np.cumsum((vel[1:] + vel[:-1]) / 2 / RATE, axis=0)])
    return Truth(t, pos, quat, vel)


def _turns(angle: np.ndarray, axis: int) -> np.ndarray:
    return so3.exp(np.outer(angle, np.eye(3)[axis]))


def _imu(rng: np.random.Generator, errors: Errors, truth: Truth) -> Imu:
    rotation = so3.from_quaternion(truth.quat_nb)
    turn = so3.log(so3.transpose(rotation[:-1]) @ rotation[1:])
    middle = so3.transpose(rotation[:-1] @ so3.exp(turn / 2))
    earth = earth_rate_n(LATITUDE)
    vel = (truth.vel_n_m_s[1:] + truth.vel_n_m_s[:-1]) / 2
    force = np.diff(truth.vel_n_m_s, axis=0) * RATE + [0, 0, GRAVITY] + 2 * np.cross(earth, vel)
    density = np.radians(errors.gyro_walk_deg_sqrt_h) / 60, errors.accel_walk_mg_sqrt_hz * 9.80665e-3
    bias = np.radians(errors.gyro_bias_deg_h) / 3600, errors.accel_bias_mg * 9.80665e-3
    white = [sigma * RATE**0.5 * rng.standard_normal(force.shape) for sigma in density]
    constant = [sigma * rng.standard_normal(3) for sigma in bias]
    return Imu(
        t_s=truth.t_s[1:],
        gyro_b_rad_s=turn * RATE + (middle @ earth) + constant[0] + white[0],
        accel_b_m_s2=(middle @ force[..., None])[..., 0] + constant[1] + white[1],
        gyro_bias_deg_h=max(errors.gyro_bias_deg_h, 1e-3),
        gyro_random_walk_deg_sqrt_h=max(errors.gyro_walk_deg_sqrt_h, 1e-3),
        accel_bias_mg=max(errors.accel_bias_mg, 1e-3),
        accel_random_walk_mg_sqrt_hz=max(errors.accel_walk_mg_sqrt_hz, 1e-3),
    )


def _motions(
    rng: np.random.Generator, errors: Errors, truth: Truth, step_s: float, stereo: Stereo | None
) -> RelativePose:
    """Motions of the camera: the true ones, less the drawn error: ``measured = T Exp(-e)``."""
    rows = np.arange(0, len(truth.t_s), round(step_s * RATE))
    rotation, pos = so3.from_quaternion(truth.quat_nb)[rows], truth.pos_n_m[rows]
    body = Motions(*relative(rotation[:-1], pos[:-1], rotation[1:], pos[1:]), np.zeros((len(rows) - 1, 6, 6)))
    rotation_bc, pos_bc = camera_mounting(stereo)
    seen = seen_from(body, rotation_bc.T, -rotation_bc.T @ pos_bc)
    sigma = np.repeat([errors.turn_rad, errors.way_m], 3)
    off = sigma * rng.standard_normal((len(seen.pos), 6)) * (errors is not PERFECT)
    return RelativePose(
        t_from_s=truth.t_s[rows[:-1]],
        t_to_s=truth.t_s[rows[1:]],
        pos_m=seen.pos - (seen.rotation @ off[:, 3:, None])[..., 0],
        quat=so3.to_quaternion(seen.rotation @ so3.exp(-off[:, :3])),
        cov_upper=np.tile(np.diag(sigma**2)[_UPPER], (len(seen.pos), 1)),
    )


def _initial(rng: np.random.Generator, truth: Truth, rest_s: float) -> InitialState:
    """As in the scenario: attitude to 0.01 deg, position to 1 mm."""
    turn = np.radians(0.01) * rng.standard_normal(3)
    return InitialState(
        pos_n_m=truth.pos_n_m[0] + 1e-3 * rng.standard_normal(3), pos_sigma_m=np.full(3, 1e-3),
        quat_nb_wxyz=so3.to_quaternion(so3.from_quaternion(truth.quat_nb[0]) @ so3.exp(-turn)),
        att_sigma_deg=np.full(3, 0.01), vel_n_m_s=np.zeros(3), vel_sigma_m_s=np.full(3, 1e-3),
        static_until_s=rest_s if rest_s > 2 else None,
    )  # fmt: skip


def without(log: SensorLog, low_s: float, high_s: float) -> SensorLog:
    """The log without the camera's motions that end within a span."""
    poses = log.relative_pose
    kept = (poses.t_to_s <= low_s + 1e-6) | (poses.t_from_s >= high_s - 1e-6)
    columns = {name: getattr(poses, name)[kept] for name in ("t_from_s", "t_to_s", "pos_m", "quat", "cov_upper")}
    return replace(log, relative_pose=RelativePose(**columns))
