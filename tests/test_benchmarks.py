"""The benchmark scripts: their one object, what counts as met, the peers' models. No figure that depends on time."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tree import ROOT, python

from benchmarks import _shift_rows as shift
from benchmarks import accuracy, creep, lidar_accuracy
from benchmarks._measure import Outcome, measured
from benchmarks._report import Before, Row, Target, exponent, row, versions
from benchmarks.vibration import GRAVITY_M_S2, RATE_HZ, Shaking, errors, per_sample
from graphnav.config import Config
from graphnav.keyframes import run_frontend
from graphnav.log import SensorLog
from graphnav.simulation import simulate

COLUMNS = {"name", "value", "unit", "peer", "ratio", "target", "met"}


# Rows -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "value, peer, target, met",
    [
        (1.0, None, None, None),
        (1.0, None, Target(high=1.0), True),
        (1.01, None, Target(high=1.0), False),
        (50.0, None, Target(low=50.0), True),
        (49.9, None, Target(low=50.0), False),
        (0.6, None, Target(low=0.7, high=1.4), False),
        (1.5, None, Target(low=0.7, high=1.4), False),
        (1.0, None, Target(low=0.7, high=1.4), True),
        (19.0, 20.0, Target(high=1.0, of_ratio=True), True),
        (21.0, 20.0, Target(high=1.0, of_ratio=True), False),
        (0.5, None, Target(high=1.0, of_ratio=True), False),  # no peer to be faster than
        (None, None, Target(high=1.0), False),  # not measured is not met
        (float("nan"), 1.0, Target(high=1.0), False),
        (float("inf"), 1.0, Target(low=1.0), False),
    ],
)
def test_met(value: float | None, peer: float | None, target: Target | None, met: bool | None) -> None:
    made = row("figure", value, "s", peer=peer, target=target)
    assert made.met is met
    assert (made.target is None) == (target is None)


def test_ratio_is_the_value_by_the_peer() -> None:
    assert row("figure", 3.0, "s", peer=4.0).ratio == 0.75
    assert row("figure", 3.0, "s", peer=0.0).ratio is None
    assert row("figure", None, "s", peer=4.0).ratio is None


@pytest.mark.parametrize(
    "target, unit, text",
    [
        (Target(high=1.0), "GB", "<= 1 GB"),
        (Target(low=0.7, high=1.4), "1", ">= 0.7, <= 1.4"),
        (Target(high=1.0, of_ratio=True), "s", "<= 1 x peer"),
    ],
)
def test_target_text(target: Target, unit: str, text: str) -> None:
    assert target.text(unit) == text


def test_exponent_of_a_power_law() -> None:
    hours = [0.5, 1.0, 2.0, 7.1]
    assert exponent(hours, [3 * h**1.7 for h in hours]) == pytest.approx(1.7, abs=1e-12)
    assert exponent([2.0], [1.0]) is None
    assert exponent([], []) is None


def test_sources_that_change_meanwhile_are_named(capsys: pytest.CaptureFixture[str]) -> None:
    before = Before.now()
    assert versions(before)["sources"] == before.sources
    assert not capsys.readouterr().err
    assert "changed during the run" in versions(Before(before.machine, "another"))["sources"]
    assert "warning" in capsys.readouterr().err


# Measured processes -----------------------------------------------------------------------------------------

TASKS = """
import time
def grab(megabytes):
    return {"length": len(bytearray(b"x") * (megabytes * 10**6))}
def early(megabytes):
    from benchmarks._measure import peak_gb
    peak = peak_gb()
    grab(megabytes)
    return {"peak_gb": peak}
def fail():
    raise ValueError("no\\nluck")
def die():
    import os
    os._exit(3)
def sleep():
    time.sleep(60)
