"""Filter and smoother on simulated shifts: exact without errors, one with the other, and what they refuse.

Where nothing else is said the closed path is left out: its two passes are taken for independent.
"""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from engine_logs import SHORT, TWO_CUTS, rows, simulated, smoothed, until, without_imu
from filter_runs import FILTERS, config, errors, faceless, inputs_of, run_of
from scipy import stats

from factors.so3 import from_quaternion
from graphnav._metrics import attitude_error
from graphnav.baselines import kalman, rts, strapdown
from graphnav.baselines.inputs import PRESETS
from graphnav.baselines.plan import odometer_plan, prior_covariance
from graphnav.baselines.states import ACCEL_BIAS, POS, unpacked
from graphnav.errors import ConfigError, LogError, SolveError
from graphnav.evaluation import evaluate
from graphnav.log import Position, SensorLog
from graphnav.smooth import smooth

# without errors ---------------------------------------------------------------------------------------------


@cache
def exact() -> SensorLog:
    """Two cuts whose sensors, start and mounting are exact, declared with the usual sigmas."""
    spec = dataclasses.replace(TWO_CUTS, slip_sigma_m_s=1e-9, mounting_sigma_deg=(1e-9, 1e-9, 1e-9))
    log = simulated(spec, 0, False)
    usual = simulated(TWO_CUTS).odometer
    declared = log.odometer.replace(slip_sigma_m_s=usual.slip_sigma_m_s, mounting_sigma_deg=usual.mounting_sigma_deg)
    return faceless(dataclasses.replace(log, odometer=declared))


@pytest.mark.parametrize("method", FILTERS)
def test_exact_sensors_give_the_truth(method: str) -> None:
    """Five minutes: 10 um and 1e-6 rad at every keyframe (3 um, 2e-7 rad measured), sigmas of centimetres."""
    run = smooth(exact(), method=method)
    attitude, pos = errors(run, exact())
    assert np.abs(pos).max() < 1e-5
    assert np.abs(attitude).max() < 1e-6
    assert max(abs(c.value / c.sigma) for c in run.calibration.values()) < 1e-3
    assert np.sqrt(run.trajectory.cov[-1, 3, 3]) > 0.01
    assert run.innovations.nis().mean < 1e-6


# filter and smoother ----------------------------------------------------------------------------------------


