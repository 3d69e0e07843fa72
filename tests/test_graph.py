"""From log to factors: what is refused, what the initial values are, and whether the factors' sigmas are true."""

from __future__ import annotations

import dataclasses
from functools import cache

import gtsam
import numpy as np
import pytest
from engine_logs import MEMS, SHORT, TWO_CUTS, drawn, rows, simulated, without_imu, world
from scipy.spatial.transform import Rotation

from factors import so3
from factors.earth import normal_gravity
from graphnav import graph as build
from graphnav import initial as initial_
from graphnav import native_factors
from graphnav import preintegration as preintegration_
from graphnav import problem as problem_
from graphnav._metrics import truth_at
from graphnav.config import Config
from graphnav.errors import LogError
from graphnav.frontends import condense
from graphnav.keyframes import run_frontend
from graphnav.log import SensorLog
from graphnav.native_factors import FactorAt
from graphnav.preintegration import Preintegrated
from graphnav.problem import B, C, K, Problem, V, X


def config(**sections) -> Config:
    return Config.from_dict(sections)


def posed(log: SensorLog, chosen: Config | None = None) -> Problem:
    chosen = chosen or Config()
    return problem_.pose_problem(log, chosen, run_frontend(log, chosen))


def prepared(problem: Problem) -> Preintegrated:
    return preintegration_.preintegrate(problem, initial_.start_state(problem)[1], np.zeros(3))


# keys and epochs --------------------------------------------------------------------------------------------


def test_keys_are_gtsams_symbols() -> None:
    for letter, key in zip("xvbck", (X, V, B, C, K), strict=True):
        for index in (0, 7, 123456):
            assert key(index) == gtsam.symbol(letter, index)


def test_epochs_change_at_their_span() -> None:
    problem = posed(simulated(TWO_CUTS), config(imu={"bias_epoch_s": 30.0}, odometer={"calibration_epoch_s": 100.0}))
    start = problem.keyframe_s[:-1] - problem.keyframe_s[0]
    assert np.array_equal(problem.bias_epoch, np.floor(start / 30.0 + 1e-9))
    assert np.array_equal(problem.calibration_epoch, np.floor(start / 100.0 + 1e-9))
    # every epoch has an interval, so every variable a factor
    assert set(problem.bias_epoch) == set(range(int(problem.bias_epoch[-1]) + 1))


# what is refused --------------------------------------------------------------------------------------------


def test_missing_parts_are_named() -> None:
    log = simulated(SHORT)
    with pytest.raises(LogError, match=r"log\.toml, \[initial\]: missing; give the initial pose"):
        posed(dataclasses.replace(log, initial=None))
    frontend = run_frontend(log, Config())
    with pytest.raises(LogError, match="no imu table"):
        problem_.pose_problem(dataclasses.replace(log, imu=None), Config(), frontend)


def test_a_hole_in_the_imu_record_that_is_too_long_is_named() -> None:
    log = without_imu(simulated(SHORT), 40.0, 43.0)
    with pytest.raises(LogError, match=r"no samples for 3\.000 s after t = 40\.000 s"):
        posed(log)
    assert len(posed(log, config(imu={"max_gap_s": 3.5})).imu.bridged_s) == 1


def test_a_hole_in_the_odometer_record_that_is_too_long_is_named() -> None:
    log = simulated(TWO_CUTS)
    assert log.odometer is not None
    t = log.odometer.t_s
    log = dataclasses.replace(log, odometer=rows(log.odometer, (t <= 40.0) | (t > 120.0)))
    with pytest.raises(LogError, match=r"table odometer, row \d+, t_s: no samples for 80\.[01] s after t = 40\.0 s"):
        posed(log, config(closed_path={"form": "off"}))
    posed(log, config(closed_path={"form": "off"}, odometer={"max_gap_s": 90.0}))


def test_gravity_is_the_logs_or_normal() -> None:
    log = simulated(SHORT)
    assert posed(log).gravity_m_s2 == 9.7973
    elsewhere = dataclasses.replace(log.frames, gravity_m_s2=None, latitude_deg=50.0, height_m=-800.0)
    problem = posed(dataclasses.replace(log, frames=elsewhere))
    assert problem.gravity_m_s2 == pytest.approx(normal_gravity(50.0, -800.0))
    assert np.linalg.norm(problem.earth_rate_n) == pytest.approx(7.292115e-5)


