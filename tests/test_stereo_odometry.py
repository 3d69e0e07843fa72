"""Stereo odometry of tracked features: keyframes, chains of motions, gaps, and KITTI's measure of drift."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
import stereo_scene as scene
from scipy.stats import chi2

from factors import so3
from factors.relative_pose import Chain, Motions, relative
from graphnav._drift import kitti_drift
from graphnav.config import StereoMotionsConfig
from graphnav.errors import GraphnavError, LogError
from graphnav.frontends.motion_chain import camera_mounting, motion_chain
from graphnav.frontends.stereo_bundle import RotationPrior
from graphnav.frontends.stereo_odometry import StereoMotions, stereo_motions
from graphnav.log import SensorLog, StereoTracks
from graphnav.readers import kitti_tracks

SEED = 67
SETTINGS = StereoMotionsConfig()


@cache
def roadway_log(seed: int, step_m: float = 0.1, length_m: float = 6.0) -> tuple[SensorLog, scene.Drive]:
    rng = np.random.default_rng([SEED, seed])
    driven = scene.drive(np.arange(0.0, length_m, step_m))
    return scene.stereo_log(scene.tracked(rng, driven, scene.roadway(rng, 2500, 30.0))), driven


def chain_of(log: SensorLog, motions: StereoMotions) -> Motions:
    """The first frame's motion to the last, of the camera."""
    chain = motion_chain(dataclasses.replace(log, relative_pose=motions.poses))
    ends = chain.between(chain.t_s[[0, -1]])
    rotation_bc, pos_b = camera_mounting(log.stereo)
    assert not pos_b.any()
    turn = np.kron(np.eye(2), rotation_bc)
    cov = turn.T @ ends.cov[0] @ turn
    return Motions(rotation_bc.T @ ends.rotation[0] @ rotation_bc, rotation_bc.T @ ends.pos[0], cov)


def nees(log: SensorLog, driven: scene.Drive, motions: StereoMotions) -> float:
    found = chain_of(log, motions)
    at = np.searchsorted(driven.t_s, [motions.poses.t_from_s[0], motions.poses.t_to_s[-1]])
    truth = relative(driven.rotation[at[0]], driven.pos[at[0]], driven.rotation[at[1]], driven.pos[at[1]])
    error = scene.error_of(found.rotation, found.pos, *truth)
    return float(error @ np.linalg.solve(found.cov, error))


def without(tracks: StereoTracks, dropped: np.ndarray) -> StereoTracks:
    fields = ("t_s", "track", "u_left_px", "u_right_px", "v_px")
    return StereoTracks(**{name: getattr(tracks, name)[~dropped] for name in fields})


# Chains of motions ------------------------------------------------------------------------------------------


def test_motions_follow_each_other() -> None:
    log, driven = roadway_log(0)
    found = stereo_motions(log, SETTINGS)
    assert found.poses is not None and not found.failures
    assert found.poses.t_from_s[0] == driven.t_s[0] and found.poses.t_to_s[-1] == driven.t_s[-1]
    np.testing.assert_array_equal(found.poses.t_from_s[1:], found.poses.t_to_s[:-1])
    way = np.linalg.norm(found.poses.pos_m, axis=1)
    assert way.max() < 2 * SETTINGS.keyframe_m and np.median(way) > 0.3
    assert (found.inliers >= SETTINGS.min_inliers).all() and (found.inliers <= found.matched).all()


def test_chain_is_not_overconfident() -> None:
    """Ten chains of 6 m: sum of NEES below the chi-square's 1e-4 point of 60 degrees of freedom.

    Motions in a row share the noise of the keyframe between them, with opposite signs: the sum is below its
    expectation, but not by much (it stays above a quarter of it).
    """
    total = sum(nees(log, driven, stereo_motions(log, SETTINGS)) for log, driven in map(roadway_log, range(10)))
    assert 60 / 4 < total < chi2.isf(1e-4, 60)


def test_same_every_time() -> None:
    log, _ = roadway_log(0)
    first, second = (stereo_motions(log, SETTINGS).poses for _ in range(2))
    np.testing.assert_array_equal(first.pos_m, second.pos_m)


# Keyframes --------------------------------------------------------------------------------------------------


