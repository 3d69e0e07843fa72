"""Static alignment: tilt and gyro bias from the first rest."""

from __future__ import annotations

import numpy as np

from factors import so3
from factors.increments import Samples
from factors.inertial import ImuNoise
from factors.so3 import Array, from_quaternion
from graphnav.log import InitialState


def aligned(
    samples: Samples, rest_s: Array, initial: InitialState, noise: ImuNoise, gravity_m_s2: float, earth_rate_n: Array
) -> tuple[Array, Array]:
    """Attitude R_nb (3, 3) at the start, and gyro bias (3,), rad/s.

    Heading is the declared one. Tilt is the accelerometers' where the log starts at rest and they know better; the
    bias is what the gyro shows at rest, less Earth rate, and zero where that is no bias of this sensor.
    """
    rotation = levelled(
        samples,
        rest_s,
        from_quaternion(initial.quat_nb_wxyz),
        float(samples.edge_s[0]),
        float(np.radians(initial.att_sigma_deg[:2].max())),
        noise.accel_bias / gravity_m_s2,
    )
    bias = rest_bias(samples, rest_s, rotation, earth_rate_n)
    return rotation, bias if np.abs(bias).max() <= 5 * noise.gyro_bias else np.zeros(3)


def rest_bias(samples: Samples, rest_s: Array, rotation_nb: Array, earth_rate_n: Array) -> Array:
    """Gyro bias (3,) from the first rest: mean rate less Earth rate; zero when there is no rest at the start."""
    if not len(rest_s):
        return np.zeros(3)
    inside = (samples.edge_s[:-1] >= rest_s[0, 0]) & (samples.edge_s[1:] <= rest_s[0, 1])
    if not inside.any():
        return np.zeros(3)
    return np.asarray(samples.gyro_b[inside].mean(axis=0) - rotation_nb.T @ earth_rate_n)


def levelled(
    samples: Samples, rest_s: Array, rotation_nb: Array, start_s: float, tilt_sigma_rad: float, tilt_noise_rad: float
) -> Array:
    """The declared attitude, its tilt from the accelerometers where the log starts at rest and they know better."""
    at_start = len(rest_s) and rest_s[0, 0] - start_s < 2.0
    if not at_start or tilt_noise_rad > tilt_sigma_rad:
        return rotation_nb
    inside = (samples.edge_s[:-1] >= rest_s[0, 0]) & (samples.edge_s[1:] <= rest_s[0, 1])
    if not inside.any():
        return rotation_nb
    up_b = samples.accel_b[inside].mean(axis=0)
    up_b = up_b / np.linalg.norm(up_b)
    expected = rotation_nb.T @ np.array([0.0, 0.0, 1.0])
    axis = np.cross(expected, up_b)
    sine = np.linalg.norm(axis)
    if sine < 1e-9:
        return rotation_nb
    turn = so3.exp(axis / sine * np.arctan2(sine, expected @ up_b))
    return rotation_nb @ so3.transpose(turn)