# preintegration ---------------------------------------------------------------------------------------------


def test_blocks_do_not_show(monkeypatch: pytest.MonkeyPatch) -> None:
    """Seven intervals at a time or all at once: the same factors, and every odometer sample once."""
    problem = posed(simulated(TWO_CUTS))
    whole = prepared(problem)
    monkeypatch.setattr(condense, "_BLOCK", 7)
    parts = prepared(problem)
    assert problem.log.odometer is not None
    for data in (whole, parts):
        assert data.travel is not None
        assert data.travel.samples.sum() == len(problem.log.odometer)
    assert len(whole.imu_factors) == len(parts.imu_factors) == len(problem.keyframe_s) - 1
    assert np.allclose(whole.motion.rotation, parts.motion.rotation, atol=1e-12)
    assert np.allclose(whole.motion.position_b, parts.motion.position_b, atol=1e-10)
    assert np.allclose(whole.travel.distance_m, parts.travel.distance_m, atol=1e-12)
    assert np.allclose(whole.travel.mean_b, parts.travel.mean_b, atol=1e-12)
    for a, b in zip(whole.imu_factors, parts.imu_factors, strict=True):
        assert a.preintegratedMeasurements().equals(b.preintegratedMeasurements(), 1e-8)


def imu_sigma(data: Preintegrated, k: int) -> np.ndarray:
    """Sigmas of attitude (rad), position (m) and velocity (m/s) of the k-th IMU factor."""
    return np.sqrt(np.diag(data.imu_factors[k].preintegratedMeasurements().preintMeasCov()))


def test_a_bridged_hole_widens_its_own_intervals() -> None:
    """By the signals' usual size for as long as the hole lasts."""
    plain = prepared(posed(simulated(SHORT)))
    problem = posed(without_imu(simulated(SHORT), 40.2, 40.6))
    bridged = prepared(problem)
    k = int(np.searchsorted(problem.keyframe_s, 40.2)) - 1
    sigma = imu_sigma(bridged, k)
    assert sigma[:3] == pytest.approx(problem.imu.gyro_spread * 0.4, rel=0.1)
    # the vertical velocity; the level ones have the turned gravity besides
    assert sigma[8] == pytest.approx(problem.imu.accel_spread * 0.4, rel=0.1)
    assert sigma[6:8] == pytest.approx(np.hypot(sigma[8], 9.8 * problem.imu.gyro_spread * 0.4 / np.sqrt(3)), rel=0.2)
    assert (sigma > 5 * imu_sigma(plain, k)).all()
    for other in (k - 2, k + 2):
        assert imu_sigma(bridged, other) == pytest.approx(imu_sigma(plain, other), rel=1e-6)


def test_every_hole_in_an_interval_counts() -> None:
    first, second = ((40.1, 40.5), (40.7, 40.8))
    k = int(np.searchsorted(posed(simulated(SHORT)).keyframe_s, 40.1)) - 1
    one = imu_sigma(prepared(posed(without_imu(simulated(SHORT), *first))), k)
    both = imu_sigma(prepared(posed(without_imu(without_imu(simulated(SHORT), *first), *second))), k)
    assert (both[:3] >= 0.99 * one[:3]).all()


# initial values ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_the_rest_at_the_start_tells_tilt_and_gyro_bias(seed: int) -> None:
    """Tilt to the accelerometer's bias over gravity, 3 mrad 1 sigma; gyro bias to its noise over 60 s, 4.6 deg/h."""
    problem = posed(simulated(MEMS, seed))
    state, gyro_bias = initial_.start_state(problem)
    truth, errors = problem.log.truth, drawn(MEMS, seed)
    assert truth is not None
    turn = so3.log(Rotation.from_quat(truth.quat_nb[0], scalar_first=True).as_matrix().T @ state.rotation_nb[0])
    up_b = state.rotation_nb[0].T @ [0, 0, 1.0]
    tilt = turn - up_b * (turn @ up_b)
    expected = np.cross(up_b, errors.accel_bias_m_s2) / 9.7973
    assert np.allclose(tilt, -expected, atol=1e-4) or np.allclose(tilt, expected, atol=1e-4)
    assert np.abs(gyro_bias - errors.gyro_bias_rad_s).max() < 5 * np.radians(4.6) / 3600
    # heading, position and velocity stay as declared
    assert problem.log.initial is not None
    declared = Rotation.from_quat(problem.log.initial.quat_nb_wxyz, scalar_first=True).as_matrix()
    assert abs(so3.log(declared.T @ state.rotation_nb[0]) @ up_b) < 1e-3
    assert np.array_equal(state.pos_n[0], problem.log.initial.pos_n_m)