def test_one_motion_bridges_a_rest() -> None:
    rng = np.random.default_rng(SEED)
    along = np.concatenate([np.arange(0, 1, 0.1), np.full(60, 1.0), np.arange(1.0, 2.0, 0.1)])
    driven = scene.drive(along)
    log = scene.stereo_log(scene.tracked(rng, driven, scene.roadway(rng, 2500, 30.0)))
    found = stereo_motions(log, SETTINGS)
    assert found.poses is not None and not found.failures
    inside = (found.poses.t_from_s >= driven.t_s[10]) & (found.poses.t_to_s <= driven.t_s[69])
    assert inside.sum() <= 1
    assert len(found.poses) <= 8
    assert nees(log, driven, found) < chi2.isf(1e-4, 6)


def test_keyframes_do_not_choose_short_motions() -> None:
    """The mean error along the axis of some 100 motions is within 4 of its standard errors (false alarms 6e-5)."""
    errors = []
    for seed in range(10):
        log, driven = roadway_log(seed)
        poses = stereo_motions(log, SETTINGS).poses
        i, j = np.searchsorted(driven.t_s, poses.t_from_s), np.searchsorted(driven.t_s, poses.t_to_s)
        _, way = relative(driven.rotation[i], driven.pos[i], driven.rotation[j], driven.pos[j])
        errors.extend((poses.pos_m - way)[:, 2] / np.sqrt(poses.cov_upper[:, 20]))
    assert abs(np.mean(errors)) < 4 * np.std(errors) / np.sqrt(len(errors))


# Failures ---------------------------------------------------------------------------------------------------


def test_dark_frames_leave_a_gap() -> None:
    """Half a second in which nothing is tracked, and no feature found again after it."""
    log, _ = roadway_log(1)
    tracks = log.stereo_tracks
    dark = (tracks.t_s > 2.95) & (tracks.t_s < 3.45)
    renamed = np.where(tracks.t_s > 3.2, tracks.track + 10_000, tracks.track)
    found = stereo_motions(log, SETTINGS, without(tracks.replace(track=renamed), dark))
    assert len(found.failures) == 1
    failure = found.failures[0]
    assert (failure.t_from_s, failure.t_to_s) == (pytest.approx(2.9), pytest.approx(3.5))
    assert failure.reason == "0 matches, 20 are needed"
    gap = np.flatnonzero(found.poses.t_from_s[1:] > found.poses.t_to_s[:-1])
    assert len(gap) == 1
    with pytest.raises(LogError, match="gap"):
        motion_chain(dataclasses.replace(log, relative_pose=found.poses))


def test_swapped_cameras_give_no_motion() -> None:
    log, _ = roadway_log(2)
    tracks = log.stereo_tracks
    found = stereo_motions(log, SETTINGS, tracks.replace(u_left_px=tracks.u_right_px, u_right_px=tracks.u_left_px))
    assert found.poses is None and found.failures
    assert all("swapped" in failure.reason for failure in found.failures)


def test_rotation_prior_is_asked_for_the_motion() -> None:
    """The truth passes the gate, and a rotation of 3 deg too much does not."""
    log, driven = roadway_log(3)

    def known(extra_rad: float):
        def between(t_from_s: float, t_to_s: float) -> RotationPrior:
            i, j = np.searchsorted(driven.t_s, [t_from_s - 1e-6, t_to_s - 1e-6])
            turn = driven.rotation[i].T @ driven.rotation[j] @ so3.exp(np.array([0.0, extra_rad, 0.0]))
            return RotationPrior(turn, np.eye(3) * 1e-8)

        return between

    assert not stereo_motions(log, SETTINGS, rotation_prior=known(0.0)).failures
    refused = stereo_motions(log, SETTINGS, rotation_prior=known(np.deg2rad(3.0)))
    assert refused.failures and "sigmas from that of the IMU" in refused.failures[0].reason


def test_a_feature_twice_in_a_frame_is_named() -> None:
    log, _ = roadway_log(0)
    track = np.array(log.stereo_tracks.track)
    track[1] = track[0]
    with pytest.raises(LogError, match=r"table stereo_tracks, row 2, track: .* is there twice"):
        stereo_motions(log, SETTINGS, log.stereo_tracks.replace(track=track))


