"""Joint marginals from the Bayes tree against dense inverses."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from engine_logs import MEMS, SHORT, simulated, smoothed

from graphnav import graph as build
from graphnav import initial as initial_
from graphnav import preintegration as preintegration_
from graphnav import problem as problem_
from graphnav.config import Config
from graphnav.errors import SolveError
from graphnav.keyframes import run_frontend
from graphnav.problem import B, C, V, X
from graphnav.simulation.scenarios import FULL_SHIFT
from graphnav.smooth import smooth
from graphnav.solvers import batch
from graphnav.solvers import covariance as covariance_
from graphnav.solvers.clique_blocks import squared_blocks
from graphnav.solvers.covariance import joint_marginals

DIMS = {"x": 6, "v": 3, "b": 6, "c": 4}


def dims(key: int) -> int:
    return DIMS[chr(key >> 56)]


def random_problem(seed: int, count: int, loops: int, apart: bool = False) -> gtsam.GaussianFactorGraph:
    """A chain of poses and velocities with biases in epochs, loops between distant poses, and uneven sigmas.

    With `apart` a second chain that nothing ties to the first.
    """
    rng = np.random.default_rng(seed)
    graph = gtsam.GaussianFactorGraph()

    def add(*keys: int, rows: int) -> None:
        blocks = [rng.normal(size=(rows, dims(k))) * 10.0 ** rng.uniform(-2, 2) for k in keys]
        terms = [part for pair in zip(keys, blocks, strict=True) for part in pair]
        graph.add(gtsam.JacobianFactor(*terms, rng.normal(size=rows), gtsam.noiseModel.Unit.Create(rows)))

    for offset in (0, 1000) if apart else (0,):
        add(X(offset), rows=6)
        add(V(offset), rows=3)
        add(B(offset), rows=6)
        for i in range(offset, offset + count - 1):
            epoch = offset + (i - offset) // 4
            add(X(i), V(i), X(i + 1), rows=9)
            add(V(i + 1), X(i + 1), B(epoch), rows=6)
            if i > offset and (i - offset) % 4 == 0:
                add(B(epoch - 1), B(epoch), rows=6)
        for _ in range(loops):
            i, j = rng.choice(count, 2, replace=False) + offset
            add(X(int(i)), X(int(j)), rows=3)
    return graph


def eliminated(graph: gtsam.GaussianFactorGraph) -> tuple[gtsam.GaussianBayesTree, list[int]]:
    ordering = gtsam.Ordering.ColamdGaussianFactorGraph(graph)
    tree = graph.eliminateMultifrontal(ordering, gtsam.EliminateQR)
    return tree, [ordering.at(k) for k in range(ordering.size())]


def dense(graph: gtsam.GaussianFactorGraph, order: list[int]) -> tuple[np.ndarray, dict[int, np.ndarray]]:
    """Inverse of the whole information matrix (through its square root) and the rows of each variable."""
    ordering = gtsam.Ordering()
    for key in order:
        ordering.push_back(key)
    jacobian = graph.jacobian(ordering)[0]
    inverse = np.linalg.inv(np.linalg.qr(jacobian, mode="r"))
    at, rows = 0, {}
    for key in order:
        rows[key] = np.arange(at, at + dims(key))
        at += dims(key)
    return inverse @ inverse.T, rows


def assert_same(found: np.ndarray, expected: np.ndarray, relative: float) -> None:
    """Every entry to a share of the product of its two sigmas."""
    sigma = np.sqrt(np.diag(expected))
    assert np.abs((found - expected) / np.outer(sigma, sigma)).max() < relative


@pytest.mark.parametrize(("count", "loops"), [(1, 0), (2, 0), (12, 0), (12, 3), (40, 15)])
@pytest.mark.parametrize("apart", [False, True])
def test_marginals_are_blocks_of_the_dense_inverse(count: int, loops: int, apart: bool) -> None:
    for seed in range(5):
        graph = random_problem(seed, count, loops, apart)
        tree, order = eliminated(graph)
        covariance, rows = dense(graph, order)
        poses = [k for k in order if k >> 56 == ord("x") and V(k & 0xFFFF) in order]
        groups = {k: (k, V(k & 0xFFFF)) for k in poses if count > 1}
        groups |= {k: (k,) for k in order if k not in groups}
        found = joint_marginals(tree, order, dims, groups)
        assert set(found) == set(groups)
        for name, keys in groups.items():
            index = np.concatenate([rows[k] for k in keys])
            assert_same(found[name], covariance[np.ix_(index, index)], 1e-7)


@pytest.mark.parametrize("seed", range(5))
def test_variables_that_were_eliminated_last_need_no_others(seed: int) -> None:
    """As for the present: only what was eliminated last is named, and whatever shares its clique is not."""
    graph = random_problem(seed, 12, 3)
    keys = [X(6), V(6)]
    ordering = gtsam.Ordering.ColamdConstrainedLastGaussianFactorGraph(graph, keys)
    order = [ordering.at(k) for k in range(ordering.size())]
    tree = graph.eliminateMultifrontal(ordering, gtsam.EliminateQR)
    found = joint_marginals(tree, order[-2:], dims, {X(6): tuple(keys)})
    covariance, rows = dense(graph, order)
    index = np.concatenate([rows[k] for k in keys])
    assert_same(found[X(6)], covariance[np.ix_(index, index)], 1e-7)


@pytest.mark.parametrize("seed", range(5))
def test_p_in_place_of_its_root_says_the_same(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """For cliques of any size, where no variable is known to the others far better than to the world."""
    graph = random_problem(seed, 40, 15)
    for i in range(40):
        graph.add(gtsam.JacobianFactor(X(i), 10.0 * np.eye(6), np.zeros(6), gtsam.noiseModel.Unit.Create(6)))
    tree, order = eliminated(graph)
    groups = {k: (k,) for k in order}
    roots = joint_marginals(tree, order, dims, groups)
    monkeypatch.setattr(covariance_, "_LARGE", 1)
    used = []
    monkeypatch.setattr(covariance_, "_squared", lambda *a, f=covariance_._squared: used.append(1) or f(*a))
    found = joint_marginals(tree, order, dims, groups)
    assert used
    for key, cov in roots.items():
        assert_same(found[key], cov, 1e-6)


@pytest.mark.parametrize("front, wide", [(1, 1), (6, 40), (30, 3)])
def test_compiled_blocks_are_those_of_the_equation(front: int, wide: int) -> None:
    """A clique's joint covariance is the inverse of its information added to its separator's."""
    rng = np.random.default_rng(front)
    r = np.triu(rng.normal(size=(front, front)), 1) + np.diag(rng.uniform(2.0, 3.0, front))
    s, root = rng.normal(size=(front, wide)), rng.normal(size=(wide + 5, wide + 9))
    parent, rows = root @ root.T, rng.permutation(wide + 5)[:wide]
    found, good = squared_blocks(np.ascontiguousarray(np.linalg.inv(r)), s, parent, rows, 1e-4)
    information = np.hstack([r, s]).T @ np.hstack([r, s])
    information[front:, front:] += np.linalg.inv(parent[np.ix_(rows, rows)])
    expected = np.linalg.inv(information)
    assert good
    sigma = np.sqrt(expected.diagonal())
    assert np.abs((found - expected) / np.outer(sigma, sigma)).max() < 1e-9


def test_compiled_blocks_tell_what_is_known_to_the_separator_alone() -> None:
    """A sigma given the separator of 1e-5 of the sigma: P would lose digits."""
    cov, good = squared_blocks(np.array([[1e-5]]), np.array([[1e5]]), np.ones((1, 1)), np.array([0]), 1e-4)
    assert np.isclose(cov[0, 0], 1.0)
    assert not good


def test_where_p_would_lose_digits_roots_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neighbours a million times better known to each other than to the world."""
    graph, unit = gtsam.GaussianFactorGraph(), gtsam.noiseModel.Unit.Create(6)
    graph.add(gtsam.JacobianFactor(X(0), 1e-2 * np.eye(6), np.zeros(6), unit))
    for i in range(20):
        graph.add(gtsam.JacobianFactor(X(i), -1e4 * np.eye(6), X(i + 1), 1e4 * np.eye(6), np.zeros(6), unit))
    tree, order = eliminated(graph)
    groups = {k: (k,) for k in order}
    roots = joint_marginals(tree, order, dims, groups)
    monkeypatch.setattr(covariance_, "_LARGE", 1)
    with pytest.raises(covariance_._IllConditionedError):
        covariance_._marginals(tree, order, dims, groups, None, 1)
    found = joint_marginals(tree, order, dims, groups)
    assert all(np.array_equal(found[key], cov) for key, cov in roots.items())


