"""A machine that moves and rests as told, with an IMU and an odometer, for tests of the front ends."""

from __future__ import annotations

import dataclasses

import numpy as np
from sample_logs import GRAVITY, imu_params, initial, odometer_params

from graphnav import log as gl

GYRO_NOISE, ACCEL_NOISE = np.deg2rad(0.6) / 60 * 10, 0.08e-3 * GRAVITY * 10  # of one sample at 100 Hz
NO_SPANS = np.zeros((0, 2))


def profile(t: np.ndarray, *moves: tuple[float, float, float]) -> np.ndarray:
    """Speed at `t`: each move (start_s, end_s, speed) accelerates and brakes at 0.1 m/s^2."""
    speed = np.zeros_like(t)
    for start, end, value in moves:
        ramp = np.clip(0.1 * np.minimum(t - start, end - t), 0, abs(value))
        speed += np.sign(value) * ramp
    return speed


def machine(duration_s, *moves, seed=0, wobble_rad_s=0.1, shake=(0.0, 0.0), zero_speed=False, **initial_keys):
    """A level machine, sensors as in shearer-mems: wobble of 1 Hz in motion, shake of the engine always."""
    rng = np.random.default_rng(seed)
    t = np.arange(1, round(duration_s * 100) + 1) / 100
    speed = profile(t, *moves)
    swing = np.outer(np.sin(2 * np.pi * t + rng.uniform(0, 6)) * np.abs(speed) / 0.3, rng.choice([-1.0, 1.0], 3))
    bias = np.deg2rad(rng.normal(0, 720, 3)) / 3600
    gyro = bias + wobble_rad_s * swing + rng.normal(0, np.hypot(GYRO_NOISE, shake[0]), (len(t), 3))
    accel = rng.normal(rng.normal([0, 0, GRAVITY], 0.003 * GRAVITY), np.hypot(ACCEL_NOISE, shake[1]), (len(t), 3))
    accel += 1.5 * wobble_rad_s * swing  # gravity seen from a frame that tilts
    accel[:, 1] += np.gradient(speed, 0.01)
    measured = 0.0 if zero_speed else speed[9::10] + rng.normal(0, 0.01, len(t) // 10)
    return gl.SensorLog(
        name="machine",
        frames=gl.Frames(35.0),
        initial=initial(**initial_keys),
        imu=gl.Imu(t_s=t, gyro_b_rad_s=gyro, accel_b_m_s2=accel, **imu_params()),
        odometer=gl.Odometer(t_s=t[9::10], speed_m_s=measured + np.zeros(len(t) // 10), **odometer_params()),
    )


def imu_only(log):
    return dataclasses.replace(log, odometer=None)


def odometer_only(log):
    return dataclasses.replace(log, imu=None)
