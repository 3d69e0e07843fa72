"""The bundle of two stereo pairs: six readings and three unknowns a point, and the motion common to all.

Minimised is ``sum |y_i - a_i|^2 + |h(y_i) - b_i|^2`` over the motion and over every point, written as the reading y it
would have in the first pair without noise; a and b are the readings, h carries y over the motion. A step with y
eliminated weighs the error of a point by ``S = I + H H^T``, H the derivative of h. Taking the first pair's reading for
y once and for all instead (reprojection of a triangulated point) puts its noise into the Jacobian: the way along the
axis comes out too short where disparities are small.

Covariance: the normal matrix at the estimated points is larger than at the true ones, since noise of their depths looks
like a spread of depths, by which a turn and a shift are told apart. That seeming part E is measured by adding the
points' own noise once more, and with ``A`` the matrix less E the covariance is ``A^-1 (A + E) A^-1`` (errors in
variables). Where E is most of the matrix the motion is not told at all.

E is first that of the declared noise. Before a wall at one depth it is too much: there perspective alone tells a turn
from a shift, which 0.5 px drown, and 0.05 px, as patches have that are found again, do not. So where the declared noise
says that nothing is told, that which the errors show is asked, with an allowance for what they cannot show: errors that
stay with a point in both pairs. Such errors make the motion too short, by the share ``(A + E)^-1 E`` of it; as much as
that is with the declared noise, the covariance allows for in every direction. A camera at rest, whose motion cannot be
too short, loses nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from factors import so3
from factors.so3 import Array
from factors.stereo import StereoCamera
from graphnav.frontends.stereo_transfer import eliminate, lens_of, normal_equations

Mask = npt.NDArray[np.bool_]

#: Readings less unknowns of a point: its squared error is chi-square with that many degrees of freedom.
FREEDOM = 3
#: Converged when the step is this many joint sigmas.
_STEP_SIGMAS = 1e-2
#: And while the points within the gate are still looked for.
_SOFT_STEP_SIGMAS = 0.3
_REGATED = 3
_STEPS = 25
#: Least share of the information that may not be due to the noise of the points, in any direction.
LEAST_TOLD = 1 / 3
#: Noise of the points' depths as a multiple of what the errors show. It allows for errors that stay with a point in
#: both pairs 3.4 times as large as those that change (correlation 0.92): they do not show, and are not averaged over
#: two pairs.
_UNSEEN = 4.0
#: Draws of noise for the seeming part, each used with both signs.
_DRAWS = 2


@dataclass(frozen=True)
class Matches:
    """N points that two stereo pairs see: readings (N, 3) each, in pixels, and the sigma of every pixel."""

    first: Array
    second: Array
    sigma_px: float

    def __len__(self) -> int:
        return len(self.first)

    def only(self, chosen: Mask) -> Matches:
        """The chosen ones."""
        return Matches(self.first[chosen], self.second[chosen], self.sigma_px)


class RotationPrior(NamedTuple):
    """The rotation that another sensor tells: ``R_true = rotation Exp(e)`` with e of covariance `cov` (3, 3) rad^2."""

    rotation: Array
    cov: Array


@dataclass(frozen=True)
class Bundle:
    """The motion at which the bundle came to rest.

    Attributes
    ----------
    rotation, pos_m : (3, 3), (3,) of ``T_from_to``.
    information : (6, 6) of its right perturbation, at the declared noise; the points are eliminated.
    seeming : (6, 6) the part of it that the declared noise makes up, if the points have that, see `_seeming`.
    readings : (N, 3) without noise, as estimated, in the first pair.
    squared : (N,) squared error of every point, chi-square with three degrees of freedom; inf behind the camera.
    inlier : (N,) points within the gate.
    converged : whether the last step was small.
    """

    rotation: Array
    pos_m: Array
    information: Array
    seeming: Array
    readings: Array
    squared: Array
    inlier: Mask
    converged: bool

    @property
    def told(self) -> float:
        """The least share, over all directions, of the information that is not due to noise."""
        return self._told(self._noise)

    @property
    def cov(self) -> Array:
        """(6, 6) of the right perturbation; errors larger than declared make it larger, smaller ones do not count."""
        gain = np.linalg.inv(self.information - self._noise**2 * self.seeming)
        cov = max(1.0, self.scale**2) * gain @ self.information @ gain
        return np.asarray(cov if self._noise == 1.0 else cov + self._shortening)

    @property
    def _noise(self) -> float:
        """Noise of the points' depths as a share of the declared one, which counts unless it drowns the motion."""
        return 1.0 if self._told(1.0) >= LEAST_TOLD else min(1.0, _UNSEEN * self.scale)

    def _told(self, noise: float) -> float:
        return float(1 - noise**2 * self._drowned[0][-1])

    @cached_property
    def _drowned(self) -> tuple[Array, Array]:
        """Shares (6,) of the information that the declared noise makes up, and their directions (6, 6), one sigma."""
        factor = np.linalg.cholesky(np.linalg.inv(self.information))
        shares, axes = np.linalg.eigh(factor.T @ self.seeming @ factor)
        return shares, factor @ axes

    @property
    def _shortening(self) -> Array:
        """Covariance (6, 6) of a motion that errors which stay with the points have made too short."""
        shares, directions = self._drowned
        drowned = np.clip(self._noise**2 * shares, 0.0, 1 - LEAST_TOLD)
        motion = np.concatenate([so3.log(self.rotation), self.rotation.T @ self.pos_m])
        missing = drowned / (1 - drowned) * np.linalg.solve(directions, motion)
        return np.asarray((directions * missing**2) @ directions.T)

    @property
    def scale(self) -> float:
        """Error of the inliers as a multiple of the declared one."""
        freedom = max(FREEDOM * int(self.inlier.sum()) - 6, 1)
        return float(np.sqrt(self.squared[self.inlier].sum() / freedom))


