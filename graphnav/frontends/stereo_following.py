"""Features followed from pair to pair: where each track of the last pair is expected in both images of the next.

Two ways, with the same kind of answer. *Descriptors*: the features found in the new pair are matched with those of the
tracks, as the paper does (ORB or SIFT). *Flow*: the image around each feature is looked for in the next left image
(Lucas-Kanade on an image pyramid), back again as a check, and from there in the right image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graphnav.frontends._opencv import Image, opencv
from graphnav.frontends.stereo_features import Features, Places, Whole
from graphnav.frontends.stereo_matching import Window, matches
from graphnav.frontends.stereo_sides import Sides
from graphnav.frontends.stereo_state import TrackState

_FLOW_WINDOW_PX = (15, 15)
#: Halvings of the image: for the way to the next frame, and for ways that begin near their end.
_FLOW_LEVELS, _NEAR_LEVELS = 3, 1
#: The flow is where the search to a fraction of a pixel begins, and need not be finer.
_FLOW_ITERATIONS, _FLOW_STEP_PX = 15, 0.02
#: What going there and back may be off, and the rows of both sides may differ.
_BACK_PX, _ROW_PX = 1.0, 1.5
#: How far a feature with descriptors may have moved between frames, as a share of the image's width.
_REACH = 0.15


@dataclass(frozen=True)
class Proposal:
    """Rows of the tracks that were found again, and where: ``(N, 2)`` left, and ``(N,)`` columns in the right image."""

    rows: Whole
    uv_px: Places
    u_right_px: Places

    def take(self, good: npt.NDArray[np.bool_]) -> Proposal:
        """Some of them."""
        return Proposal(self.rows[good], self.uv_px[good], self.u_right_px[good])


def by_descriptors(tracks: TrackState, sides: Sides) -> Proposal:
    """Tracks whose descriptor is that of a feature of the new pair."""
    reach = _REACH * sides.left.shape[1]
    known = Features(tracks.uv_px, tracks.pixel_scale, tracks.descriptor)
    rows, found = matches(known, sides.features, Window((-reach, -reach), (reach, reach)))
    return Proposal(rows, sides.features.uv_px[found], sides.u_right_px[found])


class Flow:
    """Optical flow from the last pair that was seen to the next; keeps the last left image."""

    def __init__(self) -> None:
        self._before: Image | None = None

    def see(self, sides: Sides) -> None:
        """Take a pair as the last one, without tracks to follow."""
        self._before = sides.left

    def __call__(self, tracks: TrackState, sides: Sides) -> Proposal:
        """Tracks of the last pair that are seen in the new one; the new pair becomes the last."""
        left, right = sides.left, sides.right
        before, self._before = left if self._before is None else self._before, left
        uv, good = _moved(before, left, tracks.uv_px, tracks.uv_px, _FLOW_LEVELS)
        back, returned = _moved(left, before, uv, tracks.uv_px, _NEAR_LEVELS)
        good &= returned & (np.abs(back - tracks.uv_px).max(axis=1, initial=0.0) < _BACK_PX)
        good &= _inside(uv, sides.left)
        expected = uv - np.column_stack([tracks.disparity_px, np.zeros(len(uv))])
        of_right, seen = _moved(left, right, uv, expected, _NEAR_LEVELS)
        good &= seen & (np.abs(of_right[:, 1] - uv[:, 1]) < _ROW_PX) & _inside(of_right, sides.right)
        return Proposal(np.arange(len(uv)), uv, of_right[:, 0]).take(good)


def _moved(
    one: Image, other: Image, uv_px: Places, expected_px: Places, levels: int
) -> tuple[Places, npt.NDArray[np.bool_]]:
    """Where places of one image are in another (N, 2), and which were found."""
    if not len(uv_px):
        return uv_px, np.zeros(0, bool)
    cv2 = opencv()
    start = np.ascontiguousarray(expected_px, np.float32)
    found, status, _ = cv2.calcOpticalFlowPyrLK(
        one,
        other,
        np.ascontiguousarray(uv_px, np.float32),
        start.copy(),
        winSize=_FLOW_WINDOW_PX,
        maxLevel=levels,
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, _FLOW_ITERATIONS, _FLOW_STEP_PX),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return np.asarray(found, float).reshape(-1, 2), status.ravel() > 0


def _inside(uv_px: Places, image: Image) -> npt.NDArray[np.bool_]:
    height, width = image.shape
    return np.asarray(((uv_px >= 0) & (uv_px <= [width - 1, height - 1])).all(axis=1))
