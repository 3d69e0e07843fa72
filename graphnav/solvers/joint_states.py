"""Joint covariances of all states of single keyframes, from the whole graph or from the graph cut off there.

Pose, velocity, bias and calibration share factors in pairs at most. A factor without information ties those of one
keyframe together before elimination, so that one clique of the Bayes tree holds them all. With LiDAR legs the rules of
`graphnav.solvers.batch` say in which order and how to eliminate.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from factors.so3 import Array
from graphnav.camera import Camera
from graphnav.graph import build_graph
from graphnav.legs import LegReadings
from graphnav.markov_errors import slots
from graphnav.preintegration import Preintegrated
from graphnav.problem import SIZES, B, C, D, L, Problem, T, V, X
from graphnav.ranges import RangeReadings
from graphnav.solvers.covariance import joint_marginals
from graphnav.solvers.elimination import eliminate, elimination
from graphnav.solvers.joint_keys import joint_covariance

if TYPE_CHECKING:
    import gtsam

    from factors.advance import AdvanceFamily

Progress = Callable[[float, float], None]


def graph_covariances(
    problem: Problem,
    data: Preintegrated,
    values: gtsam.Values,
    keyframes: list[int],
    *,
    legs: LegReadings | None = None,
    advances: AdvanceFamily | None = None,
    ranges: RangeReadings | None = None,
    camera: Camera | None = None,
    causal: bool = False,
    progress: Progress | None = None,
) -> Array:
    """Joint covariances of all states of single keyframes, in the order and frames of `graphnav.observability.STATES`.

    Parameters
    ----------
    keyframes : ascending; causal : False for the whole log, True for the log up to each keyframe.
    legs : the readings of LiDAR legs that take part; a reading counts from the last of its detections on.
    advances : pairs of these legs; a pair counts from the first reading of the later one on.
    ranges : the UWB ranges that take part; camera : what the camera says.

    Returns
    -------
    (T, 19, 19), or (T, 15, 15) without an odometer: bias and calibration are those of the interval that ends at the
    keyframe. With legs 8 more, `graphnav.observability.LIDAR_STATES`; with a time offset of ranges one more.
    """
    graph, extra = build_graph(problem, data, legs, advances, ranges, camera), list[int]()
    if legs is not None and problem.log.lidar is not None:
        graph, extra = graph.only_legs(legs, problem.log.lidar), [D(0)]
    if ranges is not None and ranges.family.clock is not None:
        extra.append(T(0))
    groups = {i: (*_state_keys(problem, i), *extra) for i in keyframes}
    apart = {key for keys in groups.values() for key in keys}
    chain = None if graph.chain is None else [key for key in graph.chain if key not in apart]
    if causal:
        linear = graph.linearize(values)
        found = _causal(problem, linear, groups, chain, {} if legs is None else _seen(problem, legs), progress)
    else:
        found = _smoothed(problem, graph.condensed(values)[0], groups, chain, progress)
    own = 15 + 4 * problem.has_calibration
    size = own + sum(SIZES[key >> 56] for key in extra)
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
        to_n[k, own:, own:] = np.eye(size - own)
    return np.asarray(to_n @ np.array([found[i] for i in keyframes]) @ np.swapaxes(to_n, 1, 2))


def _smoothed(
    problem: Problem,
    linear: gtsam.GaussianFactorGraph,
    groups: dict[int, tuple[int, ...]],
    chain: list[int] | None,
    progress: Progress | None,
) -> dict[int, Array]:
    """Joint covariances from one elimination of everything."""
    for keys in groups.values():
        linear.push_back(_tie(keys))
    tree, order = elimination(linear, chain)
    return joint_marginals(tree, order, _sizes(problem), groups, progress)


def _causal(
    problem: Problem,
    linear: gtsam.GaussianFactorGraph,
    groups: dict[int, tuple[int, ...]],
    chain: list[int] | None,
    seen: dict[tuple[int, ...], int],
    progress: Progress | None,
) -> dict[int, Array]:
    """Joint covariances from the graph cut off after each keyframe."""
    import gtsam

    waiting = sorted(((_needs(problem, linear.at(f).keys(), seen), f) for f in range(linear.size())), reverse=True)
    so_far = gtsam.GaussianFactorGraph()
    found: dict[int, Array] = {}
    for done, (i, keys) in enumerate(groups.items(), 1):
        while waiting and waiting[-1][0] <= i:
            so_far.push_back(linear.at(waiting.pop()[1]))
        so_far.push_back(_tie(keys))
        if chain is None:
            found |= _state_last(so_far, i, keys, _sizes(problem))
        else:
            tree, order = elimination(so_far, _first(so_far, chain))
            found[i] = joint_covariance(tree, order, _sizes(problem), list(keys))
        if progress is not None:
            progress(done, len(groups))
    return found


def _state_last(
    so_far: gtsam.GaussianFactorGraph, i: int, keys: tuple[int, ...], dims: Callable[[int], int]
) -> dict[int, Array]:
    """The joint covariance of keyframe i's `keys`, eliminated last so that nothing below need be looked at."""
    import gtsam

    ordering = gtsam.Ordering.ColamdConstrainedLastGaussianFactorGraph(so_far, list(keys))
    last = [ordering.at(k) for k in range(ordering.size() - len(keys), ordering.size())]
    return joint_marginals(eliminate(so_far, ordering), last, dims, {i: keys})


