"""Leg finder: segmentation, circle fits, motion, association."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.stats import chi2

from benchmarks._leg_scans import Push, Row, Scanned, scanned, without
from graphnav.errors import LogError
from graphnav.frontends.legs import (
    REASONS,
    Beams,
    Circles,
    Legs,
    detect,
    fit_circles,
    legs,
    planar_motion,
    segment,
    undistorted,
    with_legs,
)
from graphnav.frontends.legs.motion import PlanarMotion
from graphnav.log import Frames, Imu, Lidar, LidarScans, Odometer, RelativePose, SensorLog

STEP = np.radians(0.25)
DIAMETER, SIGMA_M, SIGMA_RAD = 0.4, 0.01, np.radians(0.05)


def circle_ranges(angles, centre, radius, background=np.inf):
    """Ranges of beams to a circle about `centre` (right, forward)."""
    along = -np.sin(angles) * centre[0] + np.cos(angles) * centre[1]
    inside = along**2 - (centre @ centre - radius**2)
    return np.where((inside > 0) & (along > 0), along - np.sqrt(np.maximum(inside, 0)), background)


def one_scan(ranges, angle_min=0.0, step=STEP) -> Beams:
    return Beams.stacked([np.asarray(ranges, float)], np.array([angle_min]), np.array([step]))


def fitted(beams: Beams, diameter=DIAMETER) -> Circles:
    return fit_circles(beams, segment(beams, diameter, SIGMA_M), diameter, SIGMA_M, SIGMA_RAD)


ANGLES = np.arange(720) * STEP
CENTRE = np.array([-4.0, 2.0])


# Segmentation -----------------------------------------------------------------------------------------------


def test_runs_end_where_the_range_jumps() -> None:
    ranges = np.r_[np.full(20, 5.0), np.full(10, 4.0), np.full(15, 6.0)]
    runs = segment(one_scan(ranges), DIAMETER, SIGMA_M)
    assert list(zip(runs.first, runs.last, strict=True)) == [(0, 20), (20, 30), (30, 45)]
    # the nearer one hides its neighbours and is not hidden; the edges of the scan hide too
    assert list(runs.hidden) == [True, False, True]


@pytest.mark.parametrize("nothing", [np.nan, np.inf, 0.0, -1.0, 0.05, 99.0])
def test_beams_without_return_belong_to_no_run(nothing: float) -> None:
    ranges = np.r_[nothing, np.full(10, 4.0), np.full(30, nothing), np.full(10, 4.0), nothing]
    runs = segment(one_scan(ranges), DIAMETER, SIGMA_M, max_range_m=50.0)
    assert list(zip(runs.first, runs.last, strict=True)) == [(1, 11), (41, 51)]
    assert (runs.label[0, [0, 20, 51]] == -1).all()


def test_dust_does_not_cut_a_leg_in_two() -> None:
    ranges = circle_ranges(ANGLES, CENTRE, DIAMETER / 2)
    on = np.flatnonzero(np.isfinite(ranges))
    ranges[on[5:7]], ranges[on[12]] = 1.5, np.nan
    found = fitted(one_scan(ranges))
    assert len(found) == 1
    assert found.beams[0] == len(on) - 3
    np.testing.assert_allclose(found.pos_s_m[0], CENTRE, atol=2e-3)


def test_scans_of_different_lengths_are_one_block() -> None:
    ranges = circle_ranges(ANGLES, CENTRE, DIAMETER / 2)
    beams = Beams.stacked([ranges, ranges[:400], ranges[:10]], np.zeros(3), np.full(3, STEP))
    assert list(fitted(beams).scan) == [0, 1]


def test_an_empty_scan_has_no_runs() -> None:
    assert len(segment(one_scan(np.full(50, np.nan)), DIAMETER, SIGMA_M)) == 0


# Circles ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("centre", [(-4.0, 0.0), (-4.0, 7.0), (-2.0, -5.0), (-1.0, 0.5), (3.0, 3.0)])
@pytest.mark.parametrize("backward", [False, True])
def test_a_perfect_circle_gives_its_centre(centre, backward) -> None:
    angles = (np.arange(1440) - 720) * STEP
    ranges = circle_ranges(angles, np.array(centre), DIAMETER / 2)
    beams = one_scan(ranges[::-1], -angles[0] - STEP, -STEP) if backward else one_scan(ranges, angles[0])
    found = fitted(beams)
    assert len(found) == 1
    # the beams at the leg's edges end on a grid: the mean of the ends is off by up to half a step, with little weight
    np.testing.assert_allclose(found.pos_s_m[0], centre, atol=1e-3)
    assert found.range_m[0] == pytest.approx(np.hypot(*centre), abs=1e-3)
    assert found.angle_rad[0] == pytest.approx(np.arctan2(-centre[0], centre[1]), abs=1e-3)


def noisy_fits(rng, count, hidden=0.0, tilt_deg=0.0):
    """Errors and covariances of fits to legs anywhere between 3 and 9 m, part of each hidden behind something near."""
    errors, covariances = [], []
    for _ in range(count):
        direction, distance = rng.uniform(0.6, 2.5), rng.uniform(3.0, 9.0)
        centre = distance * np.array([-np.sin(direction), np.cos(direction)])
        true = ANGLES + rng.normal(0, SIGMA_RAD, len(ANGLES))
        stretch = 1 / np.cos(np.radians(tilt_deg))
        turn = rng.uniform(0, np.pi)
        axis = np.array([np.cos(turn), np.sin(turn)])
        squeeze = np.eye(2) - (1 - 1 / stretch) * np.outer(axis, axis)
        rays = squeeze @ np.array([-np.sin(true), np.cos(true)])
        norm = np.linalg.norm(rays, axis=0)
        ranges = circle_ranges(np.arctan2(-rays[0], rays[1]), squeeze @ centre, DIAMETER / 2) / norm
        ranges = ranges + rng.normal(0, SIGMA_M, len(ranges))
        on = np.flatnonzero(np.isfinite(ranges))
        ranges[on[: int(hidden * len(on))]] = 1.0
        found = fitted(one_scan(ranges))
        if len(found) == 1:
            errors.append(found.pos_s_m[0] - centre)
            covariances.append(found.cov_s_m2[0])
    return np.array(errors), np.array(covariances)


def normalised(errors, cov):
    """Squared errors over their covariance, (K,)."""
    return np.einsum("ki,kij,kj->k", errors, np.linalg.inv(cov), errors)


@pytest.mark.parametrize("hidden", [0.0, 0.4])
def test_errors_of_leaning_legs_are_as_large_as_their_covariance_says(hidden: float) -> None:
    # false alarms: 1 in 1,000 per case
    errors, cov = noisy_fits(np.random.default_rng(1), 500, hidden, tilt_deg=10.0)
    assert len(errors) > 490
    low, high = chi2.ppf([0.0005, 0.9995], 2 * len(errors))
    assert low < normalised(errors, cov).sum() < high
    assert np.sqrt((errors**2).sum(axis=1).mean()) < (0.006 if not hidden else 0.012)


@pytest.mark.parametrize("hidden", [0.0, 0.4])
def test_errors_of_upright_legs_are_no_larger(hidden: float) -> None:
    # false alarms: 1 in 2,000 per case; smaller, since a lean of 10 deg is allowed for
    errors, cov = noisy_fits(np.random.default_rng(2), 500, hidden)
    assert len(errors) > 490
    assert 0.6 * 2 * len(errors) < normalised(errors, cov).sum() < chi2.ppf(0.9995, 2 * len(errors))


def test_polar_covariance_is_that_of_range_and_angle() -> None:
    rng = np.random.default_rng(3)
    cov = np.array([[4e-4, 1e-4], [1e-4, 2e-4]])
    one = Circles(np.zeros(1, int), np.zeros(1), CENTRE[None], cov[None], np.ones(1, int), {})
    drawn = rng.multivariate_normal(CENTRE, cov, 200_000)
    many = Circles(np.zeros(len(drawn), int), np.zeros(1), drawn, cov[None], np.ones(1, int), {})
    sampled = np.cov(many.range_m, many.angle_rad)
    np.testing.assert_allclose(one.polar_covariance()[0], sampled, rtol=0.02)


def plate(width, distance=4.0):
    """A flat plate that faces the sensor, nothing behind it."""
    angle = ANGLES - np.pi / 2
    return np.where(np.abs(distance * np.tan(angle)) < width / 2, distance / np.cos(angle), np.inf)


def hollow():
    """The inside of a circle's far half, seen through its open near half."""
    angle = ANGLES - np.pi / 2
    along = 4.0 * np.cos(angle)
    inside = along**2 - (16.0 - 0.04)
    return np.where((inside > 0) & (np.abs(angle) < 0.04), along + np.sqrt(np.maximum(inside, 0)), np.inf)


