"""STAR-loc: the importer on the recordings and on damaged copies of them, and what the graph makes of raw ranges."""

from __future__ import annotations

import dataclasses
import shutil
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from test_aer1513_stereo import seen_pixels

import graphnav as gn
from benchmarks._starloc import DATA, RECORDINGS, shared_constants
from factors import so3
from graphnav.config import Config
from graphnav.errors import LogError
from graphnav.evaluation import evaluate
from graphnav.log import SensorLog
from graphnav.readers import read, starloc, starloc_stereo, write
from graphnav.readers.named_csv import NamedCsv
from graphnav.run import Run
from graphnav.trajectory import Trajectory

TABLES = ("imu.csv", "uwb.csv")


@pytest.fixture(scope="module")
def recordings(data_dir: Path) -> Path:
    folder = data_dir / DATA
    if not folder.is_dir():
        pytest.skip(f"no recorded data: {folder} is no folder")
    return folder


@cache
def log(source: Path) -> SensorLog:
    return starloc.convert(source)


@cache
def run(source: Path) -> Run:
    return gn.smooth(dataclasses.replace(log(source), truth=None))


def rms(run: Run, log: SensorLog) -> float:
    error = evaluate(run.trajectory, log).error_n_m
    return float(np.sqrt((error**2).sum(axis=1).mean()))


# The importer -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", RECORDINGS)
def test_ranges_agree_with_the_reference(recordings: Path, name: str) -> None:
    """Clocks, numbers of anchors, levers: `gt_range` is the distance that the log's own geometry gives."""
    found, path = log(recordings / name), recordings / name / "uwb.csv"
    header = path.read_text().partition("\n")[0].split(",")
    columns = ("time_s", "range", "gt_range")
    given = np.loadtxt(path, delimiter=",", skiprows=1, usecols=[header.index(c) for c in columns])
    np.testing.assert_array_equal(found.uwb.range_m, given[:, 1])  # raw, not range_calib
    truth = found.truth
    near = np.clip(np.searchsorted(truth.t_s, found.uwb.t_s), 0, len(truth.t_s) - 1)
    close = np.abs(truth.t_s[near] - found.uwb.t_s) < 5e-3
    tags = {t.id: t.lever_arm_b_m for t in found.uwb.tag}
    places = {a.id: a.pos_n_m for a in found.uwb.anchor}
    lever = np.array([tags[i] for i in found.uwb.tag_id])
    tag = truth.pos_n_m[near] + np.einsum("kij,kj->ki", so3.from_quaternion(truth.quat_nb[near]), lever)
    distance = np.linalg.norm(tag - np.array([places[i] for i in found.uwb.anchor_id]), axis=1)
    off = (distance - given[:, 2])[close]
    assert close.sum() > 300 and np.median(np.abs(off)) < 0.005 and np.quantile(np.abs(off), 0.95) < 0.02


@pytest.mark.parametrize("name", RECORDINGS)
def test_rates_agree_with_the_reference(recordings: Path, name: str) -> None:
    """IMU's turn on the rig and clock: turns over a tenth of a second, body axes; half the spread if 30 ms are off."""
    found = log(recordings / name)
    truth, imu = found.truth, found.imu
    first = np.arange(0, len(truth.t_s) - 30, 10)
    last = np.searchsorted(truth.t_s, truth.t_s[first] + 0.1)
    whole = truth.t_s[last] - truth.t_s[first] < 0.12
    first, last = first[whole], last[whole]
    rotation = so3.from_quaternion(truth.quat_nb)
    turned = so3.log(so3.transpose(rotation[first]) @ rotation[last])
    angle = np.vstack([np.zeros(3), np.cumsum(imu.gyro_b_rad_s * imu.dt_s, axis=0)])
    edges = np.r_[imu.start_s, imu.t_s]

    def left(later_s: float) -> float:
        by_gyro = [
            np.interp(truth.t_s[last] + later_s, edges, angle[:, k])
            - np.interp(truth.t_s[first] + later_s, edges, angle[:, k])
            for k in range(3)
        ]
        return float(np.median(np.linalg.norm(turned - np.array(by_gyro).T, axis=1)))

    assert left(0.0) < np.radians(0.5)
    assert left(0.0) < 0.8 * min(left(-0.03), left(0.03))