def test_keys_of_a_group_come_in_the_order_asked_for() -> None:
    graph = random_problem(1, 6, 2)
    tree, order = eliminated(graph)
    one = joint_marginals(tree, order, dims, {0: (X(2), V(2)), 1: (V(2), X(2))})
    assert np.allclose(one[0][:6, :6], one[1][3:, 3:])
    assert np.allclose(one[0][:6, 6:], one[1][3:, :3])


def test_a_group_that_no_clique_holds_is_refused() -> None:
    graph = random_problem(1, 30, 0)
    tree, order = eliminated(graph)
    with pytest.raises(SolveError, match="no clique holds all variables of group 7"):
        joint_marginals(tree, order, dims, {7: (X(0), X(29))})


def test_progress_is_told() -> None:
    graph, seen = random_problem(1, 30, 0), []
    tree, order = eliminated(graph)
    joint_marginals(tree, order, dims, {0: (X(0),)}, lambda done, total: seen.append((done, total)))
    assert seen
    assert all(done <= total == len(order) for done, total in seen)


def test_a_variable_without_information_is_named() -> None:
    graph = gtsam.GaussianFactorGraph()
    graph.add(V(3), np.diag([1.0, 1.0, 1e-30]), np.zeros(3), gtsam.noiseModel.Unit.Create(3))
    tree, order = eliminated(graph)
    with pytest.raises(SolveError, match="nothing determines the velocity of keyframe 3"):
        joint_marginals(tree, order, dims, {0: (V(3),)})


