"""The importers of recorded data: axes, units, stamps and what they drop, against the recordings."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import welch
from scipy.spatial.transform import Rotation

from factors.earth import earth_rate_n, normal_gravity
from graphnav.errors import LogError
from graphnav.log import Imu, SensorLog
from graphnav.readers import comma2k19, euroc, kitti_gtsam
from graphnav.readers.ecef import enu_from_ecef, geodetic
from graphnav.readers.vibration import noise_density
from graphnav.smooth import smooth

Array = np.ndarray


# Shared -----------------------------------------------------------------------------------------------------


def same(one: SensorLog, other: SensorLog) -> None:
    """Two logs hold the same values, to the last bit."""
    assert one.tables().keys() == other.tables().keys()
    for name in ("frames", "initial", *one.tables()):
        for field in dataclasses.fields(getattr(one, name)):
            left, right = (getattr(getattr(log, name), field.name) for log in (one, other))
            assert np.array_equal(left, right), f"{name}.{field.name}"


def edges(imu: Imu) -> Array:
    return np.concatenate([[imu.start_s], imu.t_s])


def mean_rates(imu: Imu, start_s: Array, end_s: Array) -> Array:
    """Mean of the gyro (K, 3) over intervals, rows split where the intervals cut them."""
    edge = edges(imu)
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(imu.gyro_b_rad_s * np.diff(edge)[:, None], axis=0)])
    angle = [np.column_stack([np.interp(t, edge, axis) for axis in total.T]) for t in (start_s, end_s)]
    return (angle[1] - angle[0]) / (end_s - start_s)[:, None]


def reference_rates(log: SensorLog) -> tuple[Array, Array, Array]:
    """Starts, ends and body rates (K, 3) between rows of the truth that the IMU covers."""
    inside = (log.truth.t_s > log.imu.start_s) & (log.truth.t_s < log.imu.t_s[-1])
    t, quat = log.truth.t_s[inside], log.truth.quat_nb[inside]
    rotation = Rotation.from_quat(quat, scalar_first=True)
    rate = (rotation[:-1].inv() * rotation[1:]).as_rotvec() / np.diff(t)[:, None]
    return t[:-1], t[1:], rate


def strapdown_errors(
    log: SensorLog, span_rows: int, every: int, bias: Callable[[int], tuple[Array, Array]]
) -> tuple[Array, Array]:
    """Attitude (deg) and position (m) errors of the IMU integrated from rows of the truth to later ones."""
    imu, truth = log.imu, log.truth
    gravity = np.array([0.0, 0.0, -normal_gravity(log.frames.latitude_deg, log.frames.height_m)])
    earth = earth_rate_n(log.frames.latitude_deg)
    edge, attitude, position = edges(imu), [], []
    for row in range(1, len(truth.t_s) - span_rows, every):
        start, end = truth.t_s[row], truth.t_s[row + span_rows]
        if end > edge[-1]:
            break
        first, last = np.searchsorted(edge, start, side="right") - 1, np.searchsorted(edge, end) - 1
        bounds = np.concatenate([[start], edge[first + 1 : last + 1], [end]])
        gyro_bias, accel_bias = bias(row)
        rotation = Rotation.from_quat(truth.quat_nb[row], scalar_first=True)
        pos, vel = truth.pos_n_m[row].copy(), truth.vel_n_m_s[row].copy()
        for k, dt in zip(range(first, last + 1), np.diff(bounds), strict=True):
            turn = (imu.gyro_b_rad_s[k] - gyro_bias - rotation.inv().apply(earth)) * dt
            middle = rotation * Rotation.from_rotvec(turn / 2)
            accel = middle.apply(imu.accel_b_m_s2[k] - accel_bias) + gravity
            pos, vel = pos + vel * dt + accel * dt**2 / 2, vel + accel * dt
            rotation = rotation * Rotation.from_rotvec(turn)
        expected = Rotation.from_quat(truth.quat_nb[row + span_rows], scalar_first=True)
        attitude.append(np.degrees((rotation.inv() * expected).magnitude()))
        position.append(np.linalg.norm(pos - truth.pos_n_m[row + span_rows]))
    return np.array(attitude), np.array(position)


def declared_noise(imu: Imu) -> Array:
    return np.array([imu.gyro_random_walk_deg_sqrt_h, imu.accel_random_walk_mg_sqrt_hz])


def shown_noise(imu: Imu, low_hz: float, high_hz: float) -> Array:
    """Welch's estimate of what `declared_noise` states, from the samples in a band."""
    found = []
    for samples, unit in ((imu.gyro_b_rad_s, np.radians(1) / 60), (imu.accel_b_m_s2, 9.80665e-3)):
        frequency, one_sided = welch(samples, fs=1 / imu.dt_s, nperseg=1024, axis=0)
        band = (frequency >= low_hz) & (frequency <= high_hz)
        found.append(np.sqrt(one_sided[band].mean() / 2) / unit)
    return np.array(found)


