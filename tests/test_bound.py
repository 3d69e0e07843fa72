"""The Cramer-Rao bound: what it equals in the limit of small errors, and what the batch smoother reaches of it."""

from __future__ import annotations

import inspect
from dataclasses import replace

import gtsam
import numpy as np
import pytest
from engine_logs import SHORT, TWO_CUTS, rows, simulated, smoothed
from scipy.stats import chi2

import graphnav as gn
import graphnav.bound as bound_module
from graphnav._metrics import truth_states
from graphnav._stages import Stages
from graphnav.bound import bound
from graphnav.config import Config
from graphnav.errors import ConfigError, GraphnavError
from graphnav.graph import build_graph
from graphnav.problem import B, C, V, X
from graphnav.simulation.scenarios import ImuGrade
from graphnav.simulation.shearer import simulate_shearer
from graphnav.smooth import posed, smooth
from graphnav.solution import solve_batch

#: SHORT with every error a hundredth of its size.
TINY = replace(
    SHORT,
    imu=ImuGrade(7.2, 0.006, 0.03, 0.0008),
    att_sigma_deg=(0.003, 0.003, 0.01),
    pos_sigma_m=0.0005,
    vel_sigma_m_s=0.0001,
    slip_sigma_m_s=0.0001,
    scale_sigma=0.0005,
    mounting_sigma_deg=(0.03, 0.005, 0.03),
    odometer_sigma_m_s=0.0001,
    survey_sigma_m=0.0002,
)


def test_equals_the_covariance_of_the_estimate_where_errors_are_tiny() -> None:
    log = simulate_shearer("tiny", TINY, 0)
    found = bound(log)
    cov = smooth(replace(log, truth=None)).trajectory.cov
    sigma, limit = (np.sqrt(np.diagonal(c, axis1=1, axis2=2)) for c in (cov, found.limit.cov))
    np.testing.assert_allclose(sigma, limit, rtol=1e-3)


def test_errors_of_thirty_seeds_scatter_as_the_bound_says() -> None:
    # Pose errors in the middle of the cut, weighted with the bound at it: 30 independent draws of 6 squares, together
    # a chi-square of 180 degrees of freedom. False-alarm rate 1e-3.
    weighted = []
    for seed in range(30):
        found = bound(simulated(SHORT, seed))
        i = int(np.searchsorted(found.t_s, 42.0))
        error = np.r_[found.achieved.att_error_b_rad[i], found.achieved.error_n_m[i]]
        weighted.append(error @ np.linalg.solve(found.limit.cov[i, :6, :6], error))
    low, high = chi2.ppf([5e-4, 1 - 5e-4], 180) / 180
    assert low < np.sum(weighted) / 180 < high


def test_where_nothing_else_tells_the_position_the_bound_is_the_prior() -> None:
    found = bound(replace(simulated(SHORT, 0), surveyed=()))
    # the prior's error is a logarithm about the declared pose: at the truth, a degree away, it bends by 1e-4
    np.testing.assert_allclose(found.sigma_n_m[0], SHORT.pos_sigma_m, rtol=1e-3)
    surveyed = bound(simulated(SHORT, 0))
    assert (surveyed.sigma_n_m[0] < 0.99 * SHORT.pos_sigma_m).all()


def test_what_no_log_records_comes_back_with_the_states_held() -> None:
    # At the minimum over everything, biases and calibration are at their minimum given the states, so steps with
    # the states held lead back there from anywhere near.
    log = replace(simulated(TWO_CUTS, 1), truth=None)
    problem = posed(log, Config.from_dict({"batch": {"tolerance_sigma": 1e-6}}), Stages(None))
    solved = solve_batch(problem, Stages(None))
    graph, values = build_graph(problem, solved.data), gtsam.Values(solved.result.values)
    for e in range(int(problem.bias_epoch[-1]) + 1):
        bias = values.atConstantBias(B(e))
        values.update(B(e), gtsam.imuBias.ConstantBias(bias.accelerometer() + 1e-3, bias.gyroscope() + 1e-5))
        values.update(C(e), values.atVector(C(e)) + 0.002)
    for _ in range(2):
        values = values.retract(bound_module._rest_given_states(graph.linearize(values), values))
    for e in range(int(problem.bias_epoch[-1]) + 1):
        was = solved.result.values
        found, before = (v.atConstantBias(B(e)) for v in (values, was))
        np.testing.assert_allclose(found.accelerometer(), before.accelerometer(), atol=1e-6)
        np.testing.assert_allclose(found.gyroscope(), before.gyroscope(), atol=1e-8)
        np.testing.assert_allclose(values.atVector(C(e)), was.atVector(C(e)), atol=2e-6)
    for i in (0, len(problem.keyframe_s) - 1):
        assert values.atPose3(X(i)).equals(was.atPose3(X(i)), 0.0)
        np.testing.assert_array_equal(values.atVector(V(i)), was.atVector(V(i)))


