"""What one image pair gives by itself: features of the left image with their places in the right one.

This is the part of the work that does not depend on other frames, and that worker processes do.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from graphnav.errors import LogError
from graphnav.frontends._opencv import Image, opencv
from graphnav.frontends.image_pairs import PairFiles, SkippedFrame, read_pair
from graphnav.frontends.patch_alignment import aligned, patches, smoothed
from graphnav.frontends.stereo_features import Features, Places, detected
from graphnav.frontends.stereo_matching import rectified_matches

if TYPE_CHECKING:
    from graphnav.config import StereoTracksConfig

#: Correlation of a patch with what it is found to be.
LEAST_SIMILARITY = 0.85
#: How far the place to a fraction of a pixel may be from the matched one, px.
MOST_SHIFT_PX = 2.0


@dataclass(frozen=True)
class Sides:
    """One pair: both images, and the features that were found in both.

    Attributes
    ----------
    t_s : time of the frame.
    left, right : the images, enhanced as configured.
    features : of the left image.
    u_right_px : (N,) their columns in the right image.
    detected : number of features of the left image before matching.
    """

    t_s: float
    left: Image
    right: Image
    features: Features
    u_right_px: Places
    detected: int


@dataclass(frozen=True)
class Skipped:
    """A frame that was left out, and why."""

    t_s: float
    reason: str


@dataclass(frozen=True)
class PairWork:
    """What a worker has to know to work on any pair of a log."""

    settings: StereoTracksConfig
    size: tuple[int, int]
    fx_baseline_px_m: float

    @property
    def most_px(self) -> float:
        """Largest disparity: that of the least depth, ``d = fx b / z``."""
        return min(self.fx_baseline_px_m / self.settings.min_depth_m, float(self.size[0]))

    def __call__(self, files: PairFiles) -> Sides | Skipped | LogError:
        """The pair's features; an error is returned and not raised, so that it is the first frame's that is seen."""
        opencv().setNumThreads(1)
        try:
            return self.sides(files.t_s, *read_pair(files, self.size))
        except SkippedFrame as reason:
            return Skipped(files.t_s, str(reason))
        except LogError as error:
            return error

    def sides(self, t_s: float, left: Image, right: Image) -> Sides:
        """Features in both images of a pair."""
        settings = self.settings
        left, right = (enhanced(image, settings.enhance) for image in (left, right))
        of_left = detected(left, settings.features, settings.max_features)
        of_right = detected(right, settings.features, settings.max_features, spread=False)
        rows, others = rectified_matches(of_left, of_right, self.most_px)
        features, u_right = of_left.take(rows), of_right.uv_px[others, 0]
        if settings.subpixel and len(rows):
            u_right, good = self._refined(left, right, features.uv_px, u_right)
            features, u_right = features.take(good), u_right[good]
        far = features.uv_px[:, 0] - u_right
        allowed = np.flatnonzero((far >= settings.min_disparity_px) & (far <= self.most_px))
        found = Sides(t_s, left, right, features.take(allowed), u_right[allowed], len(of_left))
        if len(allowed) < settings.min_features:
            raise SkippedFrame(_too_few(found, len(of_right), settings.min_features))
        return found

    def _refined(
        self, left: Image, right: Image, uv_px: Places, u_right: Places
    ) -> tuple[Places, npt.NDArray[np.bool_]]:
        """Columns in the right image by correlation along the row, and which of them are good."""
        start = np.column_stack([u_right, uv_px[:, 1]])
        template = patches(smoothed(left), uv_px)
        found = aligned(template, smoothed(right), start, np.tile(np.eye(2), (len(start), 1, 1)), rows_fixed=True)
        moved = np.abs(found.uv_px[:, 0] - u_right)
        return found.uv_px[:, 0], (found.similarity >= LEAST_SIMILARITY) & (moved <= MOST_SHIFT_PX)


def _too_few(found: Sides, right: int, wanted: int) -> str:
    for side, count in (("left", found.detected), ("right", right)):
        if count < wanted:
            return f"fewer than {wanted} features in the {side} image"
    return f"fewer than {wanted} features that are in both images"


def enhanced(image: Image, method: str) -> Image:
    """The image as the chosen enhancement makes it."""
    if method == "none":
        return image
    # imported here: "none" is the usual case
    enhancers = importlib.import_module("graphnav.frontends.enhancement").ENHANCERS
    return np.asarray(enhancers[method](image), np.uint8)
