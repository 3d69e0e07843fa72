"""Do image pairs look rectified? Sides that are swapped and rows that do not agree are refused before the work begins.

In a rectified pair a point lies in the same row of both images, and farther left in the right one. Features of a few
pairs are matched in a window that would also let through what is wrong, and their differences are looked at.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from graphnav.errors import LogError
from graphnav.frontends.image_pairs import PairFiles, SkippedFrame, read_pair
from graphnav.frontends.stereo_features import Places, Whole, detected
from graphnav.frontends.stereo_matching import Window, matches
from graphnav.frontends.stereo_sides import PairWork, enhanced

#: Pairs looked at, spread over the log; pairs tried for them; and matches that are needed for a judgement.
_PAIRS, _TRIES, _LEAST_MATCHES = 5, 20, 40
#: Rows by which the sides may differ here, and on the median at most.
_ROWS_PX, _MOST_OFFSET_PX = 12.0, 1.0
#: Share of rows that agree to twice the latter, at least. Wrong matches are spread evenly over the window.
_LEAST_AGREEING = 0.5


def check_calibration(files: Sequence[PairFiles], work: PairWork) -> None:
    """Refuse pairs whose sides are swapped or whose rows do not agree; without enough features to tell, say nothing.

    Raises
    ------
    LogError
        They are.
    """
    shift = _shifts(files, work)
    if len(shift) < _LEAST_MATCHES:
        return
    where = str(files[0].left.parent)
    rows = shift[:, 1]
    offset = float(np.median(rows))
    agree = np.abs(rows) <= 2 * _MOST_OFFSET_PX
    if abs(offset) > _MOST_OFFSET_PX or agree.mean() < _LEAST_AGREEING:
        raise LogError(
            f"matched features are in rows that differ by {offset:.1f} px on the median"
            f" ({100 * agree.mean():.0f} % by 2 px or less), expected none: the pairs are not rectified",
            where=where,
            fix="rectify the images by their calibration (graphnav.frontends.rectification)",
        )
    if np.median(shift[agree, 0]) > work.settings.min_disparity_px:
        raise LogError(
            "matched features are farther right in the right images (negative disparity): the cameras are swapped",
            where=where,
            fix="exchange the columns left and right of the stereo table",
        )


def _shifts(files: Sequence[PairFiles], work: PairWork) -> Places:
    """Differences of places (N, 2), right less left, over the first pairs of use among some spread over the log."""
    found: list[Places] = []
    for number in np.unique(np.linspace(0, len(files) - 1, _TRIES).astype(int))[_order(len(files))]:
        try:
            found.append(_shift(files[number], work))
        except SkippedFrame:
            continue
        if len(found) == _PAIRS:
            break
    return np.concatenate([np.empty((0, 2)), *found])


def _order(count: int) -> Whole:
    """An order of the tries in which the first few are spread, too."""
    tries = min(count, _TRIES)
    return np.argsort(np.arange(tries) % (max(tries // _PAIRS, 1)), kind="stable")


def _shift(files: PairFiles, work: PairWork) -> Places:
    left, right = (enhanced(image, work.settings.enhance) for image in read_pair(files, work.size))
    settings = work.settings
    one = detected(left, settings.features, settings.max_features)
    other = detected(right, settings.features, settings.max_features, spread=False)
    reach = work.most_px
    rows, others = matches(one, other, Window((-reach, -_ROWS_PX), (reach, _ROWS_PX)))
    return other.uv_px[others] - one.uv_px[rows]
