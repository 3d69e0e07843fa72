"""What a solution says of a camera's mounting that is declared to be exact: the score of its angles.

An IMU beside a camera that is turned against it still finds a smooth way, whose errors no reading shows. But all of
them together pull at the angles.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from factors.so3 import Array
from graphnav.camera_errors import camera_sigmas
from graphnav.graph import SmoothingGraph
from graphnav.leg_means import npt_bool
from graphnav.log import Stereo
from graphnav.problem import E, Problem

if TYPE_CHECKING:
    import gtsam

#: The camera's errors with free angles: a variable of its own beside E(0), whose prior may hold them.
_FREE = E(1)
#: What stands for an error declared to be none, m and px; and information of angles that tells nothing, 1/rad^2.
_HELD, _NOTHING = 1e-6, 1.0
#: Rareness of a score that is told: that of five sigmas of one number.
_SIGMAS = 5.0


@dataclass(frozen=True)
class MountingScore:
    """Angles (3,) of ``R_bc = R(T_bc_quat) Exp(angles)``, rad, to first order; and their length in sigmas."""

    angle_rad: Array
    sigmas: float


def mounting_score(problem: Problem, graph: SmoothingGraph, values: gtsam.Values) -> MountingScore | None:
    """The score of the angles that are declared to be exact; None where there are none, or nothing tells of them.

    One Gauss-Newton step with these angles as further variables, of which nothing is known before (C. R. Rao, Proc.
    Cambridge Phil. Soc. 44 (1948)): of a camera that sits as declared its square in sigmas is a chi square.

    Parameters
    ----------
    graph, values : as solved.
    """
    stereo = problem.log.stereo
    if stereo is None or (graph.motions is None and graph.tracks is None):
        return None
    tested = camera_sigmas(stereo)[:3] == 0
    if not tested.any():
        return None
    root, right = _eliminated(_freed(graph, stereo, values), values)
    inverse = np.linalg.inv(root)
    information = np.linalg.inv((inverse @ inverse.T)[:3, :3][np.ix_(tested, tested)])
    gradient = information @ (inverse @ right)[:3][tested]
    return _stepped(information - np.eye(int(tested.sum())), gradient, tested)


def _freed(graph: SmoothingGraph, stereo: Stereo, values: gtsam.Values) -> gtsam.GaussianFactorGraph:
    """The problem linearized with free angles, held by unit information, which is taken out again."""
    import gtsam

    free = gtsam.Values(values)
    found = values.atVector(E(0)) if values.exists(E(0)) else np.zeros(7)
    free.insert(_FREE, found)
    motions = None if graph.motions is None else replace(graph.motions, camera_key=_FREE)
    tracks = None if graph.tracks is None else replace(graph.tracks, camera_key=_FREE)
    linear, _ = replace(graph, motions=motions, tracks=tracks).condensed(free)
    sigmas = camera_sigmas(stereo)
    sigmas[3:] = np.maximum(sigmas[3:], _HELD)
    sigmas[:3][sigmas[:3] == 0] = 1.0
    unit = gtsam.noiseModel.Unit.Create(7)
    linear.push_back(gtsam.JacobianFactor(_FREE, np.diag(1 / sigmas), -found / sigmas, unit))
    return linear


def _eliminated(linear: gtsam.GaussianFactorGraph, values: gtsam.Values) -> tuple[Array, Array]:
    """R (7, 7) and d (7,) of ``|R x - d|^2``, what all factors together say of the camera's errors."""
    import gtsam

    ordering = gtsam.Ordering.ColamdConstrainedLastGaussianFactorGraph(linear, [_FREE])
    try:
        tree = linear.eliminateMultifrontal(ordering)
    except RuntimeError:  # indeterminate to Cholesky, as sound long chains may be
        tree = linear.eliminateMultifrontal(ordering, gtsam.EliminateQR)
    conditional = tree[_FREE].conditional()
    return np.asarray(conditional.R()[-7:, -7:]), np.asarray(conditional.d()[-7:])


def _stepped(information: Array, gradient: Array, tested: npt_bool) -> MountingScore | None:
    """The step along what is told of the angles."""
    size, along = np.linalg.eigh(information)
    told = size > _NOTHING
    if not told.any():
        return None
    score = along[:, told].T @ gradient
    angle = np.zeros(3)
    angle[tested] = along[:, told] @ (score / size[told])
    return MountingScore(angle, _normal_sigmas(float((score**2 / size[told]).sum()), int(told.sum())))


def _normal_sigmas(square: float, freedom: int) -> float:
    """The sigmas of one number that are as rare as a chi square; beyond all rareness its root."""
    from scipy.stats import chi2, norm

    rare = float(chi2.sf(square, freedom))
    return float(norm.isf(rare / 2)) if rare > 1e-200 else float(np.sqrt(square))


def mounting_warnings(score: MountingScore | None) -> list[str]:
    """What the user should know of a camera that does not seem to sit as declared."""
    if score is None or score.sigmas < _SIGMAS:
        return []
    right, down, forward = np.degrees(score.angle_rad)
    angle = float(np.degrees(np.linalg.norm(score.angle_rad)))
    return [
        f"the camera seems turned by about {angle:.2g} deg against T_bc_quat_wxyz (about its right, down and forward"
        f" axis {right:.2g}, {down:.2g}, {forward:.2g} deg; {score.sigmas:.0f} sigmas): check [stereo], or"
        " declare mounting_sigma_deg, and it is estimated"
    ]
