"""The dense maximum-a-posteriori solution of a linear problem in the shape that `graphnav.baselines.kalman` filters.

Unknowns are the state at the start and every process noise, each in units of its own sigma; a process noise without
variance is none. Least squares of ``[u; H u - z]`` by an orthogonal factorization: nothing is inverted or squared.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from graphnav.baselines import kalman

SIZE = 19


@dataclass(frozen=True)
class Interval:
    """What happens between two keyframes: E epochs and M whitened scalar measurements.

    Attributes
    ----------
    blocks : (E, 10, 3, 3) transitions; noise : (E, 19, 19).
    rows : (M, 19), row_epoch : (M,) ascending, z : (M,): ``z = rows x + e`` after that epoch, e of unit variance.
    shift, reset : (19,) and (19, 19): in the end the state becomes ``reset (x - shift)``, as by feedback.
    """

    blocks: np.ndarray
    noise: np.ndarray
    rows: np.ndarray
    row_epoch: np.ndarray
    z: np.ndarray
    shift: np.ndarray = field(default_factory=lambda: np.zeros(SIZE))
    reset: np.ndarray = field(default_factory=lambda: np.eye(SIZE))

    def transitions(self) -> list[np.ndarray]:
        """Matrices (19, 19) of all epochs."""
        return [kalman.transition(block) for block in self.blocks]


def root(covariance: np.ndarray) -> np.ndarray:
    """S (n, r) with ``S S' = covariance``, r its rank; scaled to a correlation first, so that units do not matter."""
    scale = np.sqrt(np.diag(covariance))
    used = scale > 0
    inner = covariance[np.ix_(used, used)] / np.outer(scale[used], scale[used])
    value, vector = np.linalg.eigh(inner)
    kept = value > 1e-13
    out = np.zeros((len(covariance), int(kept.sum())))
    out[used] = scale[used, None] * vector[:, kept] * np.sqrt(value[kept])
    return out


def solve(
    prior: np.ndarray, intervals: list[Interval], mean: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Smoothed states (K+1, 19) and covariances (K+1, 19, 19) at the keyframes of K intervals.

    Parameters
    ----------
    prior : (19, 19) covariance of the state at the first keyframe; mean : (19,) its mean, zero unless given.
    """
    roots = [[root(q) for q in interval.noise] for interval in intervals]
    first = root(prior)
    count = first.shape[1] + sum(s.shape[1] for part in roots for s in part)
    offset = np.zeros(SIZE) if mean is None else mean
    # the state as an affine function of the unknowns
    state, at = np.zeros((SIZE, count)), first.shape[1]
    state[:, :at] = first
    states, offsets, rows, wanted = [state.copy()], [offset], [], []
    for interval, part in zip(intervals, roots, strict=True):
        for e, (phi, s) in enumerate(zip(interval.transitions(), part, strict=True)):
            state[:, :at] = phi @ state[:, :at]
            offset = phi @ offset
            state[:, at : at + s.shape[1]] = s
            at += s.shape[1]
            measured = interval.row_epoch == e
            rows.append(interval.rows[measured] @ state)
            wanted.append(interval.z[measured] - interval.rows[measured] @ offset)
        state[:, :at] = interval.reset @ state[:, :at]
        offset = interval.reset @ (offset - interval.shift)
        states.append(state.copy())
        offsets.append(offset)
    h, z = np.concatenate(rows), np.concatenate(wanted)
    r = np.linalg.qr(np.column_stack([np.vstack([np.eye(count), h]), np.concatenate([np.zeros(count), z])]), mode="r")
    return _at_keyframes(np.array(states), np.array(offsets), r, count)


def _at_keyframes(states: np.ndarray, offsets: np.ndarray, r: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    from scipy.linalg import solve_triangular

    unknown = solve_triangular(r[:count, :count], r[:count, count])
    spread = solve_triangular(r[:count, :count], states.reshape(-1, count).T, trans="T").T.reshape(states.shape)
    return offsets + states @ unknown, spread @ np.swapaxes(spread, 1, 2)


def filtered_and_smoothed(
    prior: np.ndarray, intervals: list[Interval], mean: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The same by `kalman.interval` and `kalman.backward`: filtered states, covariances, smoothed ones at keyframes."""
    x, p = np.zeros(SIZE) if mean is None else mean.copy(), prior.copy()
    states, covariances, maps = [x.copy()], [p.copy()], []
    for part in intervals:
        a, c, big_c = np.full((SIZE, SIZE), np.nan), np.full(SIZE, np.nan), np.full((SIZE, SIZE), np.nan)
        innovation, variance = np.empty(len(part.z)), np.empty(len(part.z))
        kalman.interval(
            part.blocks, part.noise, part.rows, part.row_epoch, part.z, x, p, innovation, variance, True, a, c, big_c
        )
        x[:], p[:], a[:] = part.reset @ (x - part.shift), part.reset @ p @ part.reset.T, part.reset @ a
        maps.append((a, c, big_c))
        states.append(x.copy())
        covariances.append(p.copy())
    adjoint, big = np.zeros(SIZE), np.zeros((SIZE, SIZE))
    smoothed, spread = [states[-1]], [covariances[-1]]
    for k in range(len(intervals) - 1, -1, -1):
        adjoint, big, change, covariance = kalman.backward(*maps[k], covariances[k], adjoint, big)
        smoothed.append(states[k] + change)
        spread.append(covariance)
    return np.array(states), np.array(covariances), np.array(smoothed[::-1]), np.array(spread[::-1])


def off(found: np.ndarray, covariances: np.ndarray, states: np.ndarray, spread: np.ndarray) -> tuple[float, float]:
    """Largest differences of states and covariances, in units of the dense solution's sigmas."""
    sigma = np.sqrt(np.diagonal(spread, axis1=1, axis2=2))
    by = sigma[:, :, None] * sigma[:, None, :]
    return float((np.abs(found - states) / sigma).max()), float((np.abs(covariances - spread) / by).max())