def test_noise_density_of_white_noise_beside_motion() -> None:
    """White noise of a known density under a slow motion a thousand times as strong, within 5 % (6 sigma)."""
    rng = np.random.default_rng(3)
    t = np.arange(20_000) * 0.005
    density = 0.02
    samples = density / np.sqrt(0.005) * rng.normal(size=(len(t), 3)) + 300 * np.sin(2 * np.pi * 0.7 * t)[:, None]
    assert noise_density(samples, 0.005, (30.0, 80.0)) == pytest.approx(density, rel=0.05)
    with pytest.raises(LogError, match="no frequencies of 300-400 Hz in 20000 samples at 200 Hz"):
        noise_density(samples, 0.005, (300.0, 400.0))


# EuRoC ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def euroc_folder(data_dir: Path) -> Path:
    folder = data_dir / "euroc_v1_01_easy"
    if not folder.is_dir():
        pytest.skip(f"no recorded data: {folder} is no folder")
    return folder


@pytest.fixture(scope="module")
def euroc_log(euroc_folder: Path) -> SensorLog:
    return euroc.convert(euroc_folder)


@pytest.fixture(scope="module")
def euroc_bias(euroc_folder: Path) -> Array:
    """Gyro and accelerometer biases of the reference (N, 6) in right, forward, up; no part of the log."""
    path = next((euroc_folder / "mav0" / "state_groundtruth_estimate0").glob("*.csv"))
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    return table[:, [12, 13, 11, 15, 16, 14]]  # x, y, z of the IMU are up, right, forward


def test_euroc_rows_and_clock(euroc_log: SensorLog) -> None:
    assert len(euroc_log.imu) == 29_120 and len(euroc_log.truth) == 2_895
    assert euroc_log.epoch == "2014-06-25T16:54:33.262142976Z"
    assert euroc_log.imu.start_s == pytest.approx(-0.0025, abs=1e-6)
    assert euroc_log.truth.t_s[0] == 0.0
    assert np.abs(np.diff(euroc_log.imu.t_s) - 0.005).max() < 1e-6
    assert euroc_log.name == "euroc_v1_01_easy"


def test_euroc_axes_at_rest(euroc_log: SensorLog) -> None:
    """On the ground the mean specific force in n is one g upward, within the accelerometer's bias."""
    still = euroc_log.imu.t_s < 4.0
    rotation = Rotation.from_quat(euroc_log.truth.quat_nb[0], scalar_first=True)
    force_n = rotation.apply(euroc_log.imu.accel_b_m_s2[still].mean(axis=0))
    assert np.abs(force_n - [0, 0, 9.807]).max() < 0.2
    assert euroc_log.imu.accel_b_m_s2[still].mean(axis=0)[2] > 9.0


def test_euroc_strapdown_follows_the_reference(euroc_folder: Path, euroc_bias: Array) -> None:
    """One second from the reference's state ends at the reference's: axes, signs, units, stamps agree."""
    recorded = euroc.convert(euroc_folder, zero_gyro_s=0)
    attitude, position = strapdown_errors(
        recorded, span_rows=20, every=20, bias=lambda row: (euroc_bias[row, :3], euroc_bias[row, 3:])
    )
    assert len(attitude) > 130
    assert np.median(attitude) < 0.12 and np.median(position) < 0.025
    assert attitude.max() < 0.5 and position.max() < 0.1


def test_euroc_half_sample_makes_rates_agree(euroc_log: SensorLog) -> None:
    """Point samples: shifted by half a sample the rates are closer to the reference's than unshifted."""
    start, end, rate = reference_rates(euroc_log)
    raw = euroc_log.imu.replace(t_s=euroc_log.imu.t_s - 0.0025)
    shifted, unshifted = (
        np.std(mean_rates(imu, start[20:-20], end[20:-20]) - rate[20:-20], axis=0) for imu in (euroc_log.imu, raw)
    )
    assert (unshifted > 1.7 * shifted).all()


