"""Joint covariances of all states of single keyframes, from the whole graph or from the graph cut off there.

Pose, velocity, bias and calibration share factors in pairs at most. A factor without information ties those of one
keyframe together before elimination, so that one clique of the Bayes tree holds them all.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from factors.so3 import Array
from graphnav.graph import build_graph
from graphnav.preintegration import Preintegrated
from graphnav.problem import B, C, Problem, V, X
from graphnav.solvers.batch import eliminate
from graphnav.solvers.covariance import joint_marginals

if TYPE_CHECKING:
    import gtsam

#: Sizes of the variables by the letter of their key.
_DIMS = {"x": 6, "v": 3, "b": 6, "c": 4, "k": 1}
Progress = Callable[[float, float], None]


def graph_covariances(
    problem: Problem,
    data: Preintegrated,
    values: gtsam.Values,
    keyframes: list[int],
    *,
    causal: bool = False,
    progress: Progress | None = None,
) -> Array:
    """Joint covariances of all states of single keyframes, in the order and frames of `graphnav.observability.STATES`.

    Parameters
    ----------
    keyframes : ascending; causal : False for the whole log, True for the log up to each keyframe.

    Returns
    -------
    (T, 19, 19), or (T, 15, 15) without an odometer: bias and calibration are those of the interval that ends at the
    keyframe.
    """
    linear = build_graph(problem, data).linearize(values)
    groups = {i: _state_keys(problem, i) for i in keyframes}
    found = (_causal if causal else _smoothed)(problem, linear, groups, progress)
    size = 15 + 4 * problem.has_calibration
    to_n = np.zeros((len(keyframes), size, size))
    for k, i in enumerate(keyframes):
        rotation = values.atPose3(X(i)).rotation().matrix()
        to_n[k, :3, 6:9] = np.eye(3)
        to_n[k, 3:6, :3] = to_n[k, 6:9, 3:6] = rotation
        # GTSAM's bias has the accelerometer first, the calibration the scale
        to_n[k, 9:12, 12:15] = to_n[k, 12:15, 9:12] = np.eye(3)
        if problem.has_calibration:
            to_n[k, 15:18, 16:19] = np.eye(3)
            to_n[k, 18, 15] = 1.0
    return np.asarray(to_n @ np.array([found[i] for i in keyframes]) @ np.swapaxes(to_n, 1, 2))


def _smoothed(
    problem: Problem,
    linear: gtsam.GaussianFactorGraph,
    groups: dict[int, tuple[int, ...]],
    progress: Progress | None,
) -> dict[int, Array]:
    """Joint covariances from one elimination of everything."""
    import gtsam

    for keys in groups.values():
        linear.push_back(_tie(keys))
    ordering = gtsam.Ordering.ColamdGaussianFactorGraph(linear)
    order = [ordering.at(k) for k in range(ordering.size())]
    return joint_marginals(eliminate(linear, ordering), order, _dim, groups, progress)


def _causal(
    problem: Problem,
    linear: gtsam.GaussianFactorGraph,
    groups: dict[int, tuple[int, ...]],
    progress: Progress | None,
) -> dict[int, Array]:
    """Joint covariances from the graph cut off after each keyframe, its state eliminated last."""
    import gtsam

    waiting = sorted(((_needs(problem, linear.at(f).keys()), f) for f in range(linear.size())), reverse=True)
    so_far = gtsam.GaussianFactorGraph()
    found: dict[int, Array] = {}
    for done, (i, keys) in enumerate(groups.items(), 1):
        while waiting and waiting[-1][0] <= i:
            so_far.push_back(linear.at(waiting.pop()[1]))
        so_far.push_back(_tie(keys))
        ordering = gtsam.Ordering.ColamdConstrainedLastGaussianFactorGraph(so_far, list(keys))
        last = [ordering.at(k) for k in range(ordering.size() - len(keys), ordering.size())]
        found |= joint_marginals(eliminate(so_far, ordering), last, _dim, {i: keys})
        if progress is not None:
            progress(done, len(groups))
    return found


def _state_keys(problem: Problem, i: int) -> tuple[int, ...]:
    interval = max(i - 1, 0)
    keys = (X(i), V(i), B(int(problem.bias_epoch[interval])))
    return (*keys, C(int(problem.calibration_epoch[interval]))) if problem.has_calibration else keys


def _needs(problem: Problem, keys: list[int]) -> int:
    """The last keyframe that a factor on `keys` needs; an epoch begins with the interval that ends at it."""
    needed = 0
    for key in keys:
        letter, index = chr(key >> 56), key & ((1 << 56) - 1)
        if letter in "xv":
            needed = max(needed, index)
        elif letter in "bc" and index:
            epochs = problem.bias_epoch if letter == "b" else problem.calibration_epoch
            needed = max(needed, int(np.searchsorted(epochs, index)) + 1)
    return needed


def _tie(keys: tuple[int, ...]) -> gtsam.GaussianFactor:
    """A factor of no information on some keys: elimination then keeps them together in one clique."""
    import gtsam

    parts = gtsam.GaussianFactorGraph()
    for key in keys:
        size = _dim(key)
        parts.push_back(gtsam.JacobianFactor(key, np.zeros((1, size)), np.zeros(1), gtsam.noiseModel.Unit.Create(1)))
    return gtsam.JacobianFactor(parts)


def _dim(key: int) -> int:
    return _DIMS[chr(key >> 56)]
