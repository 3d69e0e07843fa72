"""Tracked features beside an IMU: consistency, both forms, gaps, wrong features, the camera's own errors."""

from __future__ import annotations

import dataclasses
import re
from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2

import graphnav as gn
from factors import so3
from graphnav.errors import LogError
from graphnav.log import SensorLog, StereoTracks
from graphnav.run import Run

END_S = 110.0
ALARM = 1e-3


@cache
def log_of(seed: int, outlier_share: float = 0.0) -> SensorLog:
    """A minute at rest and 50 s under way: the first of the roadheader scenario, features drawn without images."""
    log = gn.simulate("roadheader-stereo", seed=seed, images=False, tracks=True, rate_hz=2, outlier_share=outlier_share)
    imu, truth = (rows(record, record.t_s <= END_S + 1e-6) for record in (log.imu, log.truth))
    return dataclasses.replace(log, imu=imu, truth=truth, stereo_tracks=kept(log, log.stereo_tracks.t_s <= END_S))


def rows(record: object, keep: np.ndarray) -> object:
    columns = [f.name for f in record.column_fields() if getattr(record, f.name) is not None]
    return record.replace(**{name: getattr(record, name)[keep] for name in columns})


def kept(log: SensorLog, keep: np.ndarray) -> StereoTracks:
    return rows(log.stereo_tracks, keep)


def smoothed(log: SensorLog, method: str = "batch", **stereo: object) -> Run:
    return gn.smooth(dataclasses.replace(log, truth=None), gn.Config.from_dict({"stereo": stereo}), method)


def errors(run: Run, log: SensorLog) -> tuple[np.ndarray, np.ndarray]:
    """Position errors and sigmas (N, 3) at the keyframes."""
    way = run.trajectory
    at = np.clip(np.searchsorted(log.truth.t_s, way.t_s - 1e-6), 0, len(log.truth.t_s) - 1)
    return way.pos_n - log.truth.pos_n_m[at], np.sqrt(np.diagonal(way.cov, axis1=1, axis2=2)[:, 3:6])


@pytest.mark.parametrize("form", ["tight", "loose"])
def test_errors_are_as_large_as_their_sigmas(form: str) -> None:
    """At the end of five logs; a loose graph may overstate its sigmas, for motions in a row share a frame's errors."""
    squares = []
    for seed in range(5):
        run = smoothed(log_of(seed), form=form)
        error = errors(run, log_of(seed))[0][-1]
        squares.append(error @ np.linalg.solve(run.trajectory.cov[-1, 3:6, 3:6], error))
        assert not run.diagnostics.warnings
    low, high = chi2.ppf([ALARM / 2, 1 - ALARM / 2], 3 * len(squares))
    assert (low if form == "tight" else 0.0) < sum(squares) < high


def test_tight_knows_more_than_loose() -> None:
    tight, loose = (errors(smoothed(log_of(1), form=form), log_of(1))[1][-1] for form in ("tight", "loose"))
    assert (tight < loose).all()


def test_isam2_ends_where_batch_does() -> None:
    batch, isam2 = smoothed(log_of(1)), smoothed(log_of(1), "isam2")
    sigma = errors(batch, log_of(1))[1]
    assert (np.abs(batch.trajectory.pos_n - isam2.trajectory.pos_n) < 0.05 * sigma).all()
    assert isam2.causal is not None  # by motions on its way
    assert np.abs(isam2.causal.pos_n - batch.trajectory.pos_n).max() < 0.5


def test_wrong_features_are_left_out() -> None:
    log = log_of(2, outlier_share=0.05)
    run = smoothed(log)
    share = run.diagnostics.rejected["stereo_tracks"] / len(log.stereo_tracks)
    assert 0.01 < share < 0.08  # those of tracks seen from one keyframe alone never come in
    error, sigma = errors(run, log)
    assert (np.abs(error) < 4.5 * sigma).all()


def test_dark_seconds_are_bridged_with_grown_covariance() -> None:
    """No features for 15 s under way: the camera sees others afterwards."""
    log = log_of(3)
    tracks = log.stereo_tracks
    others = tracks.replace(track=tracks.track + 1_000_000 * (tracks.t_s > 95.0))
    dark = dataclasses.replace(log, stereo_tracks=rows(others, (tracks.t_s < 80.0) | (tracks.t_s > 95.0)))
    seen, run = smoothed(log), smoothed(dark)
    told = [line for line in run.diagnostics.warnings if "the IMU alone bridges it" in line]
    assert len(told) == 1 and "from 80 to 96 s" in told[0]
    error, sigma = errors(run, log)
    assert (np.abs(error) < 4.5 * sigma).all()
    assert sigma[-1, 1] > 2 * errors(seen, log)[1][-1, 1]


