"""Where measurements do not come together, the error says which kind of the log to look at first."""

from __future__ import annotations

import dataclasses
import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from engine_logs import SHORT, simulated
from test_graph import config, posed, prepared
from uwb_logs import passing

import graphnav.rounds
from graphnav.camera import Camera
from graphnav.costs import costs, parted, suspects
from graphnav.errors import SolveError
from graphnav.graph import build_graph
from graphnav.initial import initial_values, start_state
from graphnav.log import Position, SensorLog
from graphnav.range_rounds import posed_ranges
from graphnav.smooth import smooth
from graphnav.solvers import batch
from graphnav.solvers.batch import StuckError

IN_ALL = {
    "odometer", "IMU samples", "initial pose and positions", "velocities at rest", "motions between keyframes",
    "declared IMU biases", "declared odometer calibration",
}  # fmt: skip


def solved(log: SensorLog) -> tuple[Any, Any]:
    """The graph of a log and its solution."""
    problem = posed(log)
    data = prepared(problem)
    values = initial_values(problem, data, start_state(problem)[0])
    graph = build_graph(problem, data, ranges=posed_ranges(problem, data, values))
    return graph, batch.solve(graph, values).values


@pytest.mark.parametrize("log", [simulated(SHORT), passing(1)], ids=["shearer", "uwb"])
def test_costs_are_all_of_the_error_and_no_more_than_declared(log: SensorLog) -> None:
    graph, values = solved(dataclasses.replace(log, truth=None))
    found = costs(graph, values)
    total = 2 * graph.linearize(values).error(values.zeroVectors())
    assert sum(chi2 for chi2, _ in found.values()) == pytest.approx(total, rel=1e-9)
    assert "others" not in found and ("UWB ranges" in found) == (log.uwb is not None)
    assert log.odometer is None or set(found) >= IN_ALL
    assert all(chi2 < 3 * rows for chi2, rows in found.values())
    assert suspects(graph, values) == ""


def contradicting(log: SensorLog) -> SensorLog:
    """With positions every 10 s that are 50 m off by turns, declared good to 1 mm."""
    t_s = np.arange(5.0, log.imu.t_s[-1] - 5, 10.0)
    off = np.outer(np.where(np.arange(len(t_s)) % 2, 50.0, -50.0), [1.0, 1.0, 0.0])
    return dataclasses.replace(log, position=Position(t_s=t_s, pos_n_m=off, sigma_n_m=np.full((len(t_s), 3), 1e-3)))


def test_the_log_is_suspected_before_the_iterations() -> None:
    with pytest.raises(SolveError) as caught:
        smooth(contradicting(simulated(SHORT)), config(batch={"max_iterations": 2}))
    text = str(caught.value)
    dear = re.search(r"check the log's sigmas first: (.*) cost ([0-9,]+) per residual where 1 is expected;", text)
    assert dear is not None and int(dear[2].replace(",", "")) > 1000, text
    assert text.index("check the log") < text.index("raise batch.max_iterations")


def test_a_solver_that_gets_stuck_says_what_stands_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where no step lowers the error (here: not one is tried)."""

    def stuck(problem: Any, graph: Any, values: Any, *_: object) -> None:
        raise StuckError(values)

    monkeypatch.setattr(graphnav.rounds, "_solved", stuck)
    with pytest.raises(SolveError) as caught:
        smooth(contradicting(simulated(SHORT)))
    text = str(caught.value)
    dear = re.search(
        r"^no step lowers the error: .* first: (.*) cost ([0-9,]+) per residual where 1 is expected; ", text
    )
    assert dear is not None and int(dear[2].replace(",", "")) > 1000, text
    assert text.endswith("declare [initial] nearer to it")


def test_what_was_left_out_is_told_where_it_is_much() -> None:
    graph, values = solved(dataclasses.replace(simulated(SHORT), truth=None))
    assert suspects(graph, values, {"UWB ranges": (6584, 6586)}) == "6,584 of 6,586 UWB ranges disagree with the rest"
    assert suspects(graph, values, {"UWB ranges": (1, 6586)}) == ""


def test_parts_are_counted() -> None:
    some, few = SimpleNamespace(row=np.arange(7)), SimpleNamespace(row=np.arange(3))
    assert parted((some, few), (None, None)) == {"UWB ranges": (3, 10)}
    assert parted((some, None), (Camera(None, some), Camera(None, few))) == {"camera readings": (3, 10)}
