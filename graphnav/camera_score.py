"""What a solution says of a camera's mounting and clock that are declared to be exact: the scores of both.

An IMU beside a camera that is turned against it, or late, still finds a smooth way, whose errors no reading shows. But
all of them together pull at the angles, or at the time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from factors.carried import CAMERA_ERRORS
from factors.increments import npt_int
from factors.so3 import Array
from graphnav.camera_errors import camera_sigmas
from graphnav.graph import SmoothingGraph
from graphnav.log import Stereo
from graphnav.problem import E, Problem

if TYPE_CHECKING:
    import gtsam

#: The camera's errors with what is tested free: a variable of its own beside E(0), whose prior may hold it.
_FREE = E(1)
#: What is tested: angles and time, of the camera's errors.
_ANGLES, _TIME = np.arange(3), np.array([7])
#: What stands for an error declared to be none, m and px; and information that tells nothing, 1/rad^2 or 1/s^2.
_HELD, _NOTHING = 1e-6, 1.0
#: Rareness of a score that is told: that of five sigmas of one number.
_SIGMAS = 5.0


@dataclass(frozen=True)
class Score:
    """A step (n,) of what is declared to be zero, and its length in sigmas; `besides` : with the other one free."""

    step: Array
    sigmas: float
    besides: float


@dataclass(frozen=True)
class CameraScore:
    """Scores, None each where it is no matter of testing.

    Attributes
    ----------
    angles : of ``R_bc = R(T_bc_quat) Exp(angles)``, rad; later : what an image at t shows was at t + d, s.
    """

    angles: Score | None
    later: Score | None


def camera_score(problem: Problem, graph: SmoothingGraph, values: gtsam.Values) -> CameraScore:
    """The scores of angles and clock where they are declared to be exact, and anything tells of them.

    One Gauss-Newton step with these as further variables, of which nothing is known before (C. R. Rao, Proc. Cambridge
    Phil. Soc. 44 (1948)): of a camera as declared its square in sigmas is a chi square.

    Parameters
    ----------
    graph, values : as solved.
    """
    stereo = problem.log.stereo
    if stereo is None or (graph.motions is None and graph.tracks is None):
        return CameraScore(None, None)
    exact = camera_sigmas(stereo) == 0
    tested = [rows[exact[rows]] for rows in (_ANGLES, _TIME)]
    both = np.concatenate(tested)
    if not len(both):
        return CameraScore(None, None)
    root, right = _eliminated(_freed(graph, stereo, values), values)
    inverse = np.linalg.inv(root)
    information = np.linalg.inv((inverse @ inverse.T)[np.ix_(both, both)])
    gradient = information @ (inverse @ right)[both]
    information -= np.eye(len(both))
    angles, later = (np.flatnonzero(np.isin(both, rows)) for rows in tested)
    found = _score(information, gradient, angles, later)
    if found is not None:  # about all three axes, whichever of them are tested
        step = np.zeros(3)
        step[tested[0]] = found.step
        found = replace(found, step=step)
    return CameraScore(found, _score(information, gradient, later, angles))


def _freed(graph: SmoothingGraph, stereo: Stereo, values: gtsam.Values) -> gtsam.GaussianFactorGraph:
    """The problem linearized with free angles and time, held by unit information, which is taken out again."""
    import gtsam

    free = gtsam.Values(values)
    found = values.atVector(E(0)) if values.exists(E(0)) else np.zeros(CAMERA_ERRORS)
    free.insert(_FREE, found)
    motions = None if graph.motions is None else replace(graph.motions, camera_key=_FREE)
    tracks = None if graph.tracks is None else replace(graph.tracks, camera_key=_FREE)
    linear, _ = replace(graph, motions=motions, tracks=tracks).condensed(free)
    sigmas = camera_sigmas(stereo)
    exact = sigmas == 0
    sigmas[exact] = _HELD
    for rows in (_ANGLES, _TIME):
        sigmas[rows[exact[rows]]] = 1.0
    unit = gtsam.noiseModel.Unit.Create(CAMERA_ERRORS)
    linear.push_back(gtsam.JacobianFactor(_FREE, np.diag(1 / sigmas), -found / sigmas, unit))
    return linear


def _eliminated(linear: gtsam.GaussianFactorGraph, values: gtsam.Values) -> tuple[Array, Array]:
    """R (n, n) and d (n,) of ``|R x - d|^2``, what all factors together say of the camera's errors."""
    import gtsam

    ordering = gtsam.Ordering.ColamdConstrainedLastGaussianFactorGraph(linear, [_FREE])
    try:
        tree = linear.eliminateMultifrontal(ordering)
    except RuntimeError:  # indeterminate to Cholesky, as sound long chains may be
        tree = linear.eliminateMultifrontal(ordering, gtsam.EliminateQR)
    conditional, n = tree[_FREE].conditional(), CAMERA_ERRORS
    return np.asarray(conditional.R()[-n:, -n:]), np.asarray(conditional.d()[-n:])