def test_a_time_without_frames_is_told_though_features_are_found_again() -> None:
    log = log_of(3)
    t_s = log.stereo_tracks.t_s
    hole = dataclasses.replace(log, stereo_tracks=kept(log, (t_s < 80.0) | (t_s > 95.0)))
    tracks = hole.stereo_tracks
    assert set(tracks.track[tracks.t_s < 80.0]) & set(tracks.track[tracks.t_s > 95.0])
    assert any("says nothing from 80 to 96 s" in line for line in smoothed(hole).diagnostics.warnings)


def test_what_disparities_are_too_large_by_is_estimated() -> None:
    log = log_of(4)
    tracks = log.stereo_tracks
    wrong = tracks.replace(u_right_px=tracks.u_right_px - 0.3)
    stereo = log.stereo.replace(disparity_sigma_px=0.3)
    run = smoothed(dataclasses.replace(log, stereo_tracks=wrong, stereo=stereo))
    found = run.calibration["camera_disparity"]
    assert abs(found.value - 0.3) < 3.3 * found.sigma < 0.3
    assert set(run.calibration) >= {"camera_disparity"}
    assert "camera_angle_right" not in run.calibration
    error, sigma = errors(run, log)
    assert (np.abs(error) < 4.5 * sigma).all()


@pytest.mark.parametrize(("error_px", "prior_px"), [(0.1, 0.005), (-0.3, 0.03)])
def test_disparities_off_by_more_than_is_allowed_for_are_told(error_px: float, prior_px: float) -> None:
    """By how much (false alarm: 1e-3), though the prior holds the estimate; as declared nothing is said (6e-7)."""
    log = log_of(4)
    stereo = log.stereo.replace(disparity_sigma_px=prior_px)
    right = log.stereo_tracks.u_right_px
    wrong = log.stereo_tracks.replace(u_right_px=right - error_px)
    run = smoothed(dataclasses.replace(log, stereo_tracks=wrong, stereo=stereo))
    (told,) = (line for line in run.diagnostics.warnings if "all disparities" in line)
    size, own, which = re.search(r"be ([\d.]+) \+- ([\d.]+) px too (\w+),", told).groups()
    assert float(size) == pytest.approx(abs(error_px), abs=3.3 * float(own))
    assert 3 * float(own) < float(size)
    assert which == ("large" if error_px > 0 else "small")
    assert not smoothed(dataclasses.replace(log, stereo=stereo)).diagnostics.warnings


def test_a_camera_mounted_askew_is_found() -> None:
    """A degree aside, as the declared sigma allows: turned about the camera's down axis it shows in the way itself."""
    log = log_of(0)
    turned = so3.to_quaternion(so3.from_quaternion(log.stereo.T_bc_quat_wxyz) @ so3.exp(np.radians([0.0, 1.0, 0.0])))
    stereo = log.stereo.replace(T_bc_quat_wxyz=turned, mounting_sigma_deg=[1.0, 1.0, 1.0])
    found = smoothed(dataclasses.replace(log, stereo=stereo)).calibration["camera_angle_down"]
    assert abs(found.value + 1.0) < 3.3 * found.sigma
    assert found.sigma < 0.9


def test_features_that_tell_no_motion() -> None:
    """A handful of features: the camera is not used, and that is told."""
    log = log_of(0)
    few = dataclasses.replace(log, stereo_tracks=kept(log, np.arange(len(log.stereo_tracks)) < 3))
    run = smoothed(few)
    assert any("the camera" in line for line in run.diagnostics.warnings)
    alone = smoothed(log, form="off")
    np.testing.assert_allclose(run.trajectory.pos_n[-1], alone.trajectory.pos_n[-1], atol=0.5)


def test_features_without_a_camera_are_told() -> None:
    run = smoothed(dataclasses.replace(log_of(0), stereo=None))
    assert "the table stereo_tracks is not used: declare the camera in a section [stereo]" in run.diagnostics.warnings


def test_one_feature_twice_in_a_frame_is_refused() -> None:
    log = log_of(0)
    tracks = log.stereo_tracks
    number = tracks.track.copy()
    number[1] = number[0]
    with pytest.raises(LogError, match="twice"):
        smoothed(dataclasses.replace(log, stereo_tracks=tracks.replace(track=number)))
