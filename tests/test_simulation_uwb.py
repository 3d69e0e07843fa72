"""face-end-uwb: exact without noise, and what is drawn is what is declared.

Statistical bounds are two-sided with a false-alarm rate of 1e-5 each; seeds are fixed, so a test that passes once
always passes.
"""

from __future__ import annotations

import json
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from strapdown import integrate

from graphnav import cli
from graphnav.errors import ConfigError
from graphnav.log import SensorLog
from graphnav.readers import read
from graphnav.simulation import simulate
from graphnav.simulation.face_end import simulate_face_end
from graphnav.simulation.ranging import RangeErrors, unit_markov
from graphnav.simulation.sensors import earth_rate_n
from graphnav.simulation.uwb_figures import SITES, UNDERGROUND
from graphnav.simulation.uwb_truth import uwb_truth

FALSE_ALARM = 1e-5
MG, DEG_H = 9.80665e-3, np.pi / 180 / 3600
#: Half a metre after 2 s at rest: a whole log in milliseconds, with every error of the scenario in it.
SHORT = replace(UNDERGROUND, from_y_m=1.5, static_s=2.0, tail_s=1.0)


@cache
def clean(site: str) -> SensorLog:
    return simulate_face_end("clean", SITES[site], 3, noise=False)


@cache
def truths(site: str = "underground", count: int = 8) -> list[RangeErrors]:
    return [uwb_truth("face-end-uwb", seed, site=site) for seed in range(count)]


def assert_unit_normal(draws: np.ndarray) -> None:
    """Zero mean and unit variance, each within its bounds."""
    draws = np.ravel(draws)
    assert abs(draws.mean()) < stats.norm.isf(FALSE_ALARM / 2) / np.sqrt(len(draws))
    low, high = stats.chi2.interval(1 - FALSE_ALARM, len(draws))
    assert low < np.sum(draws**2) < high


def tag_n(log: SensorLog, t_s: np.ndarray) -> np.ndarray:
    """The tag at times on or midway between the rows of truth: mean of positions, half the turn."""
    truth, row = log.truth, np.round(t_s * 200).astype(int)
    before, after = row // 2, (row + 1) // 2
    rot = Rotation.from_quat(truth.quat_nb, scalar_first=True)
    half = rot[before] * Rotation.from_rotvec((rot[before].inv() * rot[after]).as_rotvec() / 2)
    return (truth.pos_n_m[before] + truth.pos_n_m[after]) / 2 + half.apply(np.array(log.uwb.tag[0].lever_arm_b_m))


def anchor_n(log: SensorLog) -> np.ndarray:
    places = {anchor.id: anchor.pos_n_m for anchor in log.uwb.anchor}
    return np.array([places[name] for name in log.uwb.anchor_id])


# Without noise ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("site", SITES)
def test_error_free_ranges_are_the_distances_of_the_tag(site: str) -> None:
    log = clean(site)
    distance = np.linalg.norm(tag_n(log, log.uwb.t_s) - anchor_n(log), axis=1)
    # half way between two samples the mean of positions is off by at most a dt^2 / 8 = 3e-7 m
    np.testing.assert_allclose(log.uwb.range_m, distance, rtol=0, atol=4e-7)
    on_sample = np.arange(1, len(distance), 2)
    np.testing.assert_allclose(log.uwb.range_m[on_sample], distance[on_sample], rtol=0, atol=1e-12)


@pytest.mark.parametrize("site", SITES)
def test_anchors_range_in_turn_forty_times_a_second(site: str) -> None:
    uwb = clean(site).uwb
    np.testing.assert_allclose(uwb.t_s, np.arange(1, len(uwb) + 1) / 40, rtol=0, atol=1e-12)
    assert uwb.anchor_id[:6].tolist() == ["1", "2", "3", "4", "1", "2"]
    assert (uwb.anchor_id[4:] == uwb.anchor_id[:-4]).all()