def test_a_hard_constraint_is_refused() -> None:
    graph = gtsam.NonlinearFactorGraph()
    values = gtsam.Values()
    values.insert(V(0), np.zeros(3))
    values.insert(V(1), np.zeros(3))
    graph.add(gtsam.PriorFactorVector(V(0), np.zeros(3), gtsam.noiseModel.Constrained.All(3)))
    graph.add(gtsam.BetweenFactorVector(V(0), V(1), np.zeros(3), gtsam.noiseModel.Unit.Create(3)))
    tree, order = eliminated(graph.linearize(values))
    with pytest.raises(SolveError, match="a hard constraint"):
        joint_marginals(tree, order, dims, {0: (V(1),)})


# on the engine's own problems -------------------------------------------------------------------------------


def test_covariances_of_a_smoothed_log_are_the_dense_inverse() -> None:
    """Every 9 x 9 of a cut of 8 m with its biases, in the trajectory's order and frames."""
    log, config = simulated(SHORT), Config()
    problem = problem_.pose_problem(log, config, run_frontend(log, config))
    start, bias = initial_.start_state(problem)
    data = preintegration_.preintegrate(problem, bias, np.zeros(3))
    graph = build.build_graph(problem, data)
    result = batch.solve(graph, initial_.initial_values(problem, data, start))
    linear = graph.linearize(result.values)
    order = [*result.order]
    covariance, rows = dense(linear, order)
    count = len(problem.keyframe_s)
    groups = {X(i): (X(i), V(i)) for i in range(count)} | {B(0): (B(0),), C(0): (C(0),)}
    tree, order = eliminated(linear)
    found = joint_marginals(tree, order, dims, groups)
    for name, keys in groups.items():
        index = np.concatenate([rows[k] for k in keys])
        assert_same(found[name], covariance[np.ix_(index, index)], 1e-5)
    run = smooth(log, config)
    assert run.trajectory.cov is not None
    for i in (0, 1, count // 2, count - 1):
        rotation = result.values.atPose3(X(i)).rotation().matrix()
        turn = np.eye(9)
        turn[3:6, 3:6] = rotation  # GTSAM's position perturbation is in the body frame, the trajectory's in n
        assert_same(run.trajectory.cov[i], turn @ found[X(i)] @ turn.T, 1e-3)


def assert_sound(cov: np.ndarray) -> None:
    """Finite, symmetric and positive definite."""
    assert np.isfinite(cov).all()
    sigma = np.sqrt(np.diagonal(cov, axis1=1, axis2=2))
    assert (sigma > 0).all()
    scaled = cov / sigma[:, :, None] / sigma[:, None, :]
    assert np.abs(scaled - np.swapaxes(scaled, 1, 2)).max() < 1e-9
    assert np.linalg.eigvalsh(scaled).min() > 0


@pytest.mark.parametrize("seed", [0, 1])
def test_covariances_of_four_cycles_are_sound(seed: int) -> None:
    cov = smoothed(MEMS, seed).trajectory.cov
    assert cov is not None
    assert_sound(cov)
    # the start is known to 5 cm, the far end to 2 cm, and nothing is known to a micrometre
    position = np.sqrt(np.diagonal(cov[:, 3:6, 3:6], axis1=1, axis2=2))
    assert position.max() < 0.3
    assert position.min() > 1e-3


@pytest.mark.parametrize("hours", [0.05, 0.3, pytest.param(1.5, marks=pytest.mark.slow)])
def test_covariances_of_a_full_shift_of_any_length_are_sound(hours: float) -> None:
    """Sigmas from 1e-9 (biases) to 10 (positions far from a fix) in one matrix."""
    run = smooth(simulated(replace(FULL_SHIFT, duration_s=hours * 3600), 1))
    assert run.trajectory.cov is not None
    assert_sound(run.trajectory.cov)
    assert all(c.sigma is not None and c.sigma > 0 for c in run.calibration.values())


def test_covariances_may_be_left_out() -> None:
    run = smooth(simulated(SHORT), Config(covariance=False))
    assert run.trajectory.cov is None
    assert all(c.sigma is None for c in run.calibration.values())