@pytest.mark.parametrize("name", RECORDINGS)
def test_a_regular_grid_and_a_level_start(recordings: Path, name: str) -> None:
    found = log(recordings / name)
    np.testing.assert_allclose(np.diff(found.imu.t_s), found.imu.dt_s, rtol=1e-6)
    force = found.imu.accel_b_m_s2[: int(0.5 / found.imu.dt_s)].mean(axis=0)
    up = so3.from_quaternion(found.initial.quat_nb_wxyz) @ force
    assert np.linalg.norm(up[:2]) < 1e-2 and 9.5 < up[2] < 10.1


def test_start_tells_nothing_of_the_truth(recordings: Path) -> None:
    """The heading is north whatever the reference says; asked for, it is the reference's."""
    source = recordings / RECORDINGS[1]
    free, headed = log(source).initial, starloc.convert(source, heading_sigma_deg=10.0).initial
    assert abs(so3.from_quaternion(free.quat_nb_wxyz)[0, 1]) < 1e-9
    assert free.att_sigma_deg[2] == starloc.UNKNOWN_HEADING_DEG and headed.att_sigma_deg[2] == 10.0
    np.testing.assert_array_equal(free.pos_n_m, 0.0)
    assert (free.pos_sigma_m >= 1000.0).all()
    off = so3.log(so3.from_quaternion(headed.quat_nb_wxyz).T @ so3.from_quaternion(log(source).truth.quat_nb[0]))
    assert abs(np.degrees(off[2])) < 1.0


def test_jumps_of_the_reference_are_left_out(recordings: Path) -> None:
    truth = log(recordings / RECORDINGS[0]).truth
    speed = np.linalg.norm(np.diff(truth.pos_n_m, axis=0), axis=1) / np.diff(truth.t_s)
    assert np.quantile(speed, 0.999) < 4.0
    assert 0.7 < len(truth.t_s) / 3989 < 0.8


def test_written_and_read_again(recordings: Path, tmp_path: Path) -> None:
    found = log(recordings / RECORDINGS[1])
    write(found, tmp_path / "log")
    again = read(tmp_path / "log")
    np.testing.assert_array_equal(again.uwb.range_m, found.uwb.range_m)
    np.testing.assert_array_equal(again.imu.gyro_b_rad_s, found.imu.gyro_b_rad_s)
    np.testing.assert_array_equal(again.uwb.tag[0].lever_arm_b_m, found.uwb.tag[0].lever_arm_b_m)


def copied(recordings: Path, target: Path) -> Path:
    name = RECORDINGS[1]
    (target / name).mkdir()
    for table in TABLES:
        shutil.copy(recordings / name / table, target / name / table)
    shutil.copytree(recordings / "mocap", target / "mocap")
    return target / name


def test_damaged_files_are_named(recordings: Path, tmp_path: Path) -> None:
    source = copied(recordings, tmp_path)
    table = source / "uwb.csv"
    table.chmod(0o644)
    lines = table.read_text().splitlines()
    table.write_text("\n".join([lines[0].replace("range", "reach"), *lines[1:]]))
    with pytest.raises(LogError, match=r"uwb\.csv.*range.*missing column"):
        starloc.convert(source)
    table.write_text("\n".join([lines[0], lines[1].replace("5.58", "five", 1), *lines[2:]]))
    with pytest.raises(LogError, match=r"uwb\.csv.*no number"):
        starloc.convert(source)
    table.unlink()
    with pytest.raises(LogError, match=r"no such file"):
        starloc.convert(source)


def test_other_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="expected loop-2d-fast_s1 or loop-3d_s5"):
        starloc.convert(tmp_path)
    with pytest.raises(LogError, match="needs a source folder"):
        starloc.convert(None)


# The camera -------------------------------------------------------------------------------------------------


@cache
def with_camera(source: Path) -> SensorLog:
    return starloc.convert(source, stereo=True)


@cache
def with_tags(source: Path) -> Run:
    return gn.smooth(dataclasses.replace(with_camera(source), truth=None))


def tag_places(recordings: Path, name: str) -> dict[int, np.ndarray]:
    """Where the motion capture has the tags, in n."""
    file = recordings / "mocap" / {RECORDINGS[0]: "environment_v1.csv", RECORDINGS[1]: "environment_v3.csv"}[name]
    level = starloc._level(np.array(starloc._SETUPS[name].up_room))
    table = NamedCsv(file)
    numbers = table.column("april_id").astype(int).tolist()
    return dict(zip(numbers, table.columns("x", "y", "z") @ level.T, strict=True))


