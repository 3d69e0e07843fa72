"""Ten minutes of the full shift, cut into the stages that are timed one by one."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import pytest

# Before numpy is first imported: more BLAS threads than one slow the small matrices down.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

MINUTES = 10


@dataclass(frozen=True)
class Stages:
    """What each stage needs from the one before.

    Attributes
    ----------
    problem : log, configuration and keyframes.
    gyro_bias, accel_bias : (3,) to preintegrate at.
    data : preintegrated; values, graph : dead-reckoned initial values and all factors; result : solved.
    """

    problem: Any
    gyro_bias: Any
    accel_bias: Any
    data: Any
    values: Any
    graph: Any
    result: Any


@pytest.fixture(scope="session")
def stages() -> Stages:
    """Run once; timed again stage by stage."""
    import numpy as np

    from graphnav import graph as build
    from graphnav import initial as initial_
    from graphnav import preintegration as preintegration_
    from graphnav import problem as problem_
    from graphnav.config import Config
    from graphnav.keyframes import run_frontend
    from graphnav.simulation import simulate
    from graphnav.solvers import batch

    log, config = simulate("full-shift", seed=1, hours=MINUTES / 60), Config()
    problem = problem_.pose_problem(log, config, run_frontend(log, config))
    start, gyro_bias = initial_.start_state(problem)
    data = preintegration_.preintegrate(problem, gyro_bias, np.zeros(3))
    values = initial_.initial_values(problem, data, start)
    graph = build.build_graph(problem, data)
    return Stages(problem, gyro_bias, np.zeros(3), data, values, graph, batch.solve(graph, values))