def test_without_rest_the_start_is_what_is_declared() -> None:
    problem = posed(simulated(SHORT), config(rest={"use": False}))
    state, gyro_bias = initial_.start_state(problem)
    declared = problem.initial
    assert np.allclose(state.rotation_nb[0], so3.from_quaternion(declared.quat_nb_wxyz))
    assert np.array_equal(gyro_bias, np.zeros(3))


@pytest.mark.parametrize("seed", range(3))
def test_dead_reckoning_is_near_the_truth(seed: int) -> None:
    """Uncalibrated odometer and mounting: some percent of the way, not some multiple."""
    problem = posed(simulated(MEMS, seed))
    data = prepared(problem)
    values = initial_.initial_values(problem, data, initial_.start_state(problem)[0])
    assert problem.log.truth is not None
    _, pos, _ = truth_at(problem.log.truth, problem.keyframe_s)
    found = np.array([values.atPose3(X(i)).translation() for i in range(len(pos))])
    assert np.linalg.norm(found - pos, axis=1).max() < 15.0
    assert values.size() == 2 * len(pos) + problem.bias_epoch[-1] + 1 + problem.calibration_epoch[-1] + 1


# the model at the truth -------------------------------------------------------------------------------------


@cache
def at_truth(seed: int) -> tuple[Problem, list[FactorAt], gtsam.Values, list[FactorAt]]:
    """All factors of a shearer-mems log, and every variable at its true value."""
    log = simulated(MEMS, seed)
    problem = posed(log, config(odometer={"calibration_epoch_s": 1e6}, imu={"bias_epoch_s": 1e6}))
    errors, truth = drawn(MEMS, seed), log.truth
    # at the true biases, where the factors' first-order correction plays no part
    data = preintegration_.preintegrate(problem, errors.gyro_bias_rad_s, errors.accel_bias_m_s2)
    assert truth is not None
    assert truth.vel_n_m_s is not None
    known, pos, quat = truth_at(truth, problem.keyframe_s)
    assert known.all()
    motion = world(MEMS, seed).timeline.at(problem.keyframe_s)
    values = gtsam.Values()
    for i, rotation in enumerate(so3.from_quaternion(quat)):
        values.insert(X(i), gtsam.Pose3(gtsam.Rot3(rotation), pos[i]))
        values.insert(V(i), motion.vel_n[i])
    values.insert(B(0), gtsam.imuBias.ConstantBias(errors.accel_bias_m_s2, errors.gyro_bias_rad_s))
    values.insert(C(0), np.r_[errors.odometer_scale, world(MEMS, seed).mounting_rad])
    return problem, build.build_factors(problem, data), values, native_factors.closed_path_factors(problem)


def whitened(factors: list[FactorAt], values: gtsam.Values, keys: str) -> np.ndarray:
    """Whitened errors (K, rows) of the factors whose keys are of the given kinds, in order."""
    chosen = [f.factor for f in factors if "".join(chr(k >> 56) for k in f.factor.keys()) == keys]
    return np.array([f.linearize(values).jacobian()[1] for f in chosen])


@pytest.mark.parametrize("seed", range(3))
def test_imu_factors_have_unit_errors_at_the_truth(seed: int) -> None:
    """Sum of squares per degree of freedom, over 9 x 1,000 residuals: 1 within 5 standard errors, 7.5 %."""
    _, factors, values, _ = at_truth(seed)
    errors = whitened(factors, values, "xvxvb")
    assert errors.shape[1] == 9
    assert np.mean(errors**2) == pytest.approx(1.0, abs=0.075)


