"""Errors as large as filter and smoother believe, and innovations as large as predicted.

Statistical tests use fixed seeds; the stated false-alarm rates say how surprising a failure would be if nothing were
wrong. The closed path is left out: its two passes are taken for independent.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from engine_logs import SHORT, TWO_CUTS, simulated, without_imu
from filter_runs import config, errors, faceless, run_of
from scipy import stats

from graphnav.simulation.scenarios import ShearerSpec
from graphnav.smooth import smooth

SEEDS = range(12)
FALSE_ALARM = 1e-4


@pytest.mark.parametrize("method", ["ekf", "rts"])
@pytest.mark.parametrize("spec", [SHORT, TWO_CUTS], ids=["one cut", "two cuts"])
def test_errors_are_as_large_as_the_covariances_say(spec: ShearerSpec, method: str) -> None:
    """Twelve logs, one draw each in the second half and at the end; attitude and position; false-alarm rate 1e-4."""
    found: dict[str, list[float]] = {}
    for seed in SEEDS:
        run = run_of(spec, seed, method)
        attitude, pos = errors(run, simulated(spec, seed))
        for when, k in {"later": round(0.6 * len(pos)), "end": -1}.items():
            cov = run.trajectory.cov[k]
            parts = {"attitude": (attitude[k], cov[:3, :3]), "position": (pos[k], cov[3:6, 3:6])}
            for name, (error, block) in parts.items():
                found.setdefault(f"{name}, {when}", []).append(float(error @ np.linalg.solve(block, error)))
    low, high = stats.chi2.interval(1 - FALSE_ALARM / len(found), 3 * len(SEEDS))
    for name, values in found.items():
        assert low < sum(values) < high, f"{name}: {sum(values):.1f}, expected {low:.1f} to {high:.1f}"


@pytest.mark.parametrize("spec", [SHORT, TWO_CUTS], ids=["one cut", "two cuts"])
def test_innovations_are_as_large_as_predicted(spec: ShearerSpec) -> None:
    """NIS of every kind over twelve logs in its chi-square band; false-alarm rate 1e-4 in all.

    Speed and mean rate have white noise of just the declared sigma: of their 24 means, 18 at least are in the band
    that holds 95 of 100 (fewer with rate 2e-4). The constraint's slip vanishes where the machine starts and stops, so
    its NIS may be low, by up to a quarter. Zero velocity is exactly true; what is predicted is mostly the
    accelerometer's noise since the last keyframe, and its sigma adds a hundredth.
    """
    squares: dict[str, list[np.ndarray]] = {}
    inside = 0
    for seed in SEEDS:
        innovations = run_of(spec, seed, "ekf").innovations
        for k, kind in enumerate(innovations.kinds):
            squares.setdefault(kind, []).append(innovations.normalized[innovations.kind == k] ** 2)
        inside += sum(innovations.nis(kind).inside for kind in ("speed", "zero rate"))
    assert len(np.concatenate(squares.pop("closed path"))) == 0
    assert inside >= stats.binom.ppf(2e-4, 2 * len(SEEDS), 0.95)
    for kind, parts in squares.items():
        values = np.concatenate(parts)
        low, high = stats.chi2.interval(1 - FALSE_ALARM / len(squares), len(values))
        least = 0.75 if kind == "constraint" else 1.0
        assert least * low < values.sum() < high, f"{kind}: {values.mean():.3f} of {len(values)}"


def test_rates_at_rest_are_as_noisy_as_their_intervals_are_short() -> None:
    """Keyframes four times a second: NIS of the mean rate over six logs; false-alarm rate 1e-4."""
    chosen = config(keyframes={"interval_s": 0.25})
    found = [smooth(faceless(simulated(SHORT, s)), chosen, "ekf").innovations.nis("zero rate") for s in range(6)]
    low, high = stats.chi2.interval(1 - FALSE_ALARM, sum(nis.rows for nis in found))
    assert sum(nis.rows for nis in found) > 2000
    assert low < sum(nis.rows * nis.mean for nis in found) < high


def test_speed_and_rate_innovations_are_white() -> None:
    """Correlation of each with the next one, over twelve logs; false-alarm rate 1e-4."""
    for kind in ("speed", "zero rate"):
        found = [run_of(TWO_CUTS, seed, "ekf").innovations.nis(kind) for seed in SEEDS]
        count = sum(nis.rows for nis in found)
        together = sum(nis.rows * nis.lag_one for nis in found) / count
        assert abs(together) < stats.norm.ppf(1 - FALSE_ALARM / 4) / np.sqrt(count), kind


def test_a_wrong_declaration_shows_in_the_innovations_and_is_told() -> None:
    """An odometer three times as noisy as declared: NIS of 9, and a warning with both numbers."""
    log = faceless(simulated(SHORT))
    wrong = dataclasses.replace(log, odometer=log.odometer.replace(sigma_m_s=log.odometer.sigma_m_s / 3))
    run = smooth(wrong, method="ekf")
    assert run.innovations.nis("speed").mean > 5
    assert not run.innovations.nis("speed").inside
    told = [w for w in run.diagnostics.warnings if "speed" in w]
    assert len(told) == 1
    assert "covariances are too small" in told[0]
    assert not [w for w in smooth(log, method="ekf").diagnostics.warnings if "innovations" in w]


@pytest.mark.parametrize("method", ["ekf", "rts"])
def test_a_bridged_hole_widens_the_covariance(method: str) -> None:
    """Half a second without IMU in the cut of twelve logs: attitude sigmas grow, and are right a second later.

    What comes after tells the smoother nearly all of it again; its sigmas may change by the few percent that
    linearizing elsewhere does. False-alarm rate 1e-4.
    """
    squares = []
    for seed in SEEDS:
        log = faceless(simulated(SHORT, seed))
        whole, bridged = run_of(SHORT, seed, method), smooth(without_imu(log, 45.0, 45.5), method=method)
        assert bridged.diagnostics.warnings[0] == "1 holes in the IMU record were bridged, the longest 0.500 s"
        t = whole.trajectory.t_s
        k = int(np.searchsorted(t, 46.0 - 1e-6))
        assert np.array_equal(t, bridged.trajectory.t_s)
        sigma = [np.sqrt(np.diag(run.trajectory.cov[k])) for run in (whole, bridged)]
        assert (sigma[1][:2] > (1.0 if method == "ekf" else 0.9) * sigma[0][:2]).all()
        attitude, cov = errors(bridged, log)[0][k], bridged.trajectory.cov[k, :3, :3]
        squares.append(float(attitude @ np.linalg.solve(cov, attitude)))
    low, high = stats.chi2.interval(1 - FALSE_ALARM, 3 * len(SEEDS))
    assert low < sum(squares) < high
