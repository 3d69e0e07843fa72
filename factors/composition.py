"""The loops of `factors.increments` and `factors.inertial` over samples and minor intervals, compiled.

Vectors are tuples of three numbers here, which the compiler keeps in registers. Imported where it is called: the
compiler takes a third of a second to import.
"""

from __future__ import annotations

import math

import numpy as np

from factors.compilation import compiled
from factors.so3 import Array

Ints = np.ndarray[tuple[int, ...], np.dtype[np.int64]]
Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


@compiled
def _at(table: Array, row: int) -> Vector:
    return table[row, 0], table[row, 1], table[row, 2]


@compiled
def _sum(a: Vector, b: Vector, factor: float) -> Vector:
    """``a + factor b``."""
    return a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]


@compiled
def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled
def _rotated(q: Quaternion, v: Vector) -> Vector:
    """A vector turned by a quaternion, w first."""
    axis = (q[1], q[2], q[3])
    half = _cross(axis, v)
    return _sum(_sum(v, half, 2 * q[0]), _cross(axis, half), 2.0)


@compiled
def _turned(q: Quaternion, phi: Vector) -> Quaternion:
    """The quaternion turned further by a rotation vector, in its own frame."""
    angle = math.sqrt(phi[0] ** 2 + phi[1] ** 2 + phi[2] ** 2)
    w, s = math.cos(angle / 2), 0.5 if angle == 0 else math.sin(angle / 2) / angle
    x, y, z = s * phi[0], s * phi[1], s * phi[2]
    return (
        q[0] * w - q[1] * x - q[2] * y - q[3] * z,
        q[0] * x + q[1] * w + q[2] * z - q[3] * y,
        q[0] * y - q[1] * z + q[2] * w + q[3] * x,
        q[0] * z + q[1] * y - q[2] * x + q[3] * w,
    )


@compiled
def _rotation_vector(q: Quaternion) -> Vector:
    """Of a unit quaternion, up to half a turn."""
    sine = math.sqrt(q[1] ** 2 + q[2] ** 2 + q[3] ** 2)
    factor = 2.0 if sine < 1e-12 else 2 * math.atan2(sine, abs(q[0])) / sine
    if q[0] < 0:
        factor = -factor
    return factor * q[1], factor * q[2], factor * q[3]


@compiled
def composed(
    edge: Array,
    row: Ints,
    interval: Ints,
    first_piece: Ints,
    middle_s: Array,
    tables: tuple[Array, Array, Array, Array],
    gyro_bias_b: Array,
    accel_bias_b: Array,
) -> Array:
    """Rotation vectors, velocities and positions (M, 9) of runs of pieces, see `factors.increments`.

    Parameters
    ----------
    edge : (N+1,) bounds of the pieces; row, interval : (N,) the sample and the interval that each belongs to.
    first_piece : (M+1,) run m is the pieces ``first_piece[m]:first_piece[m+1]``.
    middle_s : (S,) of the samples; tables : (S, 3) their rates and forces, and the slopes of both.
    gyro_bias_b, accel_bias_b : (K, 3) of the intervals.
    """
    gyro, accel, gyro_slope, accel_slope = tables
    found = np.empty((len(first_piece) - 1, 9))
    for run in range(len(found)):
        quat, velocity, position = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        for k in range(first_piece[run], first_piece[run + 1]):
            h, sample, bias = edge[k + 1] - edge[k], row[k], interval[k]
            offset, cube = (edge[k + 1] + edge[k]) / 2 - middle_s[sample], h**3 / 12
            w_dot, f_dot = _at(gyro_slope, sample), _at(accel_slope, sample)
            w = _sum(_sum(_at(gyro, sample), w_dot, offset), _at(gyro_bias_b, bias), -1.0)
            f = _sum(_sum(_at(accel, sample), f_dot, offset), _at(accel_bias_b, bias), -1.0)
            w_f = _cross(w, f)
            angle = _sum(_sum((0.0, 0.0, 0.0), w, h), _cross(w, w_dot), cube)
            gained = _sum(_sum(_sum((0.0, 0.0, 0.0), f, h), w_f, h**2 / 2), _cross(w, w_f), h**3 / 6)
            gained = _sum(_sum(gained, _cross(w, f_dot), cube), _cross(f, w_dot), cube)
            moved = _sum(_sum(_sum((0.0, 0.0, 0.0), f, h**2 / 2), w_f, h**3 / 6), f_dot, -cube)
            position = _sum(_sum(position, velocity, h), _rotated(quat, moved), 1.0)
            velocity = _sum(velocity, _rotated(quat, gained), 1.0)
            quat = _turned(quat, angle)
        found[run, :3], found[run, 3:6], found[run, 6:] = _rotation_vector(quat), velocity, position
    return found


