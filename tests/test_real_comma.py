"""The recorded car: what the record says about noise and slip, and how far smoothing gets without a stop.

The figures that `docs/real-data.md` states. Recorded data is looked for as `conftest.data_dir` says.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import welch

from graphnav.errors import LogError
from graphnav.log import SensorLog
from graphnav.readers import comma2k19
from graphnav.readers.car import noise_floor, slip_sigma
from graphnav.smooth import smooth

DISTANCE_M = 1012.0

# What the record says -----------------------------------------------------------------------------------------


def test_noise_floor_of_white_noise_beside_motion_and_vibration() -> None:
    """Known density under motion below 6 Hz and a resonance at 45 Hz, both stronger: within 20 % below, 3 % above.

    The lowest of 26 bands of 120 frequencies each lies 2 sigma of its 9 % in power, 9 % in density, below; the mean of
    three axes scatters by less than 3 %. A false alarm needs more than 3 sigma (below 1 in 300).
    """
    rng = np.random.default_rng(11)
    t = np.arange(6240) / 104
    density = 0.01
    white = density * np.sqrt(104) * rng.standard_normal((len(t), 3))
    motion = sum(np.sin(2 * np.pi * f * t + rng.uniform(0, 6)) for f in np.arange(0.1, 6, 0.1))
    vibration = 3 * np.sin(2 * np.pi * 45 * t + 0.5 * np.sin(t))
    found = noise_floor(white + (motion + vibration)[:, None], 1 / 104)
    assert 0.8 * density < found < 1.03 * density


def test_noise_floor_refuses_a_handful_of_samples() -> None:
    with pytest.raises(LogError, match="79 samples are too few"):
        noise_floor(np.zeros((79, 3)), 0.01)


def test_slip_follows_from_accelerations() -> None:
    """15 m/s and 0.02 rad/s: 0.3 m/s^2 sideways, 3 deg per g of it; straight at 1 m/s^2: 2.5 deg per g of that."""
    t = np.arange(0, 60, 0.01)
    steady, turning = np.full(len(t), 15.0), np.full(len(t), 0.02)
    sideways = 15 * np.radians(3) * 0.3 / 9.81
    assert slip_sigma(t, steady, t, turning) == pytest.approx(sideways / np.sqrt(2), rel=1e-6)
    ramp = 5 + t[:1002]
    speeds = 5.5 + np.arange(10)
    expected = np.sqrt(np.mean((speeds * np.radians(2.5) / 9.81) ** 2) / 2)
    assert slip_sigma(t[:1002], ramp, t[:1002], 0 * ramp) == pytest.approx(expected, rel=1e-6)
    assert slip_sigma(t, steady, t, 0 * t) == 0.01  # no road is that even


@pytest.fixture(scope="module")
def car_folder(data_dir: Path) -> Path:
    folder = data_dir / "comma2k19_segment"
    if not folder.is_dir():
        pytest.skip(f"no recorded data: {folder} is no folder")
    return folder


@pytest.fixture(scope="module")
def car_log(car_folder: Path) -> SensorLog:
    return comma2k19.convert(car_folder)


def test_declared_noise_is_no_more_than_any_band_shows(car_log: SensorLog) -> None:
    """Welch's spectrum of each axis, averaged over 2 Hz, is nowhere below the declared density by more than 15 %
    once the axes are put together (its lowest bands differ from the periodogram's by a few per cent)."""
    imu = car_log.imu
    declared = (imu.gyro_random_walk_deg_sqrt_h, imu.accel_random_walk_mg_sqrt_hz)
    for samples, unit, value in zip(
        (imu.gyro_b_rad_s, imu.accel_b_m_s2), (np.radians(1) / 60, 9.80665e-3), declared, strict=True
    ):
        frequency, one_sided = welch(samples, fs=1 / imu.dt_s, nperseg=1040, axis=0)
        bands = [one_sided[(frequency >= f) & (frequency < f + 2)].mean(axis=0) for f in range(0, 52, 2)]
        lowest = np.sqrt(np.min(bands, axis=0).mean() / 2) / unit
        assert value == pytest.approx(lowest, rel=0.15)
    assert declared == pytest.approx((1.41, 2.47), abs=0.02)


def test_phone_corrects_with_one_constant_bias(car_folder: Path) -> None:
    """The corrected stream is the uncorrected one less a constant: the phone learned nothing during the drive."""
    raw = comma2k19.convert(car_folder, uncalibrated_gyro=True)
    removed = raw.imu.gyro_b_rad_s - comma2k19.convert(car_folder).imu.gyro_b_rad_s
    assert np.ptp(removed, axis=0).max() < 1e-12
    assert np.degrees(removed[0]) == pytest.approx([-2.01, -0.56, -3.92], abs=0.01)


def test_slip_of_the_drive_whichever_gyro(car_folder: Path, car_log: SensorLog) -> None:
    assert car_log.odometer.slip_sigma_m_s == pytest.approx(0.032, abs=0.002)
    raw = comma2k19.convert(car_folder, uncalibrated_gyro=True)
    assert raw.odometer.slip_sigma_m_s == car_log.odometer.slip_sigma_m_s


# Smoothing ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("wheel_scale", "end_percent", "along_percent"), [(None, 2.0, 1.0), (-0.0096, 1.7, 0.1)])
def test_end_error(car_folder: Path, wheel_scale: float | None, end_percent: float, along_percent: float) -> None:
    """Distance from the reference's last position, in per cent of the way, from the initial state, IMU and wheels.

    The aim of 2 % with the declared scale prior is met (1.6 %). That of 1 % with the scale given is not (1.5 %): the
    rest lies across the road, where the wheels say nothing.
    """
    log = comma2k19.convert(car_folder, wheel_scale=wheel_scale)
    last = smooth(log).trajectory.at(log.truth.t_s[-1])
    error = last.pos_n[0] - log.truth.pos_n_m[-1]
    east, north, _ = error  # the road runs north
    sigma = np.sqrt(np.diag(last.cov[0]))[3:6]
    assert np.linalg.norm(error) < end_percent / 100 * DISTANCE_M
    assert abs(north) < along_percent / 100 * DISTANCE_M
    assert np.abs(error / sigma).max() < 2.0
    # the estimate itself says that 1 % is beyond a gyro whose bias about up nothing shows
    assert 0.02 * DISTANCE_M < sigma[0] < 0.04 * DISTANCE_M
    assert abs(east) < sigma[0]


def test_gravity_shows_two_gyro_biases_and_nothing_the_third(car_log: SensorLog) -> None:
    """Gravity tells the biases about right and forward within 20 deg/h; about up half of the prior's 360 are left."""
    found = smooth(car_log).calibration
    assert max(found[f"gyro_bias_{axis}"].sigma for axis in "xy") < 25
    assert 150 < found["gyro_bias_z"].sigma < 360


def test_cross_axis_sensitivity_of_one_per_cent_costs_half_a_per_cent_of_the_way(car_folder: Path) -> None:
    """1 % of the forward specific force on the sideways axis, plausible for such parts, moves the end by 6 m: the
    accelerometer is not good enough for the missing 5 m, whatever its noise."""
    log = comma2k19.convert(car_folder, wheel_scale=-0.0096)
    mixed = np.eye(3)
    mixed[0, 1] = 0.01
    other = log.imu.replace(accel_b_m_s2=log.imu.accel_b_m_s2 @ mixed.T)
    ends = [smooth(x).trajectory.at(log.truth.t_s[-1]).pos_n[0] for x in (log, replace(log, imu=other))]
    assert 4 < np.linalg.norm(ends[1] - ends[0]) < 9
