"""The motion of a stereo camera between two times, from points that it sees at both; or why there is none.

The steps: points whose depth is told are aligned in samples of three until most agree (`stereo_alignment`), the bundle
of both pairs is solved from there (`stereo_bundle`), and what comes out has to stand some checks. A failure is a value
with a reason: there is never a wrong motion with a small covariance.

The rotation that an IMU tells can serve in two ways. As a *gate* it only rejects: the motion is the images' alone, as a
graph needs it that holds the IMU too. *Fused* it also improves the motion, which is for stereo odometry on its own: in
a graph beside the IMU the same rotation would count twice.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors import so3
from factors.so3 import Array
from factors.stereo import U_LEFT, U_RIGHT, StereoCamera
from graphnav.config import StereoMotionsConfig
from graphnav.frontends.stereo_alignment import consensus, near_enough
from graphnav.frontends.stereo_bundle import FREEDOM, LEAST_TOLD, Bundle, Mask, Matches, RotationPrior, adjusted

#: A second motion that as many points agree with, as a share of those of the first, makes both doubtful.
_RIVAL = 0.6
#: Share of negative disparities, beyond their noise, from which the sides are taken for swapped.
_SWAPPED = 0.5
#: Fewest points within the gate of a sample of three for the bundle to start from it.
_SEED = 6
#: Errors this many times the declared ones, of points within the gate, are no noise.
_LARGEST_SCALE = 1.6
#: Errors larger than declared by so many sigmas may be those of one motion put between two (by chance 1 in 30,000).
_LARGER_SIGMAS = 4.0
#: Then the two are looked for within a gate that holds 19 of 20 right points, and the second counts from this share.
_NARROW_SIGMAS, _NARROW_RIVAL = 2.0, 0.5
#: How the reason ends of a motion whose rotation is not the gyro's: `motion_failures` counts these apart.
BY_IMU = "from that of the IMU"


@dataclass(frozen=True)
class StereoMotion:
    """A motion ``T_from_to``.

    Attributes
    ----------
    rotation, pos_m : (3, 3) and (3,): ``p_from = R p_to + t``.
    cov : (6, 6) of ``T_true = T Exp(e)``, rotation before translation, rad and m.
    inlier : (N,) the matches that agree with it.
    scale : error of their readings as a multiple of the declared one; above 1 the covariance allows for it.
    """

    rotation: Array
    pos_m: Array
    cov: Array
    inlier: Mask
    scale: float


@dataclass(frozen=True)
class MotionFailure:
    """No motion, and why."""

    reason: str


def stereo_motion(
    camera: StereoCamera, matches: Matches, settings: StereoMotionsConfig, prior: RotationPrior | None = None
) -> StereoMotion | MotionFailure:
    """The motion between two stereo pairs.

    Parameters
    ----------
    matches : readings of the same points in both pairs, some of them wrong.
    prior : rotation ``R_from_to`` from another sensor; `settings.rotation_prior` says what becomes of it.

    Notes
    -----
    The samples are drawn with a fixed seed: the same matches give the same motion.
    """
    few = _too_few(matches, settings)
    if few:
        return MotionFailure(few)
    rng = np.random.default_rng(0)
    start = consensus(camera, matches, settings.inlier_sigmas, rng)
    if start is None or start[2].sum() < _SEED:
        agreed = 0 if start is None else int(start[2].sum())
        return MotionFailure(f"{agreed} of {len(matches)} matches agree on a motion, {settings.min_inliers} are needed")
    found = adjusted(camera, matches, start[0], start[1], settings.inlier_sigmas)
    problem = _doubt(camera, matches, found, settings, rng)
    if problem:
        return MotionFailure(problem)
    if prior is not None and settings.rotation_prior != "off":
        away = turn_sigmas(found, prior)
        if away > settings.rotation_gate_sigmas:
            return MotionFailure(f"the rotation is {away:.1f} sigmas {BY_IMU}")
        if settings.rotation_prior == "fuse":
            found = adjusted(camera, matches, found.rotation, found.pos_m, settings.inlier_sigmas, prior)
    return StereoMotion(found.rotation, found.pos_m, found.cov, found.inlier, found.scale)


def turn_sigmas(found: Bundle, prior: RotationPrior) -> float:
    """Distance of the rotation from the prior's, in sigmas of both together."""
    away = so3.log(prior.rotation.T @ found.rotation)
    cov = prior.cov + found.cov[:3, :3]
    return float(np.sqrt(away @ np.linalg.solve(cov, away)))


def _too_few(matches: Matches, settings: StereoMotionsConfig) -> str:
    """What is wrong with the matches as such; empty when nothing is."""
    if len(matches) < settings.min_inliers:
        return f"{len(matches)} matches, {settings.min_inliers} are needed"
    noise = np.sqrt(2.0) * matches.sigma_px
    for pixels in (matches.first, matches.second):
        negative = (pixels[:, U_LEFT] - pixels[:, U_RIGHT] < -3 * noise).mean()
        if negative > _SWAPPED:
            return f"{negative:.0%} of the disparities are negative: left and right camera are swapped"
    near = int(near_enough(matches).sum())
    if near < settings.min_inliers:
        return f"{near} of {len(matches)} points are near enough to tell a motion, {settings.min_inliers} are needed"
    return ""


def _doubt(
    camera: StereoCamera, matches: Matches, found: Bundle, settings: StereoMotionsConfig, rng: np.random.Generator
) -> str:
    """Why a motion is not to be trusted; empty when it is."""
    count = int(found.inlier.sum())
    if count < settings.min_inliers:
        return f"{count} of {len(matches)} matches agree on a motion, {settings.min_inliers} are needed"
    if found.scale > _LARGEST_SCALE:
        return f"errors of {found.scale:.1f} times the declared {matches.sigma_px:.2g} px"
    if found.told < LEAST_TOLD:
        return "the points lie on a line, on each other or too far away: the motion they tell is mostly their noise"
    if not found.converged:
        return f"the motion that {count} matches agree on does not converge"
    others = _others(camera, matches, found, settings, _RIVAL, rng)
    if not others and _larger_than_declared(found):
        narrow = settings.model_copy(update={"inlier_sigmas": _NARROW_SIGMAS})
        start = consensus(camera, matches, _NARROW_SIGMAS, rng)
        if start is not None:
            found = adjusted(camera, matches, start[0], start[1], _NARROW_SIGMAS)
            others = _others(camera, matches, found, narrow, _NARROW_RIVAL, rng)
    if others:
        return f"two motions: {int(found.inlier.sum())} matches agree on one and {others} others on another"
    return ""


def _larger_than_declared(found: Bundle) -> bool:
    """Whether errors are beyond chance larger than declared: by noise that is, or by a motion between two others."""
    freedom = FREEDOM * int(found.inlier.sum()) - 6
    return bool((found.scale**2 - 1) * np.sqrt(freedom / 2) > _LARGER_SIGMAS)


def _others(
    camera: StereoCamera,
    matches: Matches,
    found: Bundle,
    settings: StereoMotionsConfig,
    share: float,
    rng: np.random.Generator,
) -> int:
    """How many other matches agree on another motion; 0 if they are no more than a `share` of those of this one."""
    gate, least = settings.inlier_sigmas, share * int(found.inlier.sum())
    left = matches.only(~found.inlier)
    if len(left) < max(settings.min_inliers, least):
        return 0
    rival = consensus(camera, left, gate, rng, least / len(left), far=True)
    agreed = 0 if rival is None else int(adjusted(camera, left, *rival[:2], gate).inlier.sum())
    return agreed if agreed > least else 0
