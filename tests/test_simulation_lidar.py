"""shearer-lidar: legs are seen where they stand, with the errors that the log declares, and move when they should.

Statistical bounds are two-sided chi-square or normal bounds with a false-alarm rate of 1e-5 each; seeds are fixed, so a
test that passes once always passes.
"""

from __future__ import annotations

import dataclasses
import tracemalloc
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from scipy.spatial.transform import Rotation

from graphnav import cli
from graphnav.errors import ConfigError
from graphnav.log import LidarPoints, LidarScans, SensorLog, Truth
from graphnav.readers import read, write
from graphnav.simulation import simulate
from graphnav.simulation.lidar import ANGLE_STEP_RAD, RANGE_STEP_M, LidarErrors, draw_lidar_errors
from graphnav.simulation.lidar_figures import LidarSpec
from graphnav.simulation.motion import Leg
from graphnav.simulation.naming import Simulated, log_name, parse_name
from graphnav.simulation.scans import ScanRecorder, build_walls
from graphnav.simulation.scenarios import LIDAR, MEMS, ShearerSpec, resolve
from graphnav.simulation.shearer import simulate_shearer
from graphnav.simulation.supports import Supports, build_supports, supports_truth
from graphnav.simulation.world import World, build_world, draw_errors, face_frame, streams

FALSE_ALARM = 1e-5
ARCMIN = np.pi / 180 / 60
#: Two cuts of 30 m at three times the speed, with every error of the scenario: 6 minutes, simulated in a second.
SHORT = replace(
    LIDAR,
    length_m=30.0,
    cycles=2,
    speed_m_s=0.3,
    static_s=2.0,
    tail_s=1.0,
    pause_s=3.0,
    retreat_m=24.0,
    crossing_m=20.0,
    end_work_s=None,
    duration_s=None,
)
DRAWN = replace(SHORT, att_error_deg=None, mounting_deg=None, lidar=LidarSpec(draw=True))
SCANNED = replace(SHORT, duration_s=45.0, lidar=LidarSpec(scans=True))


@cache
def log(spec: ShearerSpec = SHORT, seed: int = 0, *, noise: bool = True) -> SensorLog:
    return simulate_shearer("short", spec, seed, noise=noise)


@cache
def world(spec: ShearerSpec = SHORT, seed: int = 0) -> World:
    of = streams(seed)
    return build_world(spec, of.geometry, of.machine)


@cache
def supports(spec: ShearerSpec = SHORT, seed: int = 0) -> Supports:
    return build_supports(world(spec, seed), streams(seed).supports)


def points_of(log: SensorLog) -> LidarPoints:
    assert log.lidar_points is not None
    return log.lidar_points


def pose_at(truth: Truth, t_s: np.ndarray) -> tuple[np.ndarray, Rotation]:
    row = np.rint(t_s * 100).astype(int)
    assert np.allclose(truth.t_s[row], t_s, rtol=0, atol=1e-9)
    return truth.pos_n_m[row], Rotation.from_quat(truth.quat_nb[row], scalar_first=True)


def predicted(log: SensorLog, errors: LidarErrors, points: LidarPoints, legs: Supports) -> tuple[np.ndarray, ...]:
    """Range and angle from the truth: pose and leg meet where ``o + x right + y forward = point + h axis`` in n."""
    assert log.truth is not None
    pos_n, rot_nb = pose_at(log.truth, points.t_s)
    rot_ns = (rot_nb * Rotation.from_rotvec(errors.mounting_rad)).as_matrix()
    row = legs.rows(points.feature)
    system = np.concatenate([rot_ns[:, :, :2], -legs.axis_n[row][:, :, None]], axis=2)
    x, y, _ = np.linalg.solve(system, (legs.pos_n_m[row] - pos_n)[..., None])[..., 0].T
    return np.sqrt(x**2 + y**2), np.arctan2(-x, y)


def assert_unit_normal(draws: np.ndarray) -> None:
    """Zero mean and unit variance, each within its bounds."""
    draws = np.ravel(draws)
    limit = stats.norm.isf(FALSE_ALARM / 2) / np.sqrt(len(draws))
    assert abs(draws.mean()) < limit
    low, high = stats.chi2.interval(1 - FALSE_ALARM, len(draws))
    assert low < np.sum(draws**2) < high