@lru_cache
def gate(sigmas: float, freedom: int = FREEDOM) -> float:
    """The squared error (of a right point) that is exceeded as seldom as a normal error its `sigmas`."""
    from scipy.stats import chi2, norm

    return float(chi2.isf(2 * norm.sf(sigmas), freedom))


def adjusted(
    camera: StereoCamera,
    matches: Matches,
    rotation: Array,
    pos_m: Array,
    inlier_sigmas: float,
    prior: RotationPrior | None = None,
) -> Bundle:
    """The motion of least squares, from a start near by.

    First with Geman-McClure weights, then with the points within the gate counting in full and the others not at all.
    The gate is that of the declared noise: one that grew with the errors found would let two motions pass for one.
    """
    limit = gate(inlier_sigmas)
    found = _iterated(camera, matches, _State(rotation, pos_m, matches.first), None, limit, prior)
    for _ in range(_REGATED):
        before = found.inlier
        found = _iterated(camera, matches, found, before, limit, prior)
        if (found.inlier == before).all():
            break
    return replace(found, seeming=_seeming(camera, matches, found))


class _State(NamedTuple):
    """Where an iteration begins; a `Bundle` is one too."""

    rotation: Array
    pos_m: Array
    readings: Array


def _iterated(
    camera: StereoCamera,
    matches: Matches,
    start: _State | Bundle,
    chosen: Mask | None,
    limit: float,
    prior: RotationPrior | None,
) -> Bundle:
    """Gauss-Newton, by weights of the errors themselves or with the chosen points in full."""
    rotation, pos_m, readings, converged = start.rotation, start.pos_m, start.readings, False
    least = _STEP_SIGMAS if chosen is not None else _SOFT_STEP_SIGMAS
    for _ in range(_STEPS):
        terms = _terms(lens_of(camera), matches, rotation, pos_m, readings)
        weight = 1 / (1 + terms.squared / limit) ** 2 if chosen is None else chosen.astype(float)
        information, gradient = _normal(terms, weight / matches.sigma_px**2)
        if prior is not None:
            information, gradient = _with_prior(information, gradient, rotation, prior)
        step = _solved(information, gradient)
        readings = _points(matches, terms, step, terms.squared < 4 * limit)
        pos_m = pos_m + rotation @ step[3:]
        rotation = rotation @ so3.exp(step[:3])
        if converged := bool(step @ information @ step < least**2):
            break
    none = np.zeros((6, 6))
    return Bundle(rotation, pos_m, information, none, readings, terms.squared, terms.squared < limit, converged)


