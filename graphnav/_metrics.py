"""Error measures on plain arrays: NEES, alignment, relative pose errors, truth at other times."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from graphnav._schema import Array
from graphnav.errors import GraphnavError, LogError
from graphnav.log import Truth

Indices = npt.NDArray[np.intp]

_RPE_DISTANCES_M = (10.0, 100.0, 1000.0)
_RPE_TOLERANCE = 0.1  # a pair may be this fraction longer or shorter than the stated length
_TOLD_SIGMAS = 3.0
_ROUNDING = 1e-12  # of a coordinate: a path made straight
_SLACK = 1e-6  # s or m: times that were rounded to microseconds still meet


@dataclass(frozen=True)
class RelativePoseError:
    """Error of relative poses between keyframes a fixed distance (m) or time (s) apart.

    Every keyframe that far from the end starts one pair, with the keyframe nearest to `delta` ahead of it, if
    that is within 10 %.
    """

    delta: float
    unit: str
    pairs: int
    translation_rms_m: float | None
    rotation_rms_deg: float | None

    def to_dict(self) -> dict[str, Any]:
        """JSON object; the unit of the spacing is in its key."""
        return {
            f"delta_{self.unit}": self.delta,
            "pairs": self.pairs,
            "translation_rms_m": self.translation_rms_m,
            "rotation_rms_deg": self.rotation_rms_deg,
        }


def truth_at(truth: Truth, t_s: Array) -> tuple[npt.NDArray[np.bool_], Array, Array]:
    """Truth at given times, where it is known: `truth_states` without the velocities."""
    known, pos, quat, _ = truth_states(truth, t_s)
    return known, pos, quat


def truth_states(truth: Truth, t_s: Array) -> tuple[npt.NDArray[np.bool_], Array, Array, Array]:
    """Truth at given times, where it is known.

    A gap counts as unknown when it is longer than five median steps and than one second.

    Parameters
    ----------
    truth : reference trajectory; without velocities their central differences serve for the interpolation.
    t_s : (N,) times.

    Returns
    -------
    known : (N,) bool, the M times that truth covers.
    pos_n : (M, 3) m.
    quat_nb : (M, 4) w, x, y, z.
    vel_n : (M, 3) m/s, the derivative of the interpolated positions.
    """
    from scipy.spatial.transform import Rotation

    times = truth.t_s
    if len(times) < 2:
        raise LogError("1 row, expected at least 2 to interpolate between", where="table truth")
    left = np.clip(np.searchsorted(times, t_s, side="right") - 1, 0, len(times) - 2)
    step = times[left + 1] - times[left]
    into, rest = t_s - times[left], times[left + 1] - t_s
    whole = step <= max(5 * float(np.median(np.diff(times))), 1.0)
    inside = (into >= -_SLACK) & (rest >= -_SLACK)
    known = inside & (whole | (into <= _SLACK) | (rest <= _SLACK))
    left, step = left[known], step[known]
    u = np.clip(into[known] / step, 0.0, 1.0)
    vel = truth.vel_n_m_s
    if vel is None:
        vel = np.gradient(truth.pos_n_m, times, axis=0, edge_order=2 if len(times) > 2 else 1)
    pos, moving = _hermite(u, step, truth.pos_n_m[left], truth.pos_n_m[left + 1], vel[left], vel[left + 1])
    start = Rotation.from_quat(truth.quat_nb[left], scalar_first=True)
    turn = (start.inv() * Rotation.from_quat(truth.quat_nb[left + 1], scalar_first=True)).as_rotvec()
    quat = (start * Rotation.from_rotvec(u[:, None] * turn)).as_quat(scalar_first=True)
    return known, pos, np.asarray(quat), moving


def nees(error: Array, cov: Array, t_s: Array) -> float | None:
    """Mean of ``e' P^-1 e / 3``; None when no covariance is known.

    Parameters
    ----------
    error : (N, 3).
    cov : (N, 3, 3) in the same axes, NaN where unknown.
    t_s : (N,) times, for the message when a covariance is not positive definite.
    """
    known = np.isfinite(cov).all(axis=(1, 2))
    if not known.any():
        return None
    smallest = np.linalg.eigvalsh(cov[known])[:, 0]
    if smallest.min() <= 0:
        when = t_s[known][int(np.argmin(smallest))]
        raise GraphnavError(f"covariance at {when:.3f} s is not positive definite (eigenvalue {smallest.min():.3g})")
    weighted = np.linalg.solve(cov[known], error[known][:, :, None])[:, :, 0]
    return float(np.mean(np.sum(error[known] * weighted, axis=1)) / 3)


def nees_axes(error: Array, cov: Array) -> tuple[float, ...] | None:
    """Mean of ``e^2 / sigma^2`` for each axis on its own; None when no covariance is known."""
    variance = np.diagonal(cov, axis1=1, axis2=2)
    known = np.isfinite(variance).all(axis=1)
    return tuple(np.mean(error[known] ** 2 / variance[known], axis=0).tolist()) if known.any() else None


def align(pos: Array, onto: Array) -> Array:
    """`pos` (N, 3) moved rigidly (rotation and translation, no scale) to fit `onto` best (Umeyama 1991)."""
    rotation, shift = alignment(pos, onto)
    return pos @ rotation.T + shift


def alignment(pos: Array, onto: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) and translation (3,) that move `pos` (N, 3) to fit `onto` best."""
    centre, target = pos.mean(axis=0), onto.mean(axis=0)
    u, _, vt = np.linalg.svd((onto - target).T @ (pos - centre))
    reflect = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = u @ reflect @ vt
    return rotation, target - rotation @ centre


