"""Position of a tag from ranges to known anchors: closed-form start, then nonlinear least squares, epochs all at once.

The closed form subtracts the mean of the squared ranges (the usual linearized differences, as in the squared form of
Cao et al. (2023), equation 15, without a first estimate), in the principal axes of the anchors. Along an axis in which
the anchors hardly spread it is worthless; there the mean squared range itself gives the distance from their plane, on
one side or the other. Least squares starts from both sides, and the better of the two minima is the position; where
the ranges cannot tell them apart, that is told. Two-way ranges have no clock: GDOP and PDOP are the same.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from factors.so3 import Array
from graphnav.errors import GraphnavError

Mask = npt.NDArray[np.bool_]

#: Anchors whose spread across their plane (or line) is below this share of the largest spread lie in it.
FLAT = 1e-3
#: Squared residuals (in sigmas) by which one side must beat the other: chance picks the wrong one in 1 of 600 epochs.
_TOLD_APART = 9.0
#: Information of a direction that nothing determines, 1/m^2: a sigma of 1000 m, which the log format calls unknown.
_NOTHING = 1e-6
_ITERATIONS, _STEP_M = 60, 1e-6


@dataclass(frozen=True, eq=False)
class Fix:
    """Positions of a tag with their uncertainty; leading axis the epochs (E), or none for a single one.

    Attributes
    ----------
    pos_n : (..., 3) m; cov : (..., 3, 3) m^2, first order.
    residual_m : (..., A) measured less computed ranges; NaN where there is no range.
    cost : (...,) squared residuals in sigmas.
    mirror_n : (..., 3) the other minimum, on the far side of the anchors' plane; where there is one minimum alone it
        is that; mirror_cost : (...,) its cost.
    ambiguous : (...,) whether the ranges cannot tell the two apart and `near_n` was not given to choose.
    pdop, hdop, vdop : (...,) sigma of position, of east and north, and of height for ranges of 1 m sigma each.
    converged : (...,) whether the iterations came to rest.
    """

    pos_n: Array
    cov: Array
    residual_m: Array
    cost: Array
    mirror_n: Array
    mirror_cost: Array
    ambiguous: Mask
    pdop: Array
    hdop: Array
    vdop: Array
    converged: Mask

    @property
    def gdop(self) -> Array:
        """(...,) the same as `pdop`: ranges have no clock to solve for."""
        return self.pdop

    def __getitem__(self, epochs: object) -> Fix:
        """Some of the epochs, or one."""
        return Fix(**{name: value[epochs] for name, value in vars(self).items()})


def fix(anchors_n: Array, ranges_m: Array, sigma: Array | float, near_n: Array | None = None) -> Fix:
    """Position from one epoch of ranges.

    Parameters
    ----------
    anchors_n : (A, 3) m; ranges_m : (A,) m, NaN where there is none; sigma : of a range, m, scalar or (A,).
    near_n : (3,) roughly where the tag is, to choose a side by where the ranges cannot.

    Raises
    ------
    GraphnavError : fewer than three anchors, or anchors on one line.
    """
    return fixes(anchors_n, np.atleast_2d(ranges_m), sigma, near_n)[0]


def fixes(
    anchors_n: Array, ranges_m: Array, sigma: Array | float, near_n: Array | None = None, *, nearest: bool = False
) -> Fix:
    """Positions from many epochs of ranges at once.

    Parameters
    ----------
    anchors_n : (A, 3) m; ranges_m : (E, A) m, NaN where there is none.
    sigma : of a range, m; scalar, (A,) or (E, A). near_n : (3,) or (E, 3), as in `fix`.
    nearest : whether the minimum nearest to `near_n` is taken, the better one or not.

    Raises
    ------
    GraphnavError : an epoch with fewer than three anchors, or with all of its anchors on one line.
    """
    anchors, ranges = np.asarray(anchors_n, float), np.asarray(ranges_m, float)
    there = np.isfinite(ranges)
    weight = np.where(there, 1 / np.broadcast_to(np.asarray(sigma, float), ranges.shape) ** 2, 0.0)
    ranges = np.where(there, ranges, 0.0)
    axes, spread = _principal_axes(anchors, there)
    _refuse(there.sum(axis=1), spread)
    minima = [_least_squares(start, anchors, ranges, weight) for start in _starts(anchors, ranges, there, axes, spread)]
    return _chosen(minima, anchors, ranges, weight, near_n, nearest)


def usable(anchors_n: Array, there: Mask) -> Mask:
    """(E,) whether the anchors of an epoch determine a position: three at least, and not on one line.

    Parameters
    ----------
    anchors_n : (A, 3); there : (E, A) which of them have a range.
    """
    _, spread = _principal_axes(np.asarray(anchors_n, float), there)
    return np.asarray((there.sum(axis=1) >= 3) & (spread[:, 1] > FLAT * spread[:, 0]))


def coplanar(anchors_n: Array) -> bool:
    """Whether anchors (A, 3) lie in one plane, so that ranges leave two mirrored positions."""
    anchors = np.asarray(anchors_n, float)
    _, spread = _principal_axes(anchors, np.ones((1, len(anchors)), bool))
    return bool(spread[0, 2] <= FLAT * spread[0, 0])


def _principal_axes(anchors: Array, there: Mask) -> tuple[Array, Array]:
    """Principal axes (E, 3, 3) in columns and spread along them (E, 3), largest first, of each epoch's anchors."""
    share = there / np.maximum(there.sum(axis=1, keepdims=True), 1)
    apart = anchors - (share @ anchors)[:, None]
    scatter = np.einsum("ea,eai,eaj->eij", share, apart, apart)
    value, vector = np.linalg.eigh(scatter)
    return vector[..., ::-1], np.sqrt(np.maximum(value[..., ::-1], 0.0))