@pytest.mark.parametrize(("start_s", "end_s"), [(43.0, 53.0), (145.0, 160.0)], ids=["start", "stop"])
def test_error_free_samples_integrate_back_to_truth(start_s: float, end_s: float) -> None:
    log = clean("underground")
    imu, truth = log.imu, log.truth
    first, last = np.searchsorted(truth.t_s, [start_s - 1e-6, end_s - 1e-6])

    def sample(rows: np.ndarray) -> Any:
        return lambda t_s: rows[np.ceil(np.round(t_s * 100, 6)).astype(int) - 1]

    found = integrate(
        sample(imu.gyro_b_rad_s),
        sample(imu.accel_b_m_s2),
        start_s,
        end_s,
        step_s=0.01,
        rotation=Rotation.from_quat(truth.quat_nb[first], scalar_first=True).as_matrix(),
        vel_n=truth.vel_n_m_s[first],
        pos_n=truth.pos_n_m[first],
        gravity_n=np.array([0, 0, -9.7973]),
        earth_n=earth_rate_n(35.0),
    )
    # A sample that is read a step late would cost 1e-4 rad, missing Earth rate 7e-4 rad and 3 mm.
    true = Rotation.from_quat(truth.quat_nb[last], scalar_first=True)
    assert (Rotation.from_matrix(found[0]).inv() * true).magnitude() < 1e-5
    np.testing.assert_allclose(found[1], truth.vel_n_m_s[last], rtol=0, atol=2e-4)
    np.testing.assert_allclose(found[2], truth.pos_n_m[last], rtol=0, atol=1e-3)


# The way ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("site", "rests", "end_s", "y_m", "z_m"),
    [("surface", [(0, 10)], 118, (9, 2), 0.0), ("underground", [(0, 45), (153, 166)], 166, (-5, 2), 0.5)],
)
def test_the_tag_travels_as_the_paper_has_it(site: str, rests: Any, end_s: float, y_m: Any, z_m: float) -> None:
    log = clean(site)
    truth = log.truth
    assert truth.t_s[-1] == pytest.approx(end_s)
    still = np.zeros(len(truth.t_s), bool)
    for start, end in rests:
        still |= (truth.t_s >= start) & (truth.t_s <= end)
    speed = np.linalg.norm(truth.vel_n_m_s, axis=1)
    assert speed[still].max() < 1e-12  # 0 but for rounding at the stop
    assert np.median(speed[~still]) == pytest.approx(4 / 60)
    assert (speed[~still][1:-1] > 0).all()
    tag = tag_n(log, truth.t_s)
    np.testing.assert_allclose(tag[[0, -1], 1], y_m, atol=1e-9)
    np.testing.assert_allclose(tag[still][:, [0, 2]], np.tile([0.5, z_m], (still.sum(), 1)), atol=1e-9)
    assert np.abs(tag[:, [0, 2]] - [0.5, z_m]).max() < 0.3 * np.deg2rad(0.2) * 5
    assert log.initial.static_until_s == rests[0][1]
    assert not log.initial.pos_known


def test_vibration_has_its_sigma_while_moving_and_none_at_rest() -> None:
    truth = clean("underground").truth
    turn = Rotation.from_quat(truth.quat_nb, scalar_first=True).as_rotvec(degrees=True)
    moving = (truth.t_s > 48) & (truth.t_s < 150)
    # 102 s of a process that is new about every second: 200 values of two axes, sigma good to 5 % at 1 sigma
    assert turn[moving][:, [0, 2]].std() == pytest.approx(0.2, rel=0.22)
    assert np.abs(turn[:, 1]).max() < 0.01
    assert np.abs(turn[truth.t_s <= 45]).max() < 1e-12


# Drawn and declared -------------------------------------------------------------------------------------------


@cache
def drawn(count: int = 150) -> dict[str, np.ndarray]:
    """Errors over declared sigmas, seed by seed, of start and IMU."""
    rows: dict[str, list[np.ndarray]] = {}
    for seed in range(count):
        log, exact = (simulate_face_end("short", SHORT, seed, noise=noise) for noise in (True, False))
        for name, value in _errors_over_sigmas(log, exact).items():
            rows.setdefault(name, []).append(value)
    return {name: np.array(values) for name, values in rows.items()}