@pytest.mark.parametrize(
    ("ranges", "reasons"),
    [
        (plate(3.0), {"size"}),
        (plate(0.38), {"radius", "off the circle"}),
        (plate(0.15), {"partial view"}),
        (plate(0.05), {"few beams"}),
        (hollow(), {"radius", "off the circle"}),
        (circle_ranges(ANGLES, CENTRE, 0.1), {"partial view", "radius", "off the circle"}),
        (circle_ranges(ANGLES, CENTRE, 0.5), {"size"}),
    ],
)
def test_what_is_no_leg_is_refused_and_counted(ranges, reasons) -> None:
    rng = np.random.default_rng(5)
    found = fitted(one_scan(ranges + rng.normal(0, SIGMA_M, len(ranges))))
    assert len(found) == 0
    assert set(found.rejected) == set(REASONS[1:])
    assert {reason for reason, count in found.rejected.items() if count} & reasons


@pytest.mark.parametrize("distance", [4.0, 6.0, 8.0])
def test_flat_plates_as_wide_as_a_leg_are_refused(distance: float) -> None:
    rng = np.random.default_rng(9)
    ranges = [plate(0.38, distance) + rng.normal(0, SIGMA_M, len(ANGLES)) for _ in range(200)]
    assert len(fitted(Beams.stacked(ranges, np.zeros(200), np.full(200, STEP)))) < 0.1 * 200


