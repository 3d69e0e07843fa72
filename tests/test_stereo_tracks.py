"""Features followed through drawn image pairs, whose motion is known."""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from drawn_pairs import Wall, approach, drawn_log, moved

from graphnav.config import StereoTracksConfig
from graphnav.errors import LogError
from graphnav.frontends.stereo_tracks import Tracked, tracked
from graphnav.log import SensorLog

pytest.importorskip("cv2")
FRAMES, DISPARITY_PX = 12, 5.0
SETTINGS = StereoTracksConfig(max_features=120)


@cache
def pairs() -> tuple[list, list]:
    return approach(Wall(3), FRAMES, DISPARITY_PX)


@pytest.fixture
def log(tmp_path: Path) -> SensorLog:
    return drawn_log(tmp_path, pairs()[0])


def rows_of(found: Tracked, frame: int) -> np.ndarray:
    return np.flatnonzero(found.tracks.t_s == found.t_s[frame])


@pytest.mark.parametrize("follow", ["flow", "descriptors"])
def test_tracks_keep_to_their_point_of_the_wall(log: SensorLog, follow: str) -> None:
    """Between the first and the last frame; without the correlation with the first sight a drift of 0.1 px remains."""
    found = tracked(log, StereoTracksConfig(max_features=120, follow=follow), workers=1)
    table, motions = found.tracks, pairs()[1]
    errors = []
    for frame in range(1, FRAMES):
        before, now = rows_of(found, 0), rows_of(found, frame)
        _, a, b = np.intersect1d(table.track[before], table.track[now], return_indices=True)
        start = np.column_stack([table.u_left_px[before[a]], table.v_px[before[a]]])
        expected = moved(start, *motions[frame])
        errors.append(np.column_stack([table.u_left_px[now[b]], table.v_px[now[b]]]) - expected)
    last = errors[-1] if follow == "flow" else np.concatenate(errors)
    assert len(last) >= 20
    assert np.abs(np.median(last, axis=0)).max() < 0.03
    assert 1.4826 * np.median(np.abs(last)) < 0.1


def test_disparities(log: SensorLog) -> None:
    found = tracked(log, SETTINGS, workers=1)
    scale = np.repeat([scale for _, scale in pairs()[1]], found.counts)
    error = found.tracks.u_left_px - found.tracks.u_right_px - DISPARITY_PX * scale
    assert abs(np.median(error)) < 0.02
    assert 1.4826 * np.median(np.abs(error)) < 0.08
    assert np.mean(np.abs(error) > 0.5) < 0.02


def test_the_same_with_workers(log: SensorLog) -> None:
    alone, together = (tracked(log, SETTINGS, workers=workers).tracks for workers in (1, 2))
    for column in ("t_s", "track", "u_left_px", "u_right_px", "v_px"):
        np.testing.assert_array_equal(getattr(alone, column), getattr(together, column))


def with_pairs(log: SensorLog, **changes: object) -> SensorLog:
    return dataclasses.replace(log, stereo_pairs=log.stereo_pairs.replace(**changes))


def test_swapped_cameras(log: SensorLog) -> None:
    table = log.stereo_pairs
    with pytest.raises(LogError, match="cameras are swapped"):
        tracked(with_pairs(log, left=table.right, right=table.left), SETTINGS, workers=1)