def test_what_is_missing_is_named() -> None:
    log, _ = roadway_log(0)
    with pytest.raises(LogError, match="no section"):
        stereo_motions(dataclasses.replace(log, stereo=None), SETTINGS)


# Drift ------------------------------------------------------------------------------------------------------


def straight(count: int, step_m: float, turn_rad: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    motions = Motions(
        np.broadcast_to(so3.exp(np.array([0.0, turn_rad, 0.0])), (count, 3, 3)),
        np.tile([0.0, 0.0, step_m], (count, 1)),
        np.zeros((count, 6, 6)),
    )
    chain = Chain.of(np.arange(count + 1.0), motions)
    return chain.rotation, chain.pos


def test_drift_of_a_wrong_scale_and_of_a_constant_turn() -> None:
    truth = straight(100, 0.5)
    scaled = kitti_drift(straight(100, 0.505), truth, (10.0, 20.0))
    assert scaled.translation_percent == pytest.approx(1.0)
    assert scaled.rotation_deg_m == pytest.approx(0.0, abs=1e-9)
    assert scaled.segments == 81 + 61
    turned = kitti_drift(straight(100, 0.5, 1e-3), truth, (10.0, 20.0))
    assert turned.rotation_deg_m == pytest.approx(np.rad2deg(1e-3) / 0.5)


def test_drift_does_not_depend_on_the_frames() -> None:
    rotation, pos = straight(60, 0.5, 0.01)
    turn = so3.exp(np.array([0.3, -1.0, 0.5]))
    drift = kitti_drift((turn @ rotation, pos @ turn.T + 5.0), (rotation, pos), (10.0,))
    assert drift.translation_percent < 1e-9 and drift.rotation_deg_m < 1e-6


def test_drift_of_too_short_a_path() -> None:
    with pytest.raises(GraphnavError, match=r"5\.0 m long"):
        kitti_drift(straight(10, 0.5), straight(10, 0.5), (100.0,))


# Tracks of a real drive -------------------------------------------------------------------------------------


def kitti_chain(settings: StereoMotionsConfig) -> tuple[StereoMotions, tuple[np.ndarray, ...], np.ndarray]:
    """Motions, the chain's poses, and where they are among the file's poses."""
    found = stereo_motions(kitti_tracks.convert(), settings)
    poses = found.poses
    cov = np.zeros((len(poses), 6, 6))
    chain = Chain.of(
        np.append(poses.t_from_s, poses.t_to_s[-1]), Motions(so3.from_quaternion(poses.quat), poses.pos_m, cov)
    )
    at = np.searchsorted(kitti_tracks.estimated_poses()[0], chain.t_s - 1e-6)
    return found, (chain.rotation, chain.pos), at


def test_poses_of_the_drive_are_a_visual_odometry_of_its_features() -> None:
    """Pair to pair they agree with the features far better than the features' noise allows an independent reference."""
    found, chain, at = kitti_chain(SETTINGS)
    assert not found.failures and len(found.poses) == 134
    _, rotation, pos = kitti_tracks.estimated_poses()
    _, way = relative(rotation[at[:-1]], pos[at[:-1]], rotation[at[1:]], pos[at[1:]])
    sigma = np.sqrt(found.poses.cov_upper[:, [15, 18, 20]])
    assert np.sqrt(np.mean(((found.poses.pos_m - way) / sigma) ** 2)) < 0.6
    agreement = kitti_drift(chain, (rotation[at], pos[at]), (10.0, 20.0, 30.0, 40.0, 50.0))
    assert agreement.translation_percent < 0.1


def test_longer_motions_of_the_drive_agree() -> None:
    """Every other pair, not those that the file's poses were made of."""
    found, chain, at = kitti_chain(StereoMotionsConfig(shared=0.5, keyframe_m=5.0))
    assert not found.failures and len(found.poses) < 100
    _, rotation, pos = kitti_tracks.estimated_poses()
    agreement = kitti_drift(chain, (rotation[at], pos[at]), (10.0, 20.0, 30.0, 40.0, 50.0))
    assert agreement.translation_percent < 0.5 and agreement.rotation_deg_m < 0.01


def test_the_drive_has_no_truth() -> None:
    log = kitti_tracks.convert()
    assert log.truth is None and len(log.stereo_tracks) == 88_781
    with pytest.raises(LogError, match="no such file"):
        kitti_tracks.convert("nowhere")
