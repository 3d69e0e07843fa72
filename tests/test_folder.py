"""Log folders: what is written comes back to the last bit, and is there whole or not at all."""

from __future__ import annotations

import dataclasses
import tomllib

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sample_logs import every_sensor_log, initial, odometer_params, small_log

from graphnav import log as gl
from graphnav.errors import LogError
from graphnav.readers import folder, read, tables, write, writer
from graphnav.readers.sections import _toml


def assert_same(first, second, name=""):
    """Equal to the last bit, through records, tuples and arrays."""
    if dataclasses.is_dataclass(first):
        for f in dataclasses.fields(first):
            if f.compare:
                assert_same(getattr(first, f.name), getattr(second, f.name), f"{name}.{f.name}")
    elif isinstance(first, tuple):
        assert len(first) == len(second), name
        for one, other in zip(first, second, strict=True):
            assert_same(one, other, name)
    elif isinstance(first, np.ndarray) and first.dtype == object:
        assert len(first) == len(second), name
        for one, other in zip(first, second, strict=True):
            np.testing.assert_array_equal(one, other, err_msg=name)
    elif isinstance(first, np.ndarray):
        assert first.dtype == second.dtype, name
        np.testing.assert_array_equal(first, second, err_msg=name)
    else:
        assert first == second, name


@pytest.mark.parametrize("ending", ["parquet", "csv"])
@pytest.mark.parametrize("make", [small_log, every_sensor_log])
def test_a_log_comes_back_to_the_last_bit(tmp_path, make, ending):
    log = make()
    write(log, tmp_path / "log", tables=ending)
    assert_same(log, read(tmp_path / "log"))
    written = {p.name for p in (tmp_path / "log").iterdir()}
    scans = {"lidar_scans.parquet"} if log.lidar_scans is not None else set()
    assert written == {"log.toml"} | {f"{t}.{ending}" for t in log.tables() if t != "lidar_scans"} | scans


def test_a_start_without_position_is_read(tmp_path):
    log = dataclasses.replace(small_log(), initial=initial(pos_n_m=None, pos_sigma_m=None))
    write(log, tmp_path / "log")
    assert_same(log, read(tmp_path / "log"))
    text = (tmp_path / "log" / "log.toml").read_text()
    without = "\n".join(line for line in text.splitlines() if not line.startswith("pos_"))
    assert without != text
    (tmp_path / "log" / "log.toml").write_text(without)
    assert_same(log, read(tmp_path / "log"))


@given(values=st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=20))
@pytest.mark.parametrize("ending", [".parquet", ".csv"])
def test_every_float_survives(tmp_path_factory, ending, values):
    folder = tmp_path_factory.mktemp("floats")
    record = gl.Odometer(t_s=np.arange(float(len(values))), speed_m_s=values, **odometer_params())
    tables.write_table(record, folder, ending)
    back = tables.read_columns(gl.Odometer, folder / f"odometer{ending}", "odometer")
    np.testing.assert_array_equal(back["speed_m_s"], record.speed_m_s)


@given(st.floats(allow_nan=False, allow_infinity=False) | st.text())
def test_every_toml_value_survives(value):
    assert tomllib.loads(f"key = {_toml(value)}")["key"] == value


def test_a_table_longer_than_a_block_comes_back(tmp_path):
    n = 2 * tables._BLOCK_ROWS + 3
    record = gl.Odometer(t_s=np.arange(float(n)), speed_m_s=np.sin(np.arange(n)), **odometer_params())
    log = gl.SensorLog(name="long", frames=gl.Frames(0.0), odometer=record)
    for ending in ("parquet", "csv"):
        write(log, tmp_path / "log", tables=ending)
        assert_same(log, read(tmp_path / "log"))


def test_time_offsets_are_applied_once(tmp_path):
    log = every_sensor_log()
    offsets = {"imu": 0.25, "odometer": -0.5, "uwb": 0.125, "stereo": 1.0, "lidar": 2.0}
    shared = {"lidar": ("lidar_points", "lidar_scans"), "stereo": ("stereo_pairs", "stereo_tracks")}
    records = {name: getattr(log, name).replace(time_offset_s=offset) for name, offset in offsets.items()}
    write(dataclasses.replace(log, **records), tmp_path / "log")
    back = read(tmp_path / "log")
    for name, offset in offsets.items():
        assert getattr(back, name).time_offset_s == 0.0
        for table in shared.get(name, (name,)):
            shift = getattr(back, table).t_s - getattr(log, table).t_s
            np.testing.assert_allclose(shift, offset, atol=1e-15, err_msg=table)
    for column in ("t_from_s", "t_to_s"):
        shift = getattr(back.relative_pose, column) - getattr(log.relative_pose, column)
        np.testing.assert_allclose(shift, offsets["stereo"], atol=1e-15)
    np.testing.assert_array_equal(back.truth.t_s, log.truth.t_s)
    write(back, tmp_path / "again")
    assert_same(back, read(tmp_path / "again"))


