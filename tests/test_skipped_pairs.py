"""Image pairs of no use are told by reason, time, file and row; where none is left, the first file at fault."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from drawn_pairs import SIZE, Wall, drawn_log

from graphnav.config import StereoTracksConfig
from graphnav.errors import LogError
from graphnav.frontends.skipped_pairs import skipped_notes
from graphnav.frontends.stereo_sides import Skipped
from graphnav.frontends.stereo_tracks import tracked
from graphnav.log import SensorLog, StereoPairs

pytest.importorskip("cv2")
FRAMES = 4


@pytest.fixture
def log(tmp_path: Path) -> SensorLog:
    wall = Wall(3)
    return drawn_log(tmp_path, [(wall.seen((0.7 * k, 0.0)), wall.seen((0.7 * k - 5, 0.0))) for k in range(FRAMES)])


def spoiled(log: SensorLog, side: str, image: np.ndarray | None) -> LogError:
    """The error where all images of a side are like this, or missing."""
    import cv2

    for name in getattr(log.stereo_pairs, side):
        path = log.stereo_pairs.folder / name
        path.unlink()
        if image is not None:
            cv2.imwrite(str(path), image)
    with pytest.raises(LogError) as caught:
        tracked(log, StereoTracksConfig(max_features=120), workers=1, cache=False)
    return caught.value


def test_a_missing_side_is_told_at_its_own_file(log: SensorLog) -> None:
    message = str(spoiled(log, "right", None))
    assert f"{log.stereo_pairs.folder}/right_000.png (row 1 of the table stereo): none of 4 image pairs" in message
    assert "right image file: No such file or directory; put the images where the stereo table says" in message


def test_a_covered_lens_is_told_at_its_own_file(log: SensorLog) -> None:
    message = str(spoiled(log, "right", np.zeros(SIZE[::-1], np.uint8)))
    assert "/right_000.png (row 1" in message and "right image without contrast" in message
    assert "enhancement for dark ones" in message


def test_missing_images_are_told_with_time_file_and_row(log: SensorLog) -> None:
    pairs = log.stereo_pairs
    (pairs.folder / pairs.left[2]).unlink()
    found = tracked(log, StereoTracksConfig(max_features=120), workers=1)
    (note,) = skipped_notes(pairs, found.skipped)
    assert note == (
        "1 of 4 image pairs were not used, at 0.6 s: left image file: No such file or directory"
        " (left_002.png, row 3 of the table stereo)"
    )


def test_each_reason_has_its_span() -> None:
    names = [f"{k}.png" for k in range(9)]
    pairs = StereoPairs(t_s=np.arange(9.0), left=["l" + name for name in names], right=["r" + name for name in names])
    dark = [Skipped(t, "right image without contrast") for t in (1.0, 2.0, 7.0)]
    notes = skipped_notes(pairs, [*dark, Skipped(8.0, "left image file: damaged")])
    assert (
        "3 of 9 image pairs were not used, from 1.0 to 7.0 s: right image without contrast (the first: r1.png"
        in notes[0]
    )
    assert "at 8.0 s" in notes[1] and "(l8.png, row 9" in notes[1]