def _errors_over_sigmas(log: SensorLog, exact: SensorLog) -> dict[str, np.ndarray]:
    imu, span = log.imu, len(log.imu) * log.imu.dt_s
    gyro, accel = imu.gyro_b_rad_s - exact.imu.gyro_b_rad_s, imu.accel_b_m_s2 - exact.imu.accel_b_m_s2
    gyro_walk, accel_walk = imu.gyro_random_walk_deg_sqrt_h * np.pi / 180 / 60, imu.accel_random_walk_mg_sqrt_hz * MG
    turn = Rotation.from_quat([exact.initial.quat_nb_wxyz, log.initial.quat_nb_wxyz], scalar_first=True)
    return {
        "gyro bias": gyro.mean(0) / np.hypot(imu.gyro_bias_deg_h * DEG_H, gyro_walk / np.sqrt(span)),
        "accel bias": accel.mean(0) / np.hypot(imu.accel_bias_mg * MG, accel_walk / np.sqrt(span)),
        "gyro noise": np.diff(gyro[:40], axis=0)[::2].ravel() / (gyro_walk / np.sqrt(imu.dt_s) * np.sqrt(2)),
        "accel noise": np.diff(accel[:40], axis=0)[::2].ravel() / (accel_walk / np.sqrt(imu.dt_s) * np.sqrt(2)),
        "initial attitude": (turn[0].inv() * turn[1]).as_rotvec(degrees=True) / log.initial.att_sigma_deg,
        "initial velocity": (log.initial.vel_n_m_s - exact.initial.vel_n_m_s) / log.initial.vel_sigma_m_s,
    }


NAMES = ("gyro bias", "accel bias", "gyro noise", "accel noise", "initial attitude", "initial velocity")


@pytest.mark.parametrize("name", NAMES)
def test_errors_of_imu_and_start_have_the_declared_sigma(name: str) -> None:
    assert_unit_normal(drawn()[name])


@pytest.mark.parametrize(
    ("site", "figures"),
    [("surface", (0.013, 0.003, 0.010, 2.0, 1.0)), ("underground", (0.045, 0.010, 0.045, 3.0, 0.25))],
)
def test_sites_declare_the_figures_of_the_scenario(site: str, figures: tuple[float, ...]) -> None:
    uwb = clean(site).uwb
    assert (uwb.sigma_m, uwb.bias_sigma_m, uwb.markov_sigma_m, uwb.markov_time_s, uwb.rest_factor) == figures
    assert uwb.tag[0].lever_arm_b_m.tolist() == [0, 0, -0.3]
    assert clean(site).initial.att_sigma_deg.tolist() == [0.3, 0.3, 1.0]
    imu = clean(site).imu
    assert (imu.gyro_bias_deg_h, imu.accel_bias_mg) == (720.0, 3.0)


def calm(log: SensorLog, truth: RangeErrors) -> np.ndarray:
    """Factor on the sigmas: `rest_factor` where the machine stands at a range's time."""
    speed = np.linalg.norm(log.truth.vel_n_m_s, axis=1)
    return np.where(np.interp(truth.t_s, log.truth.t_s, speed) < 1e-9, log.uwb.rest_factor, 1.0)


@pytest.mark.parametrize("site", SITES)
def test_white_noise_has_the_declared_sigma_moving_and_at_rest(site: str) -> None:
    log = clean(site)
    for factor in {1.0, log.uwb.rest_factor}:
        draws = [t.white_m[calm(log, t) == factor] / (factor * log.uwb.sigma_m) for t in truths(site)]
        assert_unit_normal(np.concatenate(draws))


