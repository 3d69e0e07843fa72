"""Where the machine has moved to between two sights of the same wall: ICP, and what is known of its result.

Source: Zheng et al., "A LiDAR-aided inertial positioning approach for a longwall shearer", equation 8:
``L1 = R L2 + T``. Open3D's point-to-plane ICP with a robust kernel finds R and T from a rough start. The last steps
are taken here: each beam weighs what its own noise says, the turn and the shift to the right are tied to what the
trajectory knows of them, and the curvature at the end gives the covariance. The shift forward is the wall's alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from graphnav._schema import Array
from graphnav.errors import GraphnavError
from graphnav.frontends._open3d import open3d

#: A wall is followed from beam to beam over no more than this.
_GAP_M = 0.3
#: Spacing of the points that Open3D is given of a wall, and the height of the second row of them above the first.
_FILL_M, _HEIGHT_M = 0.01, 1.0
#: Distances (m) over which ICP pairs points, from the start to the end.
_REACHES_M = (0.3, 0.1, 0.05)
#: Tukey's constant: 95 % efficient for normal errors.
_TUKEY = 4.685
_STEPS = 30
#: Fewest beams of one sight on the wall of the other.
FEWEST = 10
#: A straight wall seems to tell of a motion along it, by the noise of its beams; that may make the variance forward
#: seem smaller by no more than this.
_SEEMING = 1.5


@dataclass(frozen=True)
class Expected:
    """What the trajectory tells of the motion between the sights.

    Attributes
    ----------
    shift_m : ``(2,)`` right and forward; forward it is no more than the start, and must be right within `_REACHES_M`.
    right_sigma_m : 1-sigma of the shift to the right, which a straight wall does not tell.
    turn_sigma_rad : 1-sigma of the turn, whose expectation is zero.
    """

    shift_m: Array
    right_sigma_m: float
    turn_sigma_rad: float

    @property
    def information(self) -> Array:
        """``(3, 3)`` of shift and turn."""
        return np.diag([self.right_sigma_m**-2, 0.0, self.turn_sigma_rad**-2])


@dataclass(frozen=True)
class Registration:
    """Where the second sight was taken from, as seen from the first.

    Attributes
    ----------
    shift_m : ``(2,)`` T of equation 8: right and forward, in the axes of the points.
    turn_rad : R of equation 8, counter-clockwise.
    cov : ``(3, 3)`` of shift (m) and turn (rad) from the beams' noise alone: an error of what was expected is no
        noise of these sights, and is for the caller to add.
    matched : beams of the second sight on the wall of the first.
    residual : rms of their distance from it, in their own sigmas; above 1 the covariance allows for it.
    """

    shift_m: Array
    turn_rad: float
    cov: Array
    matched: int
    residual: float


@dataclass(frozen=True)
class Sight:
    """Points of a wall, in the order of the beams.

    Attributes
    ----------
    points_m : ``(N, 2)`` right and forward; sigma_m : ``(N,)`` of each.
    """

    points_m: Array
    sigma_m: Array


def register(first: Sight, second: Sight, expected: Expected) -> Registration:
    """Align the second sight of a wall with the first.

    Parameters
    ----------
    first, second : the sights, in axes that are parallel but for the turn.
    expected : what the trajectory tells of it.

    Raises
    ------
    GraphnavError
        Too little of the wall is seen from both places, or it does not tell the shift forward.
    """
    return refined(first, second, icp(first, second, expected.shift_m), expected)


def icp(first: Sight, second: Sight, predicted_m: Array) -> Array:
    """Shift and turn ``(3,)`` by Open3D's point-to-plane ICP with Tukey's kernel.

    The section of an upright wall is put in two rows, one above the other: with its normals level they hold every
    motion but the one up and down, of which nothing is asked.
    """
    o3d = open3d()
    registration = o3d.pipelines.registration
    wall, normals = _filled(first.points_m)
    source, target = _cloud(o3d, second.points_m), _cloud(o3d, wall, normals)
    pose = np.eye(4)
    pose[:2, 3] = predicted_m
    criteria = registration.ICPConvergenceCriteria(1e-9, 1e-9, 100)
    for reach_m in _REACHES_M:
        kernel = registration.TukeyLoss(reach_m)
        method = registration.TransformationEstimationPointToPlane(kernel)
        pose = registration.registration_icp(source, target, reach_m, pose, method, criteria).transformation
    return np.array([pose[0, 3], pose[1, 3], np.arctan2(pose[1, 0], pose[0, 0])])


def refined(first: Sight, second: Sight, start: Array, expected: Expected) -> Registration:
    """Gauss-Newton from a start ``(3,)`` near by: distances of the second sight's points from the first's wall.

    Raises
    ------
    GraphnavError
        Too little of the wall is seen from both places, or it does not tell the shift forward.
    """
    state, prior = np.asarray(start, float), expected.information
    mean = np.array([expected.shift_m[0], 0.0, 0.0])
    for _ in range(_STEPS):
        pairs = _distances(first, second, state)
        matrix, white = pairs.by_state, pairs.distance_m / pairs.sigma_m
        scale = max(1.0, 1.4826 * float(np.median(np.abs(white))))
        weight = np.clip(1 - (white / (_TUKEY * scale)) ** 2, 0.0, None) ** 2
        share = weight / pairs.sigma_m**2
        beams = (matrix * share[:, None]).T @ matrix
        _require_told(beams, prior, pairs, share)
        step = np.linalg.solve(beams + prior, matrix.T @ (share * pairs.distance_m) + prior @ (state - mean))
        state = state - step
        if np.abs(step).max() < 1e-9:
            break
    spread = float(np.sqrt((weight * white**2).sum() / max(weight.sum() - 2, 1.0)))
    gain = np.linalg.inv(beams + prior)
    cov = max(spread**2, 1.0) * gain @ beams @ gain
    return Registration(state[:2], float(state[2]), cov, int((weight > 0).sum()), spread)


def _require_told(beams: Array, prior: Array, pairs: _Pairs, share: Array) -> None:
    """Refuse a wall that tells the shift forward only by the noise in the direction of its pieces."""
    seeming = np.zeros((3, 3))
    seeming[:2, :2] = (pairs.along * (share * pairs.tilt_sigma_rad**2)[:, None]).T @ pairs.along
    seems, told = beams + prior, beams + prior - seeming
    if np.linalg.eigvalsh(told)[0] <= 0 or np.linalg.inv(told)[1, 1] > _SEEMING * np.linalg.inv(seems)[1, 1]:
        raise GraphnavError(
            "the wall that both stops see runs along the face and does not tell how far the machine has moved along it"
        )


class _Pairs(NamedTuple):
    """Beams of the second sight, and the pieces of the first's wall that they lie on.

    Attributes
    ----------
    by_state : ``(K, 3)`` derivatives of the distances by shift and turn.
    distance_m, sigma_m : ``(K,)`` from the wall.
    along, tilt_sigma_rad : ``(K, 2)`` directions of the pieces, and their sigmas ``(K,)`` from the noise of the beams.
    """

    by_state: Array
    distance_m: Array
    sigma_m: Array
    along: Array
    tilt_sigma_rad: Array


def _distances(first: Sight, second: Sight, state: Array) -> _Pairs:
    """Distances of the second sight's points from the first's wall, which runs from beam to beam."""
    cos, sin = np.cos(state[2]), np.sin(state[2])
    turned = second.points_m @ np.array([[cos, sin], [-sin, cos]])
    moved = turned + state[:2]
    begin, run = first.points_m[:-1], np.diff(first.points_m, axis=0)
    length = np.linalg.norm(run, axis=1)
    away = moved[:, None] - begin
    share = np.einsum("nki,ki->nk", away, run) / length**2
    foot = np.clip(share, 0.0, 1.0)[..., None] * run
    apart = np.where(length < _GAP_M, np.linalg.norm(away - foot, axis=2), np.inf)
    piece = np.argmin(apart, axis=1)
    rows = np.arange(len(moved))
    # beside the last beam on either side there is no wall to compare with
    share, ends = share[rows, piece], (piece == 0) | (piece == len(run) - 1)
    on = (apart[rows, piece] < _REACHES_M[-1]) & ~(ends & ((share < 0) | (share > 1)))
    if on.sum() < FEWEST:
        raise GraphnavError(
            f"{on.sum()} beams of one stop lie on the roadway's wall as seen from the other, {FEWEST} are needed; "
            "the stops are too far apart, or the wall has changed"
        )
    rows, piece, share = rows[on], piece[on], np.clip(share[on], 0.0, 1.0)
    normal = np.column_stack([-run[piece, 1], run[piece, 0]]) / length[piece, None]
    right = np.einsum("ni,ni->n", normal, moved[rows] - begin[piece])
    by_turn = np.column_stack([-turned[rows, 1], turned[rows, 0]])
    matrix = np.column_stack([normal, np.einsum("ni,ni->n", normal, by_turn)])
    wall_sigma = np.hypot((1 - share) * first.sigma_m[piece], share * first.sigma_m[piece + 1])
    sigma = np.hypot(second.sigma_m[rows], wall_sigma)
    tilt = np.hypot(first.sigma_m[piece], first.sigma_m[piece + 1]) / length[piece]
    return _Pairs(matrix, right, sigma, run[piece] / length[piece, None], tilt)


def _filled(points_m: Array) -> tuple[Array, Array]:
    """Points every centimetre between neighbouring ones, ``(K, 2)``, and the normals of the wall there."""
    run = np.diff(points_m, axis=0)
    length = np.linalg.norm(run, axis=1)
    count = np.where(length < _GAP_M, np.maximum(length // _FILL_M, 1), 0).astype(int)
    piece = np.repeat(np.arange(len(run)), count)
    share = (np.arange(len(piece)) - np.repeat(np.cumsum(count) - count, count)) / count[piece]
    normal = np.column_stack([-run[:, 1], run[:, 0]]) / length[:, None]
    return points_m[piece] + share[:, None] * run[piece], normal[piece]


def _cloud(o3d: Any, points_m: Array, normals: Array | None = None) -> Any:
    """Open3D's cloud of level points, at two heights."""
    heights = np.repeat([0.0, _HEIGHT_M], len(points_m))
    cloud = o3d.geometry.PointCloud()
    cloud.points = o3d.utility.Vector3dVector(np.column_stack([np.tile(points_m, (2, 1)), heights]))
    if normals is not None:
        level = np.column_stack([normals, np.zeros(len(normals))])
        cloud.normals = o3d.utility.Vector3dVector(np.tile(level, (2, 1)))
    return cloud