def test_returns_off_the_leg_do_not_pull_its_centre() -> None:
    rng = np.random.default_rng(6)
    ranges = circle_ranges(ANGLES, CENTRE, DIAMETER / 2) + rng.normal(0, 1e-3, len(ANGLES))
    on = np.flatnonzero(np.isfinite(ranges))
    ranges[on[3:6]] += 0.1  # within what a run may change, 10 sigma off the circle
    found = fitted(one_scan(ranges))
    assert found.beams[0] <= len(on) - 3
    np.testing.assert_allclose(found.pos_s_m[0], CENTRE, atol=3e-3)


# Motion -----------------------------------------------------------------------------------------------------


def arc(rate=0.3, speed=0.5, seconds=10.0, hz=100.0):
    """A log that drives a circle, with odometer and gyro, and the same as relative poses."""
    t = np.arange(0, seconds + 1e-9, 1 / hz)
    lidar = Lidar(
        range_sigma_m=0.01, angle_sigma_deg=0.05, leg_diameter_m=0.4,
        T_bs_pos_m=np.array([0.2, 0.5, 0.0]), T_bs_quat_wxyz=np.array([np.cos(0.3), 0, 0, np.sin(0.3)]),
    )  # fmt: skip
    imu = Imu(
        t_s=t[1:], gyro_b_rad_s=np.tile([0, 0, rate], (len(t) - 1, 1)), accel_b_m_s2=np.zeros((len(t) - 1, 3)),
        gyro_bias_deg_h=1.0, gyro_random_walk_deg_sqrt_h=0.1, accel_bias_mg=1.0, accel_random_walk_mg_sqrt_hz=0.1,
    )  # fmt: skip
    odometer = Odometer(
        t_s=t, speed_m_s=np.full(len(t), speed), sigma_m_s=0.01, slip_sigma_m_s=0.01, scale_sigma=0.01,
        mounting_sigma_deg=np.ones(3),
    )  # fmt: skip
    half = rate / hz / 2
    chord = 2 * speed / rate * np.sin(half)
    poses = RelativePose(
        t_from_s=t[:-1], t_to_s=t[1:], sigma_m=np.full(len(t) - 1, 0.01), sigma_rad=np.full(len(t) - 1, 0.01),
        pos_m=np.tile([-chord * np.sin(half), 0.0, chord * np.cos(half)], (len(t) - 1, 1)),
        quat=np.tile([np.cos(half), 0.0, -np.sin(half), 0.0], (len(t) - 1, 1)),
    )  # fmt: skip
    log = SensorLog(name="arc", frames=Frames(latitude_deg=35.0), imu=imu, odometer=odometer, lidar=lidar)
    return log, poses


