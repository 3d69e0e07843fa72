"""Dead reckoning: exact with exact sensors, the odometer model turned round, and the closed path."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from engine_logs import MEMS, SHORT, TWO_CUTS, rows, simulated, until, world
from filter_runs import config, errors, inputs_of

from factors import so3
from factors.earth import earth_rate_n
from factors.increments import Samples, compensated_increments
from factors.inertial import ImuNoise, cumulate
from factors.odometry import preintegrate_speed
from graphnav._metrics import truth_at
from graphnav.baselines import dead_reckoning as dr
from graphnav.errors import LogError
from graphnav.evaluation import evaluate
from graphnav.frontends import condense
from graphnav.frontends.alignment import aligned, rest_bias
from graphnav.log import InitialState, SensorLog
from graphnav.run import Run
from graphnav.smooth import smooth

MINOR_S = 0.05
METHODS = ("dead-reckoning", "dead-reckoning-cpoem")


def reckoned(log: SensorLog, method: str = "dead-reckoning", compensation: str = "none") -> Run:
    return smooth(log, config(dead_reckoning={"compensation": compensation}), method)


def off(run: Run, log: SensorLog) -> tuple[float, float]:
    """Largest attitude error (rad) and position error (m) at a keyframe."""
    attitude, pos = errors(run, log)
    return float(np.abs(attitude).max()), float(np.abs(pos).max())


def exact(mounting: bool = False) -> SensorLog:
    """Two cuts without sensor errors and without slip; mounting angles as they are drawn, or none."""
    spec = dataclasses.replace(TWO_CUTS, slip_sigma_m_s=1e-9)
    if not mounting:
        spec = dataclasses.replace(spec, mounting_sigma_deg=(1e-9, 1e-9, 1e-9))
    return simulated(spec, 0, False)


# the odometer model turned round ----------------------------------------------------------------------------


def test_exact_sensors_give_the_truth() -> None:
    """Five minutes and 70 m: attitude to 1e-7 rad, position to 1 mm, what a speed of ten samples a second allows."""
    attitude, pos = off(reckoned(exact()), exact())
    assert attitude < 1e-7
    assert pos < 1e-3


def mounted(scale: float, lever: list[float]) -> tuple[SensorLog, dr.Compensation]:
    """The exact log with mounting, a scale factor and an odometer away from the IMU; and what there is to know.

    The odometer keeps to the path of the exact log: the IMU is where the lever arm puts it.
    """
    log, mounting = exact(mounting=True), world(dataclasses.replace(TWO_CUTS, slip_sigma_m_s=1e-9), 0).mounting_rad
    lever_b = np.array(lever)
    shift = so3.from_quaternion(log.truth.quat_nb) @ lever_b
    truth = log.truth.replace(pos_n_m=log.truth.pos_n_m - shift, vel_n_m_s=None)
    initial = log.initial.replace(pos_n_m=log.initial.pos_n_m - so3.from_quaternion(log.initial.quat_nb_wxyz) @ lever_b)
    odometer = log.odometer.replace(speed_m_s=(1 + scale) * log.odometer.speed_m_s, lever_arm_b_m=lever_b)
    changed = dataclasses.replace(log, truth=truth, initial=initial, odometer=odometer)
    return changed, dr.Compensation(np.zeros(3), np.concatenate([[scale], mounting]))


@pytest.mark.parametrize("lever", [[0.0, 0.0, 0.0], [0.5, -1.5, 0.8]])
@pytest.mark.parametrize("scale", [0.0, 0.05, -0.03])
def test_what_is_known_of_the_odometer_is_taken_out(scale: float, lever: list[float]) -> None:
    """To 1 mm; without knowing it metres, by scale and mounting alike."""
    log, known = mounted(scale, lever)
    assert np.abs(known.calibration[1:]).max() > 0.01
    inputs = inputs_of(log)
    rotation = so3.from_quaternion(inputs.initial.quat_nb_wxyz)
    _, pos, _ = truth_at(log.truth, inputs.keyframe_s)

    def wrong(calibration: np.ndarray) -> float:
        track = dr.traditional(inputs, rotation, dr.Compensation(np.zeros(3), calibration), MINOR_S)
        return float(np.abs(track.pos_n - pos).max())

    assert wrong(known.calibration) < 1e-3
    assert wrong(np.concatenate([[scale], np.zeros(3)])) > 0.1
    if scale:
        assert wrong(np.concatenate([[0.0], known.calibration[1:]])) > 0.5


def test_velocity_is_the_measured_one_along_the_machine() -> None:
    log, known = mounted(0.05, [0.0, 0.0, 0.0])
    inputs = inputs_of(log)
    track = dr.traditional(inputs, so3.from_quaternion(inputs.initial.quat_nb_wxyz), known, MINOR_S)
    step = np.gradient(track.pos_n, inputs.keyframe_s, axis=0)
    assert np.median(np.linalg.norm(track.vel_n - step, axis=1)) < 0.01
    assert np.linalg.norm(track.vel_n, axis=1).max() == pytest.approx(0.3, abs=0.002)


def test_gyro_bias_is_taken_out() -> None:
    log, bias = exact(), np.array([1e-3, -2e-3, 3e-3])
    biased = dataclasses.replace(log, imu=log.imu.replace(gyro_b_rad_s=log.imu.gyro_b_rad_s + bias))
    inputs = inputs_of(biased)
    rotation, pos = so3.from_quaternion(inputs.initial.quat_nb_wxyz), truth_at(log.truth, inputs.keyframe_s)[1]
    known = dr.traditional(inputs, rotation, dr.Compensation(bias, np.zeros(4)), MINOR_S)
    unknown = dr.traditional(inputs, rotation, dr.Compensation(np.zeros(3), np.zeros(4)), MINOR_S)
    assert np.abs(known.pos_n - pos).max() < 1e-3
    assert np.abs(unknown.pos_n - pos).max() > 1.0


def test_an_interval_without_odometer_samples_is_crossed_at_the_speed_of_its_ends() -> None:
    """Ten seconds of constant speed not recorded: millimetres."""
    log = exact()
    t = log.odometer.t_s
    hole = dataclasses.replace(log, odometer=rows(log.odometer, (t < 60.0) | (t > 70.0)))
    assert off(reckoned(hole), log)[1] < 0.01


# compensation -----------------------------------------------------------------------------------------------


def test_compensation_from_rest_and_from_the_smoother_are_each_worth_their_while() -> None:
    """Mean square position error over four logs: the gyro bias of the first rest, then scale and mounting besides."""
    mean = {}
    for compensation in ("none", "rest", "rts"):
        squares = []
        for seed in range(4):
            log = simulated(TWO_CUTS, seed)
            squares.append(np.sum(evaluate(reckoned(log, compensation=compensation).trajectory, log).rms_m ** 2))
        mean[compensation] = float(np.sqrt(np.mean(squares)))
    assert mean["rts"] < 0.5 * mean["rest"]
    assert mean["rest"] < 0.5 * mean["none"]


def test_what_was_compensated_is_reported() -> None:
    log = simulated(TWO_CUTS)
    none, rest, smoothed = (reckoned(log, compensation=c) for c in ("none", "rest", "rts"))
    rts = smooth(log, method="rts")
    assert all(c.value == 0 and c.sigma is None for c in none.calibration.values())
    assert abs(rest.calibration["gyro_bias_z"].value - rts.calibration["gyro_bias_z"].value) < 100
    assert rest.calibration["odometer_scale"].value == 0
    for name, found in smoothed.calibration.items():
        assert found.value == pytest.approx(rts.calibration[name].value), name
        assert found.unit == rts.calibration[name].unit
    assert none.trajectory.cov is None


# alignment --------------------------------------------------------------------------------------------------

NOISE = ImuNoise(1e-4, 1e-3, gyro_bias=3e-3, accel_bias=0.01)
EARTH = earth_rate_n(35.0)


def at_rest(tilt: np.ndarray, bias: np.ndarray) -> tuple[Samples, InitialState, np.ndarray]:
    """Ten seconds at rest, tilted against what is declared; the true attitude."""
    declared = so3.exp(np.array([0.0, 0.0, 0.7]))
    true = declared @ so3.exp(tilt)
    edge = np.arange(1001) / 100
    samples = Samples(edge, np.tile(true.T @ EARTH + bias, (1000, 1)), np.tile(true.T @ [0, 0, 9.8], (1000, 1)))
    initial = InitialState(
        pos_n_m=np.zeros(3), pos_sigma_m=np.ones(3), quat_nb_wxyz=so3.to_quaternion(declared),
        att_sigma_deg=np.ones(3), vel_n_m_s=np.zeros(3), vel_sigma_m_s=np.ones(3),
    )  # fmt: skip
    return samples, initial, true


REST = np.array([[0.0, 10.0]])


def test_alignment_finds_tilt_and_bias() -> None:
    """Heading is left as declared: a tilt turns about a level axis."""
    bias = np.array([1e-3, -2e-3, 3e-3])
    samples, initial, true = at_rest(np.array([0.02, -0.03, 0.0]), bias)
    rotation, found = aligned(samples, REST, initial, NOISE, 9.8, EARTH)
    assert np.linalg.norm(so3.log(rotation.T @ true)) < 5e-4
    assert rotation[2] == pytest.approx(true[2], abs=1e-12)
    assert found == pytest.approx(bias, abs=1e-7)


def test_alignment_keeps_what_is_declared_where_rest_tells_less() -> None:
    """No rest, rest that starts later, an accelerometer worse than the declaration, a rate that is no bias."""
    bias = np.array([1e-3, -2e-3, 3e-3])
    samples, initial, _ = at_rest(np.array([0.02, -0.03, 0.0]), bias)
    declared = so3.from_quaternion(initial.quat_nb_wxyz)
    rotation, found = aligned(samples, np.zeros((0, 2)), initial, NOISE, 9.8, EARTH)
    assert np.array_equal(rotation, declared)
    assert not found.any()
    later, found = aligned(samples, np.array([[4.0, 9.0]]), initial, NOISE, 9.8, EARTH)
    assert np.array_equal(later, declared)
    assert found == pytest.approx(bias, abs=1e-5)
    coarse = dataclasses.replace(NOISE, accel_bias=0.5)
    assert np.array_equal(aligned(samples, REST, initial, coarse, 9.8, EARTH)[0], declared)
    fast, initial, _ = at_rest(np.zeros(3), np.array([0.0, 0.0, 0.1]))
    assert not aligned(fast, REST, initial, NOISE, 9.8, EARTH)[1].any()
    assert rest_bias(fast, np.array([[3.001, 3.005]]), declared, EARTH).tolist() == [0, 0, 0]


@pytest.mark.parametrize("block", [1, 7, 100])
def test_condensing_in_blocks_changes_nothing(block: int, monkeypatch: pytest.MonkeyPatch) -> None:
    inputs = inputs_of(simulated(SHORT))
    keyframe_s, odometer, samples = inputs.keyframe_s, inputs.log.odometer, inputs.imu.samples
    count = len(keyframe_s) - 1
    biases = np.random.default_rng(3).normal(0, 1e-3, (count, 3)), np.zeros((count, 3))
    monkeypatch.setattr(condense, "_BLOCK", block)
    parts = list(condense.condensed(samples, odometer, keyframe_s, MINOR_S, *biases))
    assert [p.rows for p in parts][-1].stop == count
    motion = condense.joined_motion([p.ends for p in parts])
    travel = condense.joined_travel([p.travel for p in parts])
    whole = cumulate(compensated_increments(samples, keyframe_s, MINOR_S, *biases))
    expected = preintegrate_speed(odometer.t_s, odometer.speed_m_s, keyframe_s, whole)
    last = whole.first[1:] - 1
    assert motion.rotation == pytest.approx(whole.rotation[last], abs=1e-14)
    assert motion.velocity_b == pytest.approx(whole.velocity_b[last], abs=1e-12)
    assert motion.elapsed_s == pytest.approx(np.diff(keyframe_s))
    for name in ("distance_m", "mean_b", "weight2_s2", "samples"):
        assert getattr(travel, name) == pytest.approx(getattr(expected, name), abs=1e-12), name


# closed path ------------------------------------------------------------------------------------------------


def test_the_first_cycle_is_left_alone_but_for_surveyed_points() -> None:
    log = simulated(MEMS)
    plain, pulled = (reckoned(log, method, "rest").trajectory for method in METHODS)
    inputs = inputs_of(log)
    (fix_s, fix, _), *_ = inputs.fixes
    at = inputs.index(fix_s)
    assert at > 100
    assert np.array_equal(plain.pos_n[:at], pulled.pos_n[:at])
    assert np.array_equal(plain.quat_nb, pulled.quat_nb)
    assert np.linalg.norm(pulled.pos_n[at] - fix) < 0.1 * np.linalg.norm(plain.pos_n[at] - fix)
    unsurveyed = dataclasses.replace(log, surveyed=())
    alone = reckoned(unsurveyed, METHODS[1], "rest").trajectory
    again = inputs_of(unsurveyed)
    second = min(again.index(p.second_s) for p in again.closed_path)
    assert second > at
    assert alone.pos_n[:second] == pytest.approx(reckoned(unsurveyed, METHODS[0], "rest").trajectory.pos_n[:second])
    assert not np.allclose(alone.pos_n[second], plain.at(alone.t_s[second]).pos_n[0], atol=1e-3)


def test_later_cycles_are_pulled_to_what_the_one_before_predicts() -> None:
    """The advance between the two passes comes nearer to the push, as far as the first pass itself is known."""
    log = dataclasses.replace(simulated(MEMS), surveyed=())
    inputs = inputs_of(log)
    plain, pulled = (reckoned(log, method, "rest").trajectory for method in METHODS)

    def missed(track) -> np.ndarray:
        """Distance of the advance, right and up, from the declared push, at every point."""
        out = []
        for p in inputs.closed_path:
            i, j = inputs.index(p.first_s), inputs.index(p.second_s)
            in_m = so3.from_quaternion(track.quat_nb[i]).T @ (track.pos_n[j] - track.pos_n[i])
            out.append(np.hypot(in_m[0] - p.push_m, in_m[2]))
        return np.array(out)

    assert len(inputs.closed_path) > 60
    assert np.median(missed(pulled)) < 0.6 * np.median(missed(plain))


def test_closed_path_and_survey_help_on_the_whole() -> None:
    """Mean square error over four logs of four cycles."""
    total = {
        method: sum(
            np.sum(
                evaluate(reckoned(simulated(MEMS, seed), method, "rest").trajectory, simulated(MEMS, seed)).rms_m ** 2
            )
            for seed in range(4)
        )
        for method in METHODS
    }
    assert total[METHODS[1]] < 0.5 * total[METHODS[0]]


def test_without_points_both_methods_are_one() -> None:
    log = dataclasses.replace(simulated(TWO_CUTS), face=None, surveyed=())
    plain, pulled = (reckoned(log, method, "rest").trajectory for method in METHODS)
    assert np.array_equal(plain.pos_n, pulled.pos_n)


# other logs -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_without_an_odometer_there_is_nothing_to_reckon_with(method: str) -> None:
    log = dataclasses.replace(simulated(SHORT), odometer=None)
    with pytest.raises(LogError, match=r"no odometer table.*dead reckoning needs an odometer"):
        smooth(log, method=method)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("end_s", [2.0, 33.0, 150.0])
def test_a_log_cut_off_anywhere(method: str, end_s: float) -> None:
    log = until(dataclasses.replace(simulated(TWO_CUTS), events=None), end_s)
    for compensation in ("none", "rest", "rts"):
        run = reckoned(log, method, compensation)
        assert run.trajectory.t_s[-1] == pytest.approx(end_s)
        assert np.isfinite(run.trajectory.pos_n).all()


@pytest.mark.parametrize("method", METHODS)
def test_truth_plays_no_part(method: str) -> None:
    log = simulated(TWO_CUTS)
    with_truth, without = (reckoned(x, method, "rts") for x in (log, dataclasses.replace(log, truth=None)))
    assert np.array_equal(with_truth.trajectory.pos_n, without.trajectory.pos_n)
