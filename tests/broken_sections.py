"""Broken log.toml and wrong sets of files: what is done to a valid log, and what the error must hold."""

from __future__ import annotations

from log_changes import ODOMETER, parquet, remove, rename, text, toml

HEADER = {
    "no format": (
        toml('format = "graphnav-log/1"\n', ""),
        ["shift_042/log.toml, format: missing", "graphnav-log/1"],
    ),
    "other format": (
        toml("graphnav-log/1", "graphnav-log/2"),
        ['format: "graphnav-log/2"', '"graphnav-log/1"'],
    ),
    "syntax": (toml("[imu]", "[imu"), ["shift_042/log.toml: TOML syntax error", "line "]),
    "not utf-8": (lambda f: (f / "log.toml").write_bytes(b"\xff\xfe\x00"), ["log.toml: not UTF-8"]),
    "key twice": (toml("[imu]\n", "[imu]\naccel_bias_mg = 3.0\n"), ["TOML syntax error", "line "]),
    "unknown section": (
        toml("[odometer]", "[odometre]"),
        ['unknown section "odometre"', 'did you mean "odometer"?'],
    ),
    "unknown top key": (toml("epoch", "epoche"), ['unknown key "epoche"', 'did you mean "epoch"?']),
    "no name": (
        lambda f: text("log.toml", 'format = "graphnav-log/1"\n')(f),
        ["log.toml, name: missing key", "add name"],
    ),
    "name no text": (
        lambda f: toml("name = ", "name = 1 #")(f),
        ["log.toml, name: 1, expected text", "quotes"],
    ),
    "epoch no time": (toml("2026-03-01T06:00:00Z", "today"), ['epoch: "today", expected an ISO 8601 time']),
    "epoch unquoted": (toml('"2026-03-01T06:00:00Z"', "2026-03-01T06:00:00Z"), ["epoch", "put it in quotes"]),
    "section as list": (
        toml("[imu]", "[[imu]]"),
        ['"imu" is no [imu] section', "write its keys under [imu]"],
    ),
}

KEYS = {
    "unknown key": (
        toml("sigma_m_s = 0.01\nslip", "sigma = 0.01\nslip"),
        [
            "shift_042/log.toml [odometer]",
            'unknown key "sigma"',
            'did you mean "sigma_m_s" (the unit',
            "unit",
        ],
    ),
    "far-off key": (
        toml("scale_sigma", "xyz"),
        ['unknown key "xyz"', "expected one of: sigma_m_s, slip_sigma_m_s"],
    ),
    "key of the configuration": (
        toml("scale_sigma", 'form = "velocity"\nscale_sigma'),
        ['unknown key "form"', "odometer.form is a choice of method: give it in the configuration (--config FILE)"],
    ),
    "missing key": (
        toml("gyro_bias_deg_h = 720.0\n", ""),
        ["shift_042/log.toml [imu], gyro_bias_deg_h: missing key", "add gyro_bias_deg_h"],
    ),
    "zero sigma": (
        toml("sigma_m_s = 0.01", "sigma_m_s = 0.0"),
        ["shift_042/log.toml [odometer], sigma_m_s: 0.0, expected a value above zero", "1-sigma"],
    ),
    "zero in sigmas": (
        toml("pos_sigma_m = [0.05, 0.05", "pos_sigma_m = [0.05, 0"),
        ["log.toml [initial], pos_sigma_m", "above zero"],
    ),
    "negative": (
        toml("accel_bias_mg = 3.0", "accel_bias_mg = -3.0"),
        ["[imu], accel_bias_mg: -3.0", "above zero"],
    ),
    "text for a number": (
        toml("accel_bias_mg = 3.0", 'accel_bias_mg = "3.0"'),
        ['[imu], accel_bias_mg: "3.0", expected a number'],
    ),
    "truth value for a number": (
        toml("accel_bias_mg = 3.0", "accel_bias_mg = true"),
        ["true, expected a number"],
    ),
    "truth value in an array": (
        toml("att_sigma_deg = [0.3", "att_sigma_deg = [true"),
        ["[initial], att_sigma_deg", "expected an array of 3 numbers"],
    ),
    "short array": (
        toml("vel_n_m_s = [0.0, ", "vel_n_m_s = ["),
        ["vel_n_m_s: [0.0, 0.0], expected an array of 3"],
    ),
    "number for an array": (
        toml("mounting_sigma_deg = [3.0, 0.5, 3.0]", "mounting_sigma_deg = 3"),
        ["3, expected an"],
    ),
    "ragged matrix": (
        toml("[imu]\n", "[imu]\ngyro_matrix = [[1,0,0],[0,1,0],[0,0]]\n"),
        ["[imu], gyro_matrix", "3 x 3 numbers"],
    ),
    "nan": (toml("push_m = 0.4", "push_m = nan"), ["[face], push_m: nan, expected finite numbers"]),
    "inf offset": (
        toml("time_offset_s = 0.0", "time_offset_s = inf"),
        ["[lidar], time_offset_s: inf, expected finite"],
    ),
    "huge": (toml("push_m = 0.4", "push_m = 1" + "0" * 400), ["[face], push_m", "finite"]),
    "latitude": (
        toml("latitude_deg = 35.0", "latitude_deg = 135.0"),
        ["[frames], latitude_deg: 135.0, expected -90"],
    ),
    "attitude": (
        toml("quat_nb_wxyz = [", "quat_nb_wxyz = [2, 0, 0, 0] # "),
        ["[initial], quat_nb_wxyz", "length 2"],
    ),
    "camera attitude": (
        toml("T_bc_quat_wxyz = [", "T_bc_quat_wxyz = [2, 0, 0, 0] # "),
        ["shift_042/log.toml [stereo], T_bc_quat_wxyz: quaternion of length 2"],
    ),
    "number for text": (
        toml('id = "1"', "id = 1"),
        ["log.toml [[uwb.tag]] 1, id: 1, expected text", "quotes"],
    ),
    "anchor key": (
        toml("sigma_m = 0.005", "sigma = 0.005"),
        ["[[uwb.anchor]] 1", 'did you mean "sigma_m" (the unit'],
    ),
    "anchor sigma": (
        toml("sigma_m = 0.005", "sigma_m = 0.0"),
        ["[[uwb.anchor]] 1, sigma_m: 0.0", "above zero"],
    ),
    "tags no list": (toml("[[uwb.tag]]", "[uwb.tag]"), ['[uwb]: "tag" is no list', "write [[uwb.tag]]"]),
    "surveyed end": (toml('end = "far"', 'end = "left"'), ['[[surveyed]] 1, end: "left"', '"far" or "near"']),
    "surveyed nothing": (toml("t_s = 0.15\n", ""), ["log.toml [[surveyed]] 2", "expected either t_s or end"]),
    "surveyed key": (toml('end = "far"', 'ende = "far"'), ["[[surveyed]] 1", 'did you mean "end"?']),
}

