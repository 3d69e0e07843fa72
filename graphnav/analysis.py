"""Observability of a log: posed and solved first, then `graphnav.observability` on what came out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

from graphnav._observability import Observability
from graphnav._stages import ProgressHook, Stages
from graphnav.config import Config
from graphnav.log import SensorLog
from graphnav.observability import of_filter, of_graph
from graphnav.smooth import posed
from graphnav.solution import solve_batch


def observe(
    log: SensorLog | str | Path,
    config: Config | None = None,
    *,
    source: Literal["graph", "filter"] = "graph",
    kind: Literal["causal", "smoothed"] = "causal",
    progress: ProgressHook | None = None,
) -> Observability:
    """Which states a log makes observable.

    Parameters
    ----------
    log : a `SensorLog`, or the folder of one; its truth is not used.
    source : whose covariances: the graph's, or the Kalman filter's (smoothed: its RTS smoother's), which does not use
        LiDAR legs.
    kind : "causal" takes each time from the log up to it, "smoothed" from the whole log.

    Raises
    ------
    LogError, ConfigError : bad input.
    SolveError : a variable without information, by name.
    """
    stages = Stages(progress)
    if isinstance(log, SensorLog):
        log = replace(log, truth=None)
    problem = posed(log, Config.given(config), stages)
    if source == "graph":
        solved = solve_batch(problem, stages)
        with stages.stage("covariance") as tick:
            return of_graph(
                problem, solved.data, solved.result.values,
                legs=solved.legs, advances=solved.advances, ranges=solved.ranges, camera=solved.camera,
                causal=kind == "causal", progress=tick,
            )  # fmt: skip
    from graphnav.baselines import rts
    from graphnav.baselines.inputs import PRESETS
    from graphnav.filtered import as_inputs

    run = rts.filtered if kind == "causal" else rts.smoothed
    with stages.stage("solve") as tick:
        estimates, _ = run(as_inputs(problem), PRESETS[problem.config.filter.preset], tick)
    return of_filter(problem, estimates, kind)
