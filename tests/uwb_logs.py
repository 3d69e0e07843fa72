"""Small logs with ranges: a machine that passes four anchors with a perfect or a noisy IMU, drawn at random."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from factors.earth import earth_rate_n
from graphnav.log import Frames, Imu, InitialState, SensorLog, Truth, Uwb, UwbAnchor, UwbTag

#: Table 3 of Cao et al. (2023).
ANCHORS = np.array([(1.112, 0.471, 1.375), (0.442, 1.483, 1.556), (1.925, 1.551, 1.913), (1.073, 0.542, 2.532)])
LEVER = np.array([0.0, 0.0, -0.3])
LATITUDE, GRAVITY, RATE = 35.0, 9.7973, 100.0
SWING_S = 10.0


@dataclass(frozen=True)
class Errors:
    """1-sigma errors of the drawn sensors; `multipath` : share of delayed ranges."""

    white_m: float = 0.013
    markov_m: float = 0.0
    markov_s: float = 2.0
    constant_m: float = 0.0
    multipath: float = 0.0
    gyro_bias_deg_h: float = 72.0
    accel_bias_mg: float = 3.0


def passing(
    seed: int = 0,
    errors: Errors = Errors(),
    seconds: float = 60.0,
    rest_s: float = 10.0,
    anchors: np.ndarray = ANCHORS,
    tag_start: tuple[float, float, float] = (0.5, 7.0, 0.0),
    known: bool = True,
    swing_m: float = 0.0,
) -> SensorLog:
    """Rest, then 4 m/min along -y at constant attitude; 100 Hz IMU, 40 ranges/s to the anchors in turn.

    With `swing_m` to and fro so far instead, in `SWING_S` there and back.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(1, int(seconds * RATE) + 1) / RATE
    start = np.array(tag_start) - LEVER
    truth = _swing(np.r_[0.0, t], rest_s, start, swing_m) if swing_m else _motion(np.r_[0.0, t], rest_s, start)
    uwb = _ranges(rng, errors, truth, anchors)
    turn = np.zeros((len(t), 3)) + earth_rate_n(LATITUDE)
    force = np.diff(truth.vel_n_m_s, axis=0) * RATE + [0, 0, GRAVITY] + 2 * np.cross(turn, truth.vel_n_m_s[1:])
    gyro_sigma, accel_sigma = np.radians(0.6) / 60, 0.08 * 9.80665e-3
    gyro = turn + np.radians(errors.gyro_bias_deg_h) / 3600 * rng.standard_normal(3)
    accel = force + errors.accel_bias_mg * 9.80665e-3 * rng.standard_normal(3)
    imu = Imu(
        t_s=t,
        gyro_b_rad_s=gyro + gyro_sigma * RATE**0.5 * rng.standard_normal(gyro.shape),
        accel_b_m_s2=accel + accel_sigma * RATE**0.5 * rng.standard_normal(accel.shape),
        gyro_bias_deg_h=max(errors.gyro_bias_deg_h, 1.0),
        gyro_random_walk_deg_sqrt_h=0.6,
        accel_bias_mg=max(errors.accel_bias_mg, 0.1),
        accel_random_walk_mg_sqrt_hz=0.08,
    )
    return SensorLog(
        "passing", Frames(latitude_deg=LATITUDE, gravity_m_s2=GRAVITY), initial=_initial(rng, truth, known, rest_s),
        imu=imu, uwb=uwb, truth=truth,
    )  # fmt: skip


def _motion(t: np.ndarray, rest_s: float, start: np.ndarray) -> Truth:
    """Speed rises over 2 s, so that the specific force stays finite."""
    part = np.clip((t - rest_s) / 2.0, 0.0, 1.0)
    speed = 4 / 60 * part**2 * (3 - 2 * part)
    way = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * np.diff(t))])
    pos = start + np.outer(way, [0.0, -1.0, 0.0])
    return Truth(t, pos, np.tile([1.0, 0, 0, 0], (len(t), 1)), np.outer(speed, [0.0, -1.0, 0.0]))


def _swing(t: np.ndarray, rest_s: float, start: np.ndarray, far_m: float) -> Truth:
    phase = 2 * np.pi * np.maximum(t - rest_s, 0.0) / SWING_S
    way, speed = far_m / 2 * (1 - np.cos(phase)), far_m * np.pi / SWING_S * np.sin(phase)
    pos = start + np.outer(way, [0.0, -1.0, 0.0])
    return Truth(t, pos, np.tile([1.0, 0, 0, 0], (len(t), 1)), np.outer(speed, [0.0, -1.0, 0.0]))


def _ranges(rng: np.random.Generator, errors: Errors, truth: Truth, anchors: np.ndarray) -> Uwb:
    t = np.arange(0.0125, truth.t_s[-1], 0.025)
    which = np.arange(len(t)) % len(anchors)
    tag = np.column_stack([np.interp(t, truth.t_s, column) for column in truth.pos_n_m.T]) + LEVER
    markov = _markov(rng, t, len(anchors), errors)
    constant = errors.constant_m * rng.standard_normal(len(anchors))
    error = errors.white_m * rng.standard_normal(len(t)) + markov[np.arange(len(t)), which] + constant[which]
    error += np.where((which == 0) & (rng.random(len(t)) < errors.multipath), rng.exponential(0.3, len(t)), 0.0)
    ids = [str(k + 1) for k in range(len(anchors))]
    return Uwb(
        t_s=t, tag_id=np.full(len(t), "1", object), anchor_id=np.array(ids, object)[which],
        range_m=np.linalg.norm(tag - anchors[which], axis=1) + error, sigma_m=errors.white_m,
        bias_sigma_m=errors.constant_m or None, markov_sigma_m=errors.markov_m or None,
        markov_time_s=errors.markov_s if errors.markov_m else None, tag=(UwbTag("1", LEVER),),
        anchor=tuple(UwbAnchor(name, pos, 1e-4) for name, pos in zip(ids, anchors, strict=True)),
    )  # fmt: skip


def _markov(rng: np.random.Generator, t: np.ndarray, count: int, errors: Errors) -> np.ndarray:
    keep = np.exp(-0.025 / errors.markov_s)
    out = np.empty((len(t), count))
    out[0] = errors.markov_m * rng.standard_normal(count)
    for k in range(1, len(t)):
        out[k] = keep * out[k - 1] + errors.markov_m * np.sqrt(1 - keep**2) * rng.standard_normal(count)
    return out


def _initial(rng: np.random.Generator, truth: Truth, known: bool, rest_s: float) -> InitialState:
    sigma = np.array([0.3, 0.3, 1.0])
    turn = np.radians(sigma * rng.standard_normal(3)) / 2
    quat = np.r_[1.0, turn] / np.linalg.norm(np.r_[1.0, turn])
    declared = InitialState(
        pos_n_m=truth.pos_n_m[0] + 0.05 * rng.standard_normal(3), pos_sigma_m=np.full(3, 0.05), quat_nb_wxyz=quat,
        att_sigma_deg=sigma, vel_n_m_s=np.zeros(3), vel_sigma_m_s=np.full(3, 0.01),
        static_until_s=rest_s if rest_s > 2 else None,
    )  # fmt: skip
    return declared if known else replace(declared, pos_n_m=np.zeros(3), pos_sigma_m=np.full(3, 1000.0))