def turns_about_line(pos: Array, onto: Array) -> bool:
    """Whether positions say how a path is turned about its own straight line: `pos` (N, 3) aligned, `onto` truth.

    With offsets of rms r from the line and errors of rms e across it, the best turn about it is off by about e / r rad.
    Where r is below three sigmas of these errors, it is no more than a fit of them.
    """
    centred = onto - onto.mean(axis=0)
    spread, axes = np.linalg.svd(centred, full_matrices=False)[1:]
    beside = float(np.hypot(*spread[1:])) if len(spread) > 2 else 0.0
    error = pos - onto
    across = float(np.linalg.norm(error - np.outer(error @ axes[0], axes[0])))
    rounding = _ROUNDING * float(np.linalg.norm(onto))
    return beside > max(_TOLD_SIGMAS * across, rounding)


def resolved_distance(travelled: Array) -> float:
    """The first standard distance that the keyframes' spacing while moving resolves."""
    steps = np.diff(travelled)
    spacing = float(np.percentile(steps, 95)) if len(steps) else 0.0
    return next((d for d in _RPE_DISTANCES_M if spacing <= 2 * _RPE_TOLERANCE * d), _RPE_DISTANCES_M[-1])


def relative_error(
    along: Array, delta: float, unit: str, pos: Array, quat: Array, pos_true: Array, quat_true: Array
) -> RelativePoseError:
    """Relative pose error between keyframes `delta` apart along `along` (N,), path length or time.

    Poses are positions (N, 3) and quaternions (N, 4), estimate first.
    """
    from scipy.spatial.transform import Rotation

    i, j = _pairs(along, delta) if len(along) > 1 else (np.arange(0), np.arange(0))
    if len(i) == 0:
        return RelativePoseError(delta, unit, 0, None, None)
    moves, turns = [], []
    for p, q in ((pos, quat), (pos_true, quat_true)):
        back = Rotation.from_quat(q[i], scalar_first=True).inv()
        moves.append(back.apply(p[j] - p[i]))
        turns.append(back * Rotation.from_quat(q[j], scalar_first=True))
    angle = (turns[1].inv() * turns[0]).magnitude()
    # The norm of the translation of (truth step)^-1 (estimated step): rotating by the truth's turn keeps it.
    return RelativePoseError(
        delta, unit, len(i), rms_norm(moves[0] - moves[1]), float(np.rad2deg(np.sqrt(np.mean(angle**2))))
    )


def _pairs(along: Array, delta: float) -> tuple[Indices, Indices]:
    """Indices (i, j), j the keyframe ahead of i whose spacing along `along` is nearest to `delta`."""
    first = np.arange(len(along))
    beyond = np.clip(np.searchsorted(along, along + delta), 1, len(along) - 1)
    nearer = np.abs(along[beyond - 1] - along - delta) < np.abs(along[beyond] - along - delta)
    second = beyond - nearer
    reached = along + delta <= along[-1] + _SLACK
    good = reached & (second > first) & (np.abs(along[second] - along - delta) <= _RPE_TOLERANCE * delta)
    return first[good], second[good]


def _hermite(u: Array, step: Array, p0: Array, p1: Array, v0: Array, v1: Array) -> tuple[Array, Array]:
    """The cubic that meets both positions and velocities, and its time derivative."""
    u, step = u[:, None], step[:, None]
    rise = u * u * (3 - 2 * u)
    pos = p0 + rise * (p1 - p0) + step * u * (1 - u) * ((1 - u) * v0 - u * v1)
    vel = 6 * u * (1 - u) * (p1 - p0) / step + (1 - u) * (1 - 3 * u) * v0 + u * (3 * u - 2) * v1
    return pos, vel


def attitude_error(quat: Array, quat_true: Array) -> Array:
    """Return ``Log(R_true^T R_estimate)``, (N, 3) rad in body axes."""
    from scipy.spatial.transform import Rotation

    truth, estimate = (Rotation.from_quat(q, scalar_first=True) for q in (quat_true, quat))
    return np.asarray((truth.inv() * estimate).as_rotvec())


def rms(values: Array) -> Array:
    """Root mean square down the rows."""
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def rms_norm(values: Array) -> float:
    """Root mean square of the rows' norms."""
    return float(np.sqrt(np.mean(np.sum(values**2, axis=1))))


def largest(values: Array) -> Array:
    """Largest absolute value down the rows."""
    return np.asarray(np.abs(values).max(axis=0))
