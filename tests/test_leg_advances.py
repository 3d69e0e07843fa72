"""Legs of successive cycles tied by the push of their support: who was who, the factor, and what it gives."""

from __future__ import annotations

import dataclasses
from dataclasses import replace
from functools import cache

import gtsam
import numpy as np
import pytest

from factors.advance import AdvanceFamily
from graphnav._stages import Stages
from graphnav.config import Config
from graphnav.leg_advances import _pairs, leg_advances
from graphnav.log import SensorLog
from graphnav.problem import L
from graphnav.run import Run
from graphnav.simulation.lidar_figures import LidarSpec
from graphnav.simulation.scenarios import LIDAR
from graphnav.simulation.shearer import simulate_shearer
from graphnav.smooth import posed, smooth
from graphnav.solution import solve_batch

#: Three cuts of 30 m at three times the speed, every error drawn: two advances of every support.
SPEC = replace(
    LIDAR, length_m=30.0, cycles=3, speed_m_s=0.3, static_s=20.0, tail_s=1.0, pause_s=3.0, retreat_m=24.0,
    crossing_m=20.0, end_work_s=None, duration_s=None, att_error_deg=None, mounting_deg=None,
    lidar=LidarSpec(draw=True),
)  # fmt: skip


@cache
def log(seed: int) -> SensorLog:
    return simulate_shearer("advances", SPEC, seed)


@cache
def run(seed: int, advances: bool, form: str) -> Run:
    config = {"lidar": {"advances": advances}, "closed_path": {"form": form}}
    return smooth(dataclasses.replace(log(seed), truth=None), Config.from_dict(config))


@pytest.mark.parametrize("seed", range(2))
def test_every_pair_is_one_support(seed: int) -> None:
    """The simulator numbers supports through, advance by advance: pairs differ by the number of supports."""
    problem = posed(dataclasses.replace(log(seed), truth=None), Config(), Stages(None))
    solved = solve_batch(problem, Stages(None))
    assert solved.legs is not None
    family = leg_advances(problem, solved.legs, solved.result.values)
    assert family is not None
    feature = solved.legs.feature
    apart = feature[family.key_j - L(0)] - feature[family.key_i - L(0)]
    assert len(set(apart.tolist())) == 1
    assert len(apart) > 10
    # the push's own scatter, and what a lean makes of it: chi-square of as many, false-alarm rate 1e-4
    squares = float(((family.residuals(solved.result.values) / family.sigma_m) ** 2).sum())
    assert 0.3 < squares / len(apart) < 2.5


def test_pairs_are_mutual_and_in_order_of_time() -> None:
    """Legs 0 and 1 were before, 2 to 4 come after; 3 is the nearer of two to where 1 is pushed, 4 was there already."""
    place = np.array([[0.0, 0.0], [1.5, 0.0], [0.05, 1.0], [1.52, 1.01], [1.4, 1.1]])
    first, last = np.array([0.0, 1.0, 20.0, 21.0, 1.5]), np.array([5.0, 6.0, 30.0, 31.0, 2.0])
    before, after = _pairs(place, np.ones(5), first, last, np.array([0.75, 0.3]))
    assert sorted(zip(before.tolist(), after.tolist(), strict=True)) == [(0, 2), (1, 3)]
    none, _ = _pairs(place + np.arange(5)[:, None] * 10, np.ones(5), first, last, np.array([0.75, 0.3]))
    assert not len(none)


def test_the_linear_factors_are_those_of_the_residual() -> None:
    rng = np.random.default_rng(1)
    across = np.array([0.6, -0.8])
    family = AdvanceFamily(L(0) + np.array([0, 1]), L(0) + np.array([2, 3]), across, np.ones(2), np.array([0.03, 0.05]))
    values = gtsam.Values()
    for j in range(4):
        values.insert(L(j), rng.normal(size=4))
    linear = gtsam.GaussianFactorGraph()
    family.linearize_into(linear, values)
    step = values.zeroVectors()
    delta = gtsam.VectorValues()
    for j in range(4):
        delta.insert(L(j), rng.normal(size=4))
    for vectors, at in ((step, values), (delta, values.retract(delta))):
        whitened = family.residuals(at) / family.sigma_m
        assert linear.error(vectors) == pytest.approx(0.5 * float((whitened**2).sum()))


@pytest.mark.parametrize("form", ["off", "relative"])
def test_advances_add_information(form: str) -> None:
    """How much is for `benchmarks.lidar`: a short log drifts too little to tell."""
    with_, without = (run(0, advances, form).trajectory.cov[:, 3, 3] for advances in (True, False))
    assert (with_ <= without * (1 + 1e-3)).all()
    assert with_.sum() < without.sum()


@pytest.mark.parametrize("seed", range(4))
def test_errors_stay_within_their_sigmas(seed: int) -> None:
    """Largest of the last third of the log, each axis within 4 sigma (false-alarm rate 1e-3 for all)."""
    from graphnav.evaluation import evaluate

    found = run(seed, True, "off")
    error = evaluate(found.trajectory, log(seed)).error_n_m
    sigma = np.sqrt(np.diagonal(found.trajectory.cov, axis1=1, axis2=2)[: len(error), 3:6])
    assert (np.abs(error[-len(error) // 3 :]) < 4 * sigma[-len(error) // 3 :]).all()
