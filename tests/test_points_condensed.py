"""Points of tracked features eliminated beforehand: solution, bound and observability are those with points in them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import gtsam
import numpy as np
import pytest
from test_features_alone import roadway, smoothed
from test_stereo_in_the_graph import kept, log_of, rows

import graphnav as gn
from graphnav._stages import Stages
from graphnav.graph import SmoothingGraph
from graphnav.observability import of_graph
from graphnav.smooth import posed
from graphnav.solution import solve_batch

#: Positions as shares of their sigmas, and sigmas of one another.
SAME = 1e-5


def with_points(monkeypatch: pytest.MonkeyPatch, measure: Callable[[], object]) -> object:
    """The same where GTSAM is given the points to eliminate."""

    def whole(graph: SmoothingGraph, values: gtsam.Values) -> tuple[gtsam.GaussianFactorGraph, None]:
        return graph.linearize(values), None

    with monkeypatch.context() as patched:
        patched.setattr(SmoothingGraph, "condensed", whole)
        return measure()


def wrong_ones(log: gn.log.SensorLog) -> gn.log.SensorLog:
    """A fortieth of the readings are anywhere."""
    rng, tracks = np.random.default_rng(5), log.stereo_tracks
    off = rng.normal(0, 30, (len(tracks), 1)) * (rng.random((len(tracks), 1)) < 0.025)
    moved = np.column_stack([tracks.u_left_px, tracks.u_right_px, tracks.v_px]) + off
    return dataclasses.replace(
        log, stereo_tracks=tracks.replace(u_left_px=moved[:, 0], u_right_px=moved[:, 1], v_px=moved[:, 2])
    )


@pytest.mark.parametrize("too_large_px", [0.0, 0.3])
def test_the_solution_is_the_same(monkeypatch: pytest.MonkeyPatch, too_large_px: float) -> None:
    """Wrong readings, and the camera's disparity known or not."""
    log = wrong_ones(roadway(1, too_large_px))
    found, expected = smoothed(log), with_points(monkeypatch, lambda: smoothed(log))
    assert found.diagnostics.rejected == expected.diagnostics.rejected != {}
    sigma, known = (np.sqrt(np.diagonal(run.trajectory.cov, axis1=1, axis2=2)[:, :6]) for run in (found, expected))
    np.testing.assert_allclose(sigma, known, rtol=SAME)
    assert (np.abs(found.trajectory.pos_n - expected.trajectory.pos_n) < SAME * known[:, 3:]).all()


def test_bound_and_observability_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the first seconds under way, after a minute at rest."""
    log, end_s = log_of(1), 66.0
    imu, truth = (rows(record, record.t_s <= end_s + 1e-6) for record in (log.imu, log.truth))
    log = dataclasses.replace(log, imu=imu, truth=truth, stereo_tracks=kept(log, log.stereo_tracks.t_s <= end_s))
    problem = posed(dataclasses.replace(log, truth=None), gn.Config(), Stages(None))
    solved = solve_batch(problem, Stages(None))

    def sigmas() -> list[np.ndarray]:
        seen = of_graph(problem, solved.data, solved.result.values, camera=solved.camera, count=5)
        return [gn.bound(log).limit.cov[-1], seen.sigma]

    for found, expected in zip(sigmas(), with_points(monkeypatch, sigmas), strict=True):
        np.testing.assert_allclose(found, expected, rtol=SAME, atol=SAME * np.abs(expected).max())
