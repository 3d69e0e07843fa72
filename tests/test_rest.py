"""Rest detection: standstills are found, travel is not called rest, wrong units are refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from machine_logs import NO_SPANS, imu_only, machine, odometer_only
from sample_logs import initial

from graphnav import log as gl
from graphnav.errors import LogError
from graphnav.frontends import spans as sp
from graphnav.frontends.rest import odometer_rest, rest_spans
from graphnav.frontends.units import check_units
from graphnav.simulation import simulate
from graphnav.simulation.roadheader import simulate_roadheader
from graphnav.simulation.roadheader_figures import ROADHEADER

ALL_VIEWS = pytest.mark.parametrize("view", [lambda log: log, imu_only, odometer_only], ids=["both", "imu", "odometer"])


@ALL_VIEWS
@pytest.mark.parametrize("seed", range(3))
def test_standstills_are_found_without_the_braking_before_them(view, seed):
    log = machine(200, (20, 80, 0.3), (90, 150, -0.3), seed=seed)
    found = rest_spans(view(log))
    expected = np.array([[0, 20], [80, 90], [150, 200]])
    assert found.shape == (3, 2)
    assert (found[:, 0] >= expected[:, 0]).all()
    assert (found[:, 1] <= expected[:, 1]).all()
    np.testing.assert_allclose(found, expected, atol=1.5)


@pytest.mark.parametrize("seed", range(3))
def test_standstills_of_the_simulated_shearer(seed):
    """Every one of its pauses, and no sample of motion: the machine's true speed is zero in every span."""
    log = simulate("shearer-mems", seed=seed)
    speed = np.linalg.norm(log.truth.vel_n_m_s, axis=1)
    still = sp.from_mask(speed < 1e-9, log.truth.t_s, log.truth.t_s)
    for view in (log, imu_only(dataclasses.replace(log, face=None)), odometer_only(log)):
        found = rest_spans(view)
        assert len(found) == len(still)
        assert np.diff(found).sum() > 0.9 * np.diff(still).sum()
        for start, end in found:
            assert speed[(log.truth.t_s >= start) & (log.truth.t_s <= end)].max() < 1e-9


@pytest.mark.parametrize("speed", [0.1, -0.1, 0.03])
@pytest.mark.parametrize("view", [lambda log: log, odometer_only], ids=["both", "odometer"])
def test_slow_constant_travel_is_not_rest(speed, view):
    """An hour each: at 0.1 m/s a window mean is 31 of its sigmas from zero, at 0.03 m/s still 9."""
    log = machine(3600, (10, 3590, speed), wobble_rad_s=0.0)
    found = rest_spans(view(log))
    assert sp.intersect(found, np.array([[13.0, 3587.0]])).size == 0


def test_a_creep_below_the_noise_of_a_window_is_seen_over_the_whole_span():
    """0.01 m/s for 5 min: no window of 1 s can tell, the mean of 3000 samples does (55 sigmas)."""
    log = machine(300, wobble_rad_s=0.0)
    creeping = log.odometer.replace(speed_m_s=log.odometer.speed_m_s + 0.01)
    assert len(odometer_rest(creeping)) > 0
    assert len(rest_spans(dataclasses.replace(log, odometer=creeping))) == 0


def test_an_hour_at_rest_is_hardly_broken_up():
    """Five-sigma tests on 36,000 windows: 4 % chance of any break at all."""
    log = machine(3600)
    assert len(rest_spans(log)) == 1
    assert len(rest_spans(odometer_only(log))) == 1


def test_smooth_travel_without_an_odometer_is_not_rest():
    """As quiet as rest, and nothing in the log to tell it from: nothing may be claimed."""
    assert len(rest_spans(imu_only(machine(600, (-100, 700, 0.3), wobble_rad_s=0.0)))) == 0
    assert len(rest_spans(imu_only(machine(600, (-100, 700, 0.3), wobble_rad_s=0.1)))) == 0
    assert len(rest_spans(imu_only(machine(600)))) == 0


