"""Strapdown navigation in n on the rotating Earth, sample by sample, with its error transition; compiled.

Equations: attitude ``R' = R [w]x - [Omega]x R``, velocity ``v' = R f + g - 2 Omega x v``, position ``p' = v``, as in
Zheng et al. (2021), equation 13 without its errors. Within a sample rate and force run linearly with the slopes that
both neighbours show, and the coning, sculling and scrolling terms are those of `factors.increments`
(Savage 1998). The error transition is the first variation of that recursion, equations 13-17, to second order in a
sample.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from factors.so3 import Array
from graphnav.baselines import kalman
from graphnav.baselines._compiled import compiled

if TYPE_CHECKING:
    from graphnav.baselines.inputs import Inputs
    from graphnav.baselines.states import Nominal

#: Blocks of the transition matrix over an epoch, in the order they are kept: row state by column state.
#: phi-phi, phi-gyro; v-phi, v-v, v-gyro, v-accel; p-phi, p-v, p-gyro, p-accel.
BLOCKS = 10


@compiled
def cross(a: Array, b: Array) -> Array:
    """Cross product of two vectors."""
    out = np.empty(3)
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
    return out


@compiled
def crossed(a: Array, m: Array) -> Array:
    """``[a]x m`` for a matrix (3, 3)."""
    out = np.empty((3, 3))
    for j in range(3):
        out[0, j] = a[1] * m[2, j] - a[2] * m[1, j]
        out[1, j] = a[2] * m[0, j] - a[0] * m[2, j]
        out[2, j] = a[0] * m[1, j] - a[1] * m[0, j]
    return out


@compiled
def times(m: Array, v: Array) -> Array:
    """Matrix (3, 3) times vector."""
    out = np.empty(3)
    for i in range(3):
        out[i] = m[i, 0] * v[0] + m[i, 1] * v[1] + m[i, 2] * v[2]
    return out


@compiled
def product(a: Array, b: Array) -> Array:
    """Product of two matrices (3, 3)."""
    out = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]
    return out


@compiled
def rotation(phi: Array) -> Array:
    """``Exp(phi)`` (3, 3)."""
    angle2 = phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2]
    if angle2 < 1e-6:
        s, c = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0
    else:
        angle = np.sqrt(angle2)
        s, c = np.sin(angle) / angle, 2.0 * np.sin(angle / 2.0) ** 2 / angle2
    out = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            out[i, j] = c * phi[i] * phi[j]
        out[i, i] += 1.0 - c * angle2
    out[0, 1] -= s * phi[2]
    out[0, 2] += s * phi[1]
    out[1, 0] += s * phi[2]
    out[1, 2] -= s * phi[0]
    out[2, 0] -= s * phi[1]
    out[2, 1] += s * phi[0]
    return out


@compiled
def slope(values: Array, edge_s: Array, k: int) -> Array:
    """Time derivative of a sampled signal in sample k by the central difference, one-sided at the ends."""
    lo, hi = max(k - 1, 0), min(k + 1, len(values) - 1)
    out = np.zeros(3)
    if hi > lo:
        span = (edge_s[hi + 1] + edge_s[hi] - edge_s[lo + 1] - edge_s[lo]) / 2.0
        for i in range(3):
            out[i] = (values[hi, i] - values[lo, i]) / span
    return out


@compiled
def piece(rate: Array, rate_slope: Array, force: Array, force_slope: Array, h: float) -> tuple[Array, Array, Array]:
    """Rotation vector, velocity and position increments in the body frame at the start of a piece of one sample.

    The formulas of `factors.increments.compensated_increments`.
    """
    turned = cross(rate, force)
    cube = h * h * h / 12.0
    angle = rate * h + cross(rate, rate_slope) * cube
    velocity = (force + turned * (h / 2.0) + cross(rate, turned) * (h * h / 6.0)) * h
    velocity += (cross(rate, force_slope) + cross(force, rate_slope)) * cube
    position = force * (h * h / 2.0) + turned * (h * h * h / 6.0) - force_slope * cube
    return angle, velocity, position


@compiled
def advance(
    edge_s: Array,
    gyro_b: Array,
    accel_b: Array,
    start_s: float,
    epoch_s: Array,
    rotation_nb: Array,
    vel_n: Array,
    pos_n: Array,
    gyro_bias_b: Array,
    accel_bias_b: Array,
    gravity_m_s2: float,
    earth_n: Array,
    resting: bool,
    rotations: Array,
    velocities: Array,
    positions: Array,
    blocks: Array,
    force_n: Array,
) -> None:
    """Navigate from `start_s` through the epochs, one after the other.

    Parameters
    ----------
    edge_s, gyro_b, accel_b : samples as in `factors.increments.Samples`; they must cover the epochs.
    epoch_s : (E,) ascending, after `start_s`; they may divide samples.
    rotation_nb, vel_n, pos_n : state at the start; gyro_bias_b, accel_bias_b : (3,), taken out of the samples.
    resting : hold the attitude, as when the machine is known not to move.
    rotations, velocities, positions : outputs (E, 3, 3), (E, 3), (E, 3).
    blocks : output (E, 10, 3, 3), the error transition over each epoch (see `BLOCKS`).
    force_n : output (E, 3), mean specific force in n over each epoch, m/s^2.
    """
    r, v, p = rotation_nb.copy(), vel_n.copy(), pos_n.copy()
    gravity = np.array([0.0, 0.0, -gravity_m_s2])
    k = max(int(np.searchsorted(edge_s, start_s + 1e-9)) - 1, 0)
    now = start_s
    for e in range(len(epoch_s)):
        b = blocks[e]
        b[:] = 0.0
        for i in range(3):
            b[0, i, i] = b[3, i, i] = 1.0
        gained = np.zeros(3)
        began = now
        while now < epoch_s[e] - 1e-9:
            until = min(edge_s[k + 1], epoch_s[e])
            h = until - now
            middle = (until + now - edge_s[k + 1] - edge_s[k]) / 2.0
            w_dot, f_dot = slope(gyro_b, edge_s, k), slope(accel_b, edge_s, k)
            w = gyro_b[k] + w_dot * middle - gyro_bias_b
            f = accel_b[k] + f_dot * middle - accel_bias_b
            if resting:
                w, w_dot = np.zeros(3), np.zeros(3)
            angle, dv, dp = piece(w, w_dot, f, f_dot, h)
            # the Earth turns n under the body meanwhile; at rest the body turns with it
            turn = np.zeros(3) if resting else -earth_n * h
            dv_n, dp_n = times(r, dv), times(r, dp)
            dv_n += cross(turn, dv_n) * 0.5
            ahead = product(rotation(turn), product(r, rotation(angle)))
            mean = (r + ahead) * 0.5
            vary(b, mean, dv_n, turn, earth_n, h, resting)
            moved = v * h + gravity * (h * h / 2.0) + dp_n
            p += moved - cross(earth_n, v) * (h * h)
            v += gravity * h + dv_n - 2.0 * cross(earth_n, moved)
            r = ahead
            gained += dv_n
            now = until
            if now >= edge_s[k + 1] - 1e-9 and k + 2 < len(edge_s):
                k += 1
        rotations[e], velocities[e], positions[e] = r, v, p
        force_n[e] = gained / (now - began)


@compiled
def vary(b: Array, mean: Array, dv_n: Array, turn: Array, earth_n: Array, h: float, resting: bool) -> None:
    """One piece of the error transition, in place: Zheng (2021), equation 13, in the signs of `states`."""
    half_gyro = b[1] if resting else b[1] - mean * (h / 2.0)
    # position first: it takes the velocity error at the start and half of what it gains
    for column, attitude in ((0, b[0]), (1, half_gyro)):
        gain = crossed(dv_n, attitude)
        row_v, row_p = (2, 6) if column == 0 else (4, 8)
        b[row_p] += b[row_v] * h - gain * (h / 2.0)
        b[row_v] += crossed(earth_n, b[row_v]) * (-2.0 * h) - gain
    b[7] += b[3] * h
    b[3] += crossed(earth_n, b[3]) * (-2.0 * h)
    b[9] += b[5] * h - mean * (h * h / 2.0)
    b[5] += crossed(earth_n, b[5]) * (-2.0 * h) - mean * h
    b[0] += crossed(turn, b[0])
    if not resting:
        b[1] += crossed(turn, b[1]) - mean * h


def navigate(
    inputs: Inputs,
    nominal: Nominal,
    start_s: float,
    epoch_s: Array,
    walks: Array,
    *,
    resting: bool,
    noise_scale: float = 1.0,
) -> tuple[Array, Array, Array, Array, Array]:
    """The state carried from `start_s` through the epochs, with what that does to its errors.

    Parameters
    ----------
    epoch_s : (E,) as in `advance`; walks : (n,) as in `kalman.process_noise`, n states.
    noise_scale : factor on the IMU's noise densities.

    Returns
    -------
    rotations (E, 3, 3), velocities (E, 3), positions (E, 3), blocks (E, 10, 3, 3), process noise (E, n, n).
    """
    count, size = len(epoch_s), len(walks)
    samples = inputs.imu.samples
    rotations, velocities, positions = np.empty((count, 3, 3)), np.empty((count, 3)), np.empty((count, 3))
    blocks, force, noise = np.empty((count, BLOCKS, 3, 3)), np.empty((count, 3)), np.empty((count, size, size))
    advance(
        samples.edge_s, samples.gyro_b, samples.accel_b, start_s, epoch_s, nominal.rotation_nb, nominal.vel_n,
        nominal.pos_n, nominal.gyro_bias_b, nominal.accel_bias_b, inputs.gravity_m_s2, inputs.earth_rate_n, resting,
        rotations, velocities, positions, blocks, force,
    )  # fmt: skip
    bounds = np.concatenate([[start_s], epoch_s])
    gyro, accel = inputs.imu.densities(bounds, inputs.noise.gyro_density, inputs.noise.accel_density)
    kalman.process_noise(force, np.diff(bounds), gyro * noise_scale, accel * noise_scale, walks, resting, noise)
    return rotations, velocities, positions, blocks, noise
