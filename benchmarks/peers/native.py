"""Peer (b): native GTSAM factors only, on the same keyframes.

`ImuFactor` from per-sample preintegration with Earth rate, biases in epochs of 60 s (one bias for all, or one per
keyframe, makes it slower or larger), `LevenbergMarquardtOptimizer`, `Marginals`. The odometer is the most natural
native stand-in: a `BetweenFactorPose3` holding the displacement in b, its rotation left free. GTSAM has no native
factor with a scale factor or mounting angles, so the calibration stays at its nominal value: this is a timing peer,
its accuracy is not compared.
"""

from __future__ import annotations

from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X

from benchmarks.peers.chain import (
    FREE_RAD,
    Array,
    Chain,
    bias_sigmas,
    common_factors,
    dead_reckoned,
    displacement,
    preintegrated,
    sigmas,
)

BIAS_EPOCH_S = 60.0


def build(chain: Chain) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """The graph and its dead-reckoned initial value."""
    log, times = chain.log, chain.keyframe_s
    assert log.odometer is not None
    graph = common_factors(chain)
    epoch = np.floor((times[:-1] - times[0]) / BIAS_EPOCH_S + 1e-9).astype(int).tolist()
    lengths = np.diff(times)
    turns: list[gtsam.Rot3] = []
    moves: list[Array] = []
    for i, (pim, distance_m) in enumerate(preintegrated(chain)):
        turn = pim.deltaRij()
        moved = displacement(turn, distance_m)
        graph.add(gtsam.ImuFactor(X(i), V(i), X(i + 1), V(i + 1), B(epoch[i]), pim))
        slip = log.odometer.slip_sigma_m_s * np.sqrt(lengths[i])
        forward = log.odometer.sigma_m_s * np.sqrt(0.1 * lengths[i])  # 10 Hz, white
        noise = sigmas(*[FREE_RAD] * 3, slip, forward, slip)
        graph.add(gtsam.BetweenFactorPose3(X(i), X(i + 1), gtsam.Pose3(turn, moved), noise))
        turns.append(turn)
        moves.append(moved)
    values = dead_reckoned(chain, turns, moves)
    add_biases(graph, values, chain, epoch[-1] + 1, B)
    return graph, values


def add_biases(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, chain: Chain, count: int, key: Any) -> None:
    """`count` biases in a chain, near enough constant, the first with its datasheet prior."""
    accel, gyro = bias_sigmas(chain.log)
    zero = gtsam.imuBias.ConstantBias()
    graph.add(gtsam.PriorFactorConstantBias(key(0), zero, sigmas(*[accel] * 3, *[gyro] * 3)))
    walk = sigmas(*[accel / 1000] * 3, *[gyro / 1000] * 3)
    for e in range(count):
        values.insert(key(e), zero)
        if e:
            graph.add(gtsam.BetweenFactorConstantBias(key(e - 1), key(e), zero, walk))


def optimise(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, solver: str = "MULTIFRONTAL_CHOLESKY"
) -> tuple[gtsam.Values, int, float]:
    """Levenberg-Marquardt with GTSAM's defaults: estimate, iterations, error."""
    params = gtsam.LevenbergMarquardtParams()
    params.setLinearSolverType(solver)
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values, params)
    found = optimizer.optimize()
    return found, optimizer.iterations(), optimizer.error()


def marginals(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, count: int) -> tuple[list[Array], int]:
    """Covariances of all poses and velocities, and how many GTSAM refused as indeterminate.

    `Marginals` eliminates by Cholesky; the Python package offers no other way in it.
    """
    try:
        solver = gtsam.Marginals(graph, values)
    except RuntimeError:
        return [], 2 * count
    found, failed = [], 0
    for i in range(count):
        for key in (X(i), V(i)):
            try:
                found.append(solver.marginalCovariance(key))
            except RuntimeError:
                failed += 1
    return found, failed
