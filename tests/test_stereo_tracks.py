"""Features followed through drawn image pairs, whose motion is known."""

from __future__ import annotations

import dataclasses
import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from drawn_pairs import SIZE, Wall, approach, drawn_log, moved

from graphnav.config import StereoTracksConfig
from graphnav.errors import LogError
from graphnav.frontends import stereo_cache, stereo_tracks
from graphnav.frontends.stereo_tracks import Tracked, tracked
from graphnav.log import SensorLog
from graphnav.readers import read, write
from graphnav.readers.image_files import gathered

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


def test_pairs_that_are_not_rectified(tmp_path: Path) -> None:
    wall = Wall(3)
    shifted = [(wall.seen((0.5 * k, 0)), wall.seen((0.5 * k - DISPARITY_PX, 4.0))) for k in range(4)]
    with pytest.raises(LogError, match=r"rows that differ by 4\.\d px.*not rectified"):
        tracked(drawn_log(tmp_path, shifted), SETTINGS, workers=1)


def spoil(log: SensorLog, names: list[str], content: bytes | np.ndarray) -> None:
    import cv2

    for name in names:
        path = log.stereo_pairs.folder / name
        path.write_bytes(content if isinstance(content, bytes) else cv2.imencode(".png", content)[1].tobytes())


BLACK = np.zeros((SIZE[1], SIZE[0]), np.uint8)
NOISE = np.random.default_rng(9).integers(20, 60, BLACK.shape).astype(np.uint8)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (BLACK, "right image without contrast"),
        (NOISE, "fewer than 12 features that are in both images"),
        (b"no image", "right image file: no image, or a damaged one"),
        (b"", "right image file: no image"),
        (None, "right image file: No such file"),
    ],
)
def test_frames_without_use_are_skipped(log: SensorLog, content: bytes | np.ndarray | None, reason: str) -> None:
    """One side covered, damaged, missing: the frames are named, and tracks go on after them."""
    names = list(log.stereo_pairs.right[4:6])
    if content is None:
        for name in names:
            (log.stereo_pairs.folder / name).unlink()
    else:
        spoil(log, names, content)
    found = tracked(log, SETTINGS, workers=1)
    assert [frame.t_s for frame in found.skipped] == list(log.stereo_pairs.t_s[4:6])
    assert {frame.reason for frame in found.skipped} == {found.skipped[0].reason}
    assert re.search(reason, found.skipped[0].reason)
    assert len(found.t_s) == FRAMES - 2
    before, after = (set(found.tracks.track[rows_of(found, k)]) for k in (3, 4))
    assert len(before & after) > 20


def test_nothing_of_use(log: SensorLog) -> None:
    spoil(log, [*log.stereo_pairs.left, *log.stereo_pairs.right], BLACK)
    with pytest.raises(LogError, match=r"left_000\.png .*none of 12 image pairs is of use; .*: left image without"):
        tracked(log, SETTINGS, workers=1)
    with pytest.raises(LogError, match="none of 12 image pairs can be read"):
        tracked(with_pairs(log, folder=log.stereo_pairs.folder / "elsewhere"), SETTINGS, workers=1)


@pytest.mark.parametrize("workers", [1, 2])
def test_an_image_of_another_size(log: SensorLog, workers: int) -> None:
    spoil(log, [log.stereo_pairs.right[7]], NOISE[:100])
    with pytest.raises(LogError, match="right image of 212 x 100 pixels, expected 212 x 120"):
        tracked(log, SETTINGS, workers=workers)


def test_calibration_for_another_size(tmp_path: Path) -> None:
    log = drawn_log(tmp_path, pairs()[0][:2], cx_px=320.0)
    with pytest.raises(LogError, match=r"212 x 120 pixels, but the principal point is at \(320, 59.5\)"):
        tracked(log, SETTINGS, workers=1)


def test_logs_without_images(log: SensorLog) -> None:
    with pytest.raises(LogError, match="not read from a folder"):
        tracked(with_pairs(log, folder=None), SETTINGS)
    with pytest.raises(LogError, match=r"no section \[stereo\]"):
        tracked(dataclasses.replace(log, stereo=None), SETTINGS)