"""


@pytest.fixture
def task(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    (tmp_path / "odd_tasks.py").write_text(TASKS)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return "odd_tasks"


def test_peak_memory_is_the_childs_own(task: str) -> None:
    small, large = (measured(f"{task}:grab", {"megabytes": n}) for n in (1, 300))
    again = measured(f"{task}:grab", {"megabytes": 1})
    assert small.peak_gb is not None and large.peak_gb is not None and again.peak_gb is not None
    assert large.peak_gb - small.peak_gb == pytest.approx(0.3, abs=0.05)
    assert again.peak_gb == pytest.approx(small.peak_gb, abs=0.02)
    assert large.result == {"length": 300_000_000}


def test_a_task_may_note_its_peak_before_it_goes_on(task: str) -> None:
    early = measured(f"{task}:early", {"megabytes": 300})
    assert early.peak_gb is not None and early.peak_gb < 0.2


def test_failures_are_reported_not_raised(task: str) -> None:
    assert measured(f"{task}:fail", {}).error == "ValueError: no luck"
    assert measured(f"{task}:die", {}).error == "exit status 3"
    assert measured(f"{task}:sleep", {}, limit_s=1.0).error == "stopped after 1 s"


# The scripts ------------------------------------------------------------------------------------------------


def rows_of(script: str, *args: str) -> dict[str, dict[str, Any]]:
    """Rows by name of a run, its one object checked for form."""
    done = python("-m", f"benchmarks.{script}", "--json", *args, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout, parse_constant=lambda text: pytest.fail(f"{text} is not JSON"))
    assert found.keys() == {"machine", "versions", "rows"}
    assert found["versions"].keys() >= {"python", "graphnav", "sources", "gtsam", "numpy"}
    assert found["machine"]["cores"] == os.cpu_count()
    rows = found["rows"]
    assert all(r.keys() == COLUMNS for r in rows)
    assert len({r["name"] for r in rows}) == len(rows)
    for r in rows:
        assert (r["met"] is None) == (r["target"] is None), r
        assert r["met"] is None or isinstance(r["met"], bool)
    return {r["name"]: r for r in rows}


def test_shift_script(tmp_path: Path) -> None:
    small = ("--hours", "0.02,0.03", "--peer-a-sizes", "72", "--repeats", "1", "--cache", str(tmp_path))
    rows = rows_of("shift", *small)
    for method in ("batch", "isam2"):
        for hours in ("0.02", "0.03"):
            stages = [rows[f"{method} {hours} h: {stage}"]["value"] for stage in shift.STAGES]
            total = rows[f"{method} {hours} h: whole run"]["value"]
            assert 0 < sum(stages) <= total
            assert 0.05 < rows[f"{method} {hours} h: peak memory"]["value"] < 2
            assert rows[f"{method} {hours} h: covariances"]["value"] == rows[f"{method} {hours} h: keyframes"]["value"]
        assert np.isfinite(rows[f"{method}: growth exponent"]["value"])
        assert rows[f"{method}: growth exponent"]["met"] is None  # the target is for 0.5 to 7.1 h
    assert rows["batch 0.03 h: whole run"]["peer"] == rows["peer b 0.03 h: whole run"]["value"]
    assert rows["peer b 0.03 h: keyframes"]["value"] == rows["batch 0.03 h: keyframes"]["value"]
    assert rows["batch at 72 s, beside peer a: whole run"]["peer"] > 0
    assert rows["graphnav: runs that failed, indeterminate or else"]["met"] is True
    assert len(list(tmp_path.iterdir())) == 2  # 72 s is 0.02 h: simulated once


def test_vibration_script() -> None:
    rows = rows_of("vibration", "--spans", "1", "--frequencies", "5", "--cost-span", "5")
    assert {name.split()[0] for name in rows} == {"attitude", "velocity", "position", "cost"}
    assert all(r["value"] > 0 and r["peer"] > 0 for r in rows.values())


def test_accuracy_script() -> None:
    rows = rows_of("accuracy", "--seeds", "1")
    assert rows["runs of all seeds that failed"]["met"] is True
    for cycle in range(1, 5):
        assert 0 < rows[f"batch: median SEP of cycle {cycle}, isam2 beside"]["value"] < 1
    assert rows["batch, position: mean NEES"]["target"] == ">= 0.7, <= 1.4"
    assert rows["isam2 less batch: rms position, worst run"]["target"] == "<= 5 mm"


@pytest.mark.parametrize(
    "option, value, text",
    [
        ("--methods", "magic", "choose from batch,isam2"),
        ("--repeats", "0", "at least 1"),
        ("--hours", "", "at least 1"),
    ],
)
def test_wrong_arguments_are_refused(option: str, value: str, text: str) -> None:
    done = python("-m", "benchmarks.shift", option, value, cwd=ROOT)
    assert done.returncode == 2
    assert text in done.stderr
    assert not done.stdout


# Shift: targets and failures --------------------------------------------------------------------------------


def timed(hours: float, seconds: float, peak_gb: float = 0.5) -> shift.Timed:
    figures = {"seconds": {"total": seconds, "solve": seconds / 2}, "keyframes": 10, "iterations": 5}
    return shift.Timed(hours, Outcome(figures, peak_gb))


def failed(hours: float) -> shift.Timed:
    return shift.Timed(hours, Outcome({}, None, "SolveError: Indeterminate linear system"))


def by_name(rows: list[Row]) -> dict[str, Row]:
    return {r.name: r for r in rows}


def test_targets_hold_at_full_length() -> None:
    rows = by_name(shift.our_rows("batch", [timed(0.5, 1.0), timed(7.1, 15.0)], timed(7.1, 20.0), None))
    assert rows["batch 0.5 h: whole run"].met is None
    assert rows["batch 7.1 h: whole run"].met is True
    assert rows["batch 7.1 h: whole run"].ratio == 0.75
    assert rows["batch 7.1 h: peak memory"].met is True
    assert rows["batch: growth exponent"].met is True
    rows = by_name(shift.our_rows("batch", [timed(0.5, 1.0), timed(7.1, 25.0, 1.2)], timed(7.1, 20.0), None))
    assert rows["batch 7.1 h: whole run"].met is False
    assert rows["batch 7.1 h: peak memory"].met is False
    assert rows["batch: growth exponent"].met is False


def test_isam2_speed_is_that_of_the_whole_run() -> None:
    rows = by_name(shift.our_rows("isam2", [timed(0.5, 10.0), timed(7.1, 600.0)], None, None))
    faster = rows["isam2 7.1 h: times faster than real time"]
    assert faster.value == pytest.approx(42.6)
    assert faster.met is False
    assert rows["isam2: growth exponent"].met is False


def test_a_failed_run_meets_nothing() -> None:
    rows = by_name(shift.our_rows("batch", [timed(0.5, 1.0), failed(7.1)], timed(7.1, 20.0), None))
    for name in ("batch 7.1 h: whole run", "batch 7.1 h: peak memory", "batch: growth exponent"):
        assert rows[name].value is None
        assert rows[name].met is False


def test_peer_a_goes_as_far_as_it_goes() -> None:
    pairs = [(timed(n / 3600, 1e-6 * n**2), timed(n / 3600, 1e-3 * n)) for n in (500, 1000, 2000)]
    rows, slope = shift.peer_a_rows([*pairs, (failed(4000 / 3600), timed(4000 / 3600, 4.0))], 120.0)
    assert slope == pytest.approx(2.0)
    named = by_name(rows)
    assert named["peer a: growth exponent of one iteration"].value == pytest.approx(2.0)
    assert named["peer a: longest run within 120 s"].value == pytest.approx(2000 / 3600)
    assert named["batch at 2000 s, beside peer a: whole run"].ratio == pytest.approx(0.5)
    assert named["batch at 4000 s, beside peer a: whole run"].peer is None


# The peers --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def short_log() -> SensorLog:
    return simulate("full-shift", seed=2, hours=0.05)


def test_per_sample_peer_solves_the_same_problem(short_log: SensorLog) -> None:
    """Its odometer uses one sample a second where graphnav uses all ten, so they agree to their own errors only."""
    from benchmarks.peers import native, per_sample
    from benchmarks.peers.chain import Chain
    from graphnav.smooth import smooth

    assert short_log.initial is not None
    chain = Chain(short_log, run_frontend(short_log, Config()), short_log.initial)
    graph, values = per_sample.build(chain)
    estimate, _, error = native.optimise(graph, values)
    ours = smooth(short_log).trajectory
    assert ours.cov is not None
    covariances, refused = native.marginals(graph, estimate, len(chain.keyframe_s))
    assert refused == 0
    found = np.array([estimate.atPose3(per_sample.X(i)).translation() for i in range(len(ours))])
    theirs = np.array([c[3:, 3:].trace() for c in covariances[::2]])
    allowed = 5 * np.sqrt(theirs + np.trace(ours.cov[:, 3:6, 3:6], axis1=1, axis2=2))
    assert (np.linalg.norm(found - ours.pos_n, axis=1) < allowed).all()
    assert error < graph.error(values)


def test_native_peer_delivers_all_covariances(short_log: SensorLog) -> None:
    from benchmarks.peers import native
    from benchmarks.peers.chain import Chain

    assert short_log.initial is not None
    chain = Chain(short_log, run_frontend(short_log, Config()), short_log.initial)
    graph, values = native.build(chain)
    estimate, _, _ = native.optimise(graph, values)
    covariances, refused = native.marginals(graph, estimate, len(chain.keyframe_s))
    assert refused == 0
    assert len(covariances) == 2 * len(chain.keyframe_s)
    assert all(np.linalg.eigvalsh(c)[0] > 0 for c in covariances)


def test_peers_odometer_jacobians() -> None:
    import gtsam

    from benchmarks.peers.chain import sigmas
    from benchmarks.peers.per_sample import odometer_factor

    factor = odometer_factor(0, 1, 2, 0.3, sigmas(1.0, 1.0, 1.0))
    values = gtsam.Values()
    values.insert(0, gtsam.Pose3(gtsam.Rot3.RzRyRx(0.3, -0.2, 2.0), np.array([1.0, 2.0, 3.0])))
    values.insert(1, np.array([0.2, -0.4, 0.1]))
    values.insert(2, np.array([0.05, 0.02, -0.03, 0.4]))
    jacobian = factor.linearize(values).jacobian()[0]

    def moved_by(column: int, step: float) -> np.ndarray:
        whole = np.zeros(13)
        whole[column] = step
        delta = gtsam.VectorValues()
        for key, rows in ((0, slice(0, 6)), (1, slice(6, 9)), (2, slice(9, 13))):
            delta.insert(key, whole[rows])
        return np.asarray(factor.unwhitenedError(values.retract(delta)))

    numerical = np.column_stack([(moved_by(c, 1e-6) - moved_by(c, -1e-6)) / 2e-6 for c in range(13)])
    np.testing.assert_allclose(jacobian, numerical, atol=1e-8)


# Vibration: the truth ---------------------------------------------------------------------------------------


def test_shaking_is_a_motion() -> None:
    """Rates are the derivatives of what they are rates of."""
    from factors import so3

    motion, h = Shaking(10.0), 1e-6
    t_s = np.linspace(0.1, 0.3, 7)
    for state, rate in ((motion.pos_n, motion.vel_n), (motion.vel_n, motion.accel_n)):
        np.testing.assert_allclose((state(t_s + h) - state(t_s - h)) / (2 * h), rate(t_s), atol=1e-6)
    turned = (motion.attitude(t_s + h) - motion.attitude(t_s - h)) / (2 * h)
    spin = so3.transpose(motion.attitude(t_s)) @ turned
    np.testing.assert_allclose(spin, so3.skew(motion.rate_b(t_s)), atol=1e-6)


def test_samples_are_means() -> None:
    motion = Shaking(40.0)
    edge, gyro, accel = motion.samples(0.05)
    fine = (np.arange(2000) + 0.5) / 2000
    for k in range(len(gyro)):
        t_s = edge[k] + fine / RATE_HZ
        np.testing.assert_allclose(gyro[k], motion.rate_b(t_s).mean(axis=0), atol=1e-5)
        np.testing.assert_allclose(accel[k], motion.force_b(t_s).mean(axis=0), atol=1e-5)
    assert accel[:, 2].mean() == pytest.approx(GRAVITY_M_S2, abs=5.0)


def test_error_vanishes_with_the_samples_length() -> None:
    """Ten times the rate takes GTSAM's own error down by its order: the truth is right."""
    motion, found = Shaking(5.0), []
    for parts in (1, 10):
        edge = np.arange(100 * parts + 1) / (100 * parts)
        middle = (edge[1:] + edge[:-1]) / 2
        pim = per_sample(edge, motion.rate_b(middle), motion.force_b(middle))
        found.append(errors(pim, motion, 0.0, 1.0))
    assert (found[1] < 0.15 * found[0]).all()