def test_smoothing_never_widens_a_covariance() -> None:
    """All 19 states at every keyframe, with the closed path too: the forward pass is the smoother's own."""
    inputs = inputs_of(simulated(TWO_CUTS, 3))
    assert inputs.closed_path
    forward, out = rts._online(inputs, PRESETS["matched"], None)
    rts.smooth_span(forward, 0, len(inputs.keyframe_s) - 1, out)
    before, after = unpacked(np.asarray(forward.estimates.covariance)), unpacked(np.asarray(out.covariance))
    unit = 1 / np.sqrt(np.diagonal(before, axis1=1, axis2=2))
    gain = np.linalg.eigvalsh((before - after) * unit[:, :, None] * unit[:, None, :])
    assert gain.min() > -1e-9
    assert gain[len(gain) // 2].max() > 0.5
    assert np.linalg.eigvalsh(after * unit[:, :, None] * unit[:, None, :]).min() > -1e-9


def test_at_the_last_keyframe_there_is_nothing_to_smooth() -> None:
    ekf, rts_ = run_of(TWO_CUTS, 0, "ekf").trajectory, run_of(TWO_CUTS, 0, "rts").trajectory
    for name in ("pos_n", "quat_nb", "vel_n", "cov"):
        assert np.array_equal(getattr(ekf, name)[-1], getattr(rts_, name)[-1]), name
        assert not np.array_equal(getattr(ekf, name)[-60], getattr(rts_, name)[-60]), name


def test_online_is_the_filter_after_the_last_cut_and_the_smoother_within_one() -> None:
    """A cycle's states know what was measured until its cut ended: as if the log had stopped there."""
    log = faceless(simulated(TWO_CUTS, 1))
    online, ekf = (run_of(TWO_CUTS, 1, method).trajectory for method in ("rts-online", "ekf"))
    inputs = inputs_of(log)
    first, second = (cycle.end_s for cycle in inputs.cycles)
    after = online.t_s > second - 1e-6
    assert after.sum() > 4
    for name in ("pos_n", "quat_nb", "vel_n", "cov"):
        assert np.array_equal(getattr(online, name)[after], getattr(ekf, name)[after]), name
        assert not np.array_equal(getattr(online, name)[~after][-5], getattr(ekf, name)[~after][-5]), name
    # to the next IMU sample, 3 ms after the cut's end
    stopped = dataclasses.replace(until(log, first + 0.004), events=rows(log.events, log.events.t_s <= first))
    assert np.allclose(inputs_of(stopped).rest_s, inputs.rest_s[inputs.rest_s[:, 1] <= first + 1e-6])
    alone = smooth(stopped, method="rts").trajectory
    known = online.t_s <= first + 1e-6
    assert np.allclose(online.t_s[known], alone.t_s[:-1], atol=1e-9)
    # sigmas are centimetres; the last sample's slope is one-sided where the log stops
    assert online.pos_n[known] == pytest.approx(alone.pos_n[:-1], abs=1e-6)
    sigma, other = (np.sqrt(np.diagonal(c, axis1=1, axis2=2)) for c in (online.cov[known], alone.cov[:-1]))
    assert sigma == pytest.approx(other, rel=1e-4)


def test_smoothing_between_cuts_does_not_change_what_is_smoothed_in_the_end() -> None:
    """Without closed-path points nothing that the smoother finds on the way comes back to the filter."""
    inputs = inputs_of(faceless(simulated(TWO_CUTS, 2)))
    forward, out = rts._online(inputs, PRESETS["matched"], None)
    plain, _ = rts.filtered(inputs, PRESETS["matched"])
    assert np.array_equal(forward.estimates.pos_n, plain.pos_n)
    with_path = inputs_of(simulated(TWO_CUTS, 2))
    forward, out = rts._online(with_path, PRESETS["matched"], None)
    plain, _ = rts.filtered(with_path, PRESETS["matched"])
    points = [with_path.index(p.second_s) for p in with_path.closed_path]
    assert np.array_equal(forward.estimates.pos_n[: min(points)], plain.pos_n[: min(points)])
    assert not np.allclose(forward.estimates.pos_n[-1], plain.pos_n[-1], atol=1e-6)
    # optimal points updated at once: the first passes are the smoothed ones
    first = with_path.index(with_path.closed_path[0].first_s)
    assert np.array_equal(forward.passes[first].nominal.pos_n, out.pos_n[first])


def test_how_often_errors_are_fed_back_changes_little() -> None:
    """At every odometer sample instead of once a second, with the same information at rest.

    Over sixteen logs smoothed positions differ by 0.13 of their sigma (rms) and attitudes by 0.24, sigmas by 2 %; the
    errors of position are the same, those of heading an eighth smaller.
    """
    often = config(keyframes={"interval_s": 0.1}, rest={"velocity_sigma_m_s": 1e-4 * np.sqrt(10)})
    moved, sizes = [], []
    for spec, seed in ((SHORT, 0), (SHORT, 1), (TWO_CUTS, 0), (TWO_CUTS, 1)):
        a, b = run_of(spec, seed, "rts").trajectory, smooth(faceless(simulated(spec, seed)), often, "rts").trajectory
        same = np.searchsorted(b.t_s, a.t_s - 1e-9)
        assert b.t_s[same] == pytest.approx(a.t_s)
        sigma, other = (np.sqrt(np.diagonal(c, axis1=1, axis2=2))[:, :6] for c in (a.cov, b.cov[same]))
        moved.append(np.hstack([attitude_error(a.quat_nb, b.quat_nb[same]), a.pos_n - b.pos_n[same]]) / sigma)
        sizes.append(np.mean(other / sigma))
    rms = np.sqrt(np.mean([np.mean(m**2, axis=0) for m in moved], axis=0)).reshape(2, 3)
    assert rms[0].max() < 0.5
    assert rms[1].max() < 0.3
    assert sizes == pytest.approx([1.0] * 4, abs=0.06)


# presets ----------------------------------------------------------------------------------------------------


def test_the_papers_preset_is_appendix_a(monkeypatch: pytest.MonkeyPatch) -> None:
    """P0 x 3 and Q x 5 in sigmas: 9 and 25 in variances; random walks are none of the paper's Q."""
    inputs = inputs_of(faceless(simulated(SHORT)), rest={"use": False})
    matched, paper = PRESETS["matched"], PRESETS["paper"]
    assert prior_covariance(inputs, paper) == pytest.approx(9 * prior_covariance(inputs, matched))
    noises = []

    def first(blocks, noise, *rest):
        noises.append(noise.copy())
        raise StopIteration

    monkeypatch.setattr(kalman, "interval", first)
    for preset in (matched, paper):
        with pytest.raises((StopIteration, RuntimeError)):
            rts.filtered(inputs, preset)
    navigation = (slice(None), slice(9), slice(9))
    assert noises[1][navigation] == pytest.approx(25 * noises[0][navigation], rel=1e-9, abs=0)
    assert np.array_equal(noises[1][:, 9:], noises[0][:, 9:])
    # equation 19 at every sample, instead of once in a second's slip
    assert odometer_plan(inputs, paper)[1].all()
    assert odometer_plan(inputs, matched)[1].mean() == pytest.approx(0.1, abs=0.01)


@pytest.mark.parametrize("method", ["ekf", "rts"])
def test_the_papers_preset_expects_larger_innovations(method: str) -> None:
    log = faceless(simulated(TWO_CUTS))
    run = smooth(log, config(filter={"preset": "paper"}), method)
    matched = run_of(TWO_CUTS, 0, method)
    for kind in ("speed", "zero rate", "zero velocity"):
        assert run.innovations.nis(kind).mean < matched.innovations.nis(kind).mean, kind
    # the slip of one second counted ten times: no better for it
    assert evaluate(matched.trajectory, log).rms_m.max() < evaluate(run.trajectory, log).rms_m.max() < 2.0


# what is measured -------------------------------------------------------------------------------------------


def test_prior_is_what_is_declared() -> None:
    """Attitude sigmas are about the body's axes, the state's errors about those of n."""
    log = simulated(SHORT)
    w = np.sqrt(0.5)
    turned = dataclasses.replace(
        log, initial=log.initial.replace(quat_nb_wxyz=[w, 0, 0, w], att_sigma_deg=[0.1, 0.2, 0.3])
    )
    inputs = inputs_of(turned, rest={"use": False})
    p = prior_covariance(inputs, PRESETS["matched"])
    # a quarter turn to the left: right is north, forward is west
    assert from_quaternion(turned.initial.quat_nb_wxyz) @ [1.0, 0, 0] == pytest.approx([0, 1.0, 0])
    assert np.degrees(np.sqrt(np.diag(p)[3:6])) == pytest.approx([0.2, 0.1, 0.3])
    assert np.sqrt(np.diag(p)[POS]) == pytest.approx(log.initial.pos_sigma_m)
    assert np.sqrt(np.diag(p)[ACCEL_BIAS]) == pytest.approx([3 * 9.80665e-3] * 3)
    assert np.degrees(np.sqrt(np.diag(p)[15:18])) == pytest.approx(log.odometer.mounting_sigma_deg)


def test_every_odometer_sample_in_motion_is_used_once() -> None:
    """At rest it would say again, with noise, that the velocity is zero; innovations are in order of their times."""
    for seed, keep in ((0, 1.0), (1, 0.6)):
        log = faceless(simulated(SHORT, seed))
        used = np.random.default_rng(1).random(len(log.odometer)) <= keep
        log = dataclasses.replace(log, odometer=rows(log.odometer, used))
        inputs, run = inputs_of(log), smooth(log, method="ekf")
        interval = np.searchsorted(inputs.keyframe_s, log.odometer.t_s - 1e-6) - 1
        moving = ~inputs.resting()[interval]
        assert 0.4 < moving.mean() < 0.6
        innovations = run.innovations
        speed = innovations.kind == innovations.kinds.index("speed")
        assert innovations.t_s[speed] == pytest.approx(log.odometer.t_s[moving], abs=1e-6)
        assert (np.diff(innovations.t_s) >= 0).all()
        assert (innovations.variance >= 1.0).all()


@pytest.mark.parametrize("method", FILTERS)
def test_positions_instead_of_a_face(method: str) -> None:
    """Fixes every 10 s of 10 cm, without an odometer: NEES and NIS of their rows near one."""
    log = simulated(TWO_CUTS, 4)
    take = slice(1000, None, 1000)
    pos = log.truth.pos_n_m[take]
    noise = np.random.default_rng(5).normal(0, 0.1, pos.shape)
    fixes = Position(t_s=log.truth.t_s[take], pos_n_m=pos + noise, sigma_n_m=np.full(pos.shape, 0.1))
    fixed = dataclasses.replace(log, face=None, surveyed=(), events=None, odometer=None, position=fixes)
    run = smooth(fixed, method=method)
    found = evaluate(run.trajectory, fixed)
    assert found.rms_m.max() < (0.3 if method != "rts" else 0.1)
    assert 0.2 < found.nees_position < 3.0
    nis = run.innovations.nis("position")
    low, high = stats.chi2.interval(1 - 1e-3, nis.rows)
    assert low < nis.rows * nis.mean < high
    assert "odometer_scale" not in run.calibration


@pytest.mark.parametrize("method", ["ekf", "rts"])
def test_an_imu_alone_is_inertial_navigation(method: str) -> None:
    """Thirty seconds at rest and twenty of travel: metres off, and the covariance knows it (false-alarm rate 1e-4)."""
    log = until(simulated(SHORT, 5), 50.0)
    log = dataclasses.replace(log, odometer=None, face=None, surveyed=(), events=None)
    run = smooth(log, method=method)
    _, pos = errors(run, log)
    sigma = np.sqrt(np.diagonal(run.trajectory.cov[-1])[3:6])
    assert (np.abs(pos[-1]) < stats.norm.ppf(1 - 1e-4 / 6) * sigma).all()
    assert 0.1 < sigma.max() < 30.0
    assert {"gyro_bias_x", "accel_bias_x"} <= set(run.calibration)


@pytest.mark.parametrize("method", FILTERS)
def test_truth_plays_no_part_and_runs_repeat(method: str) -> None:
    log = simulated(TWO_CUTS)
    runs = [smoothed(TWO_CUTS, 0, method), smooth(log, method=method)]
    wrong = log.truth.replace(pos_n_m=log.truth.pos_n_m + 100.0)
    runs += [smooth(dataclasses.replace(log, truth=truth), method=method) for truth in (None, wrong)]
    for run in runs[1:]:
        for name in ("t_s", "pos_n", "quat_nb", "vel_n", "cov"):
            assert np.array_equal(getattr(run.trajectory, name), getattr(runs[0].trajectory, name)), name
        assert run.calibration == runs[0].calibration


@pytest.mark.parametrize("end_s", [2.0, 29.0, 33.0, 61.7])
def test_a_log_cut_off_anywhere(end_s: float) -> None:
    log = until(dataclasses.replace(simulated(SHORT), events=None), end_s)
    for method in FILTERS:
        run = smooth(log, method=method)
        assert run.trajectory.t_s[-1] == pytest.approx(end_s)
        assert np.isfinite(run.trajectory.cov).all()


# refusals ---------------------------------------------------------------------------------------------------


def test_unknown_methods_and_presets_are_named() -> None:
    with pytest.raises(ConfigError, match=r'unknown method "kalman"; known: batch, .*rts-online, ekf'):
        smooth(simulated(SHORT), method="kalman")
    with pytest.raises(ConfigError, match=r"filter\.preset: \"papr\", expected 'matched' or 'paper'"):
        config(filter={"preset": "papr"})
    with pytest.raises(ConfigError, match=r'unknown key filter\.presett; did you mean "preset"'):
        config(filter={"presett": "paper"})


@pytest.mark.parametrize("method", FILTERS)
def test_what_is_no_number_is_refused_with_its_time(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """However it came about: the navigation of the tenth interval gives NaN."""
    advance, calls = strapdown.advance, []

    def broken(*args):
        advance(*args)
        calls.append(1)
        if len(calls) == 10:
            args[-4][-1] = np.nan  # velocities

    monkeypatch.setattr(strapdown, "advance", broken)
    with pytest.raises(SolveError, match=r"the filter diverged at \d+\.\d s \(speed nan m/s\): look for wild values"):
        smooth(faceless(simulated(SHORT)), method=method)


@pytest.mark.parametrize("method", FILTERS)
def test_no_imu_and_no_initial_state(method: str) -> None:
    log = simulated(SHORT)
    with pytest.raises(LogError, match="smoothing needs an IMU"):
        smooth(dataclasses.replace(log, imu=None), method=method)
    with pytest.raises(LogError, match="give the initial pose with its sigmas"):
        smooth(dataclasses.replace(log, initial=None), method=method)
    with pytest.raises(LogError, match=r"no samples for 3\.000 s after t = 40\.000 s"):
        smooth(without_imu(log, 40.0, 43.0), method=method)