def test_is_linearised_at_the_truth() -> None:
    log = simulated(SHORT, 3)
    found = bound(log)
    _, pos, quat, vel = truth_states(log.truth, found.t_s)
    np.testing.assert_allclose(found.limit.pos_n, pos, atol=1e-12)
    np.testing.assert_allclose(np.abs(np.sum(found.limit.quat_nb * quat, axis=1)), 1, atol=1e-12)
    np.testing.assert_allclose(found.limit.vel_n, vel, atol=1e-12)
    np.testing.assert_allclose(found.achieved.error_n_m, smoothed(SHORT, 3).trajectory.pos_n - pos, atol=1e-9)


def test_the_smoother_is_shown_no_truth(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []

    def watched(log: object, *rest: object) -> object:
        seen.append(log.truth)
        return posed(log, *rest)

    monkeypatch.setattr(bound_module, "posed", watched)
    bound(simulated(SHORT, 0))
    assert seen == [None]


def test_shares_by_hand() -> None:
    log = simulated(TWO_CUTS, 0)
    found = bound(log)
    assert list(found.per_cycle) == [1, 2]
    cut = found.achieved.per_cycle[1]
    inside = (found.t_s >= cut.start_s) & (found.t_s <= cut.end_s)
    share = found.per_cycle[2]
    np.testing.assert_allclose(share.bound_m, np.sqrt(np.mean(found.sigma_n_m[inside] ** 2, axis=0)))
    square = np.sum(found.achieved.error_n_m[inside] ** 2, axis=1).mean()
    assert share.rms_3d_m == pytest.approx(np.sqrt(square))
    limit = np.trace(found.limit.cov[inside, 3:6, 3:6], axis1=1, axis2=2).mean()
    assert share.efficiency == pytest.approx(np.sqrt(square / limit))
    assert share.sep_m == cut.sep_m


def test_json_keys() -> None:
    found = bound(simulated(SHORT, 0))
    known = found.to_dict()
    row = {"bound_m", "rms_m", "bound_3d_m", "rms_3d_m", "efficiency", "sep_m", "max_m"}
    assert row <= set(known)
    assert set(known["per_cycle"][0]) == row | {"cycle"}
    assert np.shape(known["over_time"]["sigma_m"]) == (len(known["over_time"]["t_s"]), 3) == (known["keyframes"], 3)
    assert len(known["att_bound_deg"]) == len(known["att_rms_deg"]) == 3


def test_what_has_no_bound_is_said() -> None:
    log = simulated(SHORT, 0)
    with pytest.raises(GraphnavError, match="log engine_seed0 has no truth table to linearise at; add"):
        bound(replace(log, truth=None))
    part = replace(log, truth=rows(log.truth, log.truth.t_s <= 40.0))
    with pytest.raises(
        GraphnavError, match=r"covers 0\.000 to 40\.000 s and 4\d of 6\d keyframes, the bound needs all"
    ):
        bound(part)
    with pytest.raises(ConfigError, match="absolute"):
        bound(log, Config.from_dict({"closed_path": {"form": "absolute"}}))


def test_module_is_callable_and_public() -> None:
    assert gn.bound is bound_module
    assert inspect.signature(gn.bound) == inspect.signature(bound)
    assert gn.bound(simulated(SHORT, 0)).name == "engine_seed0"


def test_a_log_without_cycles_has_none() -> None:
    log = replace(simulated(SHORT, 0), face=None, surveyed=(), events=None)
    assert bound(log).per_cycle == {}