def test_euroc_positions_are_rows_of_the_truth(euroc_folder: Path, euroc_log: SensorLog) -> None:
    assert len(euroc_log.position) == 144
    assert np.abs(euroc_log.position.t_s - np.arange(1, 145)).max() < 1e-3
    rows = np.searchsorted(euroc_log.truth.t_s, euroc_log.position.t_s)
    assert np.array_equal(euroc_log.position.pos_n_m, euroc_log.truth.pos_n_m[rows])
    assert (euroc_log.position.sigma_n_m == 0.01).all()
    faster = euroc.convert(euroc_folder, position_rate_hz=4.0, position_sigma_m=0.02)
    assert len(faster.position) == 4 * 144 + 2 and (faster.position.sigma_n_m == 0.02).all()
    assert euroc.convert(euroc_folder, position_rate_hz=0).position is None
    with pytest.raises(LogError, match="position_rate_hz -1, expected 0 or more"):
        euroc.convert(euroc_folder, position_rate_hz=-1)


def test_euroc_noise(euroc_folder: Path, euroc_log: SensorLog) -> None:
    """Bias walks are the yaml's in datasheet units; random walks are what the record shows in flight."""
    imu = euroc_log.imu
    assert imu.gyro_bias_walk_deg_h_sqrt_h == pytest.approx(np.degrees(1.9393e-5) * 3600 * 60)
    assert imu.accel_bias_walk_mg_sqrt_h == pytest.approx(3e-3 / 9.80665e-3 * 60)
    assert shown_noise(imu, 30, 80) == pytest.approx(declared_noise(imu), rel=0.1)
    assert imu.gyro_random_walk_deg_sqrt_h > np.degrees(1.6968e-4) * 60
    assert imu.accel_random_walk_mg_sqrt_hz > 2e-3 / 9.80665e-3


def test_euroc_gyro_is_zeroed_while_standing(euroc_folder: Path, euroc_log: SensorLog, euroc_bias: Array) -> None:
    recorded = euroc.convert(euroc_folder, zero_gyro_s=0)
    removed = recorded.imu.gyro_b_rad_s - euroc_log.imu.gyro_b_rad_s
    assert np.ptp(removed, axis=0).max() < 1e-12
    assert np.degrees(removed[0]) == pytest.approx([1.2, 4.48, -0.12], abs=0.02)
    for log, bias in ((recorded, euroc_bias[:, :3]), (euroc_log, euroc_bias[:, :3] - removed[0])):
        assert np.abs(np.degrees(bias).mean(axis=0) * 3600).max() < log.imu.gyro_bias_deg_h
    assert np.abs(euroc_bias[:, 3:]).max() < 2 * euroc_log.imu.accel_bias_mg * 9.80665e-3
    with pytest.raises(LogError, match=r"the drone turns at .* within the first 8 s"):
        euroc.convert(euroc_folder, zero_gyro_s=8)


def test_euroc_refuses(euroc_folder: Path, tmp_path: Path) -> None:
    with pytest.raises(LogError, match="pass the folder that holds mav0"):
        euroc.convert(tmp_path)
    imu0 = tmp_path / "mav0" / "imu0"
    shutil.copytree(euroc_folder / "mav0" / "imu0", imu0, copy_function=shutil.copyfile)
    reference = tmp_path / "mav0" / "state_groundtruth_estimate0"
    with pytest.raises(LogError, match="no csv file"):
        euroc.convert(tmp_path)
    shutil.copytree(euroc_folder / "mav0" / "state_groundtruth_estimate0", reference, copy_function=shutil.copyfile)
    yaml = (imu0 / "sensor.yaml").read_text()
    (imu0 / "sensor.yaml").write_text(yaml.replace("1.0, 0.0, 0.0, 0.0", "0.0, 1.0, 0.0, 0.0"))
    with pytest.raises(LogError, match=r"sensor\.yaml, T_BS: the IMU is not the body frame"):
        euroc.convert(tmp_path)
    (imu0 / "sensor.yaml").write_text(yaml.replace("gyroscope_random_walk", "gyro_walk"))
    with pytest.raises(LogError, match="gyroscope_random_walk: missing"):
        euroc.convert(tmp_path)
    (imu0 / "sensor.yaml").write_text(yaml)
    same(euroc.convert(tmp_path), euroc.convert(tmp_path / "mav0"))
    with (imu0 / "data.csv").open("a") as file:
        file.write("1403715420000000000,0,0\n")
    with pytest.raises(LogError, match=r"data\.csv: not an ASL table of 7 columns"):
        euroc.convert(tmp_path)


# comma2k19 --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def car_folder(data_dir: Path) -> Path:
    folder = data_dir / "comma2k19_segment"
    if not folder.is_dir():
        pytest.skip(f"no recorded data: {folder} is no folder")
    return folder


