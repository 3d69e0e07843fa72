"""Two-speed strapdown integration: coning- and sculling-compensated increments over several IMU samples.

P. Savage, "Strapdown Inertial Navigation Integration Algorithm Design", J. Guidance 21 (1998), parts 1-2: a fast
loop composes rotation and velocity increments over a minor interval, a slow loop (GTSAM's preintegration) takes
them as one sample. Offline the slopes of rate and force within a sample are known from both neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.so3 import Array


@dataclass(frozen=True)
class Samples:
    """IMU samples; row k is the mean over ``(edge_s[k], edge_s[k+1]]``.

    Attributes
    ----------
    edge_s : (N+1,) interval bounds, s.
    gyro_b : (N, 3) mean angular rate, rad/s.
    accel_b : (N, 3) mean specific force, m/s^2.
    """

    edge_s: Array
    gyro_b: Array
    accel_b: Array

    def block(self, start_s: float, end_s: float) -> Samples:
        """The samples that cover a span, with one neighbour on either side for the slopes; views, no copies."""
        edge = self.edge_s
        lo = max(int(np.searchsorted(edge, start_s + 1e-6)) - 2, 0)
        hi = min(int(np.searchsorted(edge, end_s - 1e-6)) + 1, len(edge) - 1)
        return Samples(edge[lo : hi + 1], self.gyro_b[lo:hi], self.accel_b[lo:hi])

    def mean_rate(self, start_s: float, end_s: float) -> Array:
        """Mean angular rate (3,) over a span, samples at its ends by the part that lies within it, rad/s."""
        part = self.block(start_s, end_s)
        inside = np.clip(part.edge_s, start_s, end_s)
        return np.asarray(np.diff(inside) @ part.gyro_b / (end_s - start_s))


@dataclass(frozen=True)
class Increments:
    """Compensated increments over minor intervals, grouped by the intervals they were asked for.

    Attributes
    ----------
    first : (K+1,) minor intervals ``first[k]:first[k+1]`` make up interval k.
    dt_s : (M,) durations, s.
    rotation_b : (M, 3) rotation vector from the start to the end of the minor interval, rad.
    velocity_b : (M, 3) integral of specific force in the body frame at its start, m/s.
    position_b : (M, 3) its double integral, m.
    """

    first: npt_int
    dt_s: Array
    rotation_b: Array
    velocity_b: Array
    position_b: Array


npt_int = np.ndarray[tuple[int, ...], np.dtype[np.int64]]


def slopes(samples: Samples) -> tuple[Array, Array]:
    """Time derivatives of rate and force in every sample by central differences, each (N, 3)."""
    middle = (samples.edge_s[1:] + samples.edge_s[:-1]) / 2
    if len(middle) < 2:
        return np.zeros_like(samples.gyro_b), np.zeros_like(samples.accel_b)
    lo = np.maximum(np.arange(len(middle)) - 1, 0)
    hi = np.minimum(np.arange(len(middle)) + 1, len(middle) - 1)
    span = (middle[hi] - middle[lo])[:, None]
    return (samples.gyro_b[hi] - samples.gyro_b[lo]) / span, (samples.accel_b[hi] - samples.accel_b[lo]) / span


def compensated_increments(
    samples: Samples,
    boundaries_s: Array,
    minor_s: float,
    gyro_bias_b: Array | None = None,
    accel_bias_b: Array | None = None,
) -> Increments:
    """Increments over minor intervals of about `minor_s` between successive boundaries.

    Parameters
    ----------
    samples : IMU samples that cover the boundaries.
    boundaries_s : (K+1,) ascending times (keyframes); a boundary inside a sample splits it.
    minor_s : longest minor interval wanted, s; at least one sample long.
    gyro_bias_b, accel_bias_b : (3,) or (K, 3) biases removed before compensation (rad/s, m/s^2).

    Returns
    -------
    Increments, with K groups.

    Notes
    -----
    Over a piece of length h with rate w, force f and slopes w', f' the increments are
    ``dtheta = w h + w x w' h^3/12`` (coning),
    ``dv = (I + h/2 w x + h^2/6 (w x)^2) f h + (w x f' + f x w') h^3/12`` (rotation and sculling) and
    ``dp = f h^2/2 + w x f h^3/6 - f' h^3/12`` (scrolling); pieces are composed exactly.
    """
    edge, row, interval = _pieces(samples.edge_s, np.asarray(boundaries_s, float))
    first_piece, first = _group(edge, interval, len(boundaries_s) - 1, minor_s)
    h = np.diff(edge)[:, None]
    gyro_slope, accel_slope = slopes(samples)
    offset = ((edge[1:] + edge[:-1] - samples.edge_s[row] - samples.edge_s[row + 1]) / 2)[:, None]
    w_dot, f_dot = gyro_slope[row], accel_slope[row]
    w = samples.gyro_b[row] + w_dot * offset - _per_interval(gyro_bias_b, interval)
    f = samples.accel_b[row] + f_dot * offset - _per_interval(accel_bias_b, interval)
    w_f = _cross(w.T, f.T).T
    cube = h**3 / 12
    angle = w * h + _cross(w.T, w_dot.T).T * cube
    velocity = (f + w_f * h / 2 + _cross(w.T, w_f.T).T * h**2 / 6) * h
    velocity += (_cross(w.T, f_dot.T) + _cross(f.T, w_dot.T)).T * cube
    position = f * h**2 / 2 + w_f * h**3 / 6 - f_dot * cube
    turned, total_v, total_p = _composed(first_piece, h[:, 0], angle, velocity, position)
    return Increments(first, edge[first_piece[1:]] - edge[first_piece[:-1]], turned, total_v, total_p)


def _composed(
    first_piece: npt_int, h: Array, angle: Array, velocity: Array, position: Array
) -> tuple[Array, Array, Array]:
    """Rotation vectors, velocities and positions of runs of pieces; components first, for speed."""
    lengths = np.diff(first_piece)
    count = len(lengths)
    quat = np.zeros((4, count))
    quat[0] = 1.0
    total_v, total_p = np.zeros((3, count)), np.zeros((3, count))
    pieces = _half_angle_quaternion(angle.T)
    for step in range(int(lengths.max(initial=0))):
        run = slice(None) if step < lengths.min() else np.flatnonzero(lengths > step)
        piece = first_piece[:-1][run] + step
        q = quat[:, run]
        total_p[:, run] += total_v[:, run] * h[piece] + _rotated(q, position[piece].T)
        total_v[:, run] += _rotated(q, velocity[piece].T)
        quat[:, run] = _product(q, pieces[:, piece])
    return _rotation_vector(quat).T, np.ascontiguousarray(total_v.T), np.ascontiguousarray(total_p.T)


def _cross(a: Array, b: Array) -> Array:
    """Cross products of vectors (3, N)."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _half_angle_quaternion(phi: Array) -> Array:
    """Quaternions (4, N), w first, of rotation vectors (3, N)."""
    angle = np.sqrt((phi * phi).sum(axis=0))
    return np.concatenate([np.cos(angle / 2)[None], phi * (np.sinc(angle / (2 * np.pi)) / 2)])


