"""What an image is worth to visual odometry: matches kept by RANSAC, their spread, contrast, entropy.

Source of the first measure: the roadheader's stereo paper, section 4.1.3 and figures 8 and 9 (SIFT, "points retained
after employing the RANSAC algorithm"; matches over an extended depth). NIQE has a file of its own, `niqe.py`. NIQMC
(Gu et al. 2017), the paper's table 2, is not here: it chooses salient regions by a fitted model of its authors' own
software, which is not to be had; figures of something like it would not compare with the paper's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from graphnav._schema import Array
from graphnav.errors import GraphnavError
from graphnav.frontends._opencv import Image, opencv, require_image

Kind = Literal["sift", "orb", "sift-faint", "orb-faint"]
Motion = Literal["auto", "homography", "fundamental"]

#: Kind -> OpenCV's maker and how it departs from what OpenCV ships. Faint ones take a quarter of the usual contrast:
#: what an enhancement must beat to be worth more than a threshold.
_DETECTORS: dict[str, tuple[str, dict[str, float]]] = {
    "sift": ("SIFT_create", {}),
    "orb": ("ORB_create", {}),
    "sift-faint": ("SIFT_create", {"contrastThreshold": 0.01}),
    "orb-faint": ("ORB_create", {"fastThreshold": 5}),
}
#: Features of one image at most: more than ORB's own default of 500, so that richer images can show it.
_MOST_FEATURES = 2000
#: Distance of the best match by that of the second best (Lowe 2004, figure 11).
_RATIO = 0.8
#: RANSAC: distance (pixels) of an inlier, confidence, iterations.
_REACH_PX, _CONFIDENCE, _TRIALS = 2.0, 0.999, 5000
#: A homography is the motion's model where it keeps this share of what a fundamental matrix keeps. The latter has one
#: equation a match, not two, and so always keeps more, some of them by chance.
_PLANAR_SHARE = 0.8
#: Fewest matches from which a fundamental matrix follows.
_FEWEST = 8


@dataclass(frozen=True)
class Matches:
    """Features of two images that are each other's best match.

    Attributes
    ----------
    first_px, second_px : ``(N, 2)`` places, x right and y down.
    kept : ``(N,)`` those that RANSAC keeps.
    motion : model of which they are inliers.
    """

    first_px: Array
    second_px: Array
    kept: NDArray[np.bool_]
    motion: str

    @property
    def count(self) -> int:
        """Matches kept by RANSAC: the paper's figure of merit."""
        return int(self.kept.sum())

    def true_to(self, warp: Array, reach_px: float = _REACH_PX) -> NDArray[np.bool_]:
        """``(N,)`` which matches a known homography ``(3, 3)`` from first to second confirms.

        Noise has features too, and RANSAC keeps those that match by chance as the motion would have them; and where
        matches are few it keeps wrong ones that agree with each other.
        """
        mapped = np.column_stack([self.first_px, np.ones(len(self.first_px))]) @ warp.T
        found: NDArray[np.bool_] = np.linalg.norm(mapped[:, :2] / mapped[:, 2:] - self.second_px, axis=1) <= reach_px
        return found


def matched(first: Image, second: Image, kind: Kind = "sift", motion: Motion = "auto") -> Matches:
    """Match two images and keep what one motion explains.

    Parameters
    ----------
    first, second : grey images.
    kind : SIFT, or ORB by Hamming distance; both with Lowe's ratio and cross-check.
    motion : `homography` for a plane or a turn, `fundamental` for any scene, `auto` for what fits.

    Raises
    ------
    GraphnavError
        An image is not uint8 grey, or the kind is unknown.
    """
    first_px, one = _features(require_image(first, "matched"), kind)
    second_px, other = _features(require_image(second, "matched"), kind)
    pairs = _pairs(one, other, kind)
    first_px, second_px = first_px[pairs[:, 0]], second_px[pairs[:, 1]]
    kept, model = _ransac(first_px, second_px, motion)
    return Matches(first_px, second_px, kept, model)


def _features(image: Image, kind: str) -> tuple[Array, Any]:
    """Places ``(N, 2)`` and descriptors of a detector as OpenCV ships it, but for `_DETECTORS`."""
    if kind not in _DETECTORS:
        raise GraphnavError(f"matched: kind = {kind!r}, expected one of {', '.join(_DETECTORS)}")
    maker, options = _DETECTORS[kind]
    found, descriptors = getattr(opencv(), maker)(nfeatures=_MOST_FEATURES, **options).detectAndCompute(image, None)
    return np.array([point.pt for point in found], float).reshape(-1, 2), descriptors