def test_matrices_are_applied_once(tmp_path):
    log = small_log(rows=70_000)  # more than one block
    gyro, accel = np.array([[1, 0.1, 0], [0, 2, 0], [0.3, 0, 1]]), np.diag([1.0, 1.01, 0.99])
    imu = log.imu.replace(gyro_matrix=gyro, accel_matrix=accel)
    write(dataclasses.replace(log, imu=imu), tmp_path / "log")
    back = read(tmp_path / "log")
    assert back.imu.gyro_matrix is None
    assert back.imu.accel_matrix is None
    expected = np.array([gyro @ row for row in log.imu.gyro_b_rad_s[-5:]])
    np.testing.assert_allclose(back.imu.gyro_b_rad_s[-5:], expected, rtol=1e-12)
    np.testing.assert_allclose(back.imu.accel_b_m_s2, log.imu.accel_b_m_s2 * [1, 1.01, 0.99], rtol=1e-12)


def test_csv_as_other_programs_write_it(tmp_path):
    write(small_log(), tmp_path / "log")
    (tmp_path / "log" / "odometer.parquet").unlink()
    text = "\ufeffspeed_m_s,t_s\r\n1, 0.5\r\n\r\n-2.5e-1,1.5\r\n"
    (tmp_path / "log" / "odometer.csv").write_bytes(text.encode())
    back = read(tmp_path / "log").odometer
    np.testing.assert_array_equal(back.t_s, [0.5, 1.5])
    np.testing.assert_array_equal(back.speed_m_s, [1.0, -0.25])


def test_whole_numbers_may_be_stored_as_floats(tmp_path):
    log = every_sensor_log()
    write(log, tmp_path / "log")
    folder = tmp_path / "log"
    events = pa.table({"t_s": [0.05, 0.1], "kind": ["cut_start", "cut_end"], "cycle": [1.0, 2.0]})
    pq.write_table(events, folder / "events.parquet")
    assert read(folder).events.cycle.tolist() == [1, 2]
    (folder / "events.parquet").unlink()
    (folder / "events.csv").write_text("t_s,kind,cycle\n0.05,cut_start,1.0\n0.1,cut_end,2\n")
    cycle = read(folder).events.cycle
    assert cycle.tolist() == [1, 2]
    assert cycle.dtype == np.int64


def test_parquet_as_other_programs_write_it(tmp_path):
    """Float32 values, whole numbers where floats are expected, dictionary-coded text."""
    write(every_sensor_log(), tmp_path / "log")
    odometer = pa.table({"t_s": [0, 1], "speed_m_s": pa.array([0.1, 0.2], pa.float32())})
    pq.write_table(odometer, tmp_path / "log" / "odometer.parquet")
    kinds = pa.array(["cut_start", "cut_end"]).dictionary_encode()
    pq.write_table(pa.table({"t_s": [0.05, 0.1], "kind": kinds, "cycle": [1, 1]}), tmp_path / "log" / "events.parquet")
    back = read(tmp_path / "log")
    np.testing.assert_array_equal(back.odometer.speed_m_s, np.float32([0.1, 0.2]).astype(float))
    assert back.events.kind.tolist() == ["cut_start", "cut_end"]


def test_other_files_in_the_folder_are_left_alone(tmp_path):
    write(small_log(), tmp_path / "log")
    (tmp_path / "log" / "notes.txt").write_text("night shift")
    (tmp_path / "log" / "left").mkdir()
    (tmp_path / "log" / "left" / "0.csv").write_text("not a table")
    (tmp_path / "log" / ".~lock.imu.csv#").write_text("")
    assert read(tmp_path / "log").name == "small"


def test_reading_works_from_inside_the_folder(tmp_path, monkeypatch):
    write(small_log(), tmp_path / "log")
    monkeypatch.chdir(tmp_path / "log")
    assert read(".").name == "small"
    (tmp_path / "log" / "imu.parquet").write_bytes(b"nothing")
    with pytest.raises(LogError, match=r"^log/imu.parquet: unreadable as parquet"):
        read(".")


@pytest.mark.parametrize(
    ("prepare", "pattern"),
    [
        (lambda p: None, "no such folder; check the path"),
        (lambda p: p.write_text("x"), r"a file, expected a log folder; pass a folder with log.toml"),
        (lambda p: p.mkdir(), r'no log.toml in the folder.*add log.toml with format = "graphnav-log/1"'),
        (lambda p: (p.mkdir(), (p / "Log.toml").write_text("")), "rename Log.toml to log.toml"),
        (lambda p: (p.mkdir(), (p / "config.toml").write_text("")), "add log.toml with format"),
        (lambda p: (p.mkdir(), (p / "trajectory.parquet").write_text("")), "results of a run.*pass the log that"),
    ],
)
def test_a_path_that_is_no_log(tmp_path, prepare, pattern):
    prepare(tmp_path / "place")
    with pytest.raises(LogError, match=pattern) as caught:
        read(tmp_path / "place")
    assert str(tmp_path / "place") in str(caught.value)


