"""Joint covariance of variables far apart, against dense inverses."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from test_covariance import dims, random_problem

from graphnav.problem import B, V, X
from graphnav.solvers.elimination import eliminate
from graphnav.solvers.joint_keys import joint_covariance


def found_and_dense(graph: gtsam.GaussianFactorGraph, keys: list[int]) -> tuple[np.ndarray, np.ndarray]:
    ordering = gtsam.Ordering.ColamdGaussianFactorGraph(graph)
    order = [ordering.at(k) for k in range(ordering.size())]
    found = joint_covariance(eliminate(graph, ordering), order, dims, keys)
    ends = np.cumsum([0, *(dims(key) for key in order)])
    rows = np.concatenate([np.arange(ends[order.index(k)], ends[order.index(k)] + dims(k)) for k in keys])
    root = np.linalg.inv(np.linalg.qr(graph.jacobian(ordering)[0], mode="r"))
    return found, root[rows] @ root[rows].T


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    "keys",
    [
        [X(3)],
        [X(0), X(39)],
        [X(30), X(2), X(17), X(16), B(4)],  # in any order, neighbours and other kinds among them
        [V(5), X(5), B(0), B(9)],
        [X(i) for i in range(40)],
    ],
    ids=["one", "both ends", "mixed", "kinds", "all"],
)
def test_joint_covariance_is_the_dense_inverse(seed: int, keys: list[int]) -> None:
    found, dense = found_and_dense(random_problem(seed, 40, 6), keys)
    sigma = np.sqrt(np.diag(dense))
    assert np.abs((found - dense) / np.outer(sigma, sigma)).max() < 1e-6


def test_chains_that_nothing_ties_have_nothing_in_common() -> None:
    """A forest: the paths up end at different roots."""
    found, dense = found_and_dense(random_problem(7, 12, 2, apart=True), [X(4), X(1007)])
    sigma = np.sqrt(np.diag(dense))
    assert np.abs((found - dense) / np.outer(sigma, sigma)).max() < 1e-6
    assert np.abs(found[:6, 6:]).max() < 1e-12


def test_it_is_symmetric_and_positive() -> None:
    found, _ = found_and_dense(random_problem(1, 40, 6), [X(0), X(20), X(39)])
    assert np.array_equal(found, found.T)
    assert np.linalg.eigvalsh(found)[0] > 0