@pytest.mark.parametrize("site", SITES)
def test_markov_process_is_stationary_and_correlated_as_declared(site: str) -> None:
    log = clean(site)
    decay = np.exp(-0.1 / log.uwb.markov_time_s)  # each anchor every 0.1 s
    starts, steps = [], []
    for truth in truths(site):
        unit = (truth.markov_m / calm(log, truth) / log.uwb.markov_sigma_m)[: len(truth.t_s) // 4 * 4].reshape(-1, 4)
        starts.append(unit[0])
        steps.append((unit[1:] - decay * unit[:-1]) / np.sqrt(1 - decay**2))
    assert_unit_normal(np.array(starts))
    whitened = np.concatenate(steps)
    assert_unit_normal(whitened)
    bound = stats.norm.isf(FALSE_ALARM / 2) / np.sqrt(len(whitened))
    assert abs(np.mean(whitened[1:] * whitened[:-1])) < bound / 2  # mean of four columns
    assert abs(np.corrcoef(whitened.T) - np.eye(4)).max() < stats.norm.isf(FALSE_ALARM / 12) / np.sqrt(len(whitened))


def test_markov_process_is_exact_over_gaps() -> None:
    rng = np.random.default_rng(1)
    t_s = np.tile([0.0, 0.1, 5.0], 20_000) + np.repeat(1000.0 * np.arange(20_000), 3)
    x = unit_markov(t_s, np.zeros(len(t_s), int), 3.0, rng).reshape(-1, 3)
    for (i, j), dt_s in {(0, 1): 0.1, (1, 2): 4.9, (0, 2): 5.0}.items():
        rho = np.exp(-dt_s / 3.0)
        assert np.mean(x[:, i] * x[:, j]) == pytest.approx(rho, abs=4.5 * np.sqrt((1 + rho**2) / len(x)))


def test_constants_belong_to_their_anchors_with_the_declared_sigma() -> None:
    constants = []
    for seed in range(40):
        truth = uwb_truth("face-end-uwb", seed)
        by_anchor = [truth.constant_m[truth.anchor_id == name] for name in "1234"]
        assert all((values == values[0]).all() for values in by_anchor)
        constants.append([values[0] for values in by_anchor])
    assert_unit_normal(np.array(constants) / 0.010)


def test_anchors_are_off_by_the_declared_survey() -> None:
    """The difference of true and declared distance is the survey's error along one direction: a unit normal."""
    log, first = clean("underground"), slice(0, 4)
    declared_m = np.linalg.norm(tag_n(log, log.uwb.t_s[first]) - anchor_n(log)[first], axis=1)
    off_m = np.array([uwb_truth("face-end-uwb", seed).distance_m[first] - declared_m for seed in range(60)])
    assert_unit_normal(off_m / log.uwb.anchor[0].sigma_m)


def test_only_underground_anchor_1_has_multipath() -> None:
    assert not any(truth.delayed.any() for truth in truths("surface"))
    late = np.concatenate([truth.multipath_m[truth.anchor_id == "1"] for truth in truths()])
    others = np.concatenate([truth.multipath_m[truth.anchor_id != "1"] for truth in truths()])
    assert not others.any()
    count = int((late > 0).sum())
    assert stats.binomtest(count, len(late), 0.05).pvalue > FALSE_ALARM
    assert stats.kstest(late[late > 0], "expon", args=(0, 0.3)).pvalue > FALSE_ALARM


def test_nlos_ranges_are_a_share_of_all_with_a_uniform_delay() -> None:
    options = {"site": "surface", "nlos_share": 0.2, "nlos_max_m": 2.0}
    truth = uwb_truth("face-end-uwb", 4, **options)
    for name in "1234":
        late = truth.nlos_m[truth.anchor_id == name]
        assert stats.binomtest(int((late > 0).sum()), len(late), 0.2).pvalue > FALSE_ALARM
        assert stats.kstest(late[late > 0], "uniform", args=(0, 2.0)).pvalue > FALSE_ALARM
    assert (truth.delayed == (truth.nlos_m > 0)).all()
    plain = uwb_truth("face-end-uwb", 4, site="surface")
    np.testing.assert_allclose(truth.total_m - truth.nlos_m, plain.total_m, rtol=0, atol=1e-12)


def test_ranges_are_true_distances_with_the_errors_told_for_scoring() -> None:
    log, truth = simulate("face-end-uwb", 4, nlos_share=0.2), uwb_truth("face-end-uwb", 4, nlos_share=0.2)
    np.testing.assert_array_equal(log.uwb.t_s, truth.t_s)
    np.testing.assert_array_equal(log.uwb.anchor_id, truth.anchor_id)
    np.testing.assert_allclose(log.uwb.range_m, truth.distance_m + truth.total_m, rtol=0, atol=1e-12)


# UWB alone ----------------------------------------------------------------------------------------------------


def alone_error_m(log: SensorLog) -> np.ndarray:
    """Mean absolute error of least squares over four ranges in turn, each started at the truth.

    Ranges to anchors that lie nearly in a plane have a second minimum on its other side; the start at the truth
    leaves that ambiguity out, so that what is judged is the noise of the ranges and the shape of the anchors.
    """
    places = np.array([anchor.pos_n_m for anchor in log.uwb.anchor])
    ranges, t_s = log.uwb.range_m[: len(log.uwb) // 4 * 4].reshape(-1, 4), log.uwb.t_s[1::4]
    true_n = tag_n(log, t_s[: len(ranges)])
    found = [
        least_squares(lambda x, r=r: np.linalg.norm(x - places, axis=1) - r, start, method="lm").x
        for r, start in zip(ranges[::4], true_n[::4], strict=True)
    ]
    return np.abs(np.array(found) - true_n[::4]).mean(axis=0)


@pytest.mark.parametrize(
    ("site", "x_m", "z_m", "share"), [("surface", 0.062, 0.089, 0.15), ("underground", 0.128, 0.239, 0.4)]
)
def test_uwb_alone_is_about_as_good_as_in_the_paper(site: str, x_m: float, z_m: float, share: float) -> None:
    """Means over eight seeds, which scatter by a sixth at most and so are good to 6 %, beside the paper's.

    The scenario's figures are fixed, and underground they give more than the paper has: 0.142 / 0.308 m (standard
    deviation of a seed 0.014 / 0.049 m), 29 % more in z. The bound there allows for that, it does not deny it; at the
    surface it is 0.067 / 0.087 m.
    """
    error = np.mean([alone_error_m(simulate("face-end-uwb", seed, site=site)) for seed in range(8)], axis=0)
    assert error[0] == pytest.approx(x_m, rel=share)
    assert error[2] == pytest.approx(z_m, rel=share)


# Use ----------------------------------------------------------------------------------------------------------


def same(one: SensorLog, other: SensorLog) -> bool:
    pairs = [(getattr(one.uwb, f.name), getattr(other.uwb, f.name)) for f in fields(one.uwb) if f.name != "anchor"]
    arrays = [(a, b) for a, b in pairs if isinstance(a, np.ndarray)]
    return all((a == b).all() for a, b in arrays) and bool((one.imu.gyro_b_rad_s == other.imu.gyro_b_rad_s).all())


def test_the_seed_tells_the_log() -> None:
    assert same(simulate("face-end-uwb", 7), simulate("face-end-uwb", 7))
    assert not same(simulate("face-end-uwb", 7), simulate("face-end-uwb", 8))


def test_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = str(tmp_path / "L")
    assert cli.main(["simulate", "face-end-uwb", "--site", "underground", "--seed", "5", "-o", folder]) == 0
    log = read(folder)
    assert log.name == "face-end-uwb_seed5"
    assert same(log, simulate("face-end-uwb", 5, site="underground"))
    capsys.readouterr()
    assert cli.main(["info", folder, "--json"]) == 0
    known = json.loads(capsys.readouterr().out)
    assert known["tables"]["uwb"] == {"rows": 6640, "start_s": 0.025, "end_s": 166.0, "rate_hz": 40.0, "gaps": []}
    assert known["suspicious"] == []
    words = ["simulate", "face-end-uwb", "--site", "surface", "--nlos-share", "0.2", "--nlos-max", "2", "-o", folder]
    assert cli.main(words) == 0
    assert read(folder).name == "face-end-uwb_nlos_max_m=2_nlos_share=0.2_site=surface_seed0"


@pytest.mark.parametrize(
    ("options", "fragments"),
    [
        ({"site": "moon"}, ["'moon'", "surface, underground"]),
        ({"nlos_share": 1.5}, ["nlos_share = 1.5", "0 to 1"]),
        ({"nlos_max_m": -1.0}, ["nlos_max_m = -1.0", "0 to 100"]),
        ({"par": 1}, ['"par"', "site, nlos_share, nlos_max_m"]),
    ],
)
def test_wrong_options_are_refused(options: dict[str, Any], fragments: list[str]) -> None:
    with pytest.raises(ConfigError) as caught:
        simulate("face-end-uwb", **options)
    for fragment in fragments:
        assert fragment in str(caught.value)


def test_only_scenarios_with_uwb_have_its_truth() -> None:
    with pytest.raises(ConfigError, match="shearer-lidar: no UWB"):
        uwb_truth("shearer-lidar")