# --- geometry ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 1])
def test_noise_free_points_are_where_truth_puts_the_legs(seed: int) -> None:
    clean = log(seed=seed, noise=False)
    errors = draw_lidar_errors(LidarSpec(), streams(seed).lidar, 0.0)
    assert errors.mounting_rad == pytest.approx([-0.6 * ARCMIN, 0.0, 25.5 * ARCMIN])
    points = points_of(clean)
    range_m, angle_rad = predicted(clean, errors, points, supports(seed=seed))
    assert np.abs(points.range_m - range_m).max() < 1e-9
    assert np.abs(points.angle_rad - angle_rad).max() < 1e-9


def test_every_leg_at_rest_within_reach_is_reported_once_in_each_scan() -> None:
    clean, legs = log(noise=False), supports()
    points, spec = points_of(clean), LidarSpec()
    every = np.arange(1, int(clean.imu.t_s[-1] * 25 + 1e-6) + 1) / 25  # type: ignore[union-attr]
    errors = draw_lidar_errors(spec, streams(0).lidar, 0.0)
    for t in every[:: len(every) // 60]:
        rest = (legs.from_s <= t) & (t < legs.until_s)
        candidates = LidarPoints(
            t_s=np.full(rest.sum(), t),
            feature=legs.feature[rest],
            range_m=np.ones(rest.sum()),
            angle_rad=np.zeros(rest.sum()),
        )
        range_m, angle_rad = predicted(clean, errors, candidates, legs)
        seen = (range_m <= 12.0) & (angle_rad >= 0.0)
        reported = points.feature[np.abs(points.t_s - t) < 1e-6]
        assert sorted(reported) == sorted(candidates.feature[seen])
    assert np.unique(np.round(points.t_s * 25)).size == every.size


def test_the_row_stands_on_the_left_at_its_spacing() -> None:
    legs, to_n = supports(), face_frame(SHORT)
    first = legs.advance == 0
    in_face = legs.pos_n_m[first] @ to_n
    assert in_face[:, 0] == pytest.approx(-4.0, abs=0.1 + 5 * 0.03)  # the bend of the line, placement errors
    assert np.diff(in_face[:, 1]) == pytest.approx(1.5, abs=6 * np.sqrt(2) * 0.03)
    assert in_face[0, 1] == pytest.approx(-10.5, abs=0.15) and in_face[-1, 1] >= 30 + 10.5 - 1.5 - 0.15
    lean = np.degrees(np.arccos(legs.axis_n[:, 2]))
    assert lean.min() >= 8.0 and lean.max() <= 10.0
    assert np.linalg.norm(legs.axis_n, axis=1) == pytest.approx(1.0)
    assert np.all(legs.axis_n[:, 0] > 0)  # towards the coal


# --- error model ------------------------------------------------------------------------------------------

PAPER = LidarErrors(np.zeros(3), 0.0006, 0.035, 0.00004, -0.0075, 0.0531)


@given(
    st.floats(-170, 170),
    st.floats(-1e-4, 1e-4),
    st.floats(-0.03, 0.03),
    st.floats(-0.2, 0.2),
)
def test_angle_error_has_its_inverse(deg: float, quadratic: float, scale: float, bias: float) -> None:
    errors = LidarErrors(np.zeros(3), 0.0, 0.0, quadratic, scale, bias)
    measured = errors.measured_angle(np.deg2rad(np.array([deg])))
    assert np.rad2deg(errors.true_angle(measured)) == pytest.approx(deg, abs=1e-9)


def test_errors_are_equation_4() -> None:
    deg = np.linspace(1.0, 179.0, 90)
    a1, a2, a3 = 0.00004, 0.9925, 0.0531
    paper = (np.sqrt(4 * a1 * deg + a2**2 - 4 * a1 * a3) - a2) / (2 * a1)
    assert np.rad2deg(PAPER.measured_angle(np.deg2rad(deg))) == pytest.approx(paper, abs=1e-9)
    assert PAPER.measured_range(np.array([4.0])) == pytest.approx([4.0 * 1.0006 + 0.035])


@pytest.mark.parametrize("spec", [SHORT, DRAWN], ids=["fixed", "drawn"])
def test_points_are_truth_with_the_errors_and_declared_noise(spec: ShearerSpec) -> None:
    noisy = log(spec)
    assert noisy.lidar is not None and spec.lidar is not None
    errors = draw_lidar_errors(spec.lidar, streams(0).lidar, 1.0)
    points = points_of(noisy)
    range_m, angle_rad = predicted(noisy, errors, points, supports(spec))
    off_m = (points.range_m - errors.measured_range(range_m)) / noisy.lidar.range_sigma_m
    off_rad = (points.angle_rad - errors.measured_angle(angle_rad)) / np.deg2rad(noisy.lidar.angle_sigma_deg)
    # White and apart from each other: sums and differences with the next row and with the other kind are normal, too.
    for off in (off_m, off_rad, (off_m + off_rad) / np.sqrt(2), (off_m[1::2] + off_m[:-1:2]) / np.sqrt(2)):
        assert_unit_normal(off)
    # Without them the readings are off by centimetres and tenths of a degree, so the test above can fail.
    assert abs((points.range_m - range_m).mean()) > 5e-3 if spec is DRAWN else (points.range_m - range_m).mean() > 0.03


def test_recorded_numbers_are_rounded_far_below_the_noise() -> None:
    points = points_of(log())
    assert np.all(points.range_m % RANGE_STEP_M == 0) and RANGE_STEP_M < 0.01 * 0.01
    assert np.all(points.angle_rad % ANGLE_STEP_RAD == 0) and np.rad2deg(ANGLE_STEP_RAD) < 0.02 * 0.05


# --- what is fixed, drawn and declared ----------------------------------------------------------------------


def test_log_declares_the_sizes_of_the_papers_errors() -> None:
    noisy = log()
    lidar, face, odometer, initial = noisy.lidar, noisy.face, noisy.odometer, noisy.initial
    assert lidar is not None and face is not None and odometer is not None and initial is not None
    assert (lidar.range_sigma_m, lidar.angle_sigma_deg) == (0.01, 0.05)
    assert (lidar.range_scale_sigma, lidar.range_bias_sigma_m) == (0.0006, 0.035)
    assert (lidar.angle_quadratic_sigma_per_deg, lidar.angle_bias_sigma_deg) == (0.00004, 0.0531)
    assert lidar.angle_scale_sigma == pytest.approx(1 - 0.9925)
    assert lidar.mounting_sigma_deg == pytest.approx([0.6 / 60, 0.001, 25.5 / 60])
    assert odometer.mounting_sigma_deg == pytest.approx([0.72 / 60, 0.001, 20.3 / 60])
    assert initial.att_sigma_deg == pytest.approx([0.18 / 60, 0.13 / 60, 20.9 / 60])
    assert (lidar.feature_spacing_m, lidar.leg_diameter_m) == (1.5, 0.4)
    assert (face.creep_m, face.creep_sigma_m, face.push_m) == (0.0, 0.3, 1.0)
    assert np.all(lidar.T_bs_pos_m == 0) and lidar.T_bs_quat_wxyz.tolist() == [1, 0, 0, 0]


def test_fixed_errors_have_the_papers_signs() -> None:
    """Equations 6 and 10: what is assumed is ``(I - angle x)`` times what is true, for C_s^b, C_m^b and C_b^n."""
    noisy = log(seed=4)
    assert noisy.initial is not None and noisy.truth is not None
    mounting_s = draw_lidar_errors(LidarSpec(), streams(4).lidar, 1.0).mounting_rad
    true_bs, true_bm = Rotation.from_rotvec(mounting_s), Rotation.from_rotvec(world(seed=4).mounting_rad).inv()
    true_nb = Rotation.from_quat(noisy.truth.quat_nb[0], scalar_first=True)
    assumed_nb = Rotation.from_quat(noisy.initial.quat_nb_wxyz, scalar_first=True)
    for assumed, true, arcmin in (
        (Rotation.identity(), true_bs, [-0.6, 0.0, 25.5]),
        (Rotation.identity(), true_bm, [-0.72, 0.0, 20.3]),
        (assumed_nb, true_nb, [-0.18, 0.13, -20.9]),
    ):
        x, y, z = np.array(arcmin) * ARCMIN
        small = np.eye(3) - [[0, -z, y], [z, 0, -x], [-y, x, 0]]
        # The attitude's angles are about the body's axes, which lie 0.9 degrees off the navigation frame's at most.
        assert assumed.as_matrix() == pytest.approx(small @ true.as_matrix(), abs=2e-4)


def test_other_errors_are_drawn_whatever_is_fixed() -> None:
    fixed, drawn = (draw_errors(spec, streams(7).errors, 1.0) for spec in (SHORT, DRAWN))
    for name in (f.name for f in dataclasses.fields(fixed)):
        assert np.array_equal(getattr(fixed, name), getattr(drawn, name)) == (name != "initial_att_rad")
    assert np.array_equal(world(SHORT, 7).wobble_rad, world(DRAWN, 7).wobble_rad)
    assert fixed.gyro_bias_rad_s.any()


def test_drawn_errors_have_the_declared_sigmas() -> None:
    declared = log(DRAWN).lidar
    assert declared is not None and declared.mounting_sigma_deg is not None
    spec = LidarSpec(draw=True)
    drawn = [draw_lidar_errors(spec, streams(seed).lidar, 1.0) for seed in range(400)]
    for name, sigma in (
        ("range_scale", declared.range_scale_sigma),
        ("range_bias_m", declared.range_bias_sigma_m),
        ("angle_scale", declared.angle_scale_sigma),
        ("angle_bias_deg", declared.angle_bias_sigma_deg),
        ("angle_quadratic_per_deg", declared.angle_quadratic_sigma_per_deg),
    ):
        assert_unit_normal(np.array([getattr(errors, name) for errors in drawn]) / sigma)
    mounting_deg = np.rad2deg([errors.mounting_rad for errors in drawn])
    for axis in range(3):
        assert_unit_normal(mounting_deg[:, axis] / declared.mounting_sigma_deg[axis])


def test_drawn_attitude_and_odometer_mounting_have_the_declared_sigmas() -> None:
    attitude = [draw_errors(DRAWN, streams(seed).errors, 1.0).initial_att_rad for seed in range(300)]
    mounting = [world(replace(DRAWN, duration_s=5.0), seed).mounting_rad for seed in range(100)]
    assert_unit_normal(np.rad2deg(attitude) / DRAWN.att_sigma_deg)
    assert_unit_normal(np.rad2deg(mounting) / DRAWN.mounting_sigma_deg)


# --- advance of the face ----------------------------------------------------------------------------------


def test_near_end_creeps_as_the_paper_says() -> None:
    lines = world(replace(LIDAR, duration_s=80.0), 3).lines
    forward_n = face_frame(LIDAR)[:, 1]
    ends = np.array([line.at(np.zeros(1))[0][0] @ forward_n for line in lines])
    assert np.diff(ends) == pytest.approx([-0.176, -0.225, -0.175, -0.225, -0.175], abs=1e-9)


def test_all_nodes_creep_by_one_length_in_the_machines_axes() -> None:
    from graphnav.simulation.path import attitude

    for line, following in pairwise(world(replace(LIDAR, duration_s=80.0), 3).lines):
        pos_n, slope, roll = line.at(line.nodes_m)
        move_m = attitude(slope, roll).inv().apply(following.at(line.nodes_m)[0] - pos_n)
        assert np.ptp(move_m[:, 1]) < 1e-9 and -0.4 < move_m[0, 1] < 0.0


def test_supports_move_when_the_machine_has_left_them_behind() -> None:
    legs, true = supports(), world()
    row, lag_m = LidarSpec().supports, LidarSpec().supports.lag_m
    u_m = -row.beyond_m + row.spacing_m * legs.support
    cuts = [leg for leg in true.timeline.legs if leg.cycle]
    for cut, following in zip(cuts, [true.timeline.legs[1], None], strict=True):
        rows = np.flatnonzero(legs.advance == cut.cycle - 1)
        passed = cut.arc.direction * u_m[rows] + lag_m <= cut.arc.direction * (30.0 if cut.cycle == 1 else 0.0)
        moved = legs.until_s[rows]
        assert np.all((moved[passed] >= cut.start_s) & (moved[passed] <= cut.end_s))
        at_m = place_on(cut, moved[passed])
        assert cut.arc.direction * (at_m - u_m[rows][passed]) == pytest.approx(lag_m, abs=0.02)
        if following is None:
            assert np.all(np.isinf(moved[~passed])) and (~passed).any()
        else:
            assert np.all((moved[~passed] > following.start_s) & (moved[~passed] < following.end_s))
            at_m = place_on(following, moved[~passed])
            assert np.abs(at_m - u_m[rows][~passed]) == pytest.approx(lag_m, abs=0.02)


def place_on(leg: Leg, t_s: np.ndarray) -> np.ndarray:
    """Face coordinates of the machine while it travels along a leg."""
    return leg.arc.u_of_s(leg.profile.at(t_s - leg.start_s)[0])


def test_an_advanced_leg_has_a_new_number_and_a_moving_one_none() -> None:
    points, legs = points_of(log()), supports()
    assert legs.feature.tolist() == list(range(1, len(legs.feature) + 1))
    assert len(set(zip(legs.support.tolist(), legs.advance.tolist(), strict=True))) == len(legs.feature)
    row = legs.rows(points.feature)
    assert np.all((points.t_s >= legs.from_s[row]) & (points.t_s < legs.until_s[row]))
    later = legs.advance > 0
    assert np.all(legs.from_s[later] == legs.until_s[legs.feature[later] - 1 - legs.count] + 10.0)
    # What has moved a second time is out of reach before it rests, and the log ends before the machine is back.
    assert set(np.unique(legs.advance[row])) == {0, 1}
    both = legs.support[row][legs.advance[row] == 0], legs.support[row][legs.advance[row] == 1]
    assert len(np.intersect1d(*both)) > 20


def test_supports_advance_by_the_push_with_the_declared_errors() -> None:
    spec, errors = replace(LIDAR, duration_s=5.0), []
    for seed in range(6):
        legs = supports(spec, seed)
        steps = np.diff(legs.pos_n_m.reshape(-1, legs.count, 3), axis=0) @ face_frame(spec)
        steps[:, :, 0] -= 1.0
        # The sixth advance, after which the log ends, has no creep.
        steps[:, :, 1] -= np.array([-0.176, -0.225, -0.175, -0.225, -0.175, 0.0])[:, None]
        errors.append(steps.reshape(-1, 3))
    face = log().face
    assert face is not None
    scaled = np.vstack(errors) / [face.push_sigma_m, face.along_sigma_m, face.push_sigma_m]
    for axis in range(3):
        assert_unit_normal(scaled[:, axis])


def test_moving_supports_go_straight_from_place_to_place() -> None:
    legs = supports()
    row = int(np.flatnonzero(np.isfinite(legs.until_s))[0])
    start = legs.until_s[row]
    pos_n, there = legs.standing(
        np.array([row, row + legs.count]), start + np.array([-1.0, 0.0, 5.0, 9.99, 10.0, 11.0])
    )
    before_n, after_n = legs.pos_n_m[row], legs.pos_n_m[row + legs.count]
    assert pos_n[:4, 0] == pytest.approx(before_n + np.outer([0, 0, 0.5, 0.999], after_n - before_n))
    assert there.tolist() == [[True, False]] * 4 + [[False, True]] * 2
    assert pos_n[4:, 1] == pytest.approx(np.array([after_n, after_n]))


# --- the scenario in full -----------------------------------------------------------------------------------


@cache
def one_cycle() -> SensorLog:
    return simulate("shearer-lidar", seed=3, cycles=1)


def test_a_cut_has_the_legs_that_the_papers_selections_need() -> None:
    """One leg from 9 m along the face on and four from 0 m on, ahead and behind, all at rest throughout the cut."""
    points, legs = points_of(one_cycle()), supports_truth("shearer-lidar", 3, cycles=1)
    scan = np.rint(points.t_s * 25).astype(int)
    along_m = points.range_m * np.cos(points.angle_rad)
    unmoved = legs.advance[legs.rows(points.feature)] == 0
    for way in (along_m, -along_m):
        for least_m, count in ((9.0, 1), (0.0, 4), (0.1, 4), (3.0, 4)):
            enough = np.bincount(scan[unmoved & (way >= least_m)], minlength=scan[-1] + 1)
            assert enough[1:].min() >= count
    assert np.bincount(scan)[1:].max() <= 17


def test_first_cut_takes_the_papers_time_and_bend_and_the_end_is_surveyed() -> None:
    found = one_cycle()
    assert found.events is not None and found.truth is not None
    assert found.events.t_s[1] - found.events.t_s[0] == pytest.approx(3500, abs=50)
    assert np.abs(found.truth.pos_n_m[:, 0]).max() == pytest.approx(0.1, rel=0.02)
    assert found.truth.pos_n_m[-1, 1] == pytest.approx(350.0, abs=0.01)
    assert found.surveyed[0].end == "far" and found.surveyed[0].sigma_m == 0.02
    spec = resolve("shearer-lidar", {})
    assert spec.cycles == 6 and spec.duration_s == 7.1 * 3600


def test_truth_of_the_supports_is_that_of_the_log() -> None:
    found, legs = one_cycle(), supports_truth("shearer-lidar", 3, cycles=1)
    points = points_of(found)
    some = LidarPoints(*(getattr(points, f.name)[::997] for f in points.column_fields()))
    errors = draw_lidar_errors(LidarSpec(), streams(3).lidar, 1.0)
    range_m, _ = predicted(found, errors, some, legs)
    assert_unit_normal((some.range_m - errors.measured_range(range_m)) / 0.01)
    with pytest.raises(ConfigError, match="no LiDAR"):
        supports_truth("shearer-mems")


# --- streams and memory -------------------------------------------------------------------------------------


def test_a_shorter_log_is_the_start_of_a_longer_one() -> None:
    longer, shorter = log(), log(replace(SHORT, cycles=1))
    end_s = shorter.imu.t_s[-1]  # type: ignore[union-attr]
    for name, table in shorter.tables().items():
        whole = longer.tables()[name]
        for f in table.column_fields():
            values = getattr(table, f.name)
            assert np.array_equal(values, getattr(whole, f.name)[: len(values)]), (name, f.name)
    assert np.count_nonzero(points_of(longer).t_s <= end_s + 1e-9) == len(points_of(shorter))


def test_raw_scans_and_the_lidar_change_nothing_else() -> None:
    plain, scanned = log(replace(SHORT, duration_s=45.0)), log(SCANNED)
    without = log(replace(SHORT, duration_s=45.0, lidar=None))
    assert without.lidar is None and without.lidar_points is None
    assert scanned.lidar_scans is not None and plain.lidar_scans is None
    for name in ("imu", "odometer", "truth", "lidar_points"):
        for other in (scanned, without):
            if other.tables().get(name) is None:
                continue
            for f in plain.tables()[name].column_fields():
                values = getattr(plain.tables()[name], f.name), getattr(other.tables()[name], f.name)
                assert np.array_equal(*values)


def test_new_streams_leave_the_old_ones_as_they_were() -> None:
    for new, old in zip(streams(5), np.random.default_rng(5).spawn(5), strict=False):
        assert np.array_equal(new.standard_normal(4), old.standard_normal(4))


def test_memory_is_the_logs_and_a_bounded_rest() -> None:
    """Each row is held in at most 3 times its own bytes, whatever else: so 7.1 h fit into one gigabyte."""
    spec = replace(SHORT, lidar=LidarSpec())
    peaks, rows = [], []
    for cycles in (1, 2):
        tracemalloc.start()
        found = simulate_shearer("short", replace(spec, cycles=cycles), 0)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        rows.append(sum(table_bytes(table) for table in found.tables().values()))
    assert rows[1] > 2 * rows[0]
    assert peaks[1] - peaks[0] < 3 * (rows[1] - rows[0])


def table_bytes(table) -> int:
    return sum(getattr(table, f.name).nbytes for f in table.column_fields())


EXACT = 5e-6  # raw ranges are kept as 32-bit numbers

# --- raw scans ----------------------------------------------------------------------------------------------


def scans_of(log: SensorLog) -> LidarScans:
    assert log.lidar_scans is not None
    return log.lidar_scans


def returns(found: SensorLog, step: int, mounting_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Scan, time and place in n of the returns of every `step`-th noise-free scan."""
    scans = scans_of(found)
    assert found.truth is not None
    rows = np.arange(0, len(scans), step)
    ranges = np.stack([scans.ranges_m[row] for row in rows])
    angles = scans.angle_min_rad[0] + scans.angle_step_rad[0] * np.arange(ranges.shape[1])
    in_s = ranges[..., None] * np.stack([-np.sin(angles), np.cos(angles), np.zeros_like(angles)], axis=-1)
    pos_n, rot_nb = pose_at(found.truth, scans.t_s[rows])
    rot_ns = (rot_nb * Rotation.from_rotvec(mounting_rad)).as_matrix()
    in_n = pos_n[:, None] + in_s @ rot_ns.transpose(0, 2, 1)
    scan, beam = np.nonzero(ranges > 0)
    return scan, scans.t_s[rows][scan], in_n[scan, beam]


def test_beams_end_on_legs_shields_or_walls() -> None:
    spec = SCANNED.lidar
    assert spec is not None
    mounting = draw_lidar_errors(spec, streams(0).lidar, 0.0).mounting_rad
    _, t_s, hit_n = returns(log(SCANNED, noise=False), 40, mounting)
    legs = supports(SCANNED)
    walls = build_walls(world(SCANNED), spec, streams(0).roadways)
    kinds = np.zeros(3, int)
    for time in np.unique(t_s):
        at = hit_n[t_s == time]
        stand_n, there = legs.standing(np.arange(len(legs.feature)), np.array([time]))
        away = at[:, None] - stand_n[0][there[0]]
        axis = legs.axis_n[there[0]]
        off = np.linalg.norm(away - np.einsum("nki,ki->nk", away, axis)[..., None] * axis, axis=2)
        leg = np.abs(off - 0.2).min(axis=1) < EXACT
        shield = np.any((np.abs(away[..., 0] + 1.2) < EXACT) & (np.abs(away[..., 1]) < 0.75 + EXACT), axis=1)
        wall = distances(at[:, :2], walls).min(axis=1) < EXACT
        assert np.all(leg | shield | wall)
        assert np.all(off.min(axis=1) > 0.2 - EXACT)
        kinds += [leg.sum(), shield.sum(), wall.sum()]
    assert np.all(kinds > 100)


def distances(points: np.ndarray, pieces: np.ndarray) -> np.ndarray:
    """Of N points from K straight pieces."""
    run = pieces[:, 1] - pieces[:, 0]
    share = np.einsum("nki,ki->nk", points[:, None] - pieces[:, 0], run) / np.sum(run**2, axis=1)
    foot = pieces[:, 0] + np.clip(share, 0, 1)[..., None] * run
    return np.linalg.norm(points[:, None] - foot, axis=2)


def test_every_reported_leg_shows_as_an_arc_in_the_scan() -> None:
    found = log(SCANNED, noise=False)
    scans, points = scans_of(found), points_of(found)
    angles = scans.angle_min_rad[0] + scans.angle_step_rad[0] * np.arange(len(scans.ranges_m[0]))
    for row in range(0, len(scans), 100):
        at = np.abs(points.t_s - scans.t_s[row]) < 1e-6
        hit = scans.ranges_m[row][:, None] * np.column_stack([-np.sin(angles), np.cos(angles)])[:, None, :].squeeze(1)
        for range_m, angle_rad in zip(points.range_m[at], points.angle_rad[at], strict=True):
            centre = range_m * np.array([-np.sin(angle_rad), np.cos(angle_rad)])
            off = np.linalg.norm(hit - centre, axis=1)
            arc = off < 0.21  # the cut of a cylinder leaning by 10 degrees is an ellipse, wider by 1.5 per cent
            assert np.all(off[arc] > 0.2 - 1e-6)
            assert np.count_nonzero(arc) >= 0.8 * 2 * np.arcsin(0.2 / range_m) / np.deg2rad(0.25) - 1


def test_scans_have_the_declared_errors_and_dust() -> None:
    noisy, clean = scans_of(log(SCANNED)), scans_of(log(SCANNED, noise=False))
    off = np.stack(list(noisy.ranges_m)) - np.stack(list(clean.ranges_m))
    # Angle errors turn beams by 0.3 degrees: look at those with the same thing on both sides, 0.75 degrees wide.
    ranges = np.stack(list(clean.ranges_m))
    amid = maximum_filter1d(ranges, 7) - minimum_filter1d(ranges, 7) < 0.1
    assert np.median(off[amid]) == pytest.approx(0.035 + 0.0006 * 5, abs=3e-3)
    dust, draws = stats.binom(amid.sum(), 0.01), np.count_nonzero(off[amid] < -0.15)
    # On a way of 4 m and more all but 0.15 m of 3.5 m counts as early.
    assert dust.isf(1 - FALSE_ALARM) * 0.9 < draws < dust.isf(FALSE_ALARM)
    assert np.all(np.stack(list(noisy.ranges_m)) * 1024 % 1 == 0)


def test_a_long_log_is_scanned_around_its_stops() -> None:
    spec = replace(SHORT, lidar=LidarSpec(scans=True))
    found = scans_of(log(spec))
    cuts = [leg for leg in world(spec).timeline.legs if leg.cycle]
    spans = [(0.0, 62.0), (cuts[0].end_s, cuts[0].end_s + 5), (cuts[1].start_s - 5, cuts[1].start_s)]
    spans.append((cuts[1].end_s, cuts[1].end_s + 1.0))
    inside = np.zeros(len(found), bool)
    for start_s, end_s in spans:
        here = (found.t_s >= start_s) & (found.t_s <= end_s)
        assert np.count_nonzero(here) == pytest.approx(25 * (end_s - start_s), abs=1)
        inside |= here
    assert inside.all()


def test_walls_stay_where_they_are_and_show_the_creep() -> None:
    """The machine at its stop at the near end, one cycle later, is nearer to the wall behind it by the creep."""
    spec = replace(SHORT, lidar=LidarSpec(scans=True))
    true, lidar = world(spec), spec.lidar
    assert lidar is not None
    errors = LidarErrors(np.zeros(3), 0.0, 0.0, 0.0, 0.0, 0.0)
    of = streams(0)
    recorder = ScanRecorder(true, lidar, supports(spec), errors, of.roadways, of.scans, 0.0)
    level = Rotation.from_matrix(np.repeat(face_frame(spec)[None], 2, axis=0))
    stops_n = np.array([line.at(np.zeros(1))[0][0] for line in true.lines])
    stops_n[:, 0] = 0.0  # the same place along the roadway, whose wall is rough
    cuts = [leg for leg in true.timeline.legs if leg.cycle]
    recorder.add(np.array([1.0, cuts[1].end_s + 0.5]), stops_n, level)
    table = recorder.table()
    assert table is not None
    behind = [ranges[-1] for ranges in table.ranges_m]  # the beam at 180 degrees
    assert behind[0] == pytest.approx(12.5, abs=5 * 0.1)
    assert behind[1] - behind[0] == pytest.approx(-0.176, abs=1e-5)


# --- names, options, command line ---------------------------------------------------------------------------


def test_names_carry_the_options() -> None:
    name = log_name("shearer-lidar", {"cycles": 2, "scans": False, "draw": False}, 3)
    assert name == "shearer-lidar_cycles=2_scans=no_seed3"
    assert parse_name(name) == Simulated("shearer-lidar", {"cycles": 2, "scans": False}, 3)
    assert parse_name("shearer-lidar_scans=perhaps_seed3") is None


@pytest.mark.parametrize(
    ("options", "fragments"),
    [
        ({"cycles": 7}, ["cycles", "7", "1 to 6"]),
        ({"cycles": True}, ["cycles", "True"]),
        ({"cycles": 1.5}, ["cycles", "1.5"]),
        ({"scans": 1}, ["scans", "True or False"]),
        ({"draw": "yes"}, ["draw", "'yes'"]),
        ({"hours": 1}, ['"hours"', "cycles, scans, draw"]),
    ],
)
def test_wrong_options_are_refused(options: dict, fragments: list[str]) -> None:
    with pytest.raises(ConfigError) as caught:
        simulate("shearer-lidar", **options)
    for fragment in fragments:
        assert fragment in str(caught.value)


def test_a_scenario_without_lidar_has_no_supports() -> None:
    of = streams(0)
    with pytest.raises(ValueError, match="without LiDAR"):
        build_supports(build_world(replace(MEMS, duration_s=5.0), of.geometry, of.machine), of.supports)


def test_log_survives_writing_and_reading(tmp_path: Path) -> None:
    found = log(SCANNED)
    write(found, tmp_path / "log")
    again = read(tmp_path / "log")
    assert set(again.tables()) == set(found.tables())
    for f in points_of(found).column_fields():
        assert np.array_equal(getattr(points_of(found), f.name), getattr(points_of(again), f.name))
    assert all(map(np.array_equal, scans_of(found).ranges_m, scans_of(again).ranges_m))
    assert again.lidar is not None and found.lidar is not None
    assert vars(again.lidar).keys() == vars(found.lidar).keys()
    assert all(np.array_equal(value, getattr(again.lidar, name)) for name, value in vars(found.lidar).items())


@pytest.mark.parametrize("scans", [True, False])
def test_command_line_takes_the_options(scans: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import graphnav.simulation.scenarios as scenarios

    monkeypatch.setattr(scenarios, "LIDAR", SHORT)
    words = [
        "simulate",
        "shearer-lidar",
        "--seed",
        "3",
        "--cycles",
        "1",
        "--scans" if scans else "--no-scans",
        "--draw",
        "-o",
        str(tmp_path / "L"),
    ]
    assert cli.main(words) == 0
    found = read(tmp_path / "L")
    assert found.name == f"shearer-lidar_cycles=1_draw=yes{'' if scans else '_scans=no'}_seed3"
    assert (found.lidar_scans is not None) == scans
    assert found.lidar_points is not None and found.events is not None
    assert found.events.cycle.max() == 1
    assert cli.main(["simulate", "shearer-mems", "--cycles", "1", "-o", str(tmp_path / "M")]) == 2