def off_px(recordings: Path, name: str, later_s: float = 0.0) -> np.ndarray:
    """(K, 3) columns, disparities and rows of tags less those by the truth, where it is not far in time."""
    found, places = with_camera(recordings / name), tag_places(recordings, name)
    tracks, truth = found.stereo_tracks, found.truth
    t_s = tracks.t_s + later_s
    after = np.clip(np.searchsorted(truth.t_s, t_s), 1, len(truth) - 1)
    near = (truth.t_s[after] - truth.t_s[after - 1] < 0.05) & (t_s > truth.t_s[0]) & (t_s < truth.t_s[-1])
    t_s, numbers = t_s[near], tracks.track[near]
    states = Trajectory(truth.t_s, truth.pos_n_m, truth.quat_nb, np.gradient(truth.pos_n_m, truth.t_s, axis=0))
    times, which = np.unique(t_s, return_inverse=True)
    poses = states.at(times)
    expected = seen_pixels(
        poses.rotation_nb[which], poses.pos_n[which], np.array([places[k] for k in numbers.tolist()]), found
    )
    seen = np.column_stack([tracks.u_left_px, tracks.u_right_px, tracks.v_px])[near]
    off = seen - expected
    return np.column_stack([off[:, 0], off[:, 0] - off[:, 1], off[:, 2]])


@pytest.mark.parametrize(("name", "count", "tags"), [(RECORDINGS[0], 136, 17), (RECORDINGS[1], 198, 31)])
def test_tags_are_where_the_reference_has_them(recordings: Path, name: str, count: int, tags: int) -> None:
    """Mounting by the factory on the IMU's turn, which is known to half a degree: 10 px or so.

    A camera that hangs the other way, or whose place is that of `tf_cam_rig`, is off by hundreds.
    """
    tracks = with_camera(recordings / name).stereo_tracks
    assert len(tracks) == count and len(np.unique(tracks.track)) == tags
    off = off_px(recordings, name)
    assert len(off) > 0.85 * count
    assert (np.abs(np.median(off, axis=0)) < [15.0, 1.5, 10.0]).all()
    spread = 1.4826 * np.median(np.abs(off - np.median(off, axis=0)), axis=0)
    assert (spread < [8.0, 0.8, 8.0]).all()


@pytest.mark.parametrize("name", RECORDINGS)
def test_clock_of_the_images(recordings: Path, name: str) -> None:
    """Columns scatter more by poses 30 ms earlier or later."""

    def spread(later_s: float) -> float:
        off = off_px(recordings, name, later_s)[:, 0]
        return float(np.median(np.abs(off - np.median(off))))

    assert spread(0.0) < 0.75 * min(spread(-0.03), spread(0.03))


@pytest.mark.slow
def test_tags_agree_with_imu_and_ranges_as_declared(recordings: Path) -> None:
    """Few readings are left out (a wrongly read tag or two); with the sigma of the rows alone a quarter is."""
    source = recordings / RECORDINGS[1]
    found = with_camera(source)
    rows = found.stereo.replace(sigma_px=0.5)
    left_out, seen = [], len(found.stereo_tracks)
    for each in (found, dataclasses.replace(found, stereo=rows)):
        left_out.append(gn.smooth(dataclasses.replace(each, truth=None)).diagnostics.rejected.get("stereo_tracks", 0))
    assert left_out[0] < 0.03 * seen
    assert left_out[1] > 0.15 * seen


@pytest.mark.parametrize("name", RECORDINGS)
def test_the_tags_tell_what_disparities_are_too_large_by(recordings: Path, name: str) -> None:
    """As the reference has it, of which the graph knows nothing: 1.0 px by both; estimated 0.9 and 0.9 px.

    Bound: three sigmas (0.5 and 0.3 px), a false alarm in 370.
    """
    source = recordings / name
    found = with_tags(source).calibration["camera_disparity"]
    by_reference = float(np.median(off_px(recordings, name)[:, 1]))
    assert found.sigma < 0.6 * starloc_stereo.DISPARITY_SIGMA_PX
    assert abs(found.value - by_reference) < 3 * found.sigma