def test_colour_images(log: SensorLog) -> None:
    import cv2

    grey = tracked(log, SETTINGS, workers=1)
    for name in log.stereo_pairs.left:
        path = str(log.stereo_pairs.folder / name)
        cv2.imwrite(path, cv2.cvtColor(cv2.imread(path, 0), cv2.COLOR_GRAY2BGR))
    colour = tracked(log, SETTINGS, workers=1)
    np.testing.assert_array_equal(colour.tracks.u_left_px, grey.tracks.u_left_px)


def test_places_without_correlation_are_worse(log: SensorLog) -> None:
    """What `subpixel` is for."""
    sigma = {}
    for subpixel in (True, False):
        settings = StereoTracksConfig(max_features=120, subpixel=subpixel, follow="descriptors")
        found = tracked(log, settings, workers=1)
        scale = np.repeat([scale for _, scale in pairs()[1]], found.counts)
        error = found.tracks.u_left_px - found.tracks.u_right_px - DISPARITY_PX * scale
        sigma[subpixel] = 1.4826 * np.median(np.abs(error))
    assert sigma[True] < 0.5 * sigma[False]


# Kept beside the log ----------------------------------------------------------------------------------------


@pytest.fixture
def on_disk(tmp_path: Path) -> SensorLog:
    """A log folder with its images."""
    drawn = drawn_log(tmp_path, pairs()[0][:4])
    folder = tmp_path / "log"
    moved_log, images = gathered(drawn)
    write(moved_log, folder, images=images)
    return read(folder)


def kept_files(log: SensorLog) -> list[Path]:
    return sorted((log.stereo_pairs.folder / ".graphnav").glob("*"))


def same(one: Tracked, other: Tracked) -> bool:
    columns = ("t_s", "track", "u_left_px", "u_right_px", "v_px")
    return all(np.array_equal(getattr(one.tracks, c), getattr(other.tracks, c)) for c in columns) and (
        (one.t_s == other.t_s).all() and (one.counts == other.counts).all() and one.skipped == other.skipped
    )


def test_kept_tracks_are_the_same(on_disk: SensorLog, monkeypatch: pytest.MonkeyPatch) -> None:
    (on_disk.stereo_pairs.folder / on_disk.stereo_pairs.right[2]).unlink()
    first = tracked(on_disk, SETTINGS, workers=1)
    assert len(first.skipped) == 1
    assert len(kept_files(on_disk)) == 1
    monkeypatch.setattr(stereo_tracks, "_tracked", lambda *_: pytest.fail("followed again"))
    again = read(on_disk.stereo_pairs.folder)
    second = tracked(again, SETTINGS)
    assert same(first, second) and first.seconds == second.seconds


def test_what_changes_the_result_is_not_taken_from_what_was_kept(on_disk: SensorLog) -> None:
    tracked(on_disk, SETTINGS, workers=1)
    tracked(on_disk, StereoTracksConfig(max_features=60), workers=1)
    assert len(kept_files(on_disk)) == 2
    tracked(dataclasses.replace(on_disk, stereo=on_disk.stereo.replace(fx_px=140.0)), SETTINGS, workers=1)
    assert len(kept_files(on_disk)) == 3
    spoil(on_disk, [on_disk.stereo_pairs.left[1]], BLACK)
    assert len(tracked(on_disk, SETTINGS, workers=1).skipped) == 1
    assert len(kept_files(on_disk)) == 4
    tracked(on_disk, SETTINGS, workers=1, cache=False)
    assert len(kept_files(on_disk)) == 4


@pytest.mark.parametrize("damage", [lambda data: data[: len(data) // 2], lambda _: b"", lambda data: data[::-1]])
def test_damaged_file_is_made_anew(on_disk: SensorLog, damage: object) -> None:
    first = tracked(on_disk, SETTINGS, workers=1)
    (path,) = kept_files(on_disk)
    whole = path.read_bytes()
    path.write_bytes(damage(whole))
    assert same(first, tracked(on_disk, SETTINGS, workers=1))
    assert kept_files(on_disk) == [path]
    assert same(first, stereo_cache.kept(path))


def test_where_nothing_can_be_written_nothing_is_kept(on_disk: SensorLog) -> None:
    """A file stands where the folder would be: as a folder that must not be written to, also for root."""
    (on_disk.stereo_pairs.folder / ".graphnav").write_text("")
    assert len(tracked(on_disk, SETTINGS, workers=1).tracks) > 0
    assert (on_disk.stereo_pairs.folder / ".graphnav").read_text() == ""