@pytest.mark.parametrize("seed", range(3))
def test_odometer_factors_have_unit_errors_at_the_truth(seed: int) -> None:
    """Forward while the machine moves: the noise of the odometer. Sideways: a slip of the declared size.

    The slip is the machine's wobble, band-limited at 1 Hz; part of it the gyro sees within the second. What is left is
    0.6 to 0.8 of the declared variance: on the safe side, and not half of it.
    """
    problem, factors, values, _ = at_truth(seed)
    data = [f for f in factors if "".join(chr(k >> 56) for k in f.factor.keys()) == "xxc"]
    family = [f for f in data if len(f.factor.keys()) == 3 and f.factor.keys()[1] == f.factor.keys()[0] + 1]
    errors = whitened(family, values, "xxc")
    moving = np.array([np.linalg.norm(values.atVector(V(f.keyframe))) > 0.25 for f in family])
    assert moving.sum() > 500
    mean = np.mean(errors[moving] ** 2, axis=0)
    assert mean[1] == pytest.approx(1.0, abs=0.3)
    assert (mean[[0, 2]] > 0.5).all()
    assert (mean[[0, 2]] < 1.1).all()
    resting = np.array([np.linalg.norm(values.atVector(V(f.keyframe))) < 1e-9 for f in family])
    assert np.mean(errors[resting][:, 1] ** 2) == pytest.approx(1.0, abs=0.5)
    assert problem.has_calibration


@pytest.mark.parametrize("seed", range(3))
def test_closed_path_factors_have_unit_errors_at_the_truth(seed: int) -> None:
    """Push to the right and up: 69 each, so 1 within 5 standard errors is 0.15 to 1.85."""
    _, _, values, closed = at_truth(seed)
    errors = whitened(closed, values, "xxc")
    assert errors.shape == (69, 3)
    assert (np.mean(errors[:, [0, 2]] ** 2, axis=0) < 1.85).all()
    assert (np.mean(errors[:, [0, 2]] ** 2, axis=0) > 0.3).all()


def test_closed_path_errors_over_three_logs() -> None:
    """414 push errors: 1 within 5 standard errors, 35 %."""
    errors = np.concatenate([whitened(at_truth(s)[3], at_truth(s)[2], "xxc") for s in range(3)])
    assert np.mean(errors[:, [0, 2]] ** 2) == pytest.approx(1.0, abs=0.35)


@pytest.mark.parametrize("seed", range(3))
def test_the_whole_problem_has_unit_errors_at_the_truth(seed: int) -> None:
    """Priors and fixes too: no factor is tens of sigmas from the truth."""
    _, factors, values, _ = at_truth(seed)
    largest = {}
    for found in factors:
        kinds = "".join(chr(k >> 56) for k in found.factor.keys())
        b = found.factor.linearize(values).jacobian()[1]
        largest[kinds] = max(largest.get(kinds, 0.0), float(np.abs(b).max()))
    assert set(largest) == {"x", "v", "b", "c", "xvxvb", "xxc", "xx"}
    assert max(largest.values()) < 6.0


# factors ----------------------------------------------------------------------------------------------------


def kinds(factors: list[FactorAt]) -> dict[str, int]:
    count: dict[str, int] = {}
    for found in factors:
        name = "".join(chr(k >> 56) for k in found.factor.keys())
        count[name] = count.get(name, 0) + 1
    return count


def test_factors_are_fed_with_the_last_keyframe_they_need() -> None:
    problem = posed(simulated(TWO_CUTS))
    factors = build.build_factors(problem, prepared(problem))
    assert [f.keyframe for f in factors] == sorted(f.keyframe for f in factors)
    for found in factors:
        last = max((k & ((1 << 56) - 1) for k in found.factor.keys() if chr(k >> 56) in "xv"), default=0)
        assert found.keyframe >= last
        if any(chr(k >> 56) in "xv" for k in found.factor.keys()):
            assert found.keyframe <= last + 1
        # and an epoch's variable is not asked for before the interval that brings it
        for key in found.factor.keys():
            index = key & ((1 << 56) - 1)
            if chr(key >> 56) == "b":
                assert problem.bias_epoch[max(found.keyframe - 1, 0)] >= index
            if chr(key >> 56) == "c":
                assert problem.calibration_epoch[max(found.keyframe - 1, 0)] >= index