@pytest.mark.parametrize(("name", "most_m"), [(RECORDINGS[0], 0.16), (RECORDINGS[1], 0.11)])
def test_tags_hold_the_position_no_better_than_ranges(recordings: Path, name: str, most_m: float) -> None:
    """Measured 0.141 and 0.093 m; without them 0.116 and 0.097 m: the aim, to be better on both, is not met."""
    assert rms(with_tags(recordings / name), log(recordings / name)) < most_m


@pytest.mark.slow
@pytest.mark.parametrize("name", RECORDINGS)
def test_the_clock_of_the_images_is_found(recordings: Path, name: str) -> None:
    """Stamps moved by 85 ms: the same readings twice, seen from other keyframes. Found 85.9 and 85.4 ms."""
    found = []
    for late_s in (0.0, 0.085):
        own = with_camera(recordings / name)
        tracks = own.stereo_tracks.replace(t_s=own.stereo_tracks.t_s - late_s)
        moved = dataclasses.replace(own, truth=None, stereo_tracks=tracks, stereo=own.stereo.replace(time_sigma_s=0.1))
        found.append(gn.smooth(moved).calibration["camera_time"])
    assert found[1].value - found[0].value == pytest.approx(0.085, abs=3 * found[0].sigma)


def test_the_camera_is_there_on_demand_and_changes_nothing_else(recordings: Path) -> None:
    plain, full = (found(recordings / RECORDINGS[0]) for found in (log, with_camera))
    assert plain.stereo is None and plain.stereo_tracks is None
    np.testing.assert_array_equal(plain.imu.gyro_b_rad_s, full.imu.gyro_b_rad_s)
    np.testing.assert_array_equal(plain.uwb.range_m, full.uwb.range_m)


def test_a_damaged_calibration_is_named(recordings: Path, tmp_path: Path) -> None:
    source = copied(recordings, tmp_path)
    shutil.copy(recordings / RECORDINGS[1] / "apriltag_cal_global.csv", source)
    with pytest.raises(LogError, match=r"calib\.json.*no such file"):
        starloc.convert(source, stereo=True)
    (source / "calib.json").write_text('{"fu": 1000.0}')
    with pytest.raises(LogError, match=r"calib\.json.*fv.*missing"):
        starloc.convert(source, stereo=True)
    (source / "calib.json").write_text("fu: 1000")
    with pytest.raises(LogError, match=r"calib\.json.*no calibration"):
        starloc.convert(source, stereo=True)


# What the graph makes of it ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", RECORDINGS)
def test_position_within_twelve_centimetres(recordings: Path, name: str) -> None:
    """The issue's target, with raw ranges and an unknown heading; measured 0.116 and 0.097 m."""
    assert rms(run(recordings / name), log(recordings / name)) < 0.12


def test_a_clock_that_is_off_is_found_and_told(recordings: Path) -> None:
    """Ranges moved by 0.2 s: the estimates part by as much, positions stay; not asked, the run says so."""
    own = log(recordings / RECORDINGS[1])
    asked = Config.from_dict({"uwb": {"estimate_time_offset": True}})
    runs = []
    for late_s in (-0.2, 0.2):
        late = dataclasses.replace(own, truth=None, uwb=own.uwb.replace(t_s=own.uwb.t_s + late_s))
        runs.append(gn.smooth(late, asked))
    assert any("s early against the IMU" in line for line in gn.smooth(early(own)).diagnostics.warnings)
    first, second = (each.calibration["uwb_time_offset"] for each in runs)
    # the same ranges twice: what parts the two is the prior alone, a fiftieth of it
    assert first.value - second.value == pytest.approx(0.4, abs=0.3 * first.sigma)
    assert max(rms(each, own) for each in runs) < 0.12
    assert not any("stamped" in line for line in run(recordings / RECORDINGS[1]).diagnostics.warnings)


def early(own: SensorLog) -> SensorLog:
    return dataclasses.replace(own, truth=None, uwb=own.uwb.replace(t_s=own.uwb.t_s - 0.2))


@pytest.mark.slow
def test_tags_need_constants_of_their_own(recordings: Path) -> None:
    """One constant for both tags puts the rig 0.7 m too low, and the ranges themselves say so."""
    source = recordings / RECORDINGS[0]
    shared = dataclasses.replace(log(source), uwb=shared_constants(log(source)))
    other = gn.smooth(dataclasses.replace(shared, truth=None))
    assert rms(other, shared) > 3 * rms(run(source), log(source))
    assert other.diagnostics.history[-1]["error"] > run(source).diagnostics.history[-1]["error"] + 100
