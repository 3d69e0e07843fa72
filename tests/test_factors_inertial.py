"""Preintegration: against GTSAM's own, against physics, and its noise against the datasheet's meaning."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from jacobians import random_rotation
from strapdown import Signal, integrate, means
from test_increments import shaken

from factors import so3
from factors.earth import earth_rate_n
from factors.increments import Increments, Samples, compensated_increments
from factors.inertial import (
    ImuNoise,
    Motion,
    bias_walk_factor,
    cumulate,
    predict,
    preintegration_params,
    preintegrations,
)

GRAVITY, EARTH_N = 9.7973, earth_rate_n(35.0)
NOISE = ImuNoise.from_datasheet(
    gyro_random_walk_deg_sqrt_h=0.6, accel_random_walk_mg_sqrt_hz=0.08, gyro_bias_deg_h=720.0, accel_bias_mg=3.0
)
BOUNDS = np.array([0.0, 0.7, 1.0, 2.3, 3.0])


def params(noise: ImuNoise = NOISE, earth_n: np.ndarray = EARTH_N) -> gtsam.PreintegrationParams:
    return preintegration_params(noise, GRAVITY, earth_n)


def ends(motion: Motion) -> np.ndarray:
    return motion.first[1:] - 1


# datasheet --------------------------------------------------------------------------------------------------


def test_datasheet_units_mean_what_they_say() -> None:
    noise = ImuNoise.from_datasheet(
        gyro_random_walk_deg_sqrt_h=0.6,
        accel_random_walk_mg_sqrt_hz=0.08,
        gyro_bias_deg_h=720.0,
        accel_bias_mg=3.0,
        gyro_bias_walk_deg_h_sqrt_h=5.0,
        accel_bias_walk_mg_sqrt_h=0.2,
    )
    hour = np.sqrt(3600.0)
    assert np.degrees(noise.gyro_density * hour) == pytest.approx(0.6)  # deg of angle after one hour
    assert noise.accel_density == pytest.approx(0.08e-3 * 9.80665)  # m/s^2 per root hertz is m/s per root second
    assert np.degrees(noise.gyro_bias) * 3600 == pytest.approx(720.0)
    assert noise.accel_bias == pytest.approx(0.0294199, rel=1e-5)
    assert np.degrees(noise.gyro_bias_walk * hour) * 3600 == pytest.approx(5.0)  # deg/h of bias after one hour
    assert noise.accel_bias_walk * hour == pytest.approx(0.2e-3 * 9.80665)


def test_bias_walks_default_to_none() -> None:
    assert NOISE.gyro_bias_walk == NOISE.accel_bias_walk == 0.0


# against GTSAM ----------------------------------------------------------------------------------------------


def on_manifold(increments: Increments) -> list[gtsam.PreintegratedImuMeasurementsManifold]:
    """GTSAM's preintegration that composes rotations exactly (the one that `ImuFactor` takes steps in the tangent)."""
    found = []
    for k in range(len(increments.first) - 1):
        pim = gtsam.PreintegratedImuMeasurementsManifold(params(), gtsam.imuBias.ConstantBias())
        for m in range(increments.first[k], increments.first[k + 1]):
            dt = increments.dt_s[m]
            pim.integrateMeasurement(increments.velocity_b[m] / dt, increments.rotation_b[m] / dt, dt)
        found.append(pim)
    return found


def test_cumulate_is_gtsams_preintegration_of_the_increments() -> None:
    increments = compensated_increments(shaken(), BOUNDS, 0.1)
    motion = cumulate(increments)
    for last, pim in zip(ends(motion), on_manifold(increments), strict=True):
        assert motion.elapsed_s[last] == pytest.approx(pim.deltaTij(), abs=1e-12)
        assert np.allclose(motion.rotation[last], pim.deltaRij().matrix(), rtol=0, atol=1e-12)
        assert np.allclose(motion.velocity_b[last], pim.deltaVij(), rtol=0, atol=1e-11)