def test_passing_log_toml_itself_says_what_to_pass(tmp_path):
    write(small_log(), tmp_path / "log")
    with pytest.raises(LogError, match=f"pass the log folder {tmp_path / 'log'}"):
        read(tmp_path / "log" / "log.toml")


def test_writing_replaces_a_log_whole(tmp_path):
    write(every_sensor_log(), tmp_path / "log", tables="csv")
    write(small_log(), tmp_path / "log")
    assert {p.name for p in (tmp_path / "log").iterdir()} == {"log.toml", "imu.parquet", "odometer.parquet"}
    assert [p.name for p in tmp_path.iterdir()] == ["log"]


def test_writing_refuses_a_folder_with_anything_else(tmp_path):
    write(small_log(), tmp_path / "log")
    (tmp_path / "log" / "left").mkdir()
    with pytest.raises(LogError, match=r"holds left, which is no part of a log; choose another folder"):
        write(small_log(), tmp_path / "log")
    assert (tmp_path / "log" / "left").is_dir()
    write(small_log(), tmp_path / "log", overwrite=True)
    assert not (tmp_path / "log" / "left").exists()


def test_writing_into_an_empty_folder_and_below_missing_ones(tmp_path):
    (tmp_path / "empty").mkdir()
    write(small_log(), tmp_path / "empty")
    write(small_log(), tmp_path / "a" / "b" / "log")
    assert read(tmp_path / "a" / "b" / "log").name == read(tmp_path / "empty").name


def test_writing_refuses_a_file_and_a_wrong_table_type(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(LogError, match="a file, expected a folder"):
        write(small_log(), tmp_path / "file", overwrite=True)
    with pytest.raises(LogError, match="cannot be written"):
        write(small_log(), tmp_path / "file" / "log")
    with pytest.raises(LogError, match='tables="xlsx", expected "parquet" or "csv"'):
        write(small_log(), tmp_path / "log", tables="xlsx")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize("existing", [False, True])
def test_a_failure_while_writing_leaves_what_was_there(tmp_path, monkeypatch, existing):
    if existing:
        write(every_sensor_log(), tmp_path / "log")

    def fail(record, folder, ending):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(writer, "write_table", fail)
    with pytest.raises(LogError, match=r"cannot be written .No space left on device"):
        write(small_log(), tmp_path / "log")
    assert [p.name for p in tmp_path.iterdir()] == (["log"] if existing else [])
    if existing:
        assert_same(every_sensor_log(), read(tmp_path / "log"))


def test_a_failed_rename_puts_the_old_log_back(tmp_path, monkeypatch):
    write(every_sensor_log(), tmp_path / "log")
    rename = writer.Path.rename

    def fail(self, target):
        if self.name.endswith(".draft"):
            raise OSError(5, "Input/output error")
        return rename(self, target)

    monkeypatch.setattr(writer.Path, "rename", fail)
    with pytest.raises(LogError, match="Input/output error"):
        write(small_log(), tmp_path / "log")
    assert_same(every_sensor_log(), read(tmp_path / "log"))
    assert [p.name for p in tmp_path.iterdir()] == ["log"]


@pytest.mark.parametrize(
    ("missing", "pattern"),
    [
        ({"lidar": None}, r"missing section \[lidar\], needed by the table lidar_points"),
        ({"lidar_points": None, "lidar_scans": None}, r"\[lidar\]: section without its table"),
    ],
)
def test_a_log_that_could_not_be_read_is_not_written(tmp_path, missing, pattern):
    with pytest.raises(LogError, match=pattern):
        write(dataclasses.replace(every_sensor_log(), **missing), tmp_path / "log")
    assert list(tmp_path.iterdir()) == []


@given(st.lists(st.tuples(*[st.integers(0, 2)] * 3), min_size=1, max_size=9))
def test_a_detection_that_is_there_twice_is_told_in_any_order(found):
    """Of two scans: rows whose leg or range rises or falls within a scan are not looked at further."""
    rows = np.array(sorted(found, key=lambda row: row[0]))
    points = gl.LidarPoints(rows[:, 0].astype(float), rows[:, 1], 1.0 + rows[:, 2], np.zeros(len(rows)))
    twice = [k for k in range(len(rows)) if (rows[:k] == rows[k]).all(axis=1).any()]
    if twice:
        with pytest.raises(LogError, match="is there twice") as told:
            folder._refuse_repeats(points, "lidar_points")
        assert told.value.row == twice[0]
    else:
        folder._refuse_repeats(points, "lidar_points")
