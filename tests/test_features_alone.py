"""Tracked features as points of the graph: without any other sensor, and where they are too few for a motion."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import stereo_logs
import stereo_scene as scene
from scipy.stats import chi2

import graphnav as gn
from factors import so3, stereo
from graphnav.frontends.motion_chain import camera_mounting
from graphnav.log import InitialState, SensorLog, StereoTracks
from graphnav.run import Run

SEED, SEEDS = 71, range(6)
#: Two-sided band of a sum of squared errors in sigmas: false alarms are one in a thousand.
ALARM = 1e-3


@cache
def roadway(seed: int, too_large_px: float = 0.0) -> SensorLog:
    """3 m of roadway, 10 frames a second, from a pose known to 1 mm; all disparities too large by so much."""
    rng = np.random.default_rng([SEED, seed])
    driven = scene.drive(np.arange(0.0, 3.0, 0.1))
    tracks = scene.tracked(rng, driven, scene.roadway(rng, 600, 30.0))
    log = scene.stereo_log(tracks.replace(u_right_px=tracks.u_right_px - too_large_px))
    rotation_nb = driven.rotation @ camera_mounting(log.stereo)[0].T
    truth = gn.log.Truth(t_s=driven.t_s, pos_n_m=driven.pos, quat_nb=so3.to_quaternion(rotation_nb))
    start = InitialState(
        pos_n_m=truth.pos_n_m[0], pos_sigma_m=[1e-3] * 3, quat_nb_wxyz=truth.quat_nb[0], att_sigma_deg=[1e-2] * 3,
        vel_n_m_s=[0.0] * 3, vel_sigma_m_s=[1.0] * 3,
    )  # fmt: skip
    section = log.stereo.replace(disparity_sigma_px=0.5) if too_large_px else log.stereo
    return dataclasses.replace(log, initial=start, truth=truth, stereo=section)


def smoothed(log: SensorLog) -> Run:
    return gn.smooth(dataclasses.replace(log, truth=None))


def test_features_alone_are_consistent() -> None:
    """Neither an IMU nor relative poses: the position at the end is as far off as its covariance says."""
    squares = []
    for seed in SEEDS:
        log = roadway(seed)
        run = smoothed(log)
        error = run.trajectory.pos_n[-1] - log.truth.pos_n_m[-1]
        squares.append(error @ np.linalg.solve(run.trajectory.cov[-1, 3:6, 3:6], error))
    low, high = chi2.ppf([ALARM / 2, 1 - ALARM / 2], 3 * len(squares))
    assert low < np.sum(squares) < high


def test_what_disparities_are_too_large_by_is_estimated_and_told() -> None:
    """0.4 px, within three of its sigmas (a false alarm in 370); a mounting declared exact is no calibration."""
    found = smoothed(roadway(0, too_large_px=0.4)).calibration
    assert list(found) == ["camera_disparity"]
    assert found["camera_disparity"].sigma < 0.2
    assert abs(found["camera_disparity"].value - 0.4) < 3 * found["camera_disparity"].sigma
    assert smoothed(roadway(0)).calibration == {}


def few_points(count: int) -> SensorLog:
    """An IMU's log with a frame every half second in which some points ahead are seen, without relative poses."""
    log = dataclasses.replace(stereo_logs.driving(0, seconds=40.0, rest_s=10.0), relative_pose=None)
    section = roadway(0).stereo
    rotation_bc, pos_b = camera_mounting(section)
    points = np.random.default_rng(SEED).uniform([-2, 6, -1], [2, 9, 1], (count, 3))
    rows = np.arange(500, len(log.truth.t_s), 50)
    rotation, pos = so3.from_quaternion(log.truth.quat_nb[rows]), log.truth.pos_n_m[rows]
    in_b = np.einsum("kji,kpj->kpi", rotation, points[None] - pos[:, None])
    pixels = stereo.project(scene.CAMERA, ((in_b - pos_b) @ rotation_bc).reshape(-1, 3))
    tracks = StereoTracks(
        t_s=np.repeat(log.truth.t_s[rows], count),
        track=np.tile(np.arange(count), len(rows)),
        u_left_px=pixels[:, 0], u_right_px=pixels[:, 1], v_px=pixels[:, 2],
    )  # fmt: skip
    return dataclasses.replace(log, stereo=section, stereo_tracks=tracks)


def test_features_too_few_for_a_motion_still_count() -> None:
    """Six points hold position and attitude that an IMU alone loses; each frame has its keyframe."""
    log = few_points(6)
    with_, without = smoothed(log), smoothed(dataclasses.replace(log, stereo_tracks=None))
    apart = np.abs(with_.trajectory.t_s[:, None] - log.stereo_tracks.t_s[None]).min(axis=0)
    assert apart.max() < 1.5e-3
    sigma = [np.sqrt(np.trace(run.trajectory.cov[-1, 3:6, 3:6])) for run in (with_, without)]
    assert sigma[0] < 0.5 * sigma[1]
    assert any("its features are points of the graph" in line for line in with_.diagnostics.warnings)


def test_features_seen_once_are_as_none() -> None:
    """They put keyframes where frames are, and tell nothing."""
    log = few_points(6)
    once = log.stereo_tracks.replace(track=np.arange(len(log.stereo_tracks)))
    runs = [smoothed(dataclasses.replace(log, stereo_tracks=tracks)) for tracks in (once, None)]
    assert runs[0].diagnostics.rejected == {}
    sigma = [np.sqrt(np.trace(run.trajectory.cov[-1, 3:6, 3:6])) for run in runs]
    assert abs(sigma[0] / sigma[1] - 1) < 0.05
