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
    return _slope(samples.gyro_b, middle), _slope(samples.accel_b, middle)


def _slope(values: Array, t_s: Array) -> Array:
    """From the neighbour before to the one after; at either end from the one there is."""
    found = np.empty(values.shape)
    found[1:-1] = (values[2:] - values[:-2]) / (t_s[2:] - t_s[:-2])[:, None]
    found[0] = (values[1] - values[0]) / (t_s[1] - t_s[0])
    found[-1] = (values[-1] - values[-2]) / (t_s[-1] - t_s[-2])
    return found


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
    from factors.composition import composed

    edge, row, interval = _pieces(samples.edge_s, np.asarray(boundaries_s, float))
    count = len(boundaries_s) - 1
    first_piece, first = _group(edge, interval, count, minor_s)
    # copies: a table that must not be written to would be compiled for anew
    gyro_b, accel_b = (np.array(each, float) for each in (samples.gyro_b, samples.accel_b))
    middle_s = (samples.edge_s[:-1] + samples.edge_s[1:]) / 2
    biases = (_per_interval(bias, count) for bias in (gyro_bias_b, accel_bias_b))
    found = composed(edge, row, interval, first_piece, middle_s, (gyro_b, accel_b, *slopes(samples)), *biases)
    turned, velocity, position = (np.ascontiguousarray(part) for part in np.split(found, 3, axis=1))
    return Increments(first, edge[first_piece[1:]] - edge[first_piece[:-1]], turned, velocity, position)


def _per_interval(bias: Array | None, count: int) -> Array:
    found = np.zeros(3) if bias is None else np.asarray(bias, float)
    return np.array(np.broadcast_to(found, (count, 3)))


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
