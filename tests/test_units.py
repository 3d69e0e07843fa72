"""Wrong units and axes are found and refused; sound logs are not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from machine_logs import NO_SPANS, imu_only, machine
from sample_logs import GRAVITY

from graphnav import log as gl
from graphnav.errors import LogError
from graphnav.frontends.rest import rest_spans
from graphnav.frontends.units import check_units, refuse_wrong_units
from graphnav.simulation import simulate

DEG = np.rad2deg(1.0)


def with_imu(log, **changes):
    """The log with IMU columns put through functions."""
    changed = {name: change(getattr(log.imu, name)) for name, change in changes.items()}
    return dataclasses.replace(log, imu=log.imu.replace(**changed))


@pytest.fixture(scope="module")
def moving():
    return machine(200, (60, 120, 0.3), seed=4)


CASES = {
    "accel in g": (
        {"accel_b_m_s2": lambda f: f / GRAVITY},
        ["accel", "expected about 9.81", "in g", "9.80665"],
    ),
    "accel in mg": ({"accel_b_m_s2": lambda f: f / GRAVITY * 1e3}, ["in mg", "multiply them by 0.00980665"]),
    "accel in cm/s^2": ({"accel_b_m_s2": lambda f: f * 100}, ["in cm/s^2", "multiply them by 0.01"]),
    "accel in ft/s^2": ({"accel_b_m_s2": lambda f: f * 3.28084}, ["in ft/s^2"]),
    "gravity removed": (
        {"accel_b_m_s2": lambda f: f - [0, 0, GRAVITY]},
        ["expected about 9.81", "gravity not removed"],
    ),
    "accel sign": ({"accel_b_m_s2": lambda f: -f}, ["accel_z_m_s2", "-9.", "+g upward at rest", "sign"]),
    "accel axes": (
        {"accel_b_m_s2": lambda f: f[:, [2, 0, 1]]},
        ["90 deg away from up", "right, forward, up"],
    ),
    "gyro in deg/s": (
        {"gyro_b_rad_s": lambda w: w * DEG},
        ["gyro", "in deg/s, expected rad/s", "multiply them by 0.0174"],
    ),
    "gyro in deg/h": ({"gyro_b_rad_s": lambda w: w * DEG * 3600}, ["in deg/h"]),
    "gyro in mrad/s": ({"gyro_b_rad_s": lambda w: w * 1e3}, ["in mrad/s", "multiply them by 0.001"]),
    "time in ms": ({"t_s": lambda t: t * 1e3}, ["t_s: median time step 10 s", "in ms", "divide t_s by 1000"]),
    "time in us": ({"t_s": lambda t: t * 1e6}, ["in us"]),
    "time in ns": ({"t_s": lambda t: t * 1e9}, ["in ns", "divide t_s by 1e+09"]),
}


@pytest.mark.parametrize(("changes", "fragments"), CASES.values(), ids=CASES)
@pytest.mark.parametrize("spans", ["found", "none", "declared"])
def test_wrong_units_are_refused(moving, changes, fragments, spans):
    """With the spans of rest detection, without any, and with the declared ones of an IMU alone."""
    log = with_imu(moving, **changes)
    where = {"found": rest_spans(log), "none": NO_SPANS, "declared": np.array([[0.0, 59.0]])}[spans]
    log = imu_only(log) if spans == "declared" else log
    with pytest.raises(LogError) as caught:
        refuse_wrong_units(log, where)
    message = str(caught.value)
    assert message.startswith("table imu, ")
    assert all(fragment in message for fragment in fragments), message
    assert message in check_units(log, where)


@pytest.mark.parametrize("view", [lambda log: log, imu_only])
@pytest.mark.parametrize("seed", range(10))
def test_sound_logs_raise_no_suspicion(view, seed):
    log = view(machine(100, (40, 90, 0.3), seed=seed))
    for where in (rest_spans(log), NO_SPANS):
        assert check_units(log, where) == []
        refuse_wrong_units(log, where)


def test_the_simulated_shearer_raises_no_suspicion():
    log = simulate("shearer-mems", seed=1)
    assert check_units(log, rest_spans(log)) == []


def test_gyro_in_deg_s_is_seen_in_the_noise_when_the_bias_is_small(moving):
    log = with_imu(moving, gyro_b_rad_s=lambda w: (w - w[:1000].mean(axis=0)) * DEG)
    assert "in deg/s" in check_units(log, rest_spans(log))[0]


def test_gyro_in_deg_s_is_seen_in_the_mean_where_the_engine_shakes():
    log = machine(200, (60, 120, 0.3), shake=(0.0, 0.1), wobble_rad_s=0.05)
    assert check_units(log, np.array([[0.0, 59.0]])) == []
    wrong = with_imu(log, gyro_b_rad_s=lambda w: w * DEG)
    assert "in deg/s" in check_units(wrong, np.array([[0.0, 59.0]]))[0]


def test_vibration_is_not_taken_for_deg_s():
    """Noise 57 times the declared, but the accelerometer shakes too and the mean rate is within the bias."""
    log = machine(200, (60, 120, 0.3), shake=(57 * 0.00175, 0.4), wobble_rad_s=0.3)
    assert check_units(log, np.array([[0.0, 59.0]])) == []


def test_fast_turns_in_deg_s_are_seen_without_rest():
    rng = np.random.default_rng(0)
    log = imu_only(machine(60, (-10, 100, 0.3)))
    turning = rng.normal(0, 0.4, (len(log.imu), 3))
    assert check_units(with_imu(log, gyro_b_rad_s=lambda w: w + turning), NO_SPANS) == []
    assert "in deg/s" in check_units(with_imu(log, gyro_b_rad_s=lambda w: (w + turning) * DEG), NO_SPANS)[0]


def test_an_imu_upside_down_is_sound_when_the_initial_attitude_says_so(moving):
    down = with_imu(moving, accel_b_m_s2=lambda f: f * [1, -1, -1])
    start = down.initial.replace(quat_nb_wxyz=[0, 1, 0, 0])
    assert check_units(dataclasses.replace(down, initial=start), np.array([[0.0, 59.0]])) == []
    assert "sign" in check_units(down, np.array([[0.0, 59.0]]))[0]


def test_tables_on_another_clock(moving):
    times = moving.odometer.t_s
    late = dataclasses.replace(moving, odometer=moving.odometer.replace(t_s=times + 1.7e9))
    (line,) = check_units(late, NO_SPANS)
    there, here = "1700000000.100 to 1700000200.000 s", "0.000 to 200.000 s"
    assert line.startswith(f"table odometer, t_s: times {there} lie outside the IMU's {here}")
    slow = dataclasses.replace(moving, odometer=moving.odometer.replace(t_s=times * 1e3))
    assert check_units(slow, NO_SPANS)[0].startswith("table odometer, t_s: median time step 100 s")
    alone = gl.SensorLog(name="o", frames=moving.frames, odometer=slow.odometer)
    assert "in ms" in check_units(alone, NO_SPANS)[0]


def test_speed_in_mm_s(moving):
    odometer = moving.odometer.replace(speed_m_s=moving.odometer.speed_m_s * 1e3)
    (line,) = check_units(dataclasses.replace(moving, odometer=odometer), NO_SPANS)
    assert "speed_m_s" in line
    assert "mm/s" in line