def _product(a: Array, b: Array) -> Array:
    """Hamilton products (4, N)."""
    return np.stack(
        [
            a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
            a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
            a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
            a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
        ]
    )


def _rotated(quat: Array, v: Array) -> Array:
    """Vectors (3, N) turned by quaternions (4, N)."""
    twice = 2 * _cross(quat[1:], v)
    return np.asarray(v + quat[0] * twice + _cross(quat[1:], twice))


def _rotation_vector(quat: Array) -> Array:
    """Rotation vectors (3, N) of unit quaternions (4, N) up to half a turn."""
    quat = np.where(quat[0] < 0, -quat, quat)
    sine = np.sqrt((quat[1:] ** 2).sum(axis=0))
    angle = 2 * np.arctan2(sine, quat[0])
    tiny = sine < 1e-12
    return np.asarray(quat[1:] * np.where(tiny, 2.0, angle / np.where(tiny, 1.0, sine)))


def _per_interval(bias: Array | None, interval: npt_int) -> Array:
    if bias is None:
        return np.zeros(3)
    bias = np.asarray(bias, float)
    return bias if bias.ndim == 1 else bias[interval]


def _pieces(edges: Array, boundaries: Array) -> tuple[Array, npt_int, npt_int]:
    """Merged grid of sample edges and boundaries: its edges, the sample and the interval of every piece."""
    tolerance = 1e-6
    if boundaries[0] < edges[0] - tolerance or boundaries[-1] > edges[-1] + tolerance:
        raise ValueError(
            f"boundaries {boundaries[0]:.6f}..{boundaries[-1]:.6f} s"
            f" outside the samples {edges[0]:.6f}..{edges[-1]:.6f} s"
        )
    inside = edges[(edges > boundaries[0]) & (edges < boundaries[-1])]
    near = np.clip(np.searchsorted(boundaries, inside), 1, len(boundaries) - 1)
    apart = np.minimum(np.abs(inside - boundaries[near]), np.abs(inside - boundaries[near - 1]))
    merged = np.sort(np.concatenate([inside[apart > tolerance], boundaries]))
    middle = (merged[1:] + merged[:-1]) / 2
    row = np.clip(np.searchsorted(edges, middle) - 1, 0, len(edges) - 2)
    # by the start of the piece, which is exact however short the interval: its middle may round to a boundary
    interval = np.searchsorted(boundaries, merged[:-1], side="right") - 1
    return merged, row, interval


def _group(edge: Array, interval: npt_int, count: int, minor_s: float) -> tuple[npt_int, npt_int]:
    """Split every interval's pieces into runs of about `minor_s`: piece bounds of the runs, run bounds of intervals."""
    start = edge[:-1][np.searchsorted(interval, np.arange(count))]
    end = edge[1:][np.searchsorted(interval, np.arange(count), side="right") - 1]
    runs = np.maximum(1, np.ceil((end - start) / minor_s - 1e-6))
    middle = (edge[1:] + edge[:-1]) / 2
    position = (middle - start[interval]) / (end - start)[interval]
    run = np.minimum(np.floor(position * runs[interval]), runs[interval] - 1).astype(np.int64)
    new = np.flatnonzero(np.diff(interval, prepend=-1) + np.abs(np.diff(run, prepend=-1)) != 0)
    first_piece = np.append(new, len(run))
    first = np.searchsorted(interval[new], np.arange(count + 1))
    return first_piece, first
