"""Tracked features that contradict the declared camera are refused, with row, value and what to do."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from stereo_scene import HEIGHT_PX, WIDTH_PX, drive, roadway, stereo_log, tracked

from graphnav.config import Config
from graphnav.errors import LogError
from graphnav.frontends.camera_check import camera_findings, centre_note
from graphnav.frontends.units import check_units
from graphnav.log import SensorLog, StereoTracks
from graphnav.sighted import with_stereo

NO_SPANS = np.zeros((0, 2))


@pytest.fixture(scope="module")
def log() -> SensorLog:
    rng = np.random.default_rng(5)
    return stereo_log(tracked(rng, drive(np.arange(0.0, 2.0, 0.1)), roadway(rng, 800)))


def changed(log: SensorLog, **columns: np.ndarray) -> SensorLog:
    tracks = log.stereo_tracks
    assert isinstance(tracks, StereoTracks)
    return dataclasses.replace(log, stereo_tracks=tracks.replace(**columns))


def refused(log: SensorLog) -> str:
    """The message, which `info` and `smooth` both give."""
    with pytest.raises(LogError) as caught:
        with_stereo(log, Config())
    assert check_units(log, NO_SPANS) == [str(caught.value)]
    return str(caught.value)


def test_a_sound_log_is_let_through(log: SensorLog) -> None:
    assert camera_findings(log) == []


def test_swapped_sides(log: SensorLog) -> None:
    tracks = log.stereo_tracks
    message = refused(changed(log, u_left_px=tracks.u_right_px, u_right_px=tracks.u_left_px))
    assert message.startswith("table stereo_tracks, row 1, u_left_px, u_right_px: disparity -")
    assert message.endswith("the cameras are swapped; exchange these columns")


def test_features_too_far_to_tell_are_let_through(log: SensorLog) -> None:
    """Disparities of nothing but noise, half of them negative."""
    tracks = log.stereo_tracks
    noise = np.random.default_rng(6).normal(0, 0.7, len(tracks))
    assert camera_findings(changed(log, u_right_px=tracks.u_left_px - noise)) == []


def test_one_column_for_both_sides(log: SensorLog) -> None:
    message = refused(changed(log, u_right_px=log.stereo_tracks.u_left_px))
    assert f"row 1, u_left_px, u_right_px: {log.stereo_tracks.u_left_px[0]:g} px in both" in message


@pytest.mark.parametrize("key", ["cx_px", "cy_px"])
def test_a_principal_point_outside_the_image(log: SensorLog, key: str) -> None:
    message = refused(dataclasses.replace(log, stereo=log.stereo.replace(**{key: -5.0})))
    assert message.startswith(f"[stereo], {key}: -5, expected a place inside the image")


def test_features_outside_the_declared_images(log: SensorLog) -> None:
    fits = log.stereo.replace(width_px=WIDTH_PX, height_px=HEIGHT_PX)
    assert camera_findings(dataclasses.replace(log, stereo=fits)) == []
    small = fits.replace(width_px=320, height_px=180)
    message = refused(dataclasses.replace(log, stereo=small))
    assert message.startswith("table stereo_tracks, row ") and "of the rows outside 0 to 319 px" in message


@pytest.mark.parametrize("key", ["cx_px", "cy_px"])
def test_a_principal_point_beside_all_features_is_told(log: SensorLog, key: str) -> None:
    assert centre_note(log.stereo, log.stereo_tracks) == ""
    beside = dataclasses.replace(log, stereo=log.stereo.replace(**{key: 450.0}))
    assert f"{key} of [stereo] is 450" in with_stereo(beside, Config()).notes[0]


def test_a_baseline_in_mm(log: SensorLog) -> None:
    with pytest.raises(LogError, match=r"^\[stereo\], baseline_m: 95, expected metres, 5 at most; .* in mm$"):
        log.stereo.replace(baseline_m=95.0)