# Accuracy: consistency --------------------------------------------------------------------------------------


def test_degrees_of_freedom_come_back() -> None:
    draws = np.random.default_rng(5).chisquare(6, size=4000) / 6
    rows = by_name(accuracy.nees_rows("x", draws.tolist(), Target(low=0.7, high=1.4)))
    assert rows["x: mean NEES"].met is True
    assert rows["x: degrees of freedom of one run"].value == pytest.approx(6.0, rel=0.1)
    assert rows["x: standard error of the mean NEES"].value == pytest.approx(np.sqrt(2 / 6 / 4000), rel=0.1)


# Creep ------------------------------------------------------------------------------------------------------


def test_creep_rows() -> None:
    """By measurement and end: largest and rms error and mean sigma of all runs; failures are counted."""
    found = [creep.Found(kind, end, 1.0, 0.5) for kind in creep.KINDS for end in creep.ENDS]
    worse = creep.Found("positions", "far", -3.0, 1.5)
    rows = {r.name: r for r in creep.all_rows([creep.Shift(0, found), "seed 1: no", creep.Shift(2, [*found, worse])])}
    assert (rows["runs of all seeds that failed"].value, rows["runs of all seeds that failed"].met) == (1.0, False)
    largest = rows["positions, far end: largest error of 3"]
    assert (largest.value, largest.met, largest.peer) == (3.0, False, None)
    near = rows["registration, near end: largest error of 2"]
    assert (near.value, near.met, near.peer) == (1.0, True, creep.PAPER_MM)
    assert rows["positions, far end: rms error"].value == pytest.approx(np.sqrt(11 / 3))
    assert rows["positions, far end: mean sigma"].value == pytest.approx(2.5 / 3)
    assert rows["registration: mean NEES"].value == 4.0
    assert [r.value for r in creep.all_rows(["seed 0: no"])] == [1.0]