def _refuse(count: npt.NDArray[np.int_], spread: Array) -> None:
    if (count < 3).any():
        raise GraphnavError(f"ranges to {count.min()} anchors, a position needs 3 at least, and 4 to be unique")
    if (spread[:, 1] <= FLAT * spread[:, 0]).any():
        raise GraphnavError("the anchors lie on one line: their ranges leave a circle of positions; add one beside it")


def _starts(anchors: Array, ranges: Array, there: Mask, axes: Array, spread: Array) -> list[Array]:
    """Closed form, on both sides of the anchors' plane (E, 3) each.

    In the principal axes about the anchors' mean, b_i the anchors: ``r_i^2 - |b_i|^2 = |q|^2 - 2 b_i q``. Less the mean
    over the anchors it is linear in q; the mean itself is ``|q|^2``.
    """
    share = there / there.sum(axis=1, keepdims=True)
    middle = share @ anchors
    b = np.einsum("eai,eij->eaj", anchors - middle[:, None], axes)
    known = ranges**2 - np.sum(b * b, axis=-1)
    square = np.sum(share * known, axis=1)
    # the axes are principal: each coordinate of q is found by itself
    q = -0.5 * np.einsum("ea,eaj,ea->ej", share, b, known - square[:, None]) / np.maximum(spread, 1e-12) ** 2
    height = np.sqrt(np.maximum(square - q[:, 0] ** 2 - q[:, 1] ** 2, (0.01 * spread[:, 0]) ** 2))
    sides = []
    for sign in (1.0, -1.0):
        q[:, 2] = sign * height
        sides.append(middle + np.einsum("eij,ej->ei", axes, q))
    return sides


def _residual(pos: Array, anchors: Array, ranges: Array) -> tuple[Array, Array]:
    """Measured less computed ranges (E, A), and the directions from the anchors to the tag (E, A, 3)."""
    apart = pos[:, None] - anchors
    distance = np.linalg.norm(apart, axis=-1)
    return ranges - distance, apart / np.maximum(distance, 1e-9)[..., None]


def _least_squares(pos: Array, anchors: Array, ranges: Array, weight: Array) -> tuple[Array, Array, Mask]:
    """Levenberg-Marquardt from a start (E, 3): positions, costs and whether they came to rest."""
    damping, settled = np.full(len(pos), 1e-3), np.zeros(len(pos), bool)
    error, direction = _residual(pos, anchors, ranges)
    cost = np.sum(weight * error**2, axis=1)
    for _ in range(_ITERATIONS):
        information = np.einsum("ea,eai,eaj->eij", weight, direction, direction)
        gradient = np.einsum("ea,eai,ea->ei", weight, direction, error)
        level = damping * np.trace(information, axis1=1, axis2=2) / 3
        step = np.linalg.solve(information + level[:, None, None] * np.eye(3), gradient[..., None])[..., 0]
        trial_error, trial_direction = _residual(pos + step, anchors, ranges)
        trial = np.sum(weight * trial_error**2, axis=1)
        better = trial <= cost
        settled |= np.linalg.norm(step, axis=1) < _STEP_M
        pos = np.where(better[:, None], pos + step, pos)
        error, cost = np.where(better[:, None], trial_error, error), np.where(better, trial, cost)
        direction = np.where(better[:, None, None], trial_direction, direction)
        damping = np.clip(np.where(better, damping / 5, damping * 4), 1e-12, 1e6)
        if settled.all():
            break
    return pos, cost, settled


def _chosen(
    minima: list[tuple[Array, Array, Mask]],
    anchors: Array,
    ranges: Array,
    weight: Array,
    near_n: Array | None,
    nearest: bool,
) -> Fix:
    """The better minimum of each epoch, or the nearer one where both are as good."""
    (first, cost_1, rest_1), (second, cost_2, rest_2) = minima
    same = np.linalg.norm(first - second, axis=1) < 1e-3
    alike = ~same & (np.abs(cost_1 - cost_2) < _TOLD_APART)
    take_second = cost_2 < cost_1
    if near_n is not None:
        apart_1, apart_2 = (np.linalg.norm(pos - near_n, axis=1) for pos in (first, second))
        take_second = np.where(alike | nearest, apart_2 < apart_1, take_second)
    pos, mirror = np.where(take_second[:, None], second, first), np.where(take_second[:, None], first, second)
    error, direction = _residual(pos, anchors, ranges)
    there = weight > 0
    dop = np.diagonal(
        _inverse(np.einsum("ea,eai,eaj->eij", there.astype(float), direction, direction)), axis1=1, axis2=2
    )
    return Fix(
        pos_n=pos,
        cov=_inverse(np.einsum("ea,eai,eaj->eij", weight, direction, direction)),
        residual_m=np.where(there, error, np.nan),
        cost=np.where(take_second, cost_2, cost_1),
        mirror_n=mirror,
        mirror_cost=np.where(take_second, cost_1, cost_2),
        ambiguous=alike & (near_n is None),
        pdop=np.sqrt(dop.sum(axis=1)),
        hdop=np.sqrt(dop[:, :2].sum(axis=1)),
        vdop=np.sqrt(dop[:, 2]),
        converged=np.where(take_second, rest_2, rest_1),
    )


def _inverse(information: Array) -> Array:
    """Covariances of information matrices (E, 3, 3); what nothing determines is unknown, not infinite."""
    value, vector = np.linalg.eigh(information)
    return np.asarray((vector / np.maximum(value, _NOTHING)[:, None, :]) @ np.swapaxes(vector, 1, 2))