@pytest.mark.parametrize("minor_s", [0.02, 0.1, 0.25, 1.0])
def test_factors_preintegration_is_exact_whatever_the_minor_interval(minor_s: float) -> None:
    """Two steps a minor interval take GTSAM's tangent-space preintegration to our rotation, velocity and position."""
    increments = compensated_increments(shaken(), BOUNDS, minor_s)
    motion = cumulate(increments)
    gyro, accel = np.array([1e-3, -2e-3, 3e-3]), np.array([0.02, 0.01, -0.03])
    for last, pim in zip(ends(motion), preintegrations(increments, params(), gyro, accel), strict=True):
        assert motion.elapsed_s[last] == pytest.approx(pim.deltaTij(), abs=1e-12)
        assert np.allclose(motion.rotation[last], pim.deltaRij().matrix(), rtol=0, atol=1e-11)
        assert np.allclose(motion.velocity_b[last], pim.deltaVij(), rtol=0, atol=1e-10)
        assert np.allclose(motion.position_b[last], pim.deltaPij(), rtol=0, atol=1e-10)


def test_cumulate_holds_every_minor_interval() -> None:
    """A shorter interval is the start of a longer one."""
    samples = shaken()
    whole = cumulate(compensated_increments(samples, np.array([0.0, 3.0]), 0.1))
    half = cumulate(compensated_increments(samples, np.array([0.0, 1.5]), 0.1))
    row = int(np.searchsorted(whole.elapsed_s, 1.5 - 1e-9))
    assert whole.elapsed_s[row] == pytest.approx(1.5)
    assert np.allclose(whole.rotation[row], half.rotation[-1], atol=1e-12)
    assert np.allclose(whole.velocity_b[row], half.velocity_b[-1], atol=1e-12)
    assert np.allclose(whole.position_b[row], half.position_b[-1], atol=1e-12)


def test_predict_without_earth_rate_is_gtsams() -> None:
    rng, still = np.random.default_rng(1), np.zeros(3)
    increments = compensated_increments(shaken(), BOUNDS, 0.02)
    motion = cumulate(increments)
    rotation = np.array([random_rotation(rng) for _ in range(4)])
    pos, vel = rng.normal(0, 50, (4, 3)), rng.normal(0, 3, (4, 3))
    found = predict(rotation, pos, vel, motion, ends(motion), GRAVITY, still)
    for k, pim in enumerate(preintegrations(increments, params(earth_n=still), still, still)):
        theirs = pim.predict(gtsam.NavState(gtsam.Rot3(rotation[k]), pos[k], vel[k]), gtsam.imuBias.ConstantBias())
        assert np.allclose(theirs.attitude().matrix(), found[0][k], rtol=0, atol=1e-11)
        assert np.allclose(theirs.velocity(), found[2][k], rtol=0, atol=1e-10)
        assert np.allclose(theirs.position(), found[1][k], rtol=0, atol=1e-10)


def swings() -> tuple[Signal, Signal]:
    """One second of ordinary motion, smooth."""

    def rate(t: np.ndarray) -> np.ndarray:
        return 0.5 * np.sin(2 * np.pi * np.multiply.outer(t, [0.5, 0.8, 0.3]) + [0, 1, 2])

    def force(t: np.ndarray) -> np.ndarray:
        return np.array([0, 0, 9.8]) + np.cos(2 * np.pi * np.multiply.outer(t, [0.4, 0.7, 0.5]))

    return rate, force


def one_second(earth_n: np.ndarray, gtsams: bool) -> tuple[float, float, float]:
    """Errors of attitude, velocity and position after a second, ours or GTSAM's, against a fine integration in n."""
    rng, (rate, force) = np.random.default_rng(2), swings()
    edge = np.arange(101) / 100
    increments = compensated_increments(
        Samples(edge, means(rate, edge), means(force, edge)), np.array([0.0, 1.0]), 0.01
    )
    rotation, pos, vel = random_rotation(rng), rng.normal(0, 50, 3), rng.normal(0, 3, 3)
    exact = integrate(
        rate, force, 0.0, 1.0, step_s=1e-3, rotation=rotation, vel_n=vel, pos_n=pos,
        gravity_n=np.array([0, 0, -GRAVITY]), earth_n=earth_n,
    )  # fmt: skip
    if gtsams:
        pim = next(preintegrations(increments, params(earth_n=earth_n), np.zeros(3), np.zeros(3)))
        state = pim.predict(gtsam.NavState(gtsam.Rot3(rotation), pos, vel), gtsam.imuBias.ConstantBias())
        found = state.attitude().matrix(), state.velocity(), state.position()
    else:
        motion = cumulate(increments)
        r, p, v = predict(rotation[None], pos[None], vel[None], motion, ends(motion), GRAVITY, earth_n)
        found = r[0], v[0], p[0]
    return (
        float(np.linalg.norm(so3.log(exact[0].T @ found[0]))),
        float(np.linalg.norm(exact[1] - found[1])),
        float(np.linalg.norm(exact[2] - found[2])),
    )