@pytest.fixture(scope="module")
def car_log(car_folder: Path) -> SensorLog:
    return comma2k19.convert(car_folder)


def test_car_rows_and_place(car_log: SensorLog) -> None:
    assert (len(car_log.imu), len(car_log.odometer), len(car_log.truth)) == (6256, 4974, 1200)
    assert car_log.frames.latitude_deg == pytest.approx(37.721, abs=1e-4)
    assert car_log.frames.longitude_deg == pytest.approx(-122.4723, abs=1e-4)
    assert car_log.truth.t_s[0] == 0 and car_log.truth.t_s[-1] == pytest.approx(59.95, abs=0.01)
    assert car_log.imu.start_s > 0


def test_car_reference_drives_forward_and_north(car_log: SensorLog) -> None:
    truth = car_log.truth
    path = np.linalg.norm(np.diff(truth.pos_n_m, axis=0), axis=1).sum()
    assert path == pytest.approx(1011.8, abs=0.1)
    assert truth.pos_n_m[-1] == pytest.approx([43.1, 1010.3, 8.0], abs=0.1)
    rate = np.diff(truth.pos_n_m, axis=0) / np.diff(truth.t_s)[:, None]
    assert np.std(rate - (truth.vel_n_m_s[1:] + truth.vel_n_m_s[:-1]) / 2, axis=0).max() < 0.005
    vel_b = Rotation.from_quat(truth.quat_nb, scalar_first=True).inv().apply(np.array(truth.vel_n_m_s)).mean(axis=0)
    assert vel_b == pytest.approx([0.24, 16.83, 1.11], abs=0.02)


def test_car_axes_and_clock(car_log: SensorLog) -> None:
    """Gyro and reference turn about the same axes at the same time; specific force points up."""
    start, end, rate = reference_rates(car_log)
    measured = mean_rates(car_log.imu, start, end)
    correlation = [np.corrcoef(measured[:, k], rate[:, k])[0, 1] for k in range(3)]
    assert correlation[0] > 0.97 and correlation[1] > 0.97 and correlation[2] > 0.9
    late, early = (
        np.std(mean_rates(car_log.imu.replace(t_s=car_log.imu.t_s + offset), start, end) - rate, axis=0)
        for offset in (0.02, -0.02)
    )
    now = np.std(measured - rate, axis=0)
    assert (now < late).all() and (now < early).all()
    assert 9.4 < car_log.imu.accel_b_m_s2[:, 2].mean() < 9.9


def test_car_strapdown_follows_the_reference(car_log: SensorLog) -> None:
    """One second from the reference's state, biases not removed: 0.1 deg/s and 40 mg explain what is left."""
    attitude, position = strapdown_errors(car_log, span_rows=20, every=20, bias=lambda row: (np.zeros(3), np.zeros(3)))
    assert len(attitude) > 50
    assert np.median(attitude) < 0.2 and np.median(position) < 0.3


def test_car_gyro_bias_within_its_prior(car_folder: Path, car_log: SensorLog) -> None:
    for log in (car_log, comma2k19.convert(car_folder, uncalibrated_gyro=True)):
        start, end, rate = reference_rates(log)
        bias = np.degrees(mean_rates(log.imu, start, end) - rate).mean(axis=0) * 3600
        assert np.abs(bias).max() < log.imu.gyro_bias_deg_h
    assert np.abs(bias).max() > car_log.imu.gyro_bias_deg_h  # the uncorrected gyro needs its own prior


def odometer_scale(log: SensorLog) -> float:
    speed = np.linalg.norm(log.truth.vel_n_m_s, axis=1)
    measured = np.interp(log.truth.t_s, log.odometer.t_s, log.odometer.speed_m_s)
    return float(measured @ speed / (speed @ speed)) - 1


def test_car_odometer(car_folder: Path, car_log: SensorLog) -> None:
    assert odometer_scale(car_log) == pytest.approx(-0.0096, abs=5e-4)
    assert car_log.odometer.scale_sigma == 0.01
    known = comma2k19.convert(car_folder, wheel_scale=-0.0096)
    assert abs(odometer_scale(known)) < 5e-4 and known.odometer.scale_sigma == 0.001
    with pytest.raises(LogError, match=r"wheel_scale 0\.99"):
        comma2k19.convert(car_folder, wheel_scale=0.99)