def test_counts_of_factors() -> None:
    problem = posed(simulated(TWO_CUTS))
    count, closed = len(problem.keyframe_s), len(problem.frontend.closed_path)
    found = kinds(build.build_factors(problem, prepared(problem)))
    resting = [
        np.sum((problem.keyframe_s >= a - 1e-6) & (problem.keyframe_s <= b + 1e-6)) for a, b in problem.frontend.rest_s
    ]
    data = prepared(problem)
    assert data.travel is not None
    assert closed == 11
    assert found == {
        "x": 1 + 1,  # prior, far end
        "v": 1 + sum(resting),
        "b": 1,
        "c": 1,
        "bb": int(problem.bias_epoch[-1]),
        "cc": int(problem.calibration_epoch[-1]),
        "xvxvb": count - 1,
        "xx": sum(n - 1 for n in resting),
        "xxc": closed + int((data.travel.samples > 0).sum()),
    }


def test_creep_is_one_unknown_per_cycle_with_a_prior() -> None:
    log = simulated(MEMS)
    assert log.face is not None
    log = dataclasses.replace(log, face=log.face.replace(creep_sigma_m=0.3, creep_m=0.1))
    problem = posed(log)
    assert problem_.creep_cycles(problem) == [1, 2, 3]
    found = kinds(build.build_factors(problem, prepared(problem)))
    assert found["k"] == 3
    assert found["xxck"] == 69
    values = initial_.initial_values(problem, prepared(problem), initial_.start_state(problem)[0])
    assert [values.atVector(K(c))[0] for c in (1, 2, 3)] == [0.1, 0.1, 0.1]
    assert problem_.creep_cycles(posed(log, config(closed_path={"form": "absolute"}))) == []


def test_forms_of_closed_path_and_odometer() -> None:
    log = simulated(TWO_CUTS)
    counts = {}
    for name, sections in {
        "relative": {},
        "absolute": {"closed_path": {"form": "absolute"}},
        "off": {"closed_path": {"form": "off"}},
        "velocity": {"odometer": {"form": "velocity"}},
    }.items():
        problem = posed(log, config(**sections))
        counts[name] = kinds(build.build_factors(problem, prepared(problem)))
    assert counts["relative"]["xxc"] - counts["absolute"]["xxc"] == 11
    assert "xvc" not in counts["relative"]
    assert counts["velocity"]["xxc"] == 11
    # nearly every keyframe has a sample within half a sampling interval
    problem = posed(log, config(odometer={"form": "velocity"}))
    assert counts["velocity"]["xvc"] > 0.95 * len(problem.keyframe_s)


def test_velocity_form_uses_no_sample_twice() -> None:
    """Two keyframes within one odometer interval: the sample between them counts once."""
    problem = posed(simulated(MEMS), config(odometer={"form": "velocity"}))
    factors = build.build_factors(problem, prepared(problem))
    used = [f.factor.keys()[0] & 0xFFFFFF for f in factors if kinds([f]) == {"xvc": 1}]
    assert problem.log.odometer is not None
    t = problem.log.odometer.t_s
    nearest = [int(np.argmin(np.abs(t - problem.keyframe_s[i]))) for i in used]
    assert len(nearest) == len(set(nearest))


def test_an_odometer_hole_leaves_its_interval_to_the_imu() -> None:
    log = simulated(TWO_CUTS)
    assert log.odometer is not None
    t = log.odometer.t_s
    log = dataclasses.replace(log, odometer=rows(log.odometer, (t <= 40.0) | (t > 45.0)))
    problem = posed(log)
    data = prepared(problem)
    assert data.travel is not None
    empty = np.flatnonzero(data.travel.samples == 0)
    assert np.allclose(problem.keyframe_s[empty], [40, 41, 42, 43, 44], atol=0.5)
    family = native_factors.displacement_family(problem, data)
    assert family is not None
    assert not set(empty) & set((family.key_i - X(0)).tolist())
