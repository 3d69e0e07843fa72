"""Broken tables: what is done to a valid log (csv tables), and what the error must hold."""

from __future__ import annotations

import pyarrow as pa
from log_changes import IMU_HEAD, ODOMETER, cell, header, parquet, text

COLUMNS = {
    "no unit": (
        header("odometer", "speed_m_s", "speed"),
        [
            f'{ODOMETER}: unknown column "speed"',
            'did you mean "speed_m_s" (the unit',
            "the unit is part of the name",
        ],
    ),
    "no unit in parquet": (
        parquet("odometer", t_s=[0.0], speed=[0.0]),
        ['shift_042/odometer.parquet: unknown column "speed"', 'did you mean "speed_m_s" (the unit'],
    ),
    "no unit in time": (
        header("odometer", "t_s", "t"),
        ['unknown column "t"', 'did you mean "t_s" (the unit'],
    ),
    "other unit": (
        header("imu", "gyro_y_rad_s", "gyro_y_deg_s"),
        ['unknown column "gyro_y_deg_s"', '"gyro_y_rad_s"?'],
    ),
    "extra column": (
        text("odometer.csv", "t_s,speed_m_s,abc\n0,0,0\n"),
        ['unknown column "abc"', "expected one of: t_s,"],
    ),
    "space in name": (
        text("odometer.csv", "t_s, speed_m_s\n0,0\n"),
        ['unknown column " speed_m_s"', '"speed_m_s"?'],
    ),
    "missing column": (
        text("odometer.csv", "t_s\n0\n"),
        [f"{ODOMETER}, speed_m_s: missing column", "add speed_m_s"],
    ),
    "part of a field": (
        text("truth.csv", "t_s,x_m,y_m,z_m,qw,qx,qy,qz,vx_m_s,vy_m_s\n0,0,0,0,1,0,0,0,0,0\n"),
        ["shift_042/truth.csv, vz_m_s: missing column", "it comes with vx_m_s, vy_m_s"],
    ),
    "column twice": (
        text("odometer.csv", "t_s,speed_m_s,t_s\n0,0,0\n"),
        [f"{ODOMETER}, t_s: the column is there twice"],
    ),
    "semicolons": (
        text("odometer.csv", "t_s;speed_m_s\n0;0\n"),
        ["t_s;speed_m_s", "separate the columns by commas"],
    ),
    "empty table": (
        text("odometer.csv", "t_s,speed_m_s\n"),
        [f"{ODOMETER}: no rows", "remove the empty table"],
    ),
    "empty parquet": (
        parquet("odometer", t_s=pa.array([], pa.float64()), speed_m_s=pa.array([], pa.float64())),
        ["shift_042/odometer.parquet: no rows"],
    ),
    "one imu row": (
        text("imu.csv", IMU_HEAD + "0,0,0,0,0,0,9.8\n"),
        ["shift_042/imu.csv: 1 row, expected at least 2"],
    ),
}