def test_car_initial_state_is_the_reference_at_the_start(car_log: SensorLog) -> None:
    """The start lies between two rows of the truth: within what the car moves from one to the next."""
    row = int(np.searchsorted(car_log.truth.t_s, car_log.imu.start_s))
    lo, hi = car_log.truth.pos_n_m[row - 1], car_log.truth.pos_n_m[row]
    assert (car_log.initial.pos_n_m >= np.minimum(lo, hi)).all()
    assert (car_log.initial.pos_n_m <= np.maximum(lo, hi)).all()
    turn = Rotation.from_quat(car_log.truth.quat_nb[row], scalar_first=True).inv() * Rotation.from_quat(
        car_log.initial.quat_nb_wxyz, scalar_first=True
    )
    assert np.degrees(turn.magnitude()) < 0.2


@pytest.mark.parametrize(
    ("latitude_deg", "longitude_deg", "height_m"),
    [
        (0.0, 0.0, 0.0),
        (37.7, -122.5, 31.6),
        (89.9, 10.0, 500.0),
        (-33.0, 151.0, 5000.0),
        (52.0, 179.9, -80.0),
    ],
)
def test_geodetic_inverts_the_ellipsoid(latitude_deg: float, longitude_deg: float, height_m: float) -> None:
    latitude, longitude = np.radians([latitude_deg, longitude_deg])
    a, f = 6378137.0, 1 / 298.257223563
    e2 = f * (2 - f)
    normal = a / np.sqrt(1 - e2 * np.sin(latitude) ** 2)
    up = np.array([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)])
    pos_e = normal * up * [1, 1, 1 - e2] + height_m * up
    found = geodetic(pos_e)
    assert np.degrees(found[:2]) == pytest.approx([latitude_deg, longitude_deg], abs=1e-9)
    assert found[2] == pytest.approx(height_m, abs=1e-6)
    r_ne = enu_from_ecef(latitude, longitude)
    assert r_ne @ up == pytest.approx([0, 0, 1], abs=1e-15)
    assert np.linalg.det(r_ne) == pytest.approx(1)
    assert (r_ne @ [0, 0, 1])[1] > 0 and (r_ne @ [0, 0, 1])[0] == 0  # north leans to the pole, east does not


def save(path: Path, array: Array) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        np.save(file, array)


@pytest.fixture
def small_car(tmp_path: Path) -> Path:
    """A made-up segment: 10 m/s north at the equator, level, for two seconds."""
    t = 100 + np.arange(0, 2.0001, 0.05)
    pos_e = np.array([6378137.0, 0, 0]) + np.outer(t - 100, [0.0, 0.0, 10.0])
    frd_in_e = np.array([[0, 0, -1.0], [0, 1.0, 0], [1.0, 0, 0]])  # forward is north (z), right is east (y)
    quat = Rotation.from_matrix(frd_in_e).as_quat(scalar_first=True)
    save(tmp_path / "global_pose" / "frame_times", t)
    save(tmp_path / "global_pose" / "frame_positions", pos_e)
    save(tmp_path / "global_pose" / "frame_orientations", np.tile(quat, (len(t), 1)))
    save(tmp_path / "global_pose" / "frame_velocities", np.tile([0.0, 0.0, 10.0], (len(t), 1)))
    t_gyro = 100.02 + np.arange(190) * 0.01
    log = tmp_path / "processed_log"
    save(log / "IMU" / "gyro" / "t", t_gyro)
    save(log / "IMU" / "gyro" / "value", np.tile([0.1, 0.2, 0.3], (190, 1)))
    t_accel = 100.003 + np.arange(195) * 0.01
    save(log / "IMU" / "accelerometer" / "t", t_accel)
    save(log / "IMU" / "accelerometer" / "value", np.outer(t_accel - 100, [1.0, 2.0, 3.0]))
    t_wheel = 100 + np.arange(100) * 0.02
    save(log / "CAN" / "wheel_speed" / "t", t_wheel)
    save(log / "CAN" / "wheel_speed" / "value", np.tile([1.0, 2.0, 9.0, 11.0], (100, 1)))
    return tmp_path


def test_small_car(small_car: Path) -> None:
    log = comma2k19.convert(small_car)
    assert log.truth.pos_n_m[-1] == pytest.approx([0, 20, 0], abs=1e-4)
    assert np.abs(log.truth.quat_nb - [1, 0, 0, 0]).max() < 1e-12
    assert log.imu.t_s[0] == pytest.approx(0.025)  # half a sample after the stamp
    assert np.abs(log.imu.gyro_b_rad_s - [0.2, 0.1, -0.3]).max() < 1e-15
    expected = np.outer(log.imu.t_s - 0.005, [2.0, 1.0, -3.0])  # interpolated at the gyro's own stamps
    assert np.abs(log.imu.accel_b_m_s2 - expected).max() < 1e-9
    assert (log.odometer.speed_m_s == 10).all()
    assert log.initial.pos_n_m == pytest.approx([0, 0.15, 0], abs=1e-6)
    assert log.initial.vel_n_m_s == pytest.approx([0, 10, 0], abs=1e-9)


