"""Batch solver: convergence rule, damping, singular problems."""

from __future__ import annotations

from itertools import pairwise

import gtsam
import numpy as np
import pytest
from engine_logs import SHORT, simulated
from jacobians import random_rotation

from graphnav import graph as build
from graphnav import initial as initial_
from graphnav import preintegration as preintegration_
from graphnav import problem as problem_
from graphnav.config import Config
from graphnav.errors import SolveError
from graphnav.graph import SmoothingGraph
from graphnav.keyframes import run_frontend
from graphnav.problem import V, X
from graphnav.solvers import batch, elimination
from graphnav.solvers.clique_blocks import add_squares

UNIT = gtsam.noiseModel.Unit.Create


def chain(
    count: int, *, prior: bool = True, loops: int = 0, start_error: float = 0.3
) -> tuple[gtsam.NonlinearFactorGraph, ...]:
    """Poses tied to their neighbours, the values they were measured at and a start some way off."""
    rng = np.random.default_rng(1)
    poses = [gtsam.Pose3(gtsam.Rot3(random_rotation(rng)), rng.normal(0, 5, 3)) for _ in range(count)]
    graph, true, start = gtsam.NonlinearFactorGraph(), gtsam.Values(), gtsam.Values()
    if prior:
        graph.add(gtsam.PriorFactorPose3(X(0), poses[0], UNIT(6)))
    for i, pose in enumerate(poses):
        true.insert(X(i), pose)
        start.insert(X(i), pose.retract(rng.normal(0, start_error, 6)))
    pairs = [(i, i + 1) for i in range(count - 1)] + [(i, count - 1) for i in range(loops)]
    for i, j in pairs:
        measured = poses[i].between(poses[j])
        if j - i > 1:
            measured = measured.compose(gtsam.Pose3(gtsam.Rot3(), [0.1, 0, 0]))
        graph.add(gtsam.BetweenFactorPose3(X(i), X(j), measured, UNIT(6)))
    return graph, true, start


def ranges(start: list[float]) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values, np.ndarray]:
    """A point from four ranges, started where a full step overshoots."""
    anchors = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 10.0]])
    true = np.array([3.0, 4.0, 5.0])
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, anchor in enumerate(anchors):
        values.insert(V(k + 1), anchor)
        graph.add(gtsam.PriorFactorPoint3(V(k + 1), anchor, gtsam.noiseModel.Isotropic.Sigma(3, 1e-3)))
        distance = float(np.linalg.norm(true - anchor))
        graph.add(gtsam.RangeFactor3(V(0), V(k + 1), distance, gtsam.noiseModel.Isotropic.Sigma(1, 0.1)))
    values.insert(V(0), np.array(start))
    return graph, values, true


# convergence ------------------------------------------------------------------------------------------------


def test_the_minimum_is_found() -> None:
    graph, true, start = chain(20)
    result = batch.solve(graph, start)
    assert result.converged
    for i in range(20):
        assert true.atPose3(X(i)).equals(result.values.atPose3(X(i)), 1e-6)
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, start)
    assert graph.error(result.values) <= graph.error(optimizer.optimize()) + 1e-9


def test_the_last_step_is_below_the_tolerance_and_the_one_before_above() -> None:
    graph, _, start = chain(20, loops=3)
    for tolerance in (1.0, 0.01, 1e-6):
        steps = [i.step_sigmas for i in batch.solve(graph, start, tolerance_sigma=tolerance).iterations]
        assert steps[-1] <= tolerance
        assert all(s > tolerance for s in steps[:-1])


