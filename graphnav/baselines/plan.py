"""What the filter knows before it starts: priors, random walks, and which measurement comes at which keyframe."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.increments import npt_int
from factors.so3 import Array, from_quaternion
from graphnav.baselines.inputs import Inputs, Preset
from graphnav.baselines.states import ACCEL_BIAS, GYRO_BIAS, MOUNTING, PHI, POS, SCALE, SIZE, VEL


@dataclass(frozen=True)
class Advance:
    """What is expected of the second pass of a closed-path point: (3,) in m (right, forward, up)."""

    advance_m: Array
    sigma_m: Array
    at_end: bool


def prior_covariance(inputs: Inputs, preset: Preset) -> Array:
    """P0 (19, 19) from the declared sigmas (Zheng 2021, equation A2); attitude sigmas are about the body's axes."""
    initial, noise, odometer = inputs.initial, inputs.noise, inputs.log.odometer
    sigma = np.zeros(SIZE)
    sigma[VEL], sigma[PHI], sigma[POS] = initial.vel_sigma_m_s, np.radians(initial.att_sigma_deg), initial.pos_sigma_m
    sigma[GYRO_BIAS], sigma[ACCEL_BIAS] = noise.gyro_bias, noise.accel_bias
    if odometer is not None:
        sigma[MOUNTING], sigma[SCALE] = np.radians(odometer.mounting_sigma_deg), odometer.scale_sigma
    covariance = np.diag((preset.prior_scale * sigma) ** 2)
    rotation = from_quaternion(initial.quat_nb_wxyz)
    covariance[PHI, PHI] = rotation @ covariance[PHI, PHI] @ rotation.T
    return covariance


def walks(inputs: Inputs, *, resting: bool) -> Array:
    """Random-walk variance per second (19,) of biases and calibration; at rest that of the attitude too."""
    config, noise = inputs.config, inputs.noise
    out = np.zeros(SIZE)
    out[GYRO_BIAS], out[ACCEL_BIAS] = noise.gyro_bias_walk**2, noise.accel_bias_walk**2
    out[MOUNTING] = np.radians(config.odometer.mounting_walk_deg_sqrt_h) ** 2 / 3600
    out[SCALE] = config.odometer.scale_walk_sqrt_h**2 / 3600
    if resting:
        out[PHI] = np.radians(config.rest.attitude_sigma_deg) ** 2
    return out


def odometer_plan(inputs: Inputs, preset: Preset) -> tuple[npt_int, np.ndarray[tuple[int, ...], np.dtype[np.bool_]]]:
    """Odometer rows of each interval, and where the constraint across the machine counts.

    Returns
    -------
    bound : (N,) rows ``bound[i-1]:bound[i]`` lie in the interval that ends at keyframe i, its end included.
    constrained : (M,) one row in every `constraint_every_s`: the declared slip is independent from second to second.
    """
    odometer, keyframe_s = inputs.log.odometer, inputs.keyframe_s
    if odometer is None:
        return np.zeros(len(keyframe_s), np.int64), np.zeros(0, bool)
    bound = np.searchsorted(odometer.t_s, keyframe_s + 1e-6)
    if preset.constraint_every_s == 0:
        return bound, np.ones(len(odometer.t_s), bool)
    bucket = np.floor((odometer.t_s - odometer.t_s[0]) / preset.constraint_every_s + 1e-6)
    return bound, np.diff(bucket, prepend=-1) > 0


def advances(inputs: Inputs) -> dict[int, list[tuple[int, Advance]]]:
    """Closed-path points by the keyframe of their second pass: keyframe of the first one, and what is expected."""
    face = inputs.log.face
    found: dict[int, list[tuple[int, Advance]]] = {}
    if face is None or inputs.config.closed_path.form == "off":
        return found
    along = float(np.hypot(face.along_sigma_m, face.creep_sigma_m))
    sigma = np.array([face.push_sigma_m, along, face.push_sigma_m])
    for point in inputs.closed_path:
        advance = Advance(np.array([point.push_m, face.creep_m, 0.0]), sigma, point.at_end)
        found.setdefault(inputs.index(point.second_s), []).append((inputs.index(point.first_s), advance))
    return found


def fixes(inputs: Inputs) -> dict[int, list[tuple[Array, Array]]]:
    """Absolute positions by keyframe: position (3,) and sigma (3,)."""
    found: dict[int, list[tuple[Array, Array]]] = {}
    for t_s, pos_n, sigma_n in inputs.fixes:
        found.setdefault(inputs.index(t_s), []).append((pos_n, sigma_n))
    return found