def test_car_drops_what_is_no_sample(small_car: Path) -> None:
    t_path = small_car / "processed_log" / "CAN" / "wheel_speed" / "t"
    value_path = t_path.parent / "value"
    t, value = np.load(t_path), np.load(value_path)
    t[10], t[20] = t[9], t[15]
    value[30, 0], t[40] = np.nan, np.inf
    save(t_path, t)
    save(value_path, value)
    kept = comma2k19.convert(small_car).odometer
    assert len(kept) == 96
    assert np.isin([0.2, 0.4, 0.6, 0.8], np.round(kept.t_s, 6)).sum() == 0


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("processed_log/IMU/gyro/t", "gyro/t: no such file"),
        ("global_pose/frame_positions", "frame_positions: no such file"),
    ],
)
def test_car_refuses_missing_files(small_car: Path, name: str, message: str) -> None:
    (small_car / name).unlink()
    with pytest.raises(LogError, match=message):
        comma2k19.convert(small_car)


def test_car_refuses_damaged_files(small_car: Path) -> None:
    path = small_car / "processed_log" / "IMU" / "gyro" / "value"
    whole = path.read_bytes()
    path.write_bytes(whole[:-100])
    with pytest.raises(LogError, match="gyro/value: not a whole numpy file"):
        comma2k19.convert(small_car)
    save(path, np.zeros((190, 2)))
    with pytest.raises(LogError, match=r"shape \(190, 2\), expected \(N, 3\)"):
        comma2k19.convert(small_car)
    save(path, np.zeros((180, 3)))
    with pytest.raises(LogError, match="190 times for 180 values"):
        comma2k19.convert(small_car)


# KITTI-derived drive ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def drive() -> SensorLog:
    return kitti_gtsam.convert(None)


def test_drive_starts_after_the_hole(drive: SensorLog) -> None:
    steps = np.diff(drive.imu.t_s)
    assert drive.imu.t_s[0] == 0 and drive.imu.dt_s == pytest.approx(0.01, abs=1e-4)
    assert steps[:3000].max() < 0.02
    assert len(drive.imu) == 46_968 - 2 - 1_257


def test_drive_has_eight_holes_instead_of_filled_stretches(drive: SensorLog) -> None:
    holes = np.flatnonzero(np.diff(drive.imu.t_s) > 0.1)
    lengths = np.diff(drive.imu.t_s)[holes]
    assert len(holes) == 8 and lengths.min() > 1.5 and lengths.max() < kitti_gtsam.HOLE_S
    values = np.column_stack([drive.imu.accel_b_m_s2, drive.imu.gyro_b_rad_s])
    assert not kitti_gtsam.filled_rows(drive.imu.t_s, values).any()
    for k in holes:
        inside = (drive.position.t_s > drive.imu.t_s[k]) & (drive.position.t_s < drive.imu.t_s[k + 1])
        assert not inside.any()
    kept = kitti_gtsam.convert(filled="keep")
    assert len(kept.imu) - len(drive.imu) == 1_257 and len(kept.position) - len(drive.position) == 13
    with pytest.raises(LogError, match='filled "maybe"'):
        kitti_gtsam.convert(filled="maybe")


def test_filled_rows_are_the_interior_of_straight_stretches() -> None:
    rng = np.random.default_rng(7)
    t = np.cumsum(rng.uniform(0.008, 0.012, 200))
    values = rng.normal(size=(200, 6))
    for lo, hi in ((20, 60), (100, 103)):
        share = ((t[lo : hi + 1] - t[lo]) / (t[hi] - t[lo]))[:, None]
        values[lo : hi + 1] = values[lo] + share * (values[hi] - values[lo])
    values[150:170, :5] = 1.0  # one channel still moves: measured
    expected = np.zeros(200, bool)
    expected[21:60] = expected[101:103] = True
    assert np.array_equal(kitti_gtsam.filled_rows(t, values), expected)