def test_step_length_is_in_joint_sigmas() -> None:
    """One variable with two priors: from 1 sigma of the combination away the step is 1."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    values.insert(V(0), np.array([0.1, 0.0, 0.0]))
    for _ in range(4):
        graph.add(gtsam.PriorFactorVector(V(0), np.zeros(3), gtsam.noiseModel.Isotropic.Sigma(3, 0.2)))
    result = batch.solve(graph, values)
    assert result.iterations[0].step_sigmas == pytest.approx(1.0)
    assert result.iterations[0].error == pytest.approx(0.5 * 4 * 0.5**2)


def test_iterations_run_out() -> None:
    graph, _, start = chain(20)
    result = batch.solve(graph, start, max_iterations=1)
    assert not result.converged
    assert len(result.iterations) == 1
    assert graph.error(result.values) < graph.error(start)
    assert set(result.order) == set(start.keys())


def test_errors_never_rise() -> None:
    for case in (chain(20, loops=5, start_error=0.6)[::2], ranges([30.0, -20.0, 0.1])[:2]):
        graph, start = case
        errors = [i.error for i in batch.solve(graph, start, max_iterations=100).iterations]
        assert all(b <= a * (1 + 1e-9) for a, b in pairwise(errors))


def test_progress_is_told() -> None:
    graph, _, start = chain(5)
    seen: list[tuple[float, float]] = []
    result = batch.solve(graph, start, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(k + 1, 25) for k in range(len(result.iterations))]


# bad starts -------------------------------------------------------------------------------------------------

OVERSHOOTING = [16.0, 4.3, -4.1]


@pytest.mark.parametrize(
    "start", [[0.05, 0.02, 0.01], OVERSHOOTING, [20.6, 0.6, 6.8], [30.0, -20.0, 0.1], [-5.0, -6.0, -7.0]]
)
@pytest.mark.parametrize("damped", [False, True])
def test_a_bad_start_reaches_the_minimum(start: list[float], damped: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """With shortened steps, and with damping alone."""
    if damped:
        monkeypatch.setattr(batch, "_shorter_step", lambda *_: None)
    graph, values, true = ranges(start)
    result = batch.solve(graph, values, max_iterations=200)
    assert result.converged
    assert result.values.atVector(V(0)) == pytest.approx(true, abs=1e-3)


def test_a_step_that_overshoots_is_shortened() -> None:
    graph, values, _ = ranges(OVERSHOOTING)
    full = values.retract(graph.linearize(values).optimize())
    assert graph.error(full) > graph.error(values)  # or this test would show nothing
    found = batch.solve(graph, values, max_iterations=200).iterations
    assert [i.damping for i in found] == [0.0] * len(found)
    assert found[1].error < 0.9 * found[0].error


def test_damping_is_used_where_no_part_of_the_step_helps(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch, "_shorter_step", lambda *_: None)
    graph, values, _ = ranges(OVERSHOOTING)
    found = batch.solve(graph, values, max_iterations=200).iterations
    assert found[0].damping > 0
    assert found[-1].damping == 0
    assert found[1].error < found[0].error


# singular ---------------------------------------------------------------------------------------------------


def test_an_undetermined_pose_is_named() -> None:
    graph, _, start = chain(5, prior=False)
    with pytest.raises(SolveError, match=r"the problem is singular: nothing determines the pose of keyframe \d; check"):
        batch.solve(graph, start)


@pytest.mark.parametrize("loops", [1, 2, 3])
def test_an_undetermined_pose_behind_loops_is_not_called_converged(loops: int) -> None:
    """More rows than unknowns, and still no rank: QR alone does not see it."""
    graph, _, start = chain(6, prior=False, loops=loops, start_error=0.0)
    with pytest.raises(SolveError, match=r"singular|no step lowers the error"):
        batch.solve(graph, start)


def test_an_error_that_is_no_number_is_refused() -> None:
    graph, _, start = chain(3)
    start.update(X(1), gtsam.Pose3(gtsam.Rot3(), [np.inf, 0, 0]))
    with pytest.raises(SolveError, match="not finite at the start"):
        batch.solve(graph, start)


# on the engine's own problem --------------------------------------------------------------------------------


def problem_at_start() -> tuple[problem_.Problem, SmoothingGraph, gtsam.Values]:
    log, config = simulated(SHORT), Config()
    problem = problem_.pose_problem(log, config, run_frontend(log, config))
    start, bias = initial_.start_state(problem)
    data = preintegration_.preintegrate(problem, bias, np.zeros(3))
    return problem, build.build_graph(problem, data), initial_.initial_values(problem, data, start)


def test_the_start_does_not_matter() -> None:
    """From dead reckoning, and from there with every pose off by 6 deg and 10 cm."""
    problem, graph, values = problem_at_start()
    rng = np.random.default_rng(2)
    off = gtsam.Values(values)
    for i in range(len(problem.keyframe_s)):
        off.update(X(i), values.atPose3(X(i)).retract(rng.normal(0, 0.1, 6)))
    results = [batch.solve(graph, v, tolerance_sigma=1e-4) for v in (values, off)]
    assert all(r.converged for r in results)
    for i in range(len(problem.keyframe_s)):
        a, b = (r.values.atPose3(X(i)).matrix() for r in results)
        assert np.allclose(a, b, rtol=0, atol=1e-5)


def test_the_gradient_vanishes_at_the_solution() -> None:
    """Scaled by the square root of each variable's information: a part of a sigma."""
    _, graph, values = problem_at_start()
    result = batch.solve(graph, values, tolerance_sigma=1e-5)
    jacobian, b = graph.linearize(result.values).jacobian()
    assert np.abs(jacobian.T @ b / np.linalg.norm(jacobian, axis=0)).max() < 1e-2