def _first(so_far: gtsam.GaussianFactorGraph, chain: list[int]) -> list[int]:
    """The part of the chain that the graph so far has."""
    known = set(so_far.keyVector())
    return [key for key in chain if key in known]


def _seen(problem: Problem, legs: LegReadings) -> dict[tuple[int, ...], int]:
    """Keyframe from which on a reading is known, by the keys of its pose and leg, and a leg, by its own key.

    Detections go to the nearest window, so a window is over half way to the next.
    """
    t_s, centre = problem.keyframe_s, np.unique(legs.window)
    over_s = np.append((t_s[centre][1:] + t_s[centre][:-1]) / 2, t_s[-1])
    over = dict(zip(centre.tolist(), np.searchsorted(t_s, over_s).tolist(), strict=True))
    found: dict[tuple[int, ...], int] = {}
    for leg, i, window in zip(legs.leg.tolist(), legs.keyframe.tolist(), legs.window.tolist(), strict=True):
        known, own = over[window], (L(leg),)
        # two windows may be read at the keyframe between them
        found[X(i), L(leg)] = max(known, found.get((X(i), L(leg)), 0))
        found[own] = min(known, found.get(own, known))
    return found


def _state_keys(problem: Problem, i: int) -> tuple[int, ...]:
    interval = max(i - 1, 0)
    keys = (X(i), V(i), B(int(problem.bias_epoch[interval])))
    return (*keys, C(int(problem.calibration_epoch[interval]))) if problem.has_calibration else keys


def _needs(problem: Problem, keys: list[int], seen: dict[tuple[int, ...], int]) -> int:
    """The last keyframe that a factor on `keys` needs; an epoch begins with the interval that ends at it.

    Parameters
    ----------
    seen : from `_seen`; what is known of a leg never seen is never needed.
    """
    legs = [key for key in keys if key >> 56 == ord("l")]
    poses = [key for key in keys if key >> 56 == ord("x")]
    if legs:
        read: list[tuple[int, ...]] = [(pose, leg) for pose in poses for leg in legs]
        read = read or [(leg,) for leg in legs]
        return max(seen.get(key, len(problem.keyframe_s)) for key in read)
    needed = 0
    for key in keys:
        letter, index = chr(key >> 56), key & ((1 << 56) - 1)
        if letter in "xvm":
            needed = max(needed, index)
        elif letter in "bc" and index:
            epochs = problem.bias_epoch if letter == "b" else problem.calibration_epoch
            needed = max(needed, int(np.searchsorted(epochs, index)) + 1)
    # a range lies between the keyframe whose pose it has and the next
    between = 1 if any(key >> 56 == ord("a") for key in keys) else 0
    return max([needed, *(pose - X(0) + between for pose in poses)])


def _tie(keys: tuple[int, ...]) -> gtsam.GaussianFactor:
    """A factor of no information on some keys: elimination then keeps them together in one clique."""
    import gtsam

    parts = gtsam.GaussianFactorGraph()
    for key in keys:
        size = SIZES[key >> 56]
        parts.push_back(gtsam.JacobianFactor(key, np.zeros((1, size)), np.zeros(1), gtsam.noiseModel.Unit.Create(1)))
    return gtsam.JacobianFactor(parts)


def _sizes(problem: Problem) -> Callable[[int], int]:
    """Size of the variable of a key."""
    sizes = SIZES | {ord("m"): slots(problem)}
    return lambda key: sizes[key >> 56]
