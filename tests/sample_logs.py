"""Small logs for tests of reading, writing and inspecting, made up rather than recorded or simulated."""

from __future__ import annotations

from typing import Any

import numpy as np

from graphnav import log as gl

GRAVITY = 9.80665


def imu_params() -> dict[str, float]:
    return {
        "gyro_bias_deg_h": 720.0,
        "gyro_random_walk_deg_sqrt_h": 0.6,
        "accel_bias_mg": 3.0,
        "accel_random_walk_mg_sqrt_hz": 0.08,
    }


def odometer_params() -> dict[str, Any]:
    return {
        "sigma_m_s": 0.01,
        "slip_sigma_m_s": 0.01,
        "scale_sigma": 0.05,
        "mounting_sigma_deg": [3.0, 0.5, 3.0],
    }


def quaternions(rng: np.random.Generator, n: int) -> np.ndarray:
    quat = rng.normal(size=(n, 4))
    return quat / np.linalg.norm(quat, axis=1, keepdims=True)


def initial(**changes: Any) -> gl.InitialState:
    values: dict[str, Any] = {
        "pos_n_m": [0.0, 0.0, 0.0],
        "pos_sigma_m": [0.05, 0.05, 0.05],
        "quat_nb_wxyz": [1.0, 0.0, 0.0, 0.0],
        "att_sigma_deg": [0.3, 0.3, 1.0],
        "vel_n_m_s": [0.0, 0.0, 0.0],
        "vel_sigma_m_s": [0.01, 0.01, 0.01],
    }
    return gl.InitialState(**(values | changes))


def small_log(rows: int = 20) -> gl.SensorLog:
    """IMU and odometer only."""
    rng = np.random.default_rng(5)
    imu = gl.Imu(
        t_s=np.arange(1, rows + 1) / 100,
        gyro_b_rad_s=rng.normal(0, 1e-3, (rows, 3)),
        accel_b_m_s2=rng.normal([0, 0, GRAVITY], 1e-2, (rows, 3)),
        **imu_params(),
    )
    odometer = gl.Odometer(t_s=imu.t_s[::10], speed_m_s=rng.normal(0, 0.01, (rows + 9) // 10), **odometer_params())
    return gl.SensorLog(name="small", frames=gl.Frames(35.0), initial=initial(), imu=imu, odometer=odometer)


def every_sensor_log() -> gl.SensorLog:
    """Every section and table of the format, with awkward but valid values."""
    rng = np.random.default_rng(6)
    small, t = small_log(), np.array([0.1, 0.2, 1 / 3])
    tags = (gl.UwbTag(id="1"),)
    places: Any = {"pos_n_m": [1, 2, 3], "sigma_m": 0.005}
    anchors = (gl.UwbAnchor(id='a "b" \\ é', **places), gl.UwbAnchor(id="7", group="carrier", **places))
    return gl.SensorLog(
        name='shift "42", Förderer\t1',
        epoch="2026-03-01T06:00:00Z",
        frames=gl.Frames(35.0, 116.8, 12.5, 9.7973),
        initial=initial(quat_nb_wxyz=quaternions(rng, 1)[0], static_until_s=0.1),
        imu=small.imu,
        odometer=small.odometer,
        face=gl.Face(length_m=44.6, push_m=0.4),
        surveyed=(
            gl.SurveyedPoint(pos_n_m=[-13.04, 42.65, 1e-17], sigma_m=0.02, end="far"),
            gl.SurveyedPoint(pos_n_m=[0.1, 0.2, 0.3], sigma_m=0.02, t_s=0.15),
        ),
        events=gl.Events(t_s=[0.05, 0.1], kind=["cut_start", "cut_end"], cycle=[1, 1]),
        push=gl.Push(t_s=[0.1, 0.1], cycle=[1, 1], s_m=[0.0, 2.0], push_m=[0.4, 1 / 3]),
        position=gl.Position(t_s=t, pos_n_m=rng.normal(size=(3, 3)), sigma_n_m=np.full((3, 3), 0.07)),
        lidar=gl.Lidar(range_sigma_m=0.01, angle_sigma_deg=0.05, mounting_sigma_deg=[0.01, 0.01, 0.5]),
        lidar_points=gl.LidarPoints(t_s=[0.1, 0.1], feature=[7, 2**40], range_m=[4.0, 5.0], angle_rad=[0.1, -0.1]),
        lidar_scans=gl.LidarScans(
            t_s=[0.1, 0.2],
            angle_min_rad=[-1.0, -1.0],
            angle_step_rad=[0.1, 0.1],
            ranges_m=[[1.0, 0.1 + 0.2], [3.0]],
        ),
        uwb=gl.Uwb(
            t_s=[0.1, 0.1, 0.2],
            tag_id=["1", "1", "1"],
            anchor_id=[anchors[0].id] * 3,
            range_m=[3.1, 3.2, 1e-3],
            rssi_db=[-80.5, -81.0, -79.0],
            bias_sigma_m=0.1,
            group_sigma_m=0.03,
            tag=tags,
            anchor=anchors,
        ),
        stereo=gl.Stereo(fx_px=212.0, fy_px=212.0, cx_px=212.0, cy_px=120.0, baseline_m=0.095),
        stereo_pairs=gl.StereoPairs(
            t_s=t, left=["left/0.png", "left/1.png", "left/2,b.png"], right=["r0.png", "r1.png", "r2.png"]
        ),
        stereo_tracks=gl.StereoTracks(
            t_s=[0.1, 0.1, 0.2],
            track=[7, 8, 7],
            u_left_px=rng.normal(size=3),
            u_right_px=rng.normal(size=3),
            v_px=rng.normal(size=3),
        ),
        relative_pose=gl.RelativePose(
            t_from_s=[0.1, 0.1],
            t_to_s=[0.2, 0.3],
            pos_m=rng.normal(size=(2, 3)),
            quat=quaternions(rng, 2),
            cov_upper=rng.normal(size=(2, 21)) * 1e-300,
        ),
        truth=gl.Truth(t_s=t, pos_n_m=rng.normal(size=(3, 3)), quat_nb=quaternions(rng, 3), vel_n_m_s=np.zeros((3, 3))),
    )