def _pairs(first: Any, second: Any, kind: str) -> NDArray[np.intp]:
    """``(N, 2)`` rows that are each other's best match, and clearly better than the second best."""
    if first is None or second is None or len(second) < 2 or len(first) < 2:
        return np.empty((0, 2), np.intp)
    cv2 = opencv()
    matcher = cv2.BFMatcher(cv2.NORM_L2 if kind.startswith("sift") else cv2.NORM_HAMMING)
    back = {m.queryIdx: m.trainIdx for m in matcher.match(second, first)}
    forth = (m for m, other in matcher.knnMatch(first, second, k=2) if m.distance < _RATIO * other.distance)
    found = [(m.queryIdx, m.trainIdx) for m in forth if back[m.trainIdx] == m.queryIdx]
    return np.array(found, np.intp).reshape(-1, 2)


def _ransac(first: Array, second: Array, motion: Motion) -> tuple[NDArray[np.bool_], str]:
    """Which matches are kept, and the model."""
    if len(first) < _FEWEST:
        return np.zeros(len(first), bool), "none"
    found = {}
    if motion != "fundamental":
        found["homography"] = _inliers(first, second, "findHomography")
    if motion != "homography":
        found["fundamental"] = _inliers(first, second, "findFundamentalMat")
    if motion == "auto":
        planar = found["homography"].sum() >= _PLANAR_SHARE * found["fundamental"].sum()
        motion = "homography" if planar else "fundamental"
    return found[motion], motion


def _inliers(first: Array, second: Array, finder: str) -> NDArray[np.bool_]:
    """Inliers of OpenCV's RANSAC, seeded: the same images give the same count."""
    cv2 = opencv()
    cv2.setRNGSeed(0)
    if finder == "findHomography":
        _, mask = cv2.findHomography(first, second, cv2.RANSAC, _REACH_PX, None, _TRIALS, _CONFIDENCE)
    else:
        _, mask = cv2.findFundamentalMat(first, second, cv2.FM_RANSAC, _REACH_PX, _CONFIDENCE, _TRIALS)
    return np.zeros(len(first), bool) if mask is None else mask.ravel().astype(bool)


def image_spread(points_px: Array, shape: tuple[int, int], grid: tuple[int, int] = (6, 10)) -> float:
    """Share of the cells of a grid (rows, columns) over an image ``(H, W)`` in which there is a point."""
    if len(points_px) == 0:
        return 0.0
    cells = np.floor(points_px[:, ::-1] / np.array(shape) * np.array(grid)).astype(int)
    cells = np.clip(cells, 0, np.array(grid) - 1)
    return len(np.unique(cells, axis=0)) / (grid[0] * grid[1])


def depth_spread(disparity_px: Array, bins: int = 8, largest_px: float = 64.0) -> float:
    """Share of the bins of disparity, equal in its logarithm from 1 pixel to the largest, in which there is a point.

    Depth is f b / d (equation 10), so these are equal steps in log depth too; points beyond either end count at it.
    """
    disparity_px = np.asarray(disparity_px, float)
    known = disparity_px[np.isfinite(disparity_px) & (disparity_px > 0)]
    if len(known) == 0:
        return 0.0
    place = np.floor(bins * np.log(known) / np.log(largest_px)).astype(int)
    return len(np.unique(np.clip(place, 0, bins - 1))) / bins


def rms_contrast(image: Image) -> float:
    """Standard deviation of the grey levels (Peli 1990), in grey levels."""
    return float(require_image(image, "rms_contrast").std())


def local_contrast(image: Image, window_px: int = 15) -> float:
    """Mean over the image of the standard deviation within a window, in grey levels."""
    cv2 = opencv()
    window = (window_px, window_px)
    mean = cv2.boxFilter(require_image(image, "local_contrast"), cv2.CV_64F, window, borderType=cv2.BORDER_REFLECT)
    square = cv2.sqrBoxFilter(image, cv2.CV_64F, window, borderType=cv2.BORDER_REFLECT)
    return float(np.sqrt(np.maximum(square - mean**2, 0.0)).mean())


def entropy(image: Image) -> float:
    """Shannon's entropy of the histogram of grey levels, bits: 8 where all levels are equally frequent."""
    share = np.bincount(require_image(image, "entropy").ravel(), minlength=256) / image.size
    some = share[share > 0]
    return float(-(some * np.log2(some)).sum()) + 0.0