def test_travel_of_little_more_vibration_does_not_make_the_smoother_part_rest():
    """Half at the noise of rest, half at 2.5 times that: both may be travel."""
    log = machine(400)
    louder = np.where(log.imu.t_s > 200, 2.5, 1.0)[:, None]
    level = [0, 0, 9.80665]
    imu = log.imu.replace(
        gyro_b_rad_s=log.imu.gyro_b_rad_s * louder,
        accel_b_m_s2=(log.imu.accel_b_m_s2 - level) * louder + level,
    )
    assert len(rest_spans(dataclasses.replace(log, imu=imu, odometer=None))) == 0


def test_smooth_travel_beside_rough_travel_is_not_rest_when_the_road_is_not_straight():
    """Half of it rough, half with the vibration of rest but on a road whose slope and heading change."""
    log = machine(400, (-100, 200, 0.3), (200, 500, 1e-9))
    t = log.imu.t_s
    smooth = (t > 200)[:, None]
    gyro = log.imu.gyro_b_rad_s + smooth * np.outer(np.sin(t / 2), [0, 0, 2e-3])
    accel = log.imu.accel_b_m_s2 + smooth * np.outer(np.sin(t / 2), [0, 0.1, 0])
    imu = log.imu.replace(gyro_b_rad_s=gyro, accel_b_m_s2=accel)
    assert len(rest_spans(imu_only(log))) == 1  # the same log without the bends: rest beside motion
    assert len(rest_spans(dataclasses.replace(log, imu=imu, odometer=None))) == 0


def test_smooth_straight_travel_between_turns_is_not_rest():
    """Turns are loud in the gyro and in nothing else: they do not tell how travel shakes this machine."""
    log = machine(400, (-100, 500, 0.3), wobble_rad_s=0.0)
    t = log.imu.t_s
    turning = (t % 100 > 80) * 0.05 * np.sin(2 * np.pi * t / 3)
    gyro = log.imu.gyro_b_rad_s + np.outer(turning, [0, 0, 1])
    assert len(rest_spans(dataclasses.replace(log, imu=log.imu.replace(gyro_b_rad_s=gyro), odometer=None))) == 0
    rocking = np.outer(9.8 * 0.01 * np.sin(2 * np.pi * t) * (t % 100 > 60), [1, 0, 0])  # gravity seen from a tilt
    imu = log.imu.replace(gyro_b_rad_s=gyro, accel_b_m_s2=log.imu.accel_b_m_s2 + rocking)
    assert len(rest_spans(dataclasses.replace(log, imu=imu, odometer=None))) > 0  # it is for want of shaking alone


@pytest.mark.parametrize("braking_s", [1.0, 3.0, 12.0, 20.0])
def test_a_machine_that_rocks_slowly_is_found_at_rest_and_not_while_it_brakes(braking_s):
    """The roadheader tilts by 60 times its gyro's noise and shakes by 3 times its accelerometer's; seeds 0 to 2."""
    speed = ROADHEADER.speed_m_s
    spec = dataclasses.replace(
        ROADHEADER, images=False, length_m=8.0, turns_s=(20.0, 50.0), static_s=30.0, tail_s=12.0,
        accel_m_s2=speed / braking_s,
    )  # fmt: skip
    for seed in range(3):
        log = simulate_roadheader("roadheader-stereo", spec, seed)
        found, t_s = rest_spans(log), log.truth.t_s
        assert len(found) == 2 and found[1, 1] - found[1, 0] > 3.0
        inside = (t_s >= found[1, 0]) & (t_s <= found[1, 1])
        assert np.linalg.norm(log.truth.vel_n_m_s[inside], axis=1).max() < 1e-9


def test_a_running_engine_does_not_hide_a_standstill():
    log = machine(200, (60, 120, 0.3), shake=(0.01, 0.1), wobble_rad_s=0.3)
    found = rest_spans(log)
    np.testing.assert_allclose(found, [[0, 60], [120, 200]], atol=1.5)


def test_an_odometer_that_stands_while_the_machine_moves_is_not_believed():
    """Its wheel is locked over the whole log; only the true standstills are as quiet as the sensor."""
    log = machine(400, (60, 340, 0.3), zero_speed=True, wobble_rad_s=0.5)
    assert sp.intersect(rest_spans(log), np.array([[64.0, 336.0]])).size == 0


