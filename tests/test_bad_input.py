"""Broken logs: each rule of the format is enforced in one line naming file, row, column, value and fix."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from broken_sections import FILES, HEADER, KEYS
from broken_tables import COLUMNS, VALUES
from log_changes import IMU_HEAD
from sample_logs import every_sensor_log

from graphnav.errors import LogError
from graphnav.readers import read, write


@pytest.fixture(scope="module")
def valid(tmp_path_factory):
    folder = tmp_path_factory.mktemp("valid") / "shift_042"
    write(every_sensor_log(), folder, tables="csv")
    return folder


def copied(folder: Path, place: Path) -> Path:
    copy = place / folder.name
    shutil.copytree(folder, copy)
    return copy


@pytest.mark.parametrize(
    ("change", "fragments"),
    [pytest.param(*case, id=name) for group in (HEADER, KEYS, FILES, COLUMNS, VALUES) for name, case in group.items()],
)
def test_a_broken_log_is_refused(valid, tmp_path, change, fragments):
    folder = copied(valid, tmp_path)
    read(folder)
    change(folder)
    with pytest.raises(LogError) as caught:
        read(folder)
    message = str(caught.value)
    assert "\n" not in message
    assert all(fragment in message for fragment in fragments), message


def minimal(folder: Path, sections: str, **files: str) -> Path:
    folder.mkdir()
    (folder / "log.toml").write_text(f'format = "graphnav-log/1"\nname = "a"\n{sections}')
    for name, content in files.items():
        (folder / f"{name}.csv").write_text(content)
    return folder


FRAMES = "[frames]\nlatitude_deg = 35\n"
POSITION = "t_s,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m\n0,0,0,0,1,1,1\n"
IMU = IMU_HEAD + "0,0,0,0,0,0,9.8\n1,0,0,0,0,0,9.8\n"


def test_the_least_log_there_is(tmp_path):
    log = read(minimal(tmp_path / "log", FRAMES, position=POSITION))
    assert (log.name, log.epoch, log.initial, len(log.position)) == ("a", None, None, 1)


@pytest.mark.parametrize(
    ("sections", "files", "fragments"),
    [
        ("", {"position": POSITION}, ["log/log.toml: missing section [frames]", "latitude_deg"]),
        ("[frames]\n", {"position": POSITION}, ["log/log.toml [frames], latitude_deg: missing key"]),
        ("frames = 3\n", {"position": POSITION}, ['"frames" is no [frames] section']),
        ("[surveyed]\n" + FRAMES, {"position": POSITION}, ["is no [[surveyed]] section", "[[surveyed]]"]),
        (FRAMES, {}, ["log: no motion sensor", "add at least one of the tables"]),
        (
            FRAMES,
            {"imu": IMU},
            [
                "missing section [imu], needed by the table imu",
                "gyro_bias_deg_h, gyro_random_walk_deg_sqrt_h",
            ],
        ),
        (FRAMES + "[imu]\n", {"imu": IMU}, ["log.toml [imu], gyro_bias_deg_h: missing key"]),
        (
            FRAMES,
            {"lidar_points": "t_s,feature,range_m,angle_rad\n0,1,1,0\n"},
            ["missing section [lidar], needed by the table lidar_points", "range_sigma_m, angle_sigma_deg"],
        ),
        (
            FRAMES,
            {"uwb": "t_s,tag,anchor,range_m\n0,1,1,1\n"},
            ["missing section [uwb]", "add [uwb] with tag, anchor"],
        ),
        (
            FRAMES + "[uwb]\n",
            {"uwb": "t_s,tag,anchor,range_m\n0,1,1,1\n"},
            ["log/uwb.csv, row 1, tag", 'unknown tag "1"'],
        ),
    ],
)
def test_a_log_that_lacks_a_part(tmp_path, sections, files, fragments):
    with pytest.raises(LogError) as caught:
        read(minimal(tmp_path / "log", sections, **files))
    assert all(fragment in str(caught.value) for fragment in fragments), str(caught.value)


@pytest.mark.parametrize("name", ["log.toml", "odometer.csv", "uwb.csv", "lidar_scans.parquet"])
def test_damage_is_refused_or_harmless(valid, tmp_path, name):
    """Bytes changed, dropped and repeated at random: a `LogError` or a log, never another exception."""
    rng = np.random.default_rng(8)
    folder = copied(valid, tmp_path)
    sound, refused = (valid / name).read_bytes(), 0
    for _ in range(150):
        damaged = bytearray(sound)
        start, length = int(rng.integers(len(sound))), int(rng.integers(1, 8))
        new = [b"", bytes(rng.integers(256, size=length).tolist()), sound[start : start + length] * 2]
        damaged[start : start + length] = new[rng.integers(3)]
        (folder / name).write_bytes(damaged)
        try:
            read(folder)
        except LogError as error:
            assert "\n" not in str(error)
            refused += 1
    assert refused > 20