@pytest.mark.parametrize("earth_n", [np.zeros(3), EARTH_N], ids=["still", "Earth"])
@pytest.mark.parametrize("gtsams", [False, True], ids=["ours", "GTSAM's"])
def test_predict_against_the_equations_of_motion(earth_n: np.ndarray, gtsams: bool) -> None:
    """What is left of position is that of a force taken as constant over a sample: jerk x h^2 / 12."""
    attitude, velocity, position = one_second(earth_n, gtsams)
    assert attitude < (1e-4 if gtsams else 1e-7)
    assert velocity < (3e-4 if gtsams else 2e-6)
    assert position < 1e-4
    if earth_n.any():  # Earth rate left out would cost far more
        ignored = 2 * np.linalg.norm(earth_n) * 3
        assert velocity < ignored


def test_predict_leaves_earth_rate_terms_of_second_order_only() -> None:
    """On an Earth that turns 200 times faster: half the rate, a quarter of the error."""
    fast, half = (one_second(share * EARTH_N, gtsams=False) for share in (200.0, 100.0))
    assert fast[0] < 1e-7
    for k in (1, 2):
        assert 3.0 < fast[k] / half[k] < 4.5


def test_preintegrations_remove_the_bias_once() -> None:
    """Compensation takes the bias off the samples; GTSAM takes it off again what was given back."""
    samples = shaken()
    gyro, accel = np.array([0.01, -0.02, 0.005]), np.array([0.1, 0.05, -0.2])
    clean = Samples(samples.edge_s, samples.gyro_b - gyro, samples.accel_b - accel)
    expected = cumulate(compensated_increments(clean, BOUNDS, 0.02))
    increments = compensated_increments(samples, BOUNDS, 0.02, gyro, accel)
    for k, pim in enumerate(preintegrations(increments, params(), gyro, accel)):
        last = ends(expected)[k]
        # to the tangent steps' accuracy, a hundredth of the bias's effect
        assert np.linalg.norm(so3.log(pim.deltaRij().matrix().T @ expected.rotation[last])) < 1e-4
        assert np.linalg.norm(pim.deltaVij() - expected.velocity_b[last]) < 3e-4
        assert np.allclose(pim.biasHat().gyroscope(), gyro)
        assert np.allclose(pim.biasHat().accelerometer(), accel)


def test_first_order_bias_correction_is_that_of_preintegrating_anew() -> None:
    """GTSAM's bias Jacobians belong to the increments: halving the bias change quarters what they miss."""
    samples, bounds = shaken(), np.array([0.0, 1.0])
    state = gtsam.NavState(gtsam.Rot3(), np.zeros(3), np.zeros(3))
    gyro, accel = np.array([4e-3, -2e-3, 3e-3]), np.array([0.02, -0.03, 0.01])
    missed = []
    for share in (1.0, 0.5):
        # minor intervals of one sample: longer ones leave a first-order term, which `biases_moved` watches
        at_zero = next(
            preintegrations(compensated_increments(samples, bounds, 0.01), params(), np.zeros(3), np.zeros(3))
        )
        corrected = at_zero.predict(state, gtsam.imuBias.ConstantBias(share * accel, share * gyro))
        increments = compensated_increments(samples, bounds, 0.01, share * gyro, share * accel)
        anew = next(preintegrations(increments, params(), share * gyro, share * accel))
        expected = anew.predict(state, gtsam.imuBias.ConstantBias(share * accel, share * gyro))
        missed.append(np.linalg.norm(corrected.position() - expected.position()))
    plain = next(preintegrations(compensated_increments(samples, bounds, 0.01), params(), np.zeros(3), np.zeros(3)))
    whole = np.linalg.norm(plain.predict(state, gtsam.imuBias.ConstantBias()).position() - expected.position())
    assert missed[0] < 0.02 * whole
    assert missed[1] < 0.6 * missed[0]