@compiled
def _turn(phi: Vector, out: Array) -> None:
    """Rotation matrix (3, 3) of a rotation vector (Rodrigues), as `factors.so3.exp`."""
    x, y, z = phi
    square = x * x + y * y + z * z
    angle = math.sqrt(square)
    s, c = 1 - square / 6, 0.5 - square / 24
    if square >= 1e-6:
        s, c = math.sin(angle) / angle, 2 * math.sin(angle / 2) ** 2 / square
    out[0, 0], out[0, 1], out[0, 2] = 1 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y
    out[1, 0], out[1, 1], out[1, 2] = c * x * y + s * z, 1 - c * (x * x + z * z), c * y * z - s * x
    out[2, 0], out[2, 1], out[2, 2] = c * x * z - s * y, c * y * z + s * x, 1 - c * (x * x + y * y)


@compiled
def _product(a: Array, b: Array, out: Array) -> None:
    """``out = A B`` of 3 x 3."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@compiled
def _image(matrix: Array, table: Array, row: int) -> Vector:
    """A row of a table turned by a matrix."""
    x, y, z = table[row, 0], table[row, 1], table[row, 2]
    return (
        matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z,
        matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z,
        matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z,
    )


@compiled
def cumulated(
    first: Ints, dt_s: Array, rotation_b: Array, velocity_b: Array, position_b: Array
) -> tuple[Array, Array, Array, Array]:
    """Time, rotation, velocity and position since the start of each interval, after each of its minor ones."""
    count = len(dt_s)
    elapsed, rotation = np.empty(count), np.empty((count, 3, 3))
    velocity, position = np.empty((count, 3)), np.empty((count, 3))
    turn = np.empty((3, 3))
    for interval in range(len(first) - 1):
        t, r, v, p = 0.0, np.eye(3), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        for m in range(first[interval], first[interval + 1]):
            t += dt_s[m]
            p = _sum(_sum(p, v, dt_s[m]), _image(r, position_b, m), 1.0)
            v = _sum(v, _image(r, velocity_b, m), 1.0)
            _turn(_at(rotation_b, m), turn)
            _product(r, turn, rotation[m])
            r = rotation[m]
            elapsed[m], velocity[m], position[m] = t, v, p
    return elapsed, rotation, velocity, position


@compiled
def predicted(
    rotation_nb: Array,
    pos_n: Array,
    vel_n: Array,
    motion: tuple[Array, Array, Array, Array],
    index: Ints,
    gravity_m_s2: float,
    earth_rate_n: Array,
) -> tuple[Array, Array, Array]:
    """States after motions, see `factors.inertial.predict`; `motion` is what `cumulated` gave."""
    elapsed, turned, velocity_b, position_b = motion
    count = len(index)
    rotation, pos, vel = np.empty((count, 3, 3)), np.empty((count, 3)), np.empty((count, 3))
    earth, gravity = (earth_rate_n[0], earth_rate_n[1], earth_rate_n[2]), (0.0, 0.0, -gravity_m_s2)
    turn, half = np.empty((3, 3)), np.empty((3, 3))
    for k in range(count):
        m = index[k]
        t, v, p = elapsed[m], _at(vel_n, k), _at(pos_n, k)
        force_v, force_p = _image(rotation_nb[k], velocity_b, m), _image(rotation_nb[k], position_b, m)
        free = _sum(_sum(force_p, v, t), gravity, t**2 / 2)
        drag_v = _cross(earth, _sum(_sum(force_p, force_v, -t), free, -2.0))
        drag_p = _cross(earth, _sum(_sum(_sum((0.0, 0.0, 0.0), force_p, t), v, t**2), gravity, t**3 / 3))
        vel[k] = _sum(_sum(_sum(v, gravity, t), force_v, 1.0), drag_v, 1.0)
        pos[k] = _sum(_sum(p, free, 1.0), drag_p, -1.0)
        _turn((-earth[0] * t, -earth[1] * t, -earth[2] * t), turn)
        _product(turn, rotation_nb[k], half)
        _product(half, turned[m], rotation[k])
    return rotation, pos, vel


@compiled
def turned_further(rotation: Array, phi: Array) -> Array:
    """Rotation matrices (K, 3, 3) turned by rotation vectors (K, 3) in their own frames."""
    found, turn = np.empty(rotation.shape), np.empty((3, 3))
    for k in range(len(phi)):
        _turn(_at(phi, k), turn)
        _product(rotation[k], turn, found[k])
    return found
