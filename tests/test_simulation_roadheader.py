"""roadheader-stereo: the way is the scenario's, exact without noise, and what is drawn is what is declared.

Statistical bounds are two-sided with a false-alarm rate of 1e-5 each; seeds are fixed, so a test that passes once
always passes.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from roadway_scenes import expected_px
from scipy import stats
from scipy.spatial.transform import Rotation
from strapdown import integrate

from graphnav import cli
from graphnav.errors import ConfigError
from graphnav.log import SensorLog
from graphnav.readers import read, write
from graphnav.simulation import SCENARIOS, simulate, stereo_images
from graphnav.simulation.naming import parse_name
from graphnav.simulation.roadheader import machine_of, simulate_roadheader
from graphnav.simulation.roadheader_figures import ROADHEADER, TrackSpec
from graphnav.simulation.scenarios import BUILDERS
from graphnav.simulation.sensors import earth_rate_n

FALSE_ALARM = 1e-5
MG, DEG_H = 9.80665e-3, np.pi / 180 / 3600
#: 20 cm after 2 s at rest: a whole log in milliseconds, with every error of the scenario in it.
SHORT = replace(ROADHEADER, length_m=0.2, static_s=2.0, tail_s=1.0, images=False)


@cache
def clean(tracks: bool = False) -> SensorLog:
    spec = replace(ROADHEADER, images=True, tracks=TrackSpec() if tracks else None)
    return simulate_roadheader("clean", spec, 3, noise=False)


def assert_unit_normal(draws: np.ndarray) -> None:
    """Zero mean and unit variance, each within its bounds."""
    draws = np.ravel(draws)
    assert abs(draws.mean()) < stats.norm.isf(FALSE_ALARM / 2) / np.sqrt(len(draws))
    low, high = stats.chi2.interval(1 - FALSE_ALARM, len(draws))
    assert low < np.sum(draws**2) < high


# The way ------------------------------------------------------------------------------------------------------


def test_the_machine_rests_then_drives_twenty_metres_in_240_seconds() -> None:
    truth = clean().truth
    speed = np.linalg.norm(truth.vel_n_m_s, axis=1)
    assert speed[(truth.t_s <= 60) | (truth.t_s >= 300.1)].max() < 1e-12
    assert (speed[(truth.t_s > 60.02) & (truth.t_s < 299.98)] > 0).all()
    assert np.linalg.norm(np.diff(truth.pos_n_m, axis=0), axis=1).sum() == pytest.approx(20.0, abs=0.005)
    assert truth.t_s[-1] == pytest.approx(310, abs=0.05)  # the floor is uneven, so the way is a little longer
    np.testing.assert_allclose(truth.pos_n_m[0], 0, atol=1e-12)


def yaw_pitch_roll() -> np.ndarray:
    return Rotation.from_quat(clean().truth.quat_nb, scalar_first=True).as_euler("ZXY", degrees=True)


def test_it_turns_out_and_back_at_the_papers_times() -> None:
    t_s, yaw = clean().truth.t_s - 60, yaw_pitch_roll()[:, 0]
    for start_s, side in ((75.0, 1), (180.0, -1)):
        turned = (t_s > start_s) & (t_s < start_s + 32)
        assert (side * yaw[turned]).max() == pytest.approx(16.0, abs=0.4)
        about = np.abs(t_s[turned][side * yaw[turned] > 8] - start_s - 16).max()
        assert about == pytest.approx(10.0, abs=0.5)
    straight = (t_s < 75) | ((t_s > 107.5) & (t_s < 180)) | (t_s > 212.5)
    assert np.abs(yaw[straight]).max() < 0.5


def test_it_stays_within_the_walls_and_ends_before_the_face() -> None:
    pos_n, roadway = clean().truth.pos_n_m, ROADHEADER.roadway
    assert np.abs(pos_n[:, 0]).max() < 1.0  # of 2 m to each wall: a machine 2 m wide does not touch them
    assert roadway.face_m - pos_n[-1, 1] > 3.0
    assert roadway.face_m - roadway.back_m == 25.0 and roadway.half_width_m == 2.0
    assert roadway.roof_m - roadway.floor_m == 5.5
    assert 0.002 < np.ptp(pos_n[:, 2]) < 0.02


def test_vibration_is_of_some_milliradians_while_moving_and_none_at_rest() -> None:
    machine, t_s = machine_of(ROADHEADER, 3), clean().truth.t_s
    _, motion, rot_nb = machine.states(0, machine.count)
    angles = (motion.rot_nm.inv() * rot_nb).as_rotvec()
    assert np.abs(angles[(t_s <= 60) | (t_s >= 300.1)]).max() < 1e-12
    moving = angles[(t_s > 64) & (t_s < 296)]
    # 232 s of processes that are new about every second
    np.testing.assert_allclose(moving.std(axis=0), [0.003, 0.003, 0.001], rtol=4.4 / np.sqrt(2 * 232))
    steps = np.diff(moving, axis=0)
    assert steps.std() / moving.std() < 0.06  # band-limited: rate of angle / 0.25 s, 0.04 of it in a sample


@pytest.mark.parametrize(("start_s", "end_s"), [(55.0, 65.0), (140.0, 155.0)], ids=["start", "turn"])
def test_error_free_samples_integrate_back_to_truth(start_s: float, end_s: float) -> None:
    imu, truth = clean().imu, clean().truth
    first, last = np.searchsorted(truth.t_s, [start_s - 1e-6, end_s - 1e-6])

    def sample(rows: np.ndarray) -> Any:
        return lambda t_s: rows[np.ceil(np.round(t_s * 100, 4)).astype(int) - 1]

    found = integrate(
        sample(imu.gyro_b_rad_s),
        sample(imu.accel_b_m_s2),
        start_s,
        end_s,
        step_s=0.001,  # where two samples meet a step of ten reads the one before
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


# Drawn and declared -------------------------------------------------------------------------------------------


def errors_over_sigmas(log: SensorLog, exact: SensorLog) -> dict[str, np.ndarray]:
    imu, span = log.imu, len(log.imu) * log.imu.dt_s
    gyro, accel = imu.gyro_b_rad_s - exact.imu.gyro_b_rad_s, imu.accel_b_m_s2 - exact.imu.accel_b_m_s2
    gyro_walk, accel_walk = imu.gyro_random_walk_deg_sqrt_h * np.pi / 180 / 60, imu.accel_random_walk_mg_sqrt_hz * MG
    turn = Rotation.from_quat([exact.initial.quat_nb_wxyz, log.initial.quat_nb_wxyz], scalar_first=True)
    start, true = log.initial, exact.initial
    return {
        "gyro bias": gyro.mean(0) / np.hypot(imu.gyro_bias_deg_h * DEG_H, gyro_walk / np.sqrt(span)),
        "accel bias": accel.mean(0) / np.hypot(imu.accel_bias_mg * MG, accel_walk / np.sqrt(span)),
        "gyro noise": np.diff(gyro[:40], axis=0)[::2].ravel() / (gyro_walk / np.sqrt(imu.dt_s) * np.sqrt(2)),
        "accel noise": np.diff(accel[:40], axis=0)[::2].ravel() / (accel_walk / np.sqrt(imu.dt_s) * np.sqrt(2)),
        "initial attitude": (turn[0].inv() * turn[1]).as_rotvec(degrees=True) / start.att_sigma_deg,
        "initial position": (start.pos_n_m - true.pos_n_m) / start.pos_sigma_m,
        "initial velocity": (start.vel_n_m_s - true.vel_n_m_s) / start.vel_sigma_m_s,
    }


@cache
def drawn(count: int = 60) -> dict[str, np.ndarray]:
    """Errors over declared sigmas, seed by seed, of start and IMU."""
    rows: dict[str, list[np.ndarray]] = {}
    for seed in range(count):
        log, exact = (simulate_roadheader("short", SHORT, seed, noise=noise) for noise in (True, False))
        for name, value in errors_over_sigmas(log, exact).items():
            rows.setdefault(name, []).append(value)
    return {name: np.array(values) for name, values in rows.items()}


NAMES = ("gyro bias", "accel bias", "gyro noise", "accel noise")
STARTS = ("initial attitude", "initial position", "initial velocity")


@pytest.mark.parametrize("name", (*NAMES, *STARTS))
def test_errors_of_imu_and_start_have_the_declared_sigma(name: str) -> None:
    assert_unit_normal(drawn()[name])


def test_the_log_declares_the_figures_of_the_scenario() -> None:
    log = clean()
    imu, stereo, start = log.imu, log.stereo, log.initial
    figures = (
        imu.gyro_bias_deg_h,
        imu.gyro_random_walk_deg_sqrt_h,
        imu.accel_bias_mg,
        imu.accel_random_walk_mg_sqrt_hz,
    )
    assert figures == (3.5, 0.05, 0.5, 0.05)
    assert start.att_sigma_deg.tolist() == [0.01] * 3 and start.pos_sigma_m.tolist() == [0.001] * 3
    assert start.static_until_s == 60.0
    assert np.rad2deg(2 * np.arctan(212 / stereo.fx_px)) == pytest.approx(87)
    assert (stereo.fy_px, stereo.baseline_m, stereo.cx_px, stereo.cy_px) == (stereo.fx_px, 0.095, 211.5, 119.5)
    assert stereo.size_px == (424, 240)
    assert stereo.T_bc_pos_sigma_m.tolist() == stereo.mounting_sigma_deg.tolist() == [0, 0, 0]


@pytest.mark.parametrize(("rate_hz", "count"), [(1, 310), (5, 1550), (7.5, 2325), (30, 9300)])
def test_frames_come_at_their_rate(rate_hz: float, count: int) -> None:
    pairs = simulate_roadheader("rate", replace(ROADHEADER, rate_hz=rate_hz), 1).stereo_pairs
    np.testing.assert_allclose(pairs.t_s, np.arange(1, count + 1) / rate_hz, rtol=0, atol=1e-9)
    assert (pairs.left[0], pairs.right[-1]) == ("left/000000.png", f"right/{count - 1:06d}.png")


# Tracks -------------------------------------------------------------------------------------------------------


def test_error_free_tracks_are_projections_of_points_at_rest_on_the_surfaces() -> None:
    log = clean(tracks=True)
    tracks, truth, roadway = log.stereo_tracks, log.truth, ROADHEADER.roadway
    camera, r_bc = ROADHEADER.camera, Rotation.from_quat(log.stereo.T_bc_quat_wxyz, scalar_first=True)
    for name in np.unique(tracks.track)[::997]:
        rows = np.flatnonzero(tracks.track == name)
        states = np.round(tracks.t_s[rows] * 100).astype(int)
        z = log.stereo.fx_px * log.stereo.baseline_m / (tracks.u_left_px - tracks.u_right_px)[rows]
        x = (tracks.u_left_px[rows] - log.stereo.cx_px) * z / log.stereo.fx_px
        y = (tracks.v_px[rows] - log.stereo.cy_px) * z / log.stereo.fy_px
        rot_nb = Rotation.from_quat(truth.quat_nb[states], scalar_first=True)
        points_b = r_bc.apply(np.column_stack([x, y, z])) + log.stereo.T_bc_pos_m
        points_n = truth.pos_n_m[states] + rot_nb.apply(points_b)
        np.testing.assert_allclose(points_n, np.tile(points_n[0], (len(rows), 1)), rtol=0, atol=1e-8)
        east, north, up = np.abs(points_n[0] - [0, roadway.face_m, (roadway.roof_m + roadway.floor_m) / 2])
        side = min(abs(2.0 - east), abs(1.88 - east), abs(2.75 - up), abs(2.63 - up), north)
        along = (points_n[0][1] - roadway.back_m) % 1.0
        assert min(side, along, abs(along - 0.12), 1 - along) < 1e-8
        found = np.column_stack([tracks.u_left_px, tracks.u_right_px, tracks.v_px])[rows[0]]
        np.testing.assert_allclose(
            found, expected_px(camera, points_n[0], truth.pos_n_m[states[0]], rot_nb[0]), rtol=0, atol=1e-8
        )
        assert np.linalg.norm(r_bc.inv().apply(points_b), axis=1).max() < 12.0


def test_150_points_are_in_view_and_are_lost_at_random() -> None:
    log = clean(tracks=True)
    tracks = log.stereo_tracks
    _, counts = np.unique(tracks.t_s, return_counts=True)
    assert (counts == 150).all() and len(counts) == 1550
    for column, size in ((tracks.u_left_px, 424), (tracks.u_right_px, 424), (tracks.v_px, 240)):
        assert column.min() >= -0.5 and column.max() < size - 0.5
    # At rest nothing leaves the image: a track goes on to the next frame with probability exp(-0.2 s / 5 s).
    still = tracks.t_s <= 60
    frames = np.split(tracks.track[still], 300)
    kept = sum(len(np.intersect1d(a, b)) for a, b in pairwise(frames))
    low, high = stats.binom.interval(1 - FALSE_ALARM, 150 * 299, np.exp(-0.2 / 5))
    assert low <= kept <= high


def test_noise_of_tracks_has_the_declared_sigma_and_wrong_matches_their_share() -> None:
    spec = replace(ROADHEADER, images=False, static_s=10.0, length_m=1.0, tail_s=1.0)
    for share in (0.0, 0.1):
        made = replace(spec, tracks=TrackSpec(outlier_share=share))
        log, exact = (simulate_roadheader("tracks", made, 6, noise=noise) for noise in (True, False))
        np.testing.assert_array_equal(log.stereo_tracks.track, exact.stereo_tracks.track)
        error = np.array(
            [
                getattr(log.stereo_tracks, c) - getattr(exact.stereo_tracks, c)
                for c in ("u_left_px", "u_right_px", "v_px")
            ]
        )
        if share == 0:
            assert_unit_normal(error / log.stereo.sigma_px)
        else:
            far = (np.abs(error) > 3.0).any(axis=0)  # 6 sigma: of a wrong match all but 0.1 % are
            low, high = stats.binom.interval(1 - FALSE_ALARM, error.shape[1], 0.1 * 0.999)
            assert low <= far.sum() <= high


# Options, names and folders -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"rate_hz": 0.5}, "rate_hz = 0.5, expected 1 to 30"),
        ({"rate_hz": True}, "rate_hz = True"),
        ({"images": "no"}, "images = 'no', expected True or False"),
        ({"tracks": True, "outlier_share": 1.0}, "outlier_share = 1.0, expected 0 to less than 1"),
        ({"outlier_share": 0.1}, "without tracks"),
        ({"visibility": 3}, 'unknown option "visibility"'),
    ],
)
def test_options_out_of_range_are_refused(options: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError, match=text.replace("(", r"\(")):
        simulate("roadheader-stereo", 1, **options)


def test_every_option_is_explained() -> None:
    assert SCENARIOS.keys() == BUILDERS.keys()
    assert SCENARIOS["roadheader-stereo"]["options"].keys() == {"rate_hz", "images", "tracks", "outlier_share"}


def test_a_log_comes_back_from_its_folder_and_from_its_name(tmp_path: Path) -> None:
    options = {"images": False, "tracks": True, "outlier_share": 0.05, "rate_hz": 2.0}
    log = simulate("roadheader-stereo", 5, **options)
    assert log.stereo_pairs is None
    write(log, tmp_path / "L")
    again = read(tmp_path / "L")
    found = parse_name(again.name)
    assert found is not None and (found.options, found.seed) == (options, 5)
    same = simulate(found.scenario, 5, **found.options)
    for name, table in again.tables().items():
        for field in table.column_fields():
            np.testing.assert_array_equal(
                getattr(table, field.name), getattr(getattr(same, table.field_name()), field.name), name
            )
    assert not np.array_equal(simulate("roadheader-stereo", 6, **options).imu.gyro_b_rad_s, log.imu.gyro_b_rad_s)


def test_the_command_line_writes_the_tracks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = [
        "simulate",
        "roadheader-stereo",
        "--seed",
        "2",
        "--no-images",
        "--tracks",
        "--rate",
        "1",
        "-o",
        str(tmp_path / "L"),
    ]
    assert cli.main(line) == 0
    assert "stereo_tracks 46,500" in capsys.readouterr().err
    assert {path.name for path in (tmp_path / "L").iterdir()} == {
        "log.toml", "imu.parquet", "stereo_tracks.parquet", "truth.parquet",
    }  # fmt: skip


def test_the_command_line_writes_images_with_the_log_or_neither(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Images are there before the folder takes its name; a second run replaces a log with images if it is told to."""
    target = tmp_path / "L"
    line = ["simulate", "roadheader-stereo", "--seed", "2", "--rate", "1", "-o", str(target)]

    def some(scenario: str, seed: int, options: dict[str, Any], folder: Path, **_: Any) -> None:
        assert (scenario, seed, options) == ("roadheader-stereo", 2, {"rate_hz": 1.0})
        assert (folder / "log.toml").exists() and folder != target
        (folder / "left").mkdir()
        (folder / "left" / "000000.png").write_bytes(b"")

    def none(*_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(stereo_images, "render_into", none)
    assert cli.main(line) == 2
    assert "No space left" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
    monkeypatch.setattr(stereo_images, "render_into", some)
    assert cli.main(line) == 0
    assert (target / "left" / "000000.png").exists()
    assert cli.main(line) == 2
    assert (
        "holds left, which is no part of a log; choose another folder, or replace all of it with --overwrite"
        in capsys.readouterr().err
    )
    (target / "left" / "000001.png").write_bytes(b"")
    assert cli.main([*line, "--overwrite"]) == 0
    assert [path.name for path in (target / "left").iterdir()] == ["000000.png"]
