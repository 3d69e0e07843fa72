"""Simulated shifts: the truth keeps its own laws, and what is drawn is what is declared.

Statistical bounds are two-sided chi-square or normal bounds with a false-alarm rate of 1e-5 each; seeds are
fixed, so a test that passes once always passes.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from graphnav.errors import ConfigError
from graphnav.log import SensorLog
from graphnav.simulation import SCENARIOS, simulate
from graphnav.simulation.motion import Timeline, Trapezoid
from graphnav.simulation.path import attitude
from graphnav.simulation.scenarios import ADDED_ERRORS, BUILDERS, FULL_SHIFT, MEMS, ShearerSpec
from graphnav.simulation.sensors import earth_rate_n, wobble
from graphnav.simulation.shearer import simulate_shearer
from graphnav.simulation.world import World, build_world

FALSE_ALARM = 1e-5
MG, DEG, HOUR = 9.80665e-3, np.pi / 180, 3600.0
#: A cut of 5 m after 2 s at rest: a whole log in milliseconds, with every error of the scenario in it.
SHORT = replace(MEMS, length_m=5.0, cycles=1, static_s=2.0, tail_s=1.0)


@cache
def mems(seed: int = 0, *, noise: bool = True) -> SensorLog:
    return simulate_shearer("shearer-mems", MEMS, seed, noise=noise)


@cache
def world(spec: ShearerSpec, seed: int = 0) -> World:
    """The world of `simulate_shearer` with this seed."""
    streams = np.random.default_rng(seed).spawn(5)
    return build_world(spec, streams[0], streams[1])


def assert_unit_normal(draws: np.ndarray) -> None:
    """Zero mean and unit variance, each within its bounds."""
    draws = np.ravel(draws)
    limit = stats.norm.isf(FALSE_ALARM / 2) / np.sqrt(len(draws))
    assert abs(draws.mean()) < limit
    low, high = stats.chi2.interval(1 - FALSE_ALARM, len(draws))
    assert low < np.sum(draws**2) < high


# --- inertial samples -------------------------------------------------------------------------------------


def integrate(log: SensorLog, start_s: float, end_s: float) -> tuple[Rotation, np.ndarray, np.ndarray]:
    """Textbook strapdown from truth: continuous equations in n with Earth rate, Runge-Kutta."""
    imu, truth = log.imu, log.truth
    assert imu is not None and truth is not None and truth.vel_n_m_s is not None
    assert log.frames.gravity_m_s2 is not None
    first = int(np.searchsorted(truth.t_s, start_s))
    earth = 7.292115e-5 * np.array([0.0, np.cos(35 * DEG), np.sin(35 * DEG)])
    down = np.array([0.0, 0.0, -log.frames.gravity_m_s2])

    def skew(w: np.ndarray) -> np.ndarray:
        return np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])

    earth_skew = skew(earth)
    state = np.zeros((3, 5))
    state[:, :3] = Rotation.from_quat(truth.quat_nb[first], scalar_first=True).as_matrix()
    state[:, 3], state[:, 4] = truth.vel_n_m_s[first], truth.pos_n_m[first]
    step = 0.01 / 4
    for k in np.flatnonzero((imu.t_s > start_s + 0.005) & (imu.t_s < end_s + 0.005)):
        gyro, force = skew(imu.gyro_b_rad_s[k]), imu.accel_b_m_s2[k]

        def rate(x: np.ndarray, gyro: np.ndarray = gyro, force: np.ndarray = force) -> np.ndarray:
            acceleration = x[:, :3] @ force + down - 2 * earth_skew @ x[:, 3]
            return np.column_stack([x[:, :3] @ gyro - earth_skew @ x[:, :3], acceleration, x[:, 3]])

        for _ in range(4):
            k1 = rate(state)
            k2 = rate(state + step / 2 * k1)
            k3 = rate(state + step / 2 * k2)
            state = state + step / 6 * (k1 + 2 * k2 + 2 * k3 + rate(state + step * k3))
    return Rotation.from_matrix(state[:, :3]), state[:, 3], state[:, 4]


@pytest.mark.parametrize(
    ("start_s", "end_s"), [(0.0, 30.0), (55.0, 85.0), (205.0, 235.0)], ids=["rest", "start", "reversal"]
)
def test_error_free_samples_integrate_back_to_truth(start_s: float, end_s: float) -> None:
    log = mems(noise=False)
    truth = log.truth
    assert truth is not None and truth.vel_n_m_s is not None
    rot, vel, pos = integrate(log, start_s, end_s)
    row = int(np.searchsorted(truth.t_s, end_s))
    assert truth.t_s[row] == pytest.approx(end_s)
    true = Rotation.from_quat(truth.quat_nb[row], scalar_first=True)
    # Left over in position: the force is constant within a sample only on average, and 4e-6 m where a ramp
    # of the speed begins between samples. Without Earth rate 30 s would cost 2e-3 rad, and decimetres.
    assert (rot.inv() * true).magnitude() < 1e-10
    assert np.abs(vel - truth.vel_n_m_s[row]).max() < 1e-8
    assert np.abs(pos - truth.pos_n_m[row]).max() < 2e-5


def test_samples_at_rest_are_earth_rate_and_gravity() -> None:
    log = mems(noise=False)
    assert log.imu is not None and log.truth is not None
    to_b = Rotation.from_quat(log.truth.quat_nb[0], scalar_first=True).inv()
    rest = log.imu.t_s <= 60.0
    assert np.allclose(log.imu.gyro_b_rad_s[rest], to_b.apply(earth_rate_n(35.0)), rtol=0, atol=1e-12)
    assert np.allclose(log.imu.accel_b_m_s2[rest], to_b.apply([0, 0, 9.7973]), rtol=0, atol=1e-9)


def test_rates_have_no_jump_where_motion_starts_and_stops() -> None:
    log = mems(noise=False)
    assert log.imu is not None and log.events is not None
    jumps = np.linalg.norm(np.diff(log.imu.gyro_b_rad_s, axis=0), axis=1)
    for t in log.events.t_s:
        near = np.abs(log.imu.t_s[1:] - t) < 0.25
        assert jumps[near].max() < 0.1 * jumps.max()


# --- declared and drawn -----------------------------------------------------------------------------------


@cache
def drawn(count: int = 250) -> dict[str, np.ndarray]:
    """Errors over declared sigmas, seed by seed: logs less the error-free logs of the same seeds."""
    rows: dict[str, list[np.ndarray]] = {}
    for seed in range(count):
        log = simulate_shearer("short", SHORT, seed)
        clean = simulate_shearer("short", SHORT, seed, noise=False)
        for name, value in _errors_over_sigmas(log, clean).items():
            rows.setdefault(name, []).append(np.atleast_1d(value))
    return {name: np.array(values) for name, values in rows.items()}


def _errors_over_sigmas(log: SensorLog, clean: SensorLog) -> dict[str, np.ndarray]:
    imu, odo, initial = log.imu, log.odometer, log.initial
    assert imu is not None and odo is not None and initial is not None
    assert clean.imu is not None and clean.odometer is not None and clean.initial is not None
    gyro, accel = imu.gyro_b_rad_s - clean.imu.gyro_b_rad_s, imu.accel_b_m_s2 - clean.imu.accel_b_m_s2
    span = len(imu) * imu.dt_s
    gyro_walk = imu.gyro_random_walk_deg_sqrt_h * DEG / 60
    accel_walk = imu.accel_random_walk_mg_sqrt_hz * MG
    true_speed = clean.odometer.speed_m_s
    weight = np.sum(true_speed**2)
    scale = true_speed @ (odo.speed_m_s - true_speed) / weight
    turn = Rotation.from_quat([clean.initial.quat_nb_wxyz, initial.quat_nb_wxyz], scalar_first=True)
    return {
        "gyro bias": gyro.mean(0) / np.hypot(imu.gyro_bias_deg_h * DEG / HOUR, gyro_walk / np.sqrt(span)),
        "accel bias": accel.mean(0) / np.hypot(imu.accel_bias_mg * MG, accel_walk / np.sqrt(span)),
        "gyro noise": np.diff(gyro[:40], axis=0)[::2].ravel() / (gyro_walk / np.sqrt(imu.dt_s) * np.sqrt(2)),
        "accel noise": np.diff(accel[:40], axis=0)[::2].ravel() / (accel_walk / np.sqrt(imu.dt_s) * np.sqrt(2)),
        "odometer scale": scale / np.hypot(odo.scale_sigma, odo.sigma_m_s / np.sqrt(weight)),
        "odometer noise": odo.speed_m_s[:18] / odo.sigma_m_s,  # at rest
        "initial attitude": (turn[0].inv() * turn[1]).as_rotvec(degrees=True) / initial.att_sigma_deg,
        "initial position": (initial.pos_n_m - clean.initial.pos_n_m) / initial.pos_sigma_m,
        "initial velocity": (initial.vel_n_m_s - clean.initial.vel_n_m_s) / initial.vel_sigma_m_s,
        "survey": (log.surveyed[0].pos_n_m - clean.surveyed[0].pos_n_m) / log.surveyed[0].sigma_m,
    }


@pytest.mark.parametrize(
    "name",
    [
        "gyro bias",
        "accel bias",
        "gyro noise",
        "accel noise",
        "odometer scale",
        "odometer noise",
        "initial attitude",
        "initial position",
        "initial velocity",
        "survey",
    ],
)
def test_errors_have_the_declared_sigma(name: str) -> None:
    assert_unit_normal(drawn()[name])


def test_each_axis_has_its_declared_sigma() -> None:
    for axis in range(3):
        assert_unit_normal(drawn()["initial attitude"][:, axis])
        assert_unit_normal(drawn()["gyro bias"][:, axis])


def test_mounting_has_the_declared_sigma_per_axis() -> None:
    declared = simulate_shearer("short", SHORT, 0).odometer
    assert declared is not None
    alpha = np.array([world(SHORT, seed).mounting_rad for seed in range(300)]) / DEG
    for axis in range(3):
        assert_unit_normal(alpha[:, axis] / declared.mounting_sigma_deg[axis])


def test_scenarios_declare_the_figures_of_the_papers() -> None:
    log = mems()
    assert log.imu is not None and log.odometer is not None and log.face is not None and log.initial is not None
    assert (log.imu.gyro_bias_deg_h, log.imu.gyro_random_walk_deg_sqrt_h) == (720.0, 0.6)
    assert (log.imu.accel_bias_mg, log.imu.accel_random_walk_mg_sqrt_hz) == (3.0, 0.08)
    assert log.initial.att_sigma_deg.tolist() == [0.3, 0.3, 1.0]
    assert log.odometer.mounting_sigma_deg.tolist() == [3.0, 0.5, 3.0]
    assert (log.odometer.slip_sigma_m_s, log.odometer.scale_sigma) == (0.01, 0.05)
    assert (log.face.length_m, log.face.push_m, log.face.push_sigma_m, log.face.interval_m) == (
        44.6,
        0.4,
        0.03,
        2.0,
    )
    shift = simulate("full-shift", hours=0.02)
    assert shift.imu is not None and shift.odometer is not None and shift.face is not None
    assert (shift.imu.gyro_bias_deg_h, shift.imu.gyro_random_walk_deg_sqrt_h) == (0.05, 0.01)
    assert (shift.imu.accel_bias_mg, shift.imu.accel_random_walk_mg_sqrt_hz) == (0.05, 0.01)
    assert (shift.odometer.slip_sigma_m_s, shift.odometer.scale_sigma) == (0.001, 0.002)
    assert (shift.face.length_m, shift.face.push_m, shift.face.creep_sigma_m) == (350.0, 1.0, 0.0)


@pytest.mark.parametrize("par", [3, 6, 9, 12])
def test_added_errors_are_drawn_and_declared_as_root_sum_square(par: int) -> None:
    log, base = simulate("shearer-mems", par=par), mems()
    assert log.imu is not None and base.imu is not None and log.truth is not None and base.truth is not None
    for name, added in vars(ADDED_ERRORS[par]).items():
        assert getattr(log.imu, name) == pytest.approx(np.hypot(getattr(base.imu, name), added), rel=1e-12)
    assert np.array_equal(log.truth.pos_n_m, base.truth.pos_n_m)
    clean = mems(noise=False)
    assert clean.imu is not None
    # The same normal draws, so every error grows by the ratio of the sigmas.
    noise, base_noise = (imu.accel_b_m_s2 - clean.imu.accel_b_m_s2 for imu in (log.imu, base.imu))
    ratio = log.imu.accel_random_walk_mg_sqrt_hz / base.imu.accel_random_walk_mg_sqrt_hz
    assert np.allclose(np.diff(noise, axis=0), ratio * np.diff(base_noise, axis=0), rtol=1e-6, atol=1e-9)
    bias = [(imu.gyro_b_rad_s - clean.imu.gyro_b_rad_s)[:50].mean(0) for imu in (log.imu, base.imu)]
    if par == 3:
        white = 0.6 * DEG / 60 / np.sqrt(0.5) * 300 / 720
        assert bias[0] == pytest.approx(bias[1] * np.hypot(720, 300) / 720, abs=6 * white)


# --- slip -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("spec", [MEMS, replace(FULL_SHIFT, duration_s=1800.0)], ids=["mems", "full-shift"])
def test_slip_has_the_declared_sigma_while_moving_and_none_at_rest(spec: ShearerSpec) -> None:
    true = world(spec)
    _, motion, rot_nm = true.states(0, true.count)
    vel_m = rot_nm.inv().apply(motion.vel_n)
    slip = vel_m[:, [0, 2]]
    assert np.all(slip[motion.speed_m_s == 0] == 0)
    nominal = np.abs(motion.speed_m_s) > 0.999 * spec.speed_m_s
    # Variance of the mean square of a Matern-3/2 process over T: sigma^4 * 2 * (5/2 tau) / T per component.
    seconds = nominal.sum() / spec.imu_rate_hz
    ratio = (slip[nominal] ** 2).mean() / spec.slip_sigma_m_s**2
    assert abs(ratio - 1) < stats.norm.isf(FALSE_ALARM / 2) * np.sqrt(5 * 0.25 / seconds / 2)


def test_wobble_is_stationary_and_worth_one_draw_per_second() -> None:
    angles = wobble(np.random.default_rng(7), 100 * 4000, 0.01, 1.0)
    means = angles.reshape(400, 1000, 2).mean(1)
    # Mean over T of the process: sigma^2 (4 tau / T - 6 tau^2 / T^2), to exp(-40); a draw per second: 0.1.
    assert_unit_normal(means / np.sqrt(0.1 - 6 * 0.25**2 / 100))
    for lag in (5, 25, 100):
        x = lag / 25
        found = (angles[:-lag] * angles[lag:]).mean()
        assert found == pytest.approx((1 + x) * np.exp(-x), abs=0.06)
    start = np.array([wobble(np.random.default_rng(s), 1, 0.01, 2.0)[0] for s in range(300)])
    assert_unit_normal(start / 2.0)


def test_wobble_leaves_the_origin_on_its_path() -> None:
    true = world(MEMS)
    t_s, motion, _ = true.states(9_000, 10_000)
    assert np.array_equal(motion.pos_n, true.timeline.at(t_s).pos_n)


# --- path and motion --------------------------------------------------------------------------------------


@pytest.mark.parametrize("spec", [MEMS, replace(FULL_SHIFT, duration_s=80.0)], ids=["mems", "full-shift"])
def test_next_line_is_this_line_pushed_to_the_machines_right(spec: ShearerSpec) -> None:
    errors = []
    for seed in range(8):
        lines = world(spec, seed).lines
        assert len(lines) == spec.cycles
        for line, following in pairwise(lines):
            nodes = np.arange(0.0, spec.length_m, spec.interval_m)
            pos_n, slope, roll = line.at(nodes)
            move_m = attitude(slope, roll).inv().apply(following.at(nodes)[0] - pos_n)
            assert np.abs(move_m[:, 1]).max() < 1e-9
            errors.append((move_m[:, [0, 2]] - [spec.push_m, 0.0]) / spec.push_sigma_m)
    stacked = np.vstack(errors)
    assert_unit_normal(stacked[:, 0])
    assert_unit_normal(stacked[:, 1])
    neighbours = (stacked[:-1] * stacked[1:]).ravel()
    assert abs(neighbours.mean()) < stats.norm.isf(FALSE_ALARM / 2) / np.sqrt(len(neighbours))


@pytest.mark.parametrize("interval_m", [2.0, 6.0, 10.0])
def test_nodes_stand_at_the_closed_path_interval(interval_m: float) -> None:
    line = world(replace(MEMS, interval_m=interval_m)).lines[0]
    assert np.diff(line.nodes_m) == pytest.approx(interval_m)
    assert line.nodes_m[0] == 0 and line.nodes_m[-1] >= 44.6
    log = simulate("shearer-mems", interval_m=interval_m)
    assert log.face is not None and log.face.interval_m == interval_m


def test_first_line_has_the_declared_shape() -> None:
    for spec in (MEMS, FULL_SHIFT):
        true = world(replace(spec, duration_s=80.0), 3)
        line, cut = true.lines[0], true.timeline.legs[0]
        assert cut.arc.total_m == pytest.approx(spec.length_m, abs=1e-4)
        pos = line.at(np.linspace(0, spec.length_m, 3001))[0]
        assert pos[0] == pytest.approx([0, 0, 0], abs=1e-12)
        chord = pos[-1, :2] / np.linalg.norm(pos[-1, :2])
        assert np.degrees(np.arctan2(-chord[0], chord[1])) == pytest.approx(17.0, abs=1e-3)
        assert np.abs(pos[:, :2] @ [chord[1], -chord[0]]).max() == pytest.approx(spec.bend_m, rel=0.01)
        assert np.ptp(pos[:, 2]) <= 2 * spec.undulation_m + 1e-6


def test_pushed_line_is_longer_by_its_winding() -> None:
    cuts = [leg.arc.total_m for leg in world(MEMS).timeline.legs if leg.cycle]
    assert np.all(np.diff(cuts) > 0)
    assert cuts[-1] - cuts[0] < 0.25


@pytest.mark.parametrize("spec", [MEMS, replace(FULL_SHIFT, duration_s=80.0)], ids=["mems", "full-shift"])
def test_velocity_is_the_derivative_of_position_everywhere(spec: ShearerSpec) -> None:
    timeline: Timeline = world(spec).timeline
    h = 1e-3
    t_s = np.concatenate([[leg.start_s, leg.end_s] for leg in timeline.legs])
    t_s = np.sort(np.concatenate([t_s, np.linspace(0, timeline.end_s, 4001)])) + 0.4 * h
    ahead, behind, here = timeline.at(t_s + h), timeline.at(t_s - h), timeline.at(t_s)
    numeric = (ahead.pos_n - behind.pos_n) / (2 * h)
    assert np.abs(numeric - here.vel_n).max() < spec.accel_m_s2 * h
    assert np.linalg.norm(here.vel_n, axis=1) == pytest.approx(np.abs(here.speed_m_s), abs=1e-12)
    assert (behind.rot_nm.inv() * ahead.rot_nm).magnitude().max() < 0.1 * 2 * h
    assert np.abs(here.rot_nm.inv().apply(here.vel_n)[:, [0, 2]]).max() < 1e-12


@pytest.mark.parametrize("length_m", [0.2, 0.9, 44.6])
def test_trapezoid_covers_its_length(length_m: float) -> None:
    profile = Trapezoid(length_m, 0.3, 0.1)
    t = np.linspace(0, profile.duration_s, 20001)
    way, speed = profile.at(t)
    assert way[-1] == pytest.approx(length_m) and speed[-1] == pytest.approx(0, abs=1e-9)
    assert speed.max() <= 0.3 + 1e-12
    assert np.gradient(way, t) == pytest.approx(speed, abs=1e-3)
    assert profile.at(np.array([-1.0, profile.duration_s + 1.0]))[0] == pytest.approx([0, length_m])


# --- the logs ---------------------------------------------------------------------------------------------


def test_mems_log_has_four_cuts_and_their_events() -> None:
    log = mems()
    assert log.events is not None and log.odometer is not None and log.imu is not None and log.truth is not None
    assert list(log.events.kind) == ["cut_start", "cut_end"] * 4
    assert log.events.cycle.tolist() == [1, 1, 2, 2, 3, 3, 4, 4]
    assert log.events.t_s[0] == 60.0
    cuts = log.events.t_s[1::2] - log.events.t_s[::2]
    assert np.all((cuts > 151.6) & (cuts < 153.0))
    assert 1015 < log.imu.t_s[-1] < 1035
    assert log.imu.start_s == pytest.approx(0.0, abs=1e-9)
    assert len(log.truth) == len(log.imu) + 1 and len(log.odometer) == len(log.imu) // 10
    for start, end, cycle in zip(log.events.t_s[::2], log.events.t_s[1::2], range(1, 5), strict=True):
        middle = (log.odometer.t_s > start + 5) & (log.odometer.t_s < end - 5)
        assert np.all(np.sign(log.odometer.speed_m_s[middle]) == (1 if cycle % 2 else -1))


def test_truth_shows_the_advance_of_the_face() -> None:
    log = mems()
    assert log.truth is not None and log.events is not None
    right = np.array([np.cos(17 * DEG), np.sin(17 * DEG), 0.0])
    ends = np.searchsorted(log.truth.t_s, log.events.t_s)
    across = log.truth.pos_n_m[ends] @ right
    assert across[[0, 2, 4, 6]] == pytest.approx([0, 0.4, 0.8, 1.2], abs=0.3)
    assert across[[1, 3, 5, 7]] == pytest.approx([0, 0.4, 0.8, 1.2], abs=0.3)


def test_far_end_is_surveyed_where_the_machine_first_gets_there() -> None:
    log = mems(noise=False)
    assert log.truth is not None and log.events is not None
    (point,) = log.surveyed
    assert point.end == "far" and point.sigma_m == 0.02
    row = int(np.searchsorted(log.truth.t_s, log.events.t_s[1]))
    assert point.pos_n_m == pytest.approx(log.truth.pos_n_m[row], abs=1e-6)


def test_odometer_measures_forward_speed() -> None:
    clean, noisy = mems(noise=False), mems()
    assert clean.odometer is not None and noisy.odometer is not None and clean.truth is not None
    row = np.searchsorted(clean.truth.t_s, clean.odometer.t_s + 1e-6) - 1
    assert clean.truth.t_s[row] == pytest.approx(clean.odometer.t_s)
    assert clean.truth.vel_n_m_s is not None
    speed = np.linalg.norm(clean.truth.vel_n_m_s[row], axis=1)
    # The wobble turns at most some 8 degrees of the velocity out of the forward axis.
    assert np.all(np.abs(clean.odometer.speed_m_s) <= speed + 1e-12)
    assert np.all(np.abs(clean.odometer.speed_m_s) >= np.cos(10 * DEG) * speed)


def test_full_shift_runs_six_cycles_in_its_time() -> None:
    for seed in range(3):
        legs = world(replace(FULL_SHIFT, duration_s=80.0), seed).timeline.legs
        cuts = [leg for leg in legs if leg.cycle]
        assert [cut.cycle for cut in cuts] == [1, 2, 3, 4, 5, 6]
        assert legs[-1].end_s < 7.1 * HOUR < legs[-1].end_s + 200
        assert [b.start_s - a.end_s for a, b in pairwise(cuts)] == pytest.approx([870] * 5)
        assert all(3500 < cut.profile.duration_s < 3540 for cut in cuts)


def test_full_shift_is_cut_at_the_hours_asked_for() -> None:
    short, longer = simulate("full-shift", seed=4, hours=0.1), simulate("full-shift", seed=4, hours=0.25)
    assert short.imu is not None and longer.imu is not None and short.events is not None
    assert short.odometer is not None and longer.odometer is not None
    assert len(short.imu) == 36_000 and short.imu.t_s[-1] == 360.0
    assert list(short.events.kind) == ["cut_start"]
    assert short.surveyed == ()
    assert np.array_equal(short.imu.gyro_b_rad_s, longer.imu.gyro_b_rad_s[:36_000])
    assert np.array_equal(short.odometer.speed_m_s, longer.odometer.speed_m_s[:3600])


def test_long_log_carries_truth_at_the_odometers_rate() -> None:
    log = simulate("full-shift", hours=1.05)
    assert log.truth is not None and log.imu is not None and log.events is not None
    assert len(log.imu) == 378_000 and len(log.truth) == 37_801
    assert np.diff(log.truth.t_s) == pytest.approx(0.1)
    assert list(log.events.kind) == ["cut_start", "cut_end"]
    assert log.surveyed[0].end == "far"
    assert log.truth.vel_n_m_s is not None  # block borders must leave neither gap nor double row
    numeric = np.diff(log.truth.pos_n_m, axis=0) / 0.1
    assert np.abs(numeric - (log.truth.vel_n_m_s[1:] + log.truth.vel_n_m_s[:-1]) / 2).max() < 2e-3


def test_closed_path_can_be_left_out() -> None:
    log = simulate("full-shift", hours=1.0, sensors="imu, odometer")
    assert log.face is None
    (point,) = log.surveyed
    assert point.end is None and point.t_s == pytest.approx(3561.0, abs=0.01)


def test_same_seed_same_log_and_other_seed_other_log() -> None:
    first, again, other = mems(5), simulate("shearer-mems", seed=5), mems(6)
    for name, record in first.tables().items():
        for f in record.column_fields():
            assert np.array_equal(getattr(record, f.name), getattr(again.tables()[name], f.name))
    assert first.initial is not None and again.initial is not None
    assert np.array_equal(first.initial.quat_nb_wxyz, again.initial.quat_nb_wxyz)
    assert first.truth is not None and other.truth is not None
    rows = min(len(first.truth), len(other.truth))
    assert np.abs(first.truth.pos_n_m[:rows] - other.truth.pos_n_m[:rows]).max() > 0.01


def test_log_survives_writing_and_reading(tmp_path) -> None:
    from graphnav.readers import read, write

    log = simulate("full-shift", seed=2, hours=0.03)
    write(log, tmp_path / "log")
    again = read(tmp_path / "log")
    assert set(again.tables()) == set(log.tables())
    for name, record in log.tables().items():
        for f in record.column_fields():
            assert np.array_equal(getattr(record, f.name), getattr(again.tables()[name], f.name))
    assert again.face is not None and log.face is not None and vars(again.face) == vars(log.face)


# --- options ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("scenario", "options", "fragments"),
    [
        ("shearer", {}, ['"shearer"', "shearer-mems", "full-shift"]),
        ("shearer-mems", {"noise": 0}, ['"noise"', "interval_m", "par"]),
        ("shearer-mems", {"interval_m": 3}, ["interval_m", "3", "2.0, 6.0, 10.0"]),
        ("shearer-mems", {"par": 13}, ["par", "13", "0 to 12"]),
        ("shearer-mems", {"par": 1.5}, ["par", "1.5"]),
        ("shearer-mems", {"seed": -1}, ["seed", "-1"]),
        ("full-shift", {"par": 1}, ['"par"', "hours", "sensors"]),
        ("full-shift", {"hours": 8}, ["hours", "8", "7.1"]),
        ("full-shift", {"hours": float("nan")}, ["hours", "nan"]),
        ("full-shift", {"hours": "2"}, ["hours", "'2'"]),
        (
            "full-shift",
            {"sensors": ("imu", "odometer", "lidar")},
            ['"lidar"', "not available yet", "closed-path"],
        ),
        ("full-shift", {"sensors": ("imu",)}, ["odometer"]),
    ],
)
def test_wrong_options_are_refused_with_the_valid_ones(scenario: str, options: dict, fragments: list[str]) -> None:
    with pytest.raises(ConfigError) as caught:
        simulate(scenario, **options)
    for fragment in fragments:
        assert fragment in str(caught.value)


def test_help_lists_every_scenario_and_option() -> None:
    assert list(SCENARIOS) == list(BUILDERS)
    for name, entry in SCENARIOS.items():
        code = BUILDERS[name].__code__
        assert tuple(entry["options"]) == code.co_varnames[: code.co_argcount]
        assert entry["description"]