def _score(information: Array, gradient: Array, own: npt_int, other: npt_int) -> Score | None:
    """The score of some of what is tested, the others at zero, and in sigmas also with them free."""
    alone = _stepped(information[np.ix_(own, own)], gradient[own])
    if alone is None:
        return None
    step, sigmas = alone
    told, axes = _told(information[np.ix_(other, other)])
    if not len(told):
        return Score(step, sigmas, sigmas)
    across = information[np.ix_(own, other)] @ axes / told
    left = _stepped(
        information[np.ix_(own, own)] - (across * told) @ across.T, gradient[own] - across @ (axes.T @ gradient[other])
    )
    return Score(step, sigmas, 0.0 if left is None else left[1])


def _told(information: Array) -> tuple[Array, Array]:
    """The information along those of its axes that are told, and the axes."""
    size, along = np.linalg.eigh(information)
    return size[size > _NOTHING], along[:, size > _NOTHING]


def _stepped(information: Array, gradient: Array) -> tuple[Array, float] | None:
    """The step along what is told, and its length in sigmas."""
    told, axes = _told(information)
    if not len(told):
        return None
    score = axes.T @ gradient
    return axes @ (score / told), _normal_sigmas(float((score**2 / told).sum()), len(told))


def _normal_sigmas(square: float, freedom: int) -> float:
    """The sigmas of one number that are as rare as a chi square; beyond all rareness its root."""
    from scipy.stats import chi2, norm

    rare = float(chi2.sf(square, freedom))
    return float(norm.isf(rare / 2)) if rare > 1e-200 else float(np.sqrt(square))


def camera_score_warnings(score: CameraScore | None) -> list[str]:
    """What the user should know of a camera that does not seem to sit, or to be stamped, as declared.

    A turn and a delay may look alike: of two that both would be told, the lesser is only if it is with the other free.
    """
    if score is None:
        return []
    angles, later = score.angles, score.later
    lines = []
    if angles is not None and _counts(angles, later):
        right, down, forward = np.degrees(angles.step)
        size = float(np.degrees(np.linalg.norm(angles.step)))
        lines.append(
            f"the camera seems turned by about {size:.2g} deg against T_bc_quat_wxyz (about its right, down and forward"
            f" axis {right:.2g}, {down:.2g}, {forward:.2g} deg; {angles.sigmas:.0f} sigmas): check [stereo], or"
            " declare mounting_sigma_deg, and it is estimated"
        )
    if later is not None and _counts(later, angles):
        d = float(later.step[0])
        lines.append(
            f"images seem to be stamped about {abs(d):.2g} s too {'early' if d > 0 else 'late'} ({later.sigmas:.0f}"
            f" sigmas): add {d:.2g} to time_offset_s of [stereo], or declare time_sigma_s, and it is estimated"
        )
    return lines


def _counts(own: Score, other: Score | None) -> bool:
    """Whether it is told: by itself, and beside the other where that one is told first."""
    if other is None or own.sigmas >= other.sigmas:
        return own.sigmas >= _SIGMAS
    return min(own.sigmas, own.besides) >= _SIGMAS
