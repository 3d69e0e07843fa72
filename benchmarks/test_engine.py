"""The stages of a smoothing run on a ten-minute log: ``python -m pytest benchmarks``."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.conftest import MINUTES, Stages
from graphnav import preintegration as preintegration_
from graphnav.problem import V, X
from graphnav.solvers import batch
from graphnav.solvers.covariance import joint_marginals

KEYFRAMES = MINUTES * 60 + 1
DIMS = {"x": 6, "v": 3, "b": 6, "c": 4, "k": 1}


def test_preintegration(benchmark: Any, stages: Stages) -> None:
    data = benchmark(preintegration_.preintegrate, stages.problem, stages.gyro_bias, stages.accel_bias)
    assert len(data.imu_factors) == KEYFRAMES - 1


def test_preintegration_sample_by_sample(benchmark: Any, stages: Stages) -> None:
    """The peer: GTSAM fed with every sample."""
    from benchmarks.peers.chain import Chain, preintegrated

    problem = stages.problem
    chain = Chain(problem.log, problem.frontend, problem.initial)
    assert benchmark(lambda: sum(1 for _ in preintegrated(chain))) == KEYFRAMES - 1


def test_linearization(benchmark: Any, stages: Stages) -> None:
    """All factors, the odometer's as arrays."""
    linear = benchmark(stages.graph.linearize, stages.values)
    assert np.isfinite(linear.error(stages.values.zeroVectors()))


def test_linearization_of_native_factors(benchmark: Any, stages: Stages) -> None:
    linear = benchmark(stages.graph.native.linearize, stages.values)
    assert linear.size() == stages.graph.native.size()


def test_linearization_of_odometer_factors(benchmark: Any, stages: Stages) -> None:
    """As one family of arrays."""
    import gtsam

    def run() -> int:
        linear = gtsam.GaussianFactorGraph()
        stages.graph.displacements.linearize_into(linear, stages.values)
        return int(linear.size())

    assert benchmark(run) == KEYFRAMES - 1


def test_linearization_of_odometer_factors_one_by_one(benchmark: Any, stages: Stages) -> None:
    """As Python factors, the way an incremental solver has to take them."""
    import gtsam

    graph, family = gtsam.NonlinearFactorGraph(), stages.graph.displacements
    for k in range(len(family.key_i)):
        graph.add(family.factor(k))
    assert benchmark(graph.linearize, stages.values).size() == KEYFRAMES - 1


def test_batch_solve(benchmark: Any, stages: Stages) -> None:
    assert benchmark(batch.solve, stages.graph, stages.values).converged


def test_covariance_recovery(benchmark: Any, stages: Stages) -> None:
    """Joint covariance of pose and velocity at every keyframe."""
    groups = {X(i): (X(i), V(i)) for i in range(KEYFRAMES)}
    tree, order = stages.result.bayes_tree, stages.result.order
    found = benchmark(joint_marginals, tree, order, lambda key: DIMS[chr(key >> 56)], groups)
    assert len(found) == KEYFRAMES