def test_arrays_and_single_factors_are_one_problem() -> None:
    """What a batch solver linearizes is what an incremental one is fed."""
    problem, graph, values = problem_at_start()
    start, bias = initial_.start_state(problem)
    data = preintegration_.preintegrate(problem, bias, np.zeros(3))
    single = gtsam.NonlinearFactorGraph()
    for found in build.build_factors(problem, data):
        single.add(found.factor)
    assert single.error(values) == pytest.approx(graph.linearize(values).error(values.zeroVectors()), rel=1e-9)
    assert start.pos_n.shape == (1, 3)


# With landmarks ---------------------------------------------------------------------------------------------


def marks(count: int, alone: int = 0) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """A chain of points, each of which sees two landmarks; and variables that share no factor with any."""
    rng = np.random.default_rng(4)
    graph, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(gtsam.PriorFactorVector(X(0), np.zeros(3), UNIT(3)))
    for i in range(count):
        start.insert(X(i), rng.normal(size=3))
        if i:
            graph.add(gtsam.BetweenFactorVector(X(i - 1), X(i), rng.normal(size=3), UNIT(3)))
        for j in (i // 5, i // 5 + 1) if i % 2 else ():
            if not start.exists(V(j)):
                start.insert(V(j), rng.normal(size=3))
            graph.add(gtsam.BetweenFactorVector(X(i), V(j), rng.normal(size=3), UNIT(3)))
    for k in range(alone):
        start.insert(V(1000 + k), rng.normal(size=3))
        graph.add(gtsam.PriorFactorVector(V(1000 + k), rng.normal(size=3), UNIT(3)))
    return graph, start


@pytest.mark.parametrize("alone", [0, 3])
@pytest.mark.parametrize("first", [True, False])
def test_landmarks_are_ordered_last_and_nothing_is_lost(alone: int, first: bool) -> None:
    graph, start = marks(40, alone)
    chain_ = [X(i) for i in range(0, 40, 2)] if first else []
    found = batch.solve(graph, start, first=chain_)
    known = batch.solve(graph, start)
    assert sorted(found.order) == sorted(known.order)
    assert found.order[: len(chain_)] == chain_
    assert found.converged
    for key in known.order:
        np.testing.assert_allclose(found.values.atVector(key), known.values.atVector(key), atol=1e-9)


def test_sound_pivots_are_those_of_a_well_conditioned_problem() -> None:
    graph, start = marks(20)
    linear = graph.linearize(start)
    ordering = elimination.ordering_of(linear, [])
    tree = linear.eliminateMultifrontal(ordering)
    order = [ordering.at(k) for k in range(ordering.size())]
    assert elimination.sound(tree, order, tree.optimize())
    # two points tied a million times better than they are known
    strong = gtsam.NonlinearFactorGraph(graph)
    strong.add(gtsam.BetweenFactorVector(X(0), X(19), np.zeros(3), gtsam.noiseModel.Isotropic.Sigma(3, 1e-6)))
    linear = strong.linearize(start)
    tree = linear.eliminateMultifrontal(ordering)
    assert not elimination.sound(tree, order, tree.optimize())


def test_squares_of_cliques_add_up_to_the_diagonal_of_the_information() -> None:
    graph, start = marks(20)
    linear = graph.linearize(start)
    ordering = elimination.ordering_of(linear, [])
    tree = linear.eliminateMultifrontal(ordering)
    order = [ordering.at(k) for k in range(ordering.size())]
    begin = np.arange(len(order) + 1) * 3
    diagonal, pivot = np.zeros(begin[-1]), np.zeros(begin[-1])
    done: set[int] = set()
    for key in order:
        if key not in done:
            conditional = tree[key].conditional()
            which = np.array([order.index(k) for k in conditional.keys()])
            columns = conditional.augmentedJacobian().T
            frontals = add_squares(columns, which, begin, diagonal, pivot)
            assert 3 * frontals == len(conditional.R())
            done.update(conditional.keys()[:frontals])
    information, _ = linear.hessian(ordering)
    np.testing.assert_allclose(diagonal, information.diagonal(), rtol=1e-12)
    assert 2 * np.log(pivot).sum() == pytest.approx(np.linalg.slogdet(information)[1], rel=1e-10)


class Shrinking:
    """The slope of ``|x|^2 / 2`` understated: what is left after each step is the share q of what was before."""

    def __init__(self, share: float) -> None:
        self.share = share

    def linearize(self, values: gtsam.Values) -> gtsam.GaussianFactorGraph:
        """A step goes the part 1 - q of the way to zero; a row of no variable's makes the error fall with each."""
        linear = gtsam.GaussianFactorGraph()
        for key in values.keys():
            linear.add(gtsam.JacobianFactor(key, np.eye(3), -(1 - self.share) * values.atVector(key), UNIT(3)))
        rest = np.sqrt(sum(float(values.atVector(key) @ values.atVector(key)) for key in values.keys()))
        linear.add(gtsam.JacobianFactor(X(0), np.zeros((1, 3)), np.array([rest]), UNIT(1)))
        return linear


@pytest.mark.parametrize("share", [0.05, 0.2, 0.5])
@pytest.mark.parametrize("landmarks", [True, False])
def test_steps_that_shrink_end_where_what_is_left_is_small(share: float, landmarks: bool) -> None:
    """With landmarks one step sooner where they shrink fast, and never with more left than the tolerance."""
    _, start = marks(10)
    found = batch.solve(Shrinking(share), start, tolerance_sigma=0.01, first=[] if landmarks else None)
    steps = [each.step_sigmas for each in found.iterations]
    usual = next(k for k in range(100) if steps[0] * share**k <= 0.01) + 1
    assert found.converged
    soon = landmarks and share < 0.25 and steps[0] * share ** (usual - 2) <= 0.03
    assert len(steps) == usual - soon
    left = np.sqrt(sum(np.sum(found.values.atVector(key) ** 2) for key in found.values.keys()))
    assert left <= 0.01


def test_a_valley_with_next_to_no_slope_is_left() -> None:
    """Errors that fall by 0.1 an iteration, each step a whole sigma: five are enough with landmarks, else never."""
    _, start = marks(10)

    class Valley:
        def __init__(self) -> None:
            self.calls = 0

        def linearize(self, values: gtsam.Values) -> gtsam.GaussianFactorGraph:
            self.calls += 1
            linear = gtsam.GaussianFactorGraph()
            for key in values.keys():
                linear.add(gtsam.JacobianFactor(key, np.eye(3), np.full(3, 0.2), UNIT(3)))
            held = gtsam.JacobianFactor(X(0), np.zeros((1, 3)), np.array([np.sqrt(100 - 0.2 * self.calls)]), UNIT(1))
            linear.add(held)
            return linear

    found = batch.solve(Valley(), start, first=[X(1)], max_iterations=20)
    assert found.converged and len(found.iterations) == 5
    assert not batch.solve(Valley(), start, max_iterations=20).converged
