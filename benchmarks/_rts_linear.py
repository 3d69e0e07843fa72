"""The smoother against the dense maximum-a-posteriori solution of the very linear problem that its filter poses.

The problem is taken from a run of the smoother on a short simulated cut: transitions, process noise and measurement
rows of every epoch as they reach `kalman.interval`, and what the feedback at the keyframes does. All of F, Q, R and H
vary with time, and Q is singular. The dense solution is that of the tests (tests/linear_map.py).
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks._report import ROOT


@dataclass
class Recorded:
    """What passed through the linear core.

    Attributes
    ----------
    prior : (19, 19) covariance at the first keyframe; intervals : `linear_map.Interval`, one between two keyframes.
    smoothed : error (19,) and covariance (19, 19) of each backward step, in the order they were taken.
    """

    prior: Any = None
    intervals: list[Any] = field(default_factory=list)
    smoothed: list[tuple[Any, Any]] = field(default_factory=list)


@dataclass(frozen=True)
class Agreement:
    """How far the smoother is from the dense solution, at worst over all states and keyframes.

    Attributes
    ----------
    states : difference by the largest smoothed error, both in sigmas; covariances : of the correlations.
    keyframes, epochs, measurements : size of the problem.
    """

    states: float
    covariances: float
    keyframes: int
    epochs: int
    measurements: int


def agreement(seed: int = 0) -> Agreement:
    """Run the smoother on a short cut and solve its linear problem again, densely."""
    dense = linear_map()
    found = recorded(short_cut(seed))
    states, covariances = dense.solve(found.prior, found.intervals)
    steps = found.smoothed[-len(found.intervals) :][::-1]
    sigma = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    by_state, by_covariance, size = 0.0, 0.0, float(np.abs(states / sigma).max())
    for k, (x, p) in enumerate(steps):
        by_state = max(by_state, float(np.abs((x - states[k]) / sigma[k]).max()) / size)
        scale = np.outer(sigma[k], sigma[k])
        by_covariance = max(by_covariance, float(np.abs((p - covariances[k]) / scale).max()))
    epochs = sum(len(interval.blocks) for interval in found.intervals)
    measurements = sum(len(interval.z) for interval in found.intervals)
    return Agreement(by_state, by_covariance, len(steps) + 1, epochs, measurements)


def short_cut(seed: int) -> Any:
    """Three metres with the errors of shearer-mems, after five seconds at rest."""
    from graphnav.simulation.scenarios import MEMS
    from graphnav.simulation.shearer import simulate_shearer

    spec = replace(MEMS, length_m=3.0, cycles=1, static_s=5.0, tail_s=2.0)
    return replace(simulate_shearer("short-cut", spec, seed), truth=None)


def recorded(log: Any) -> Recorded:
    """Run the smoother on a log and keep its linear problem and its answer."""
    from graphnav._stages import Stages
    from graphnav.baselines import rts
    from graphnav.baselines.inputs import Preset
    from graphnav.baselines.plan import prior_covariance
    from graphnav.config import Config
    from graphnav.filtered import as_inputs
    from graphnav.smooth import posed

    inputs, preset = as_inputs(posed(log, Config(), Stages(None))), Preset()
    found = Recorded(prior_covariance(inputs, preset))
    with _tapped(found):
        rts.smoothed(inputs, preset)
    return found


@contextmanager
def _tapped(found: Recorded) -> Iterator[None]:
    """Within, every call of the linear core is kept."""
    from graphnav.baselines import ekf, kalman

    dense, interval, backward, feedback = linear_map(), kalman.interval, kalman.backward, ekf.fed_back

    def keep_interval(blocks: Any, noise: Any, rows: Any, epoch: Any, z: Any, x: Any, *rest: Any) -> None:
        interval(blocks, noise, rows, epoch, z, x, *rest)
        copies = (part.copy() for part in (blocks, noise, rows, epoch, z))
        found.intervals.append(dense.Interval(*copies, shift=x.copy()))

    def keep_feedback(*arguments: Any) -> Any:
        reset = feedback(*arguments)
        found.intervals[-1] = replace(found.intervals[-1], reset=reset.copy())
        return reset

    def keep_backward(*arguments: Any) -> Any:
        result = backward(*arguments)
        found.smoothed.append((result[2].copy(), result[3].copy()))
        return result

    with (
        patch.object(kalman, "interval", keep_interval),
        patch.object(kalman, "backward", keep_backward),
        patch.object(ekf, "fed_back", keep_feedback),
    ):
        yield


def linear_map() -> Any:
    """The tests' dense solution."""
    folder = str(ROOT / "tests")
    if folder not in sys.path:
        sys.path.append(folder)
    return importlib.import_module("linear_map")