def test_reused_preintegration_does_not_leak_into_factors() -> None:
    """Factors copy what the generator yields; the next interval starts anew."""
    increments = compensated_increments(shaken(), BOUNDS, 0.1)
    factors = [
        gtsam.ImuFactor(0, 1, 2, 3, 4, p) for p in preintegrations(increments, params(), np.zeros(3), np.zeros(3))
    ]
    many = preintegrations(increments, [params()] * 4, np.zeros((4, 3)), np.zeros((4, 3)))
    for factor, pim in zip(factors, many, strict=True):
        own = factor.preintegratedMeasurements()
        assert own.deltaTij() == pytest.approx(pim.deltaTij())
        assert np.allclose(own.deltaPij(), pim.deltaPij(), atol=1e-14)
        assert np.allclose(own.preintMeasCov(), pim.preintMeasCov(), rtol=1e-12)


# rest on the rotating Earth ---------------------------------------------------------------------------------


@pytest.mark.parametrize("minor_s", [0.01, 0.1])
@pytest.mark.parametrize("heading_deg", [0.0, 73.0, -164.0])
def test_a_resting_perfect_imu_stays_where_it_is(heading_deg: float, minor_s: float) -> None:
    """60 s at 35 deg latitude, 100 Hz, keyframes each second: ten micrometres or so, by GTSAM's prediction and ours.

    Integrating sample by sample leaves an acceleration ``g Omega dt / 2``: 5 mm.
    """
    rotation = so3.exp(np.radians([2.0, -1.0, heading_deg]))
    edge = np.arange(6001) / 100
    tile = np.ones((6000, 1))
    samples = Samples(edge, tile * (rotation.T @ EARTH_N), tile * (rotation.T @ [0, 0, GRAVITY]))
    bounds = np.arange(61.0)
    increments = compensated_increments(samples, bounds, minor_s)
    zero = np.zeros(3)
    state = gtsam.NavState(gtsam.Rot3(rotation), zero, zero)
    for pim in preintegrations(increments, params(), zero, zero):
        state = pim.predict(state, gtsam.imuBias.ConstantBias())
    assert np.linalg.norm(state.position()) < 5e-5
    motion = cumulate(increments)
    ours = rotation[None], zero[None], zero[None]
    for k in range(60):
        ours = predict(*ours, motion, ends(motion)[k : k + 1], GRAVITY, EARTH_N)
    assert np.linalg.norm(ours[1]) < 5e-5
    assert np.linalg.norm(so3.log(rotation.T @ ours[0][0])) < 1e-9

    per_sample = gtsam.PreintegratedImuMeasurements(params(), gtsam.imuBias.ConstantBias())
    crude = gtsam.NavState(gtsam.Rot3(rotation), zero, zero)
    for _second in range(60):
        per_sample.resetIntegration()
        for _ in range(100):
            per_sample.integrateMeasurement(samples.accel_b[0], samples.gyro_b[0], 0.01)
        crude = per_sample.predict(crude, gtsam.imuBias.ConstantBias())
    assert 1e-3 < np.linalg.norm(crude.position()) < 1e-2


def test_without_earth_rate_the_same_rest_would_drift_by_metres() -> None:
    edge, zero = np.arange(6001) / 100, np.zeros(3)
    tile = np.ones((6000, 1))
    samples = Samples(edge, tile * EARTH_N, tile * [0, 0, GRAVITY])
    motion = cumulate(compensated_increments(samples, np.array([0.0, 60.0]), 0.1))
    pos = predict(np.eye(3)[None], zero[None], zero[None], motion, ends(motion), GRAVITY, zero)[1]
    assert 15 < np.linalg.norm(pos) < 25


# noise ------------------------------------------------------------------------------------------------------


