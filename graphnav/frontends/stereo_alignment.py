"""A first motion between two stereo pairs, found among wrong matches: three-point samples and their consensus.

Source: the roadheader stereo paper, equation 15, the closed-form alignment of two sets of points, with weights from the
covariance of their depths. A sample of three is aligned so, and then brought to the least reprojection error, because
at disparities of a few pixels the aligned points are poor. All samples of a round are treated together.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from factors import so3
from factors.so3 import Array
from factors.stereo import U_LEFT, U_RIGHT, StereoCamera
from graphnav.frontends.stereo_bundle import Mask, Matches, gate
from graphnav.frontends.stereo_transfer import homogeneous, lens_of, sample_equations, squared_errors

Indices = npt.NDArray[np.intp]

#: Samples of a round, and rounds at most.
_SAMPLES, _ROUNDS = 32, 16
#: Points on which samples are judged; the best ones are judged on all.
_JUDGES = 80
#: Samples of a round that all points judge.
_FINALISTS = 3
#: Chance of not having drawn a sample without a wrong point.
_MISSED = 1e-4
#: Steps that bring a sample to its least reprojection error.
_SAMPLE_STEPS = 2
#: A step of a sample turns by no more, rad.
_LARGEST_TURN = 0.5
#: Disparity, in its own sigmas, that a point needs for its depth to be told.
NEAR_SIGMAS = 2.0


def aligned(points_from: Array, points_to: Array, weight: Array) -> tuple[Array, Array]:
    """Rotation (..., 3, 3) and translation (..., 3) of least ``sum w |p_from - R p_to - t|^2`` (equation 15).

    Parameters
    ----------
    points_from, points_to : (..., N, 3) m; weight : (..., N).
    """
    share = (weight / weight.sum(axis=-1, keepdims=True))[..., None]
    centre_from, centre_to = (share * points_from).sum(axis=-2), (share * points_to).sum(axis=-2)
    spread = so3.transpose(share * (points_from - centre_from[..., None, :])) @ (points_to - centre_to[..., None, :])
    u, _, vt = np.linalg.svd(spread)
    flip = np.ones(spread.shape[:-1])
    flip[..., 2] = np.sign(np.linalg.det(u @ vt))
    rotation = (u * flip[..., None, :]) @ vt
    return rotation, centre_from - (rotation @ centre_to[..., None])[..., 0]


def near_enough(matches: Matches) -> Mask:
    """Points (N,) whose depth both pairs tell."""
    least = NEAR_SIGMAS * np.sqrt(2.0) * matches.sigma_px
    return np.asarray((_disparity(matches.first) > least) & (_disparity(matches.second) > least))


def consensus(
    camera: StereoCamera,
    matches: Matches,
    inlier_sigmas: float,
    rng: np.random.Generator,
    least_share: float = 0.25,
    far: bool = False,
) -> tuple[Array, Array, Mask] | None:
    """The motion that most points agree with, and those points; None when no sample can be drawn.

    Samples are of points whose depth is told; with `far` of all, for a motion that is of interest even if it is hardly
    more than a rotation.

    Stops when a sample without a wrong point would have been drawn by now, but for one time in ten thousand: either at
    the share of points that agree so far, or at the least share that is of interest.
    """
    pool = np.arange(len(matches)) if far else np.flatnonzero(near_enough(matches))
    if len(pool) < 3:
        return None
    judges = rng.permutation(len(matches))[:_JUDGES]
    best = (np.eye(3), np.zeros(3), np.zeros(len(matches), bool))
    least = np.inf
    for k in range(_ROUNDS):
        sample = pool[_draws(rng, len(pool))]
        rotation, pos = _of_samples(camera, matches, sample)
        rough = _cost(camera, matches, rotation, pos, judges, inlier_sigmas)[0]
        first = np.argsort(rough)[:_FINALISTS]
        cost, inlier = _cost(camera, matches, rotation[first], pos[first], slice(None), inlier_sigmas)
        winner = int(np.argmin(cost))
        if cost[winner] < least:
            least, best = cost[winner], (rotation[first][winner], pos[first][winner], inlier[winner])
        share = max(best[2][pool].mean(), least_share)
        if (1 - share**3) ** (_SAMPLES * (k + 1)) < _MISSED:
            break
    return best


def _draws(rng: np.random.Generator, count: int) -> Indices:
    """Samples (M, 3) of different numbers below `count`."""
    out = rng.integers(count, size=(_SAMPLES, 3))
    again = (out[:, 0] == out[:, 1]) | (out[:, 0] == out[:, 2]) | (out[:, 1] == out[:, 2])
    out[again] = [rng.permutation(count)[:3] for _ in range(int(again.sum()))] if again.any() else out[again]
    return out


def _of_samples(camera: StereoCamera, matches: Matches, sample: Indices) -> tuple[Array, Array]:
    """Motions (M, 3, 3), (M, 3) of samples (M, 3) of points."""
    first, second = matches.first[sample], matches.second[sample]
    (m_from, rho_from), (m_to, rho_to) = homogeneous(camera, first), homogeneous(camera, second)
    least = matches.sigma_px / (camera.fx_px * camera.baseline_m)
    rho_from, rho_to = np.maximum(rho_from, least), np.maximum(rho_to, least)
    weight = 1 / (1 / rho_from**4 + 1 / rho_to**4)  # of the variance of the depths, z^4 up to a factor
    rotation, pos = aligned(m_from / rho_from[..., None], m_to / rho_to[..., None], weight)
    lens, axes = lens_of(camera), np.arange(6)
    for _ in range(_SAMPLE_STEPS):
        matrix, gradient = sample_equations(lens, rotation, pos, first, second)
        matrix[:, axes, axes] = matrix[:, axes, axes] * (1 + 1e-6) + 1e-9  # three points on a line leave a turn open
        step = np.asarray(np.linalg.solve(matrix, gradient[..., None])[..., 0], float)
        step = step / np.maximum(1.0, np.linalg.norm(step[:, :3], axis=1) / _LARGEST_TURN)[:, None]
        pos = pos + (rotation @ step[:, 3:, None])[..., 0]
        rotation = rotation @ so3.exp(step[:, :3])
    return rotation, pos


def _cost(
    camera: StereoCamera, matches: Matches, rotation: Array, pos: Array, judges: Indices | slice, inlier_sigmas: float
) -> tuple[Array, Mask]:
    """Truncated squared error (M,) of motions over the judging points, and who is within the gate (M, N)."""
    squared = squared_errors(lens_of(camera), rotation, pos, matches.first[judges], matches.second[judges])
    squared, limit = squared / matches.sigma_px**2, gate(inlier_sigmas)
    return np.asarray(np.minimum(squared, limit).sum(axis=-1)), np.asarray(squared < limit)


def _disparity(pixels: Array) -> Array:
    return np.asarray(pixels[..., U_LEFT] - pixels[..., U_RIGHT])