def test_drive_axes(drive: SensorLog) -> None:
    """Between two holes the gyro's yaw follows the course; specific force is up; braking acts backward."""
    t, pos = drive.position.t_s, drive.position.pos_n_m
    rate = np.gradient(pos, t, axis=0)
    course = np.unwrap(np.arctan2(-rate[:, 0], rate[:, 1]))
    yaw = np.interp(t, drive.imu.t_s, np.cumsum(drive.imu.gyro_b_rad_s[:, 2] * np.diff(edges(drive.imu))))
    turning = np.abs(np.gradient(yaw, t)) > 0.05
    calm = (t > 40) & (t < 195) & ~turning & (np.linalg.norm(rate, axis=1) > 4)
    difference = np.degrees(course - yaw)[calm]
    assert calm.sum() > 50 and np.ptp(np.degrees(course[calm])) > 180
    assert np.std(difference) < 1.5
    assert drive.imu.accel_b_m_s2[:, 2].mean() == pytest.approx(9.79, abs=0.05)
    speed = np.linalg.norm(rate, axis=1)
    forward = np.interp(t, drive.imu.t_s, np.convolve(drive.imu.accel_b_m_s2[:, 1], np.ones(100) / 100, "same"))
    sideways = np.interp(t, drive.imu.t_s, np.convolve(drive.imu.accel_b_m_s2[:, 0], np.ones(100) / 100, "same"))
    assert np.corrcoef(np.gradient(speed, t), forward)[0, 1] > 0.85
    assert np.corrcoef(-speed * np.gradient(yaw, t), sideways)[0, 1] > 0.85  # a left turn is felt to the left


def test_drive_initial_state(drive: SensorLog) -> None:
    """Course and speed of the next fixes, carried back by the IMU, agree with the start within its sigmas."""
    fixes = drive.position
    rate = (fixes.pos_n_m[1] - fixes.pos_n_m[0]) / (fixes.t_s[1] - fixes.t_s[0])
    middle = (fixes.t_s[0] + fixes.t_s[1]) / 2
    turned = drive.imu.gyro_b_rad_s[drive.imu.t_s < middle, 2].sum() * drive.imu.dt_s
    course = np.degrees(np.arctan2(-rate[0], rate[1]) - turned)
    w, _, _, z = drive.initial.quat_nb_wxyz
    heading = np.degrees(2 * np.arctan2(z, w))
    assert abs(heading - course) < drive.initial.att_sigma_deg[2]
    gained = drive.imu.accel_b_m_s2[drive.imu.t_s < middle, 1].sum() * drive.imu.dt_s
    speed = np.linalg.norm(drive.initial.vel_n_m_s)
    assert abs(np.linalg.norm(rate) - gained - speed) < 2 * drive.initial.vel_sigma_m_s[0]


def test_drive_noise_is_the_metadata_in_datasheet_units(drive: SensorLog) -> None:
    imu = drive.imu
    assert imu.gyro_random_walk_deg_sqrt_h == pytest.approx(np.degrees(0.000175) * 60)
    assert imu.gyro_bias_walk_deg_h_sqrt_h == pytest.approx(np.degrees(2.91e-6) * 3600 * 60)
    assert imu.accel_random_walk_mg_sqrt_hz == pytest.approx(0.01 / 9.80665e-3)
    assert imu.accel_bias_walk_mg_sqrt_h == pytest.approx(0.000167 / 9.80665e-3 * 60)
    assert (drive.position.sigma_n_m == 0.07).all()


def test_drive_position_offset(drive: SensorLog) -> None:
    moved = kitti_gtsam.convert(position_offset_s=0.05)
    common = np.isin(np.round(moved.position.t_s - 0.05, 6), np.round(drive.position.t_s, 6))
    assert common.all()


def test_drive_from_a_folder(drive: SensorLog, tmp_path: Path) -> None:
    import gtsam

    for name in (kitti_gtsam.IMU_FILE, kitti_gtsam.NOISE_FILE, kitti_gtsam.POSITION_FILE):
        with pytest.raises(LogError, match=f"{name}: no such file"):
            kitti_gtsam.convert(tmp_path)
        shutil.copyfile(gtsam.findExampleDataFile(name), tmp_path / name)
    same(kitti_gtsam.convert(tmp_path), drive)
    path = tmp_path / kitti_gtsam.POSITION_FILE
    path.write_text(path.read_text().replace("Time,X,Y,Z", "Time,Y,X,Z"))
    with pytest.raises(LogError, match=r"columns \['Time', 'Y', 'X', 'Z'\]"):
        kitti_gtsam.convert(tmp_path)