VALUES = {
    "nan": (
        cell("imu", 5, "accel_y_m_s2", "nan"),
        ["shift_042/imu.csv, row 5, accel_y_m_s2: value nan, expected a finite number", "drop the row"],
    ),
    "inf": (
        cell("odometer", 2, "speed_m_s", "-inf"),
        [f"{ODOMETER}, row 2, speed_m_s: value -inf, expected a finite"],
    ),
    "nan in parquet": (
        parquet("odometer", t_s=[0.0, 1.0], speed_m_s=[0.0, float("nan")]),
        ["shift_042/odometer.parquet, row 2, speed_m_s: value nan, expected a finite number"],
    ),
    "nan in time": (cell("imu", 3, "t_s", "NaN"), ["shift_042/imu.csv, row 3, t_s: value nan"]),
    "text": (
        cell("imu", 7, "gyro_z_rad_s", "fast"),
        ['shift_042/imu.csv, row 7, gyro_z_rad_s: value "fast", expected a finite number'],
    ),
    "truth value": (
        cell("odometer", 1, "speed_m_s", "true"),
        [f'{ODOMETER}, row 1, speed_m_s: value "true", expected'],
    ),
    "decimal comma": (
        text("odometer.csv", "t_s,speed_m_s\n0,0\n1,0,5\n"),
        [f"{ODOMETER}, row 2: 3 values, expected 2"],
    ),
    "empty value": (
        cell("imu", 2, "gyro_x_rad_s", ""),
        ["imu.csv, row 2, gyro_x_rad_s: value missing, expected a fin"],
    ),
    "short row": (
        text("odometer.csv", "t_s,speed_m_s\n0,0\n1\n"),
        [f"{ODOMETER}, row 2: 1 values, expected 2"],
    ),
    "null in parquet": (
        parquet("odometer", t_s=[0.0, 1.0], speed_m_s=[0.0, None]),
        ["shift_042/odometer.parquet, row 2, speed_m_s: value missing, expected numbers"],
    ),
    "text in parquet": (
        parquet("odometer", t_s=[0.0], speed_m_s=["fast"]),
        [
            'odometer.parquet, row 1, speed_m_s: value "fast" stored as string, expected numbers',
            "convert the column",
        ],
    ),
    "truth value in parquet": (
        parquet("odometer", t_s=[0.0], speed_m_s=[True]),
        ['odometer.parquet, row 1, speed_m_s: value "True" stored as bool, expected numbers'],
    ),
    "date in parquet": (
        parquet("odometer", t_s=pa.array([0], pa.timestamp("ms")), speed_m_s=[0.0]),
        ["odometer.parquet, row 1, t_s", "stored as timestamp[ms], expected numbers"],
    ),
    "float32 time": (
        parquet("odometer", t_s=pa.array([0.0], pa.float32()), speed_m_s=[0.0]),
        ["odometer.parquet, t_s: time stored as float, expected float64 seconds"],
    ),
    "numbers for text": (
        parquet("events", t_s=[0.0], kind=[1], cycle=[1]),
        ['events.parquet, row 1, kind: value "1" stored as int64, expected text'],
    ),
    "number for lists": (
        parquet("lidar_scans", t_s=[0.0], angle_min_rad=[0.0], angle_step_rad=[0.1], ranges_m=[1.0]),
        ["lidar_scans.parquet, row 1, ranges_m", "expected lists of numbers"],
    ),
    "nan in a list": (
        parquet(
            "lidar_scans",
            t_s=[0, 1],
            angle_min_rad=[0, 0],
            angle_step_rad=[1, 1],
            ranges_m=[[1.0], [2, float("inf")]],
        ),
        ["lidar_scans.parquet, row 2, ranges_m: value inf in the list"],
    ),
    "backwards": (
        cell("imu", 9, "t_s", "0.05"),
        ["shift_042/imu.csv, row 9, t_s: time runs backwards: 0.050000 s after 0.080000 s", "sort the rows"],
    ),
    "time twice": (
        cell("imu", 9, "t_s", "0.08"),
        ["shift_042/imu.csv, row 9, t_s: time twice: 0.080000 s after 0.080000"],
    ),
    "row twice": (
        text("push.csv", "t_s,cycle,s_m,push_m\n0.1,1,0,0.4\n0.1,1,2,0.4\n0.1,1,0,0.4\n"),
        ["shift_042/push.csv, row 3, t_s: the row at 0.100000 s is there twice", "remove duplicate rows"],
    ),
    "range twice": (
        text("uwb.csv", "t_s,tag,anchor,range_m\n1,1,7,3\n2,1,7,3\n2,1,7,4\n2,1,7,3\n"),
        ["shift_042/uwb.csv, row 4, t_s: the row at 2.000000 s is there twice"],
    ),
    "fraction for a count": (
        cell("events", 2, "cycle", "1.5"),
        ["shift_042/events.csv, row 2, cycle: value 1.5, expected a whole number"],
    ),
    "fraction in parquet": (
        parquet("events", t_s=[0.0], kind=["cut_start"], cycle=[1.5]),
        ["shift_042/events.parquet, row 1, cycle: value 1.5, expected a whole number"],
    ),
    "event kind": (
        cell("events", 2, "kind", "stop"),
        ['events.csv, row 2, kind: "stop", expected "cut_start" or'],
    ),
    "zero range": (
        cell("lidar_points", 1, "range_m", "0"),
        ["lidar_points.csv, row 1, range_m: value 0.0", "above zero"],
    ),
    "angle in degrees": (
        cell("lidar_points", 2, "angle_rad", "-35.5"),
        ["lidar_points.csv, row 2, angle_rad: value -35.5, expected an angle within a turn", "in degrees?"],
    ),
    "start in degrees": (
        parquet("lidar_scans", t_s=[0.0], angle_min_rad=[-135.0], angle_step_rad=[0.25], ranges_m=[[1.0] * 1081]),
        ["lidar_scans.parquet, row 1, angle_min_rad: value -135", "in degrees?"],
    ),
    "step in degrees": (
        parquet("lidar_scans", t_s=[0.0], angle_min_rad=[-2.356], angle_step_rad=[0.25], ranges_m=[[1.0] * 1081]),
        ["lidar_scans.parquet, row 1, angle_step_rad: value 0.25, by which 1081 beams cover 270.2 rad", "in degrees?"],
    ),
    "zero sigma": (
        cell("position", 3, "sigma_y_m", "0"),
        ["position.csv, row 3, sigma_y_m: value 0.0", "above zero"],
    ),
    "quaternion": (
        cell("truth", 2, "qw", "3"),
        ["shift_042/truth.csv, row 2, qw, qx, qy, qz: quaternion of length 3"],
    ),
    "unknown tag": (
        cell("uwb", 2, "tag", '"9"'),
        ['shift_042/uwb.csv, row 2, tag: unknown tag "9"', "[[uwb.tag]]"],
    ),
    "no uncertainty": (
        text("relative_pose.csv", "t_from_s,t_to_s,x_m,y_m,z_m,qw,qx,qy,qz\n0,1,0,0,0,1,0,0,0\n"),
        ["shift_042/relative_pose.csv: no uncertainty", "sigma_m and sigma_rad"],
    ),
    "absolute image path": (
        text("stereo.csv", "t_s,left,right\n0,a.png,/data/b.png\n"),
        ['shift_042/stereo.csv, row 1, right: "/data/b.png"', "image path relative to the log folder"],
    ),
    "image outside": (
        text("stereo.csv", "t_s,left,right\n0,a.png,b.png\n1,c.png,right/../../b.png\n"),
        [
            'shift_042/stereo.csv, row 2, right: "right/../../b.png"',
            "and within it; put the images into the log folder",
        ],
    ),
    "image outside as in Windows": (
        text("stereo.csv", "t_s,left,right\n0,..\\a.png,b.png\n"),
        ['shift_042/stereo.csv, row 1, left: "..\\a.png"', "within it"],
    ),
}
