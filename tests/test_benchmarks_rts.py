"""The RTS benchmark: what counts as met, and that its figures are those of runs. No figure that depends on time."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.stats import binom
from tree import ROOT, python

from benchmarks import _rts_accuracy as accuracy
from benchmarks import _rts_linear as linear
from benchmarks import rts
from benchmarks._measure import Outcome
from benchmarks._report import Row
from benchmarks._shift_rows import Timed

PEAK = ": peak memory of one run in a fresh process"


def timed(hours: float, seconds: float, peak_gb: float = 0.4) -> Timed:
    figures = {"seconds": {"total": seconds, "solve": seconds / 2}, "keyframes": 10}
    return Timed(hours, Outcome(figures, peak_gb))


def by_name(rows: list[Row]) -> dict[str, Row]:
    return {r.name: r for r in rows}


# Speed ------------------------------------------------------------------------------------------------------


def test_targets_are_those_of_filter_and_smoother_together() -> None:
    batch = timed(7.1, 10.0, 0.9)
    rows = by_name(rts._method_rows("rts", timed(7.1, 20.0), batch))
    assert rows["rts 7.1 h: seconds per hour of data"].value == pytest.approx(20 / 7.1)
    assert rows["rts 7.1 h: seconds per hour of data"].met is True
    assert rows["rts 7.1 h: whole run"].ratio == 2.0
    assert rows["rts 7.1 h" + PEAK].met is True
    slow = by_name(rts._method_rows("rts", timed(7.1, 40.0, 0.6), batch))
    assert slow["rts 7.1 h: seconds per hour of data"].met is False
    assert slow["rts 7.1 h" + PEAK].met is False
    assert by_name(rts._method_rows("rts", timed(1.0, 2.0, 0.6), batch))["rts 1 h" + PEAK].met is None
    assert all(r.met is None for what in ("ekf", "batch") for r in rts._method_rows(what, timed(7.1, 99.0), batch))


def test_growth_needs_the_whole_range() -> None:
    whole = [timed(1.0, 2.0), timed(7.1, 14.2)]
    assert rts._growth("rts", whole, 1.0).value == pytest.approx(1.0)
    assert rts._growth("rts", whole, 1.0).met is True
    assert rts._growth("rts", [timed(1.0, 2.0), timed(7.1, 30.0)], 1.0).met is False
    assert rts._growth("rts", whole[:1], None).met is None
    broken = rts._growth("rts", [timed(1.0, 2.0), Timed(7.1, Outcome({}, None, "stopped"))], None)
    assert broken.value is None and broken.met is False


def test_a_failed_run_meets_nothing() -> None:
    rows = by_name(rts._method_rows("rts", Timed(7.1, Outcome({}, None, "SolveError: diverged")), timed(7.1, 1.0)))
    assert rows["rts 7.1 h: seconds per hour of data"].met is False
    assert rows["rts 7.1 h" + PEAK].met is False


# Exactness --------------------------------------------------------------------------------------------------


def test_smoother_is_the_dense_solution() -> None:
    found = linear.agreement(1)
    assert found.states < 1e-9
    assert found.covariances < 1e-9
    assert found.measurements > 200 and found.epochs > 100


def test_another_problem_has_another_solution() -> None:
    """One measurement a sigma off in the recorded problem: far outside what the target allows."""
    dense, found = linear.linear_map(), linear.recorded(linear.short_cut(1))
    states, covariances = dense.solve(found.prior, found.intervals)
    found.intervals[10].z[0] += 1.0
    moved, same = dense.solve(found.prior, found.intervals)
    sigma = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    assert np.abs((moved - states) / sigma).max() > 1e-3
    np.testing.assert_allclose(same, covariances)


def test_the_linear_core_is_put_back() -> None:
    from graphnav.baselines import ekf, kalman

    before = kalman.interval, kalman.backward, ekf.fed_back
    linear.recorded(linear.short_cut(2))
    assert (kalman.interval, kalman.backward, ekf.fed_back) == before


# Consistency ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("runs", [1, 5, 10, 20, 100])
def test_share_of_seeds_has_its_false_alarm_rate(runs: int) -> None:
    least = accuracy.allowed(runs)
    assert binom.cdf(least - 1, runs, 0.95) <= 0.01 < binom.cdf(least, runs, 0.95)


def test_twenty_seeds() -> None:
    assert accuracy.allowed(20) == 16


def test_script() -> None:
    done = python("-m", "benchmarks.rts", "--json", "--hours", "", "--seeds", "1", "--workers", "1", cwd=ROOT)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout, parse_constant=lambda text: pytest.fail(f"{text} is not JSON"))
    rows = {r["name"]: r for r in found["rows"]}
    assert len(rows) == len(found["rows"])
    assert rows["seeds that failed"]["met"] is True
    agreement = rows["rts, no closed path: rms error, batch beside"]
    assert agreement["target"] == "<= 1.15 x peer"
    assert agreement["peer"] == rows["batch, no closed path: rms error"]["value"]
    assert rows["ekf, closed path, NIS of all: share of seeds inside the 95 % band"]["target"].startswith(">= ")
    exact = "rts against the dense MAP solution of the same linear problem: relative difference of the smoothed states"
    assert rows[exact]["target"] == "<= 1e-09"


@pytest.mark.slow
def test_speed_of_short_logs(tmp_path) -> None:
    arguments = ("--hours", "0.02,0.03", "--repeats", "1", "--seeds", "0", "--cache", str(tmp_path))
    done = python("-m", "benchmarks.rts", "--json", *arguments, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    rows = {r["name"]: r for r in json.loads(done.stdout)["rows"]}
    assert rows["timed runs that failed"]["met"] is True
    for what in rts.METHODS:
        for hours in ("0.02", "0.03"):
            run = rows[f"{what} {hours} h: whole run"]
            assert 0 < rows[f"{what} {hours} h: solve"]["value"] <= run["value"]
            assert run["peer"] == (None if what == "batch" else rows[f"batch {hours} h: whole run"]["value"])
    assert rows["rts 0.03 h: solve, mechanisation alone beside"]["peer"] > 0