# Legs -------------------------------------------------------------------------------------------------------


def test_lidar_accuracy_rows() -> None:
    """Rms and bound over all seeds, the errors of the calibration by their sigmas; failures are counted."""
    off = [1.0] * 9
    one = lidar_accuracy.Seed(0, (4e-4, 9e-4), (4e-4, 9e-4), 1.0, 1.0, off, off, 1.0)
    two = lidar_accuracy.Seed(2, (12e-4, 9e-4), (4e-4, 9e-4), 2.0, 1.0, [*off[1:], 7.0], off, 3.0)
    rows = {r.name: r for r in lidar_accuracy.all_rows([one, "seed 1: no", two])}
    assert (rows["runs of all seeds that failed"].value, rows["runs of all seeds that failed"].met) == (1.0, False)
    assert rows["bound with legs, without beside"].value == pytest.approx(0.02)
    assert rows["bound with legs, without beside"].peer == pytest.approx(0.03)
    over = rows["rms error by the bound, without legs beside"]
    assert (over.value, over.peer, over.met) == (pytest.approx(np.sqrt(2)), pytest.approx(1.0), False)
    assert rows["position: mean NEES"].value == 1.5
    assert rows["angle bias and mounting about up together: rms error by its sigma"].value == 5.0
    assert [r.value for r in lidar_accuracy.all_rows(["seed 0: no"])] == [1.0]