def test_split_every_other(drive: SensorLog) -> None:
    kept, withheld = kitti_gtsam.split(drive)
    assert len(kept.position) + len(withheld) == len(drive.position)
    assert not np.isin(withheld.t_s, kept.position.t_s).any()
    assert np.array_equal(np.sort(np.append(kept.position.t_s, withheld.t_s)), drive.position.t_s)
    assert np.array_equal(kept.position.t_s[[0, 1, -1]], drive.position.t_s[[0, 1, -1]])
    assert np.array_equal(withheld.t_s, drive.position.t_s[3:-1:2])
    rows = np.searchsorted(drive.position.t_s, withheld.t_s)
    assert np.array_equal(withheld.pos_n_m, drive.position.pos_n_m[rows])
    assert kept.imu is drive.imu and kept.initial is drive.initial
    same(kitti_gtsam.convert(withhold="every-other"), kept)


def test_split_gaps(drive: SensorLog) -> None:
    _, withheld = kitti_gtsam.split(drive, [(100.0, 160.0), (300.0, 330.0)])
    inside = ((withheld.t_s > 100) & (withheld.t_s < 160)) | ((withheld.t_s > 300) & (withheld.t_s < 330))
    assert inside.all() and 85 < len(withheld) <= 90
    kept, withheld = kitti_gtsam.split(drive, gap_s=60.0)
    gaps = np.diff(kept.position.t_s)
    assert (gaps > 59.9).sum() == 3 and withheld.t_s[-1] < kept.position.t_s[-1]
    same(kitti_gtsam.convert(gap_s=60.0), kept)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"withhold": "some"}, 'withhold "some", expected "every-other" or gaps'),
        ({"withhold": None}, "nothing to withhold"),
        ({"withhold": [(1000.0, 1060.0)]}, "none of the 456 positions"),
        ({"withhold": []}, "none of the 456 positions"),
        ({"withhold": [(60.0, 30.0)]}, r"gap \(60\.0, 30\.0\), expected \(start_s, end_s\)"),
        ({"gap_s": 0.0}, "gap_s 0, expected a length"),
        ({"gap_s": 400.0}, "none of the 456 positions"),
    ],
)
def test_split_refuses(drive: SensorLog, options: dict[str, object], message: str) -> None:
    with pytest.raises(LogError, match=message):
        kitti_gtsam.split(drive, **options)


# All three --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("module", [comma2k19, euroc])
def test_source_is_needed(module: object) -> None:
    with pytest.raises(LogError, match="needs a source folder"):
        module.convert(None)


@pytest.mark.parametrize("name", ["euroc", "comma2k19", "kitti_gtsam"])
def test_same_log_twice_and_through_a_folder(name: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    from graphnav.readers import read, write

    fixture, module, source = {
        "euroc": ("euroc_log", euroc, "euroc_folder"),
        "comma2k19": ("car_log", comma2k19, "car_folder"),
        "kitti_gtsam": ("drive", kitti_gtsam, None),
    }[name]
    log = request.getfixturevalue(fixture)
    same(module.convert(source and request.getfixturevalue(source)), log)
    write(log, tmp_path / "log")
    again = read(tmp_path / "log")
    assert again.name == log.name and again.epoch == log.epoch
    same(again, log)


# What smoothing makes of them -------------------------------------------------------------------------------


def withheld_error(log: SensorLog, **how: object) -> tuple[Array, float]:
    """Errors (K,) at withheld positions, m, and their NEES."""
    kept, withheld = kitti_gtsam.split(log, **how)
    run = smooth(kept)
    states = run.trajectory.at(withheld.t_s)
    error = states.pos_n - withheld.pos_n_m
    cov = states.cov[:, 3:6, 3:6] + np.eye(3) * withheld.sigma_n_m[:, :, None] ** 2
    nees = np.einsum("ki,kij,kj->k", error, np.linalg.inv(cov), error) / 3
    return np.linalg.norm(error, axis=1), float(nees.mean())


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_smoothed_drive(drive: SensorLog) -> None:
    """Between what is reached (0.12 and 2.0 m) and what the filled stretches would cost (0.37 and 14 m)."""
    error, nees = withheld_error(drive)
    assert rms(error) < 0.2 and nees < 1.5
    error, nees = withheld_error(drive, gap_s=60.0)
    assert rms(error) < 4.0 and nees < 4.0


def test_smoothed_drone(euroc_log: SensorLog) -> None:
    run = smooth(euroc_log)
    judged = ~np.isin(euroc_log.truth.t_s, euroc_log.position.t_s)
    error = run.trajectory.at(euroc_log.truth.t_s[judged]).pos_n - euroc_log.truth.pos_n_m[judged]
    assert rms(np.linalg.norm(error, axis=1)) < 0.01