def test_covariance_is_that_of_the_datasheet() -> None:
    """At rest for one second: random walks of angle and velocity, and gravity turned by the angle's error.

    GTSAM sums over minor intervals with the values at their starts: of M of them the sum of squares falls short of the
    integral by about 3 / (2 M).
    """
    edge = np.arange(101) / 100
    samples = Samples(edge, np.zeros((100, 3)), np.tile([0, 0, GRAVITY], (100, 1)))
    increments = compensated_increments(samples, np.array([0.0, 1.0]), 0.02)
    cov = next(preintegrations(increments, params(), np.zeros(3), np.zeros(3))).preintMeasCov()
    angle2, force2, t = NOISE.gyro_density**2, NOISE.accel_density**2, 1.0
    level, up = slice(0, 2), 2
    assert np.allclose(np.diag(cov)[0:3], angle2 * t, rtol=1e-6)
    position, velocity = np.diag(cov)[3:6], np.diag(cov)[6:9]
    assert velocity[up] == pytest.approx(force2 * t, rel=1e-3)
    assert np.allclose(velocity[level], force2 * t + GRAVITY**2 * angle2 * t**3 / 3, rtol=0.04)
    assert position[up] == pytest.approx(force2 * t**3 / 3, rel=0.04)
    assert np.allclose(position[level], force2 * t**3 / 3 + GRAVITY**2 * angle2 * t**5 / 20, rtol=0.08)


def test_covariance_against_drawn_noise() -> None:
    """2,000 noisy copies of one second at rest: every sigma within 12 %.

    That is 4 % for the sums of `preintMeasCov` and five standard errors of a sigma: false-alarm rate 1e-5 for all nine.
    """
    rng, draws = np.random.default_rng(3), 2000
    edge = np.arange(101) / 100
    found = np.empty((draws, 9))
    bounds, zero = np.array([0.0, 1.0]), np.zeros(3)
    clean = np.tile([0, 0, GRAVITY], (100, 1))
    for k in range(draws):
        gyro = rng.normal(0, NOISE.gyro_density * 10, (100, 3))
        accel = clean + rng.normal(0, NOISE.accel_density * 10, (100, 3))
        motion = cumulate(compensated_increments(Samples(edge, gyro, accel), bounds, 0.02))
        found[k] = np.r_[so3.log(motion.rotation[-1]), motion.position_b[-1], motion.velocity_b[-1]]
    increments = compensated_increments(Samples(edge, np.zeros((100, 3)), clean), bounds, 0.02)
    cov = next(preintegrations(increments, params(), zero, zero)).preintMeasCov()
    assert np.allclose(found.std(axis=0) / np.sqrt(np.diag(cov)), 1.0, rtol=0, atol=0.12)


def test_extra_accelerometer_noise_adds_in_squares() -> None:
    plain, noisy = params(), preintegration_params(NOISE, GRAVITY, EARTH_N, accel_extra_density=0.3)
    added = noisy.getAccelerometerCovariance() - plain.getAccelerometerCovariance()
    assert np.allclose(added, 0.09 * np.eye(3))
    assert np.allclose(noisy.getGyroscopeCovariance(), plain.getGyroscopeCovariance())


def test_bias_walk_is_a_difference_weighed_by_its_own_sigmas() -> None:
    values = gtsam.Values()
    values.insert(0, gtsam.imuBias.ConstantBias(np.array([0.1, 0, 0]), np.array([0, 0.01, 0])))
    values.insert(1, gtsam.imuBias.ConstantBias(np.array([0.3, 0, 0]), np.array([0, 0.04, 0])))
    factor = bias_walk_factor(0, 1, 0.1, 0.01)
    assert factor.error(values) == pytest.approx(0.5 * (2**2 + 3**2))


def test_bias_walk_of_a_navigation_grade_gyro_is_no_hard_constraint() -> None:
    """Sigmas below 1e-8 are sigmas."""
    values = gtsam.Values()
    for key in (0, 1):
        values.insert(key, gtsam.imuBias.ConstantBias())
    linear = bias_walk_factor(0, 1, 1e-9, 1e-11).linearize(values)
    assert np.abs(linear.jacobian()[0]).max() == pytest.approx(1e11)