def turned(angle, vectors):
    """Vectors turned counter-clockwise."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * vectors[:, 0] - s * vectors[:, 1], s * vectors[:, 0] + c * vectors[:, 1]], axis=-1)


def seen_from(point, t, rate=0.3, speed=0.5):
    """A fixed point of n in s at times t, for the machine of `arc`."""
    heading = rate * t
    radius = speed / rate
    pos = np.column_stack([radius * (np.cos(heading) - 1), radius * np.sin(heading)])
    in_b = turned(-heading, point - pos)
    return turned(np.full(len(t), -0.6), in_b - np.array([0.2, 0.5]))


@pytest.mark.parametrize("source", ["odometer and gyro", "relative poses"])
def test_motion_predicts_where_a_leg_appears_next(source: str) -> None:
    log, poses = arc()
    if source == "relative poses":
        log = dataclasses.replace(log, relative_pose=poses, imu=None, odometer=None)
    t = np.arange(1.0, 9.0, 0.2)
    motion = planar_motion(log, t)
    point = seen_from(np.array([-3.0, 2.0]), t)
    predicted = turned(-motion.turn_rad[1:], point[:-1] - motion.step_s_m[1:])
    np.testing.assert_allclose(predicted, point[1:], atol=1e-4)


def test_points_of_a_sweep_are_moved_to_its_stamp() -> None:
    log, _ = arc()
    t = np.arange(1.0, 9.0, 0.02)
    motion = planar_motion(log, t)
    point = np.array([-3.0, 2.0])
    late = seen_from(point, t + 0.1)
    corrected = undistorted(late, np.full(len(t), 0.1), motion.rate_s_m_s, motion.turn_rate_rad_s)
    before = np.linalg.norm(late - seen_from(point, t), axis=1)
    after = np.linalg.norm(corrected - seen_from(point, t), axis=1)
    assert before.min() > 0.05
    assert after.max() < 1e-3


# Association ------------------------------------------------------------------------------------------------

LOOK = Row(beams=360)


def truth_of(case: Scanned, found: Legs):
    """For each detection its leg and how far that has advanced."""
    points = found.points
    assert points is not None
    at = np.searchsorted(case.log.lidar_scans.t_s, points.t_s - 1e-9)
    place = points.range_m[:, None] * np.column_stack([-np.sin(points.angle_rad), np.cos(points.angle_rad)])
    distance = np.linalg.norm(case.legs_m[at] - place[:, None], axis=-1)
    leg = distance.argmin(axis=1)
    return leg, case.legs_m[at, leg, 0], distance.min(axis=1)


def assert_landmarks_at_rest(case: Scanned, found: Legs, most_m: float = 0.01) -> None:
    """Every number is one leg at one place."""
    leg, advance, _ = truth_of(case, found)
    for number in np.unique(found.points.feature):
        own = found.points.feature == number
        assert len(np.unique(leg[own])) == 1
        assert np.ptp(advance[own]) <= most_m


def numbers_per_landmark(case: Scanned, found: Legs) -> float:
    leg, advance, _ = truth_of(case, found)
    landmarks = {(int(k), round(float(a), 2)) for k, a in zip(leg, advance, strict=True)}
    return len(np.unique(found.points.feature)) / len(landmarks)


@pytest.fixture(scope="module")
def row_case() -> Scanned:
    return scanned(LOOK, 120.0, seed=1)


def test_every_leg_keeps_its_number_while_in_view(row_case: Scanned) -> None:
    found = legs(row_case.log)
    assert_landmarks_at_rest(row_case, found, 0.0)
    assert numbers_per_landmark(row_case, found) == 1
    assert found.warnings == ()
    assert found.moved == 0
    leg, _, error = truth_of(row_case, found)
    assert np.sqrt((error**2).mean()) < 0.01
    assert (found.points.angle_rad > 0).all()  # the left is where angles are positive
    assert found.cov.shape == (len(found.points), 2, 2)
    # nearly all that is in clear sight is used
    clear = (row_case.share > 0.9) & (np.linalg.norm(row_case.legs_m, axis=-1) < 8.0)
    used = np.zeros_like(clear)
    used[np.searchsorted(row_case.log.lidar_scans.t_s, found.points.t_s - 1e-9), leg] = True
    assert used[clear].mean() > 0.99


def test_legs_become_lidar_points_of_the_log(row_case: Scanned) -> None:
    found = legs(row_case.log)
    log = with_legs(row_case.log, found)
    assert log.lidar_points is found.points
    assert (np.diff(log.lidar_points.t_s) >= 0).all()
    assert log.lidar_points.feature.min() == 1


@pytest.mark.parametrize("speed", [0.02, 0.05, 0.1])
def test_a_support_that_advances_becomes_a_new_landmark(speed: float) -> None:
    pushes = tuple(Push(leg, 20.0 + 20.0 * k, 0.6, speed) for k, leg in enumerate((8, 9, 10)))
    case = scanned(LOOK, 120.0, 2, pushes)
    found = legs(case.log)
    assert_landmarks_at_rest(case, found)
    leg, advance, _ = truth_of(case, found)
    for push in pushes:
        if push.start_s + push.push_m / speed < 100:
            places = np.unique(np.round(advance[leg == push.leg] + LOOK.offset_m, 1))
            assert list(places) == [0.0, 0.6]
    assert found.moved >= 3
    assert found.warnings == ()


def test_a_support_that_jumps_becomes_a_new_landmark() -> None:
    pushes = tuple(Push(leg, 30.0 + 20 * k, 0.5, 1e6) for k, leg in enumerate((8, 9)))
    case = scanned(LOOK, 90.0, 2, pushes)
    found = legs(case.log)
    assert_landmarks_at_rest(case, found)
    assert numbers_per_landmark(case, found) == 1


@pytest.mark.parametrize("speed", [0.02, 0.1, 1e6])
def test_all_legs_moved_at_once_are_all_new(speed: float) -> None:
    pushes = tuple(Push(leg, 30.0, 0.7, speed) for leg in range(20))
    case = scanned(LOOK, 110.0, 2, pushes)
    found = legs(case.log)
    assert_landmarks_at_rest(case, found)
    if speed < 1:
        assert any("all legs together" in note for note in found.warnings)


def test_the_odometer_carries_numbers_over_a_minute_without_scans(row_case: Scanned) -> None:
    found = legs(without(row_case.log, 30.0, 90.0))
    assert_landmarks_at_rest(row_case, found, 0.0)
    assert numbers_per_landmark(row_case, found) == 1
    assert found.warnings == ()


def test_a_minute_on_a_poor_odometer_starts_anew_and_says_so(row_case: Scanned) -> None:
    odometer = row_case.log.odometer
    poor = odometer.replace(speed_m_s=1.15 * odometer.speed_m_s, scale_sigma=0.1, slip_sigma_m_s=0.02)
    log = dataclasses.replace(row_case.log, odometer=poor)
    assert numbers_per_landmark(row_case, legs(log)) == 1  # with scans it does not matter
    found = legs(without(log, 30.0, 90.0))
    assert_landmarks_at_rest(row_case, found, 0.0)
    assert any("legs were lost" in note for note in found.warnings)


def test_no_odometer_and_no_gyro_are_needed_while_scans_come(row_case: Scanned) -> None:
    found = legs(dataclasses.replace(row_case.log, odometer=None, imu=None))
    assert_landmarks_at_rest(row_case, found, 0.0)


@pytest.mark.parametrize("spacing", [0.7, 3.0])
def test_a_wrong_spacing_is_noticed_and_changes_nothing(row_case: Scanned, spacing: float) -> None:
    log = dataclasses.replace(row_case.log, lidar=row_case.log.lidar.replace(feature_spacing_m=spacing))
    found = legs(log)
    assert found.warnings == (f"legs stand 1.50 m apart, [lidar] feature_spacing_m is {spacing:g} m",)
    assert numbers_per_landmark(row_case, found) == 1


def test_false_circles_become_no_landmarks(row_case: Scanned) -> None:
    rng = np.random.default_rng(7)
    scans = row_case.log.lidar_scans
    angles = scans.angle_min_rad[0] + scans.angle_step_rad[0] * np.arange(len(scans.ranges_m[0]))
    changed = []
    for ranges in scans.ranges_m:
        direction, distance = rng.uniform(0.3, 2.8), rng.uniform(1.5, 3.2)
        centre = distance * np.array([-np.sin(direction), np.cos(direction)])
        near = circle_ranges(angles, centre, LOOK.diameter_m / 2)
        changed.append(np.where(np.isfinite(near), near, ranges))
    case = dataclasses.replace(
        row_case, log=dataclasses.replace(row_case.log, lidar_scans=scans.replace(ranges_m=changed))
    )
    assert len(detect(case.log.lidar_scans, case.log.lidar)) > len(detect(scans, case.log.lidar)) - 2 * len(scans)
    found = legs(case.log)
    _, _, error = truth_of(case, found)
    assert (error > 0.2).mean() < 1e-3
    assert found.rejected["not at rest or seen too rarely"] > 0.5 * len(scans)
    assert_landmarks_at_rest(case, found, 0.0)


def test_the_other_side_is_left_out(row_case: Scanned) -> None:
    found = legs(row_case.log, side="right")
    assert found.points is None
    assert found.cov.shape == (0, 2, 2)
    assert found.warnings == ("no leg was found in any scan: check leg_diameter_m and the side",)


def test_a_sweep_in_time_is_taken_out() -> None:
    # a machine that passes at 2 m/s while the scanner sweeps for 0.1 s sees the last legs 0.2 m displaced
    look = dataclasses.replace(LOOK, speed_m_s=2.0, range_sigma_m=1e-3, angle_sigma_deg=0.01, dust=0, lost=0)
    case = scanned(look, 4.0, 8)
    scans = case.log.lidar_scans
    sweep_s = 0.1
    share = np.arange(look.beams) / (look.beams - 1)
    # beam k of a sweeping scan is beam k of an instantaneous scan taken that much later
    late = np.round(share * sweep_s * look.rate_hz).astype(int)
    ranges = np.array(list(scans.ranges_m))
    rows = np.arange(len(ranges) - late.max())
    swept = ranges[rows[:, None] + late, np.arange(look.beams)]
    log = dataclasses.replace(
        case.log,
        lidar_scans=LidarScans(
            t_s=scans.t_s[rows], angle_min_rad=scans.angle_min_rad[rows], angle_step_rad=scans.angle_step_rad[rows],
            ranges_m=list(swept),
        ),
    )  # fmt: skip
    raw, corrected = legs(log), legs(log, sweep_s=sweep_s)
    # late is a whole number of scan intervals of 40 ms: on average right, 20 ms off at most, 12 ms rms
    error = {name: np.sqrt((truth_of(case, found)[2] ** 2).mean()) for name, found in (("raw", raw), ("ok", corrected))}
    assert error["raw"] > 0.08
    assert error["ok"] < 0.035


def test_what_is_missing_is_named(row_case: Scanned) -> None:
    with pytest.raises(LogError, match="no scans"):
        legs(dataclasses.replace(row_case.log, lidar_scans=None))
    bare = dataclasses.replace(row_case.log, lidar=row_case.log.lidar.replace(leg_diameter_m=None))
    with pytest.raises(LogError, match=r"\[lidar\], leg_diameter_m: not declared"):
        legs(bare)
    with pytest.raises(LogError, match=r"leg_diameter_m: not declared"):
        detect(bare.lidar_scans, bare.lidar)
    with pytest.raises(LogError, match='side "up"'):
        legs(row_case.log, side="up")


def test_one_scan_is_enough_to_be_refused_quietly(row_case: Scanned) -> None:
    scans = row_case.log.lidar_scans
    one = LidarScans(
        t_s=scans.t_s[:1], angle_min_rad=scans.angle_min_rad[:1], angle_step_rad=scans.angle_step_rad[:1],
        ranges_m=list(scans.ranges_m[:1]),
    )  # fmt: skip
    found = legs(dataclasses.replace(row_case.log, lidar_scans=one))
    assert found.points is None
    assert isinstance(planar_motion(row_case.log, one.t_s), PlanarMotion)