def test_calibration_of_the_scanner_is_compared_with_what_was_drawn() -> None:
    """Against the log's own declaration: an estimate of nothing, known as declared, is off by what was drawn."""
    from types import SimpleNamespace

    from graphnav.leg_priors import lidar_sigmas
    from graphnav.simulation.lidar import declared, draw_lidar_errors
    from graphnav.simulation.scenarios import shearer_lidar
    from graphnav.simulation.world import streams

    spec = shearer_lidar(2, False, True).lidar
    log = SimpleNamespace(lidar=declared(spec))
    sigma = lidar_sigmas(log.lidar)
    run = SimpleNamespace(stops=SimpleNamespace(scanner=np.zeros(8), cov=np.diag(sigma**2)))
    off, learnt, nees = lidar_accuracy.calibration(run, log, 5, 2)
    assert np.allclose(learnt, 1.0)
    drawn = draw_lidar_errors(spec, streams(5).lidar, 1.0)
    assert off[0] == pytest.approx(-drawn.range_scale / spec.range_scale)
    assert off[4] == pytest.approx(-drawn.angle_quadratic_per_deg / spec.angle_quadratic_per_deg)
    assert off[7] == pytest.approx(-np.degrees(drawn.mounting_rad[2]) / spec.mounting_sigma_deg[2])
    assert nees == pytest.approx(np.mean(np.square(off[:8])))