def test_a_hole_in_the_record_is_not_rest():
    log = machine(100)
    keep = (log.imu.t_s < 40) | (log.imu.t_s > 60)
    imu = log.imu.replace(
        t_s=log.imu.t_s[keep],
        gyro_b_rad_s=log.imu.gyro_b_rad_s[keep],
        accel_b_m_s2=log.imu.accel_b_m_s2[keep],
    )
    hole = np.array([[40.2, 59.8]])
    assert sp.intersect(rest_spans(dataclasses.replace(log, imu=imu)), hole).size == 0
    keep = (log.odometer.t_s < 40) | (log.odometer.t_s > 60)
    odometer = log.odometer.replace(t_s=log.odometer.t_s[keep], speed_m_s=log.odometer.speed_m_s[keep])
    found = rest_spans(dataclasses.replace(log, odometer=odometer))
    assert sp.intersect(found, hole).size == 0
    assert np.diff(found).sum() > 70


def test_short_stops_are_left_out():
    """1.5 s at rest: less than the 2 s that a span must last."""
    log = machine(60, (10, 30, 0.3), (31.5, 50, 0.3))
    assert sp.intersect(rest_spans(log), np.array([[15.0, 45.0]])).size == 0


def test_the_declared_static_start_is_taken_whole():
    log = machine(100, (60, 90, 0.3), static_until_s=60.0)
    for view in (log, imu_only(log), odometer_only(log)):
        start, end = rest_spans(view)[0]
        assert start == pytest.approx(0.0 if view.imu else 0.1)
        assert end == pytest.approx(60.0, abs=1e-9)
    log = machine(100, static_until_s=500.0)
    assert rest_spans(log)[-1, 1] == log.imu.t_s[-1]


def test_a_static_start_that_the_odometer_contradicts_is_refused():
    log = machine(100, (40, 90, 0.3), static_until_s=60.0)
    with pytest.raises(LogError, match=r"\[initial\], static_until_s: 60.0 s, but the odometer moves at .* at 4\d"):
        rest_spans(log)


def test_logs_without_motion_sensors_or_with_very_few_rows():
    position = gl.Position(t_s=[0.0], pos_n_m=np.zeros((1, 3)), sigma_n_m=np.ones((1, 3)))
    log = gl.SensorLog(name="p", frames=gl.Frames(0.0), initial=initial(static_until_s=5.0), position=position)
    assert rest_spans(log).shape == (0, 2)
    assert check_units(log, NO_SPANS) == []
    for rows in (2, 3, 12):
        short = machine(1.0)
        imu = short.imu.replace(**{f.name: getattr(short.imu, f.name)[:rows] for f in gl.Imu.column_fields()})
        odometer = short.odometer.replace(t_s=[0.01], speed_m_s=short.odometer.speed_m_s[:1])
        for view in (
            dataclasses.replace(short, imu=imu, odometer=odometer),
            gl.SensorLog("s", short.frames, imu=imu),
        ):
            assert rest_spans(view).shape == (0, 2)
            assert check_units(view, NO_SPANS) == []


def test_an_imu_without_noise_has_no_floor_to_find_rest_by():
    log = simulate_roadheader("roadheader-stereo", dataclasses.replace(ROADHEADER, images=False), 0, noise=False)
    assert len(rest_spans(log)) == 1  # the declared one


def test_spans_as_sets():
    a, b = np.array([[0.0, 2], [3, 5], [6, 9]]), np.array([[1.0, 4], [7, 8], [9, 10]])
    np.testing.assert_array_equal(sp.intersect(a, b), [[1, 2], [3, 4], [7, 8]])
    np.testing.assert_array_equal(sp.unite(a, b), [[0, 5], [6, 10]])
    np.testing.assert_array_equal(sp.unite(sp.NONE, b), b)
    assert sp.intersect(a, sp.NONE).shape == (0, 2)
    np.testing.assert_array_equal(sp.shrink(a, 0.25, 1.5), [[0.25, 1.75], [3.25, 4.75], [6.25, 8.75]])
    mask, t = np.array([True, False, True, True]), np.arange(4.0)
    np.testing.assert_array_equal(sp.from_mask(mask, t, t + 1), [[0, 1], [2, 4]])
