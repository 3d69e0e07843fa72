"""What a machine's IMU records: error-free samples of its motion, biases and white noise."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from graphnav.simulation import sensors as sense
from graphnav.simulation.machine_figures import ImuGrade, MachineSpec
from graphnav.simulation.motion import Motion

Array = npt.NDArray[np.float64]


def draw_triple(rng: np.random.Generator, sigma: Any, on: float) -> Array:
    """Three independent errors with one sigma, or one each, times `on`."""
    drawn: Array = on * np.broadcast_to(np.asarray(sigma, float), 3) * rng.standard_normal(3)
    return drawn


def draw_biases(grade: ImuGrade, rng: np.random.Generator, on: float) -> tuple[Array, Array]:
    """Turn-on biases of gyro (rad/s) and accelerometer (m/s^2), ``(3,)`` each."""
    gyro = draw_triple(rng, sense.gyro_si(grade.gyro_bias_deg_h), on)
    return gyro, draw_triple(rng, sense.accel_si(grade.accel_bias_mg), on)


def samples(
    spec: MachineSpec,
    motion: Motion,
    rot_nb: Rotation,
    biases: tuple[Array, Array],
    rng: np.random.Generator,
    on: float,
) -> tuple[Array, Array]:
    """Gyro (rad/s) and accelerometer (m/s^2) samples between N states, ``(N-1, 3)`` each.

    The mean over a sample of a white process has density / sqrt(dt).
    """
    earth_n = sense.earth_rate_n(spec.latitude_deg)
    clean = sense.inertial_samples(motion, rot_nb, 1.0 / spec.imu_rate_hz, earth_n, spec.gravity_m_s2)
    grade, root = spec.imu, np.sqrt(spec.imu_rate_hz)
    white = on * root * rng.standard_normal((len(clean[0]), 6))
    gyro = sense.gyro_density_si(grade.gyro_random_walk_deg_sqrt_h) * white[:, :3]
    accel = sense.accel_si(grade.accel_random_walk_mg_sqrt_hz) * white[:, 3:]
    return clean[0] + biases[0] + gyro, clean[1] + biases[1] + accel