class _Terms(NamedTuple):
    """Errors left when the points have been eliminated.

    Attributes
    ----------
    error : (N, 3) px; weight : (N, 3, 3) the inverse of S; by_reading : (N, 3, 3) H; by_motion : (N, 3, 6).
    squared : (N,) in units of the declared variance; inf behind the camera.
    """

    error: Array
    weight: Array
    by_reading: Array
    by_motion: Array
    squared: Array


def _terms(lens: Array, matches: Matches, rotation: Array, pos_m: Array, readings: Array) -> _Terms:
    error, weight, by_reading, by_motion, squared = eliminate(
        lens, rotation, pos_m, matches.first, matches.second, readings
    )
    return _Terms(error, weight, by_reading, by_motion, squared / matches.sigma_px**2)


def _normal(terms: _Terms, share: Array) -> tuple[Array, Array]:
    """Information (6, 6) and gradient (6,) of the motion."""
    return normal_equations(terms.weight, terms.by_motion, terms.error, share)


def _with_prior(information: Array, gradient: Array, rotation: Array, prior: RotationPrior) -> tuple[Array, Array]:
    away = so3.log(prior.rotation.T @ rotation)
    by_rotation = np.linalg.inv(so3.right_jacobian(away))
    weighed = by_rotation.T @ np.linalg.inv(prior.cov)
    information, gradient = information.copy(), gradient.copy()
    information[:3, :3] += weighed @ by_rotation
    gradient[:3] -= weighed @ away
    return information, gradient


def _solved(information: Array, gradient: Array) -> Array:
    """The step; along directions of which nothing is known, none."""
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    kept = values > 1e-12 * max(values[-1], 1e-300)
    gains = np.where(kept, 1 / np.where(kept, values, 1.0), 0.0)
    return np.asarray(vectors @ (gains * (vectors.T @ (gradient / scale))) / scale)


def _points(matches: Matches, terms: _Terms, step: Array, near: Mask) -> Array:
    """Readings (N, 3) that fit both pairs best after the step; those of wrong points stay as read."""
    left = terms.error - terms.by_motion @ step
    change = (so3.transpose(terms.by_reading) @ (terms.weight @ left[..., None]))[..., 0]
    return np.asarray(np.where(near[:, None], matches.first + change, matches.first))


def _seeming(camera: StereoCamera, matches: Matches, found: Bundle) -> Array:
    """What noise of the points adds to the information (6, 6): by so much it grows when they get it once more."""
    lens = lens_of(camera)
    terms = _terms(lens, matches, found.rotation, found.pos_m, found.readings)
    back = so3.transpose(terms.by_reading)
    cov = np.eye(3) - back @ terms.weight @ terms.by_reading  # of a point's reading, the inverse of I + H^T H
    normal = np.random.default_rng(0).normal(size=(2, _DRAWS, len(matches), 3, 1))
    noise = matches.sigma_px * (cov @ (normal[0] + back @ normal[1]))[..., 0]
    share = found.inlier / matches.sigma_px**2
    moved = (found.readings + part for part in (*noise, *-noise))
    noisier = [_normal(_terms(lens, matches, found.rotation, found.pos_m, y), share)[0] for y in moved]
    return np.asarray(np.mean(noisier, axis=0) - _normal(terms, share)[0])