FILES = {
    "two endings": (
        lambda f: parquet("odometer", t_s=[0.0], speed_m_s=[0.0])(f) or text("odometer.csv", "t_s,speed_m_s\n0,0\n")(f),
        ["shift_042/odometer.parquet: the table is there twice, also as odometer.csv", "remove one"],
    ),
    "unknown table": (
        rename("odometer.csv", "odo.csv"),
        ['shift_042/odo.csv: unknown table "odo"', 'did you mean "odometer"?', "move the file away"],
    ),
    "misspelt table": (
        rename("odometer.csv", "odometr.csv"),
        ['unknown table "odometr"', 'did you mean "odometer"?'],
    ),
    "upper case": (rename("imu.csv", "IMU.csv"), ['shift_042/IMU.csv: unknown table "IMU"']),
    "unknown ending": (
        rename("imu.csv", "imu.txt"),
        ['shift_042/imu.txt: unknown file ending ".txt"', "imu.parquet or imu.csv"],
    ),
    "compressed": (rename("imu.csv", "imu.csv.gz"), ['shift_042/imu.csv.gz: unknown file ending ".csv.gz"']),
    "upper-case ending": (rename("imu.csv", "imu.CSV"), ['unknown file ending ".CSV"']),
    "list table as csv": (
        lambda f: (
            remove("lidar_scans.parquet")(f)
            or text("lidar_scans.csv", "t_s,angle_min_rad,angle_step_rad,ranges_m\n0,0,0,1\n")(f)
        ),
        ["shift_042/lidar_scans.csv", "save it as lidar_scans.parquet"],
    ),
    "section without table": (
        remove("odometer.csv"),
        ["shift_042/log.toml [odometer]: section without its table", "odometer.parquet or .csv"],
    ),
    "lidar without tables": (
        lambda f: remove("lidar_points.csv")(f) or remove("lidar_scans.parquet")(f),
        ["log.toml [lidar]: section without its table", "lidar_points.parquet or .csv or lidar_scans"],
    ),
    "damaged parquet": (
        lambda f: remove("imu.csv")(f) or text("imu.parquet", "PAR1 nonsense")(f),
        ["shift_042/imu.parquet: unreadable as parquet"],
    ),
    "cut-off parquet": (
        lambda f: (f / "lidar_scans.parquet").write_bytes((f / "lidar_scans.parquet").read_bytes()[:-20]),
        ["shift_042/lidar_scans.parquet: unreadable as parquet"],
    ),
    "empty csv": (text("imu.csv", ""), ["shift_042/imu.csv: empty file, expected a header row"]),
    "csv no utf-8": (
        lambda f: (f / "odometer.csv").write_bytes(b"t_s,speed_m_s\n0,\xff\n"),
        [f"{ODOMETER}: unreadable as csv", "UTF-8"],
    ),
}
