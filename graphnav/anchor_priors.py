"""What a log declares of its UWB anchors: how wrong their ranges are, and where they stand, alone or in groups."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from factors.known import linear_factor
from factors.noise import diagonal
from factors.so3 import Array
from graphnav.log import Uwb
from graphnav.problem import A

if TYPE_CHECKING:
    import gtsam

#: Sigma of a constant error that is declared to be none: too small to show.
_NONE_M = 1e-4


def anchor_priors(uwb: Uwb, anchors: list[int]) -> list[gtsam.NonlinearFactor]:
    """Priors of the anchors heard: one each, and one for all anchors of a group.

    Parameters
    ----------
    anchors : their indices in the log.
    """
    import gtsam

    found: list[gtsam.NonlinearFactor] = []
    groups: dict[str, list[int]] = {}
    for a in anchors:
        group = uwb.anchor[a].group
        if group is None:
            found.append(gtsam.PriorFactorVector(A(a), np.zeros(4), diagonal(_own_sigma(uwb, a))))
        else:
            groups.setdefault(group, []).append(a)
    return found + [_group_prior(uwb, name, members) for name, members in groups.items()]


def _own_sigma(uwb: Uwb, a: int) -> Array:
    """Sigmas (4,) of an anchor's constant error and of its place."""
    return np.asarray(np.r_[uwb.constant_sigma_m[a] or _NONE_M, np.full(3, uwb.anchor[a].sigma_m)])


def _group_prior(uwb: Uwb, name: str, members: list[int]) -> gtsam.NonlinearFactor:
    """Joint prior of a group's anchors, whose common displacement and turn it marginalizes: a Gaussian of all of them.

    Anchor a is off by ``D + psi up x (p_a - mean) + own``, linear in D and in the turn psi, for a carrier put down anew
    turns by a degree or two at most.
    """
    cov = group_covariance(uwb, name, members)
    white = np.linalg.inv(np.linalg.cholesky(cov))
    blocks = [white[:, 4 * k : 4 * k + 4] for k in range(len(members))]
    return linear_factor([A(a) for a in members], blocks)


def group_covariance(uwb: Uwb, name: str, members: list[int]) -> Array:
    """Covariance (4 G, 4 G) of the errors of a group's anchors, each constant error and displacement, m.

    The mean about which they turn is that of all anchors of the group, heard or not.
    """
    mean = np.mean([anchor.pos_n_m for anchor in uwb.anchor if anchor.group == name], axis=0)
    turn = np.radians(uwb.group_turn_sigma_deg or 0.0)
    shared = np.zeros((4 * len(members), 4))
    for k, a in enumerate(members):
        east, north, _ = uwb.anchor[a].pos_n_m - mean
        shared[4 * k + 1 : 4 * k + 4, :3] = (uwb.group_sigma_m or 0.0) * np.eye(3)
        shared[4 * k + 1 : 4 * k + 3, 3] = turn * np.array([-north, east])
    own = np.concatenate([_own_sigma(uwb, a) for a in members])
    return np.asarray(np.diag(own**2) + shared @ shared.T)
