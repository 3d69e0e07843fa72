"""Images of another size than the camera was calibrated for: refused where the size is declared, else told."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from drawn_pairs import SIZE, drawn_log

from graphnav.errors import LogError
from graphnav.frontends.image_pairs import pair_files
from graphnav.frontends.image_size import image_size, size_note
from graphnav.log import SensorLog

pytest.importorskip("cv2")
#: Three quarters of the calibrated size, as a recorder may write them: the principal point is inside.
SMALL = np.full((SIZE[1] * 3 // 4, SIZE[0] * 3 // 4), 99, np.uint8)
AS_DRAWN = np.full((SIZE[1], SIZE[0]), 99, np.uint8)


def noted(log: SensorLog) -> str:
    return size_note(pair_files(log), log.stereo)


def test_another_size_than_declared_is_refused(tmp_path: Path) -> None:
    log = drawn_log(tmp_path, [(SMALL, SMALL)], width_px=SIZE[0], height_px=SIZE[1])
    with pytest.raises(LogError, match=r"left_000.png: image of 159 x 90 pixels, but \[stereo\] is for 212 x 120"):
        image_size(pair_files(log), log.stereo)


def test_a_principal_point_far_from_the_middle_is_told(tmp_path: Path) -> None:
    assert "(105.5, 59.5), far from the middle of images of 159 x 90" in noted(drawn_log(tmp_path, [(SMALL, SMALL)]))


def test_nothing_is_told_of_images_as_calibrated(tmp_path: Path) -> None:
    log = drawn_log(tmp_path, [(AS_DRAWN, AS_DRAWN)])
    assert noted(log) == ""
    declared = log.stereo.replace(cx_px=130.0, width_px=SIZE[0], height_px=SIZE[1])
    assert noted(dataclasses.replace(log, stereo=declared)) == ""


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"width_px": 424}, "height_px: missing key; it comes with width_px"),
        ({"width_px": 424, "height_px": 0}, "height_px: 0, expected a number above zero"),
        ({"width_px": 424, "height_px": 50}, "expected a place in the image of 424 x 50 pixels"),
    ],
)
def test_sizes_that_cannot_be(tmp_path: Path, changes: dict[str, int], message: str) -> None:
    with pytest.raises(LogError, match=message):
        drawn_log(tmp_path, [(AS_DRAWN, AS_DRAWN)], **changes)
