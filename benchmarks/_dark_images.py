"""Dark photographs as a camera that moves a little would see them twice, and what is measured of such a pair."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks._report import ROOT, say
from graphnav._schema import Array
from graphnav.frontends import enhancement
from graphnav.frontends._opencv import Image
from graphnav.frontends.image_quality import Kind, Matches, Motion, image_spread, matched

SETS = ("DICM", "LIME")
SIZE = enhancement.SIZE
Confirmed = Callable[[Matches], NDArray[np.bool_]]
KINDS: tuple[Kind, ...] = ("sift", "orb")


@dataclass(frozen=True)
class Noise:
    """Of a camera: variance ``read^2 + shot * level``, in grey levels."""

    read: float
    shot: float

    def added(self, light: Array, generator: np.random.Generator) -> Image:
        """A frame: light with noise, rounded to grey levels."""
        noisy = light + np.sqrt(self.read**2 + self.shot * light) * generator.standard_normal(light.shape)
        return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


#: Chosen: 5,000 electrons at the brightest and one grey level of read noise; and a camera at four times its gain.
NOISES = {"usual noise": Noise(1.0, 0.05), "much noise": Noise(3.0, 0.2)}


@dataclass(frozen=True)
class Pair:
    """Two frames of one photograph.

    Attributes
    ----------
    warp : ``(3, 3)`` homography from the first to the second, pixels.
    """

    name: str
    first: Image
    second: Image
    warp: Array


def folder() -> Path:
    """Where the photographs are looked for."""
    data = Path(os.environ.get("GRAPHNAV_DATA") or ROOT.parent / "shared" / "data")
    return data / "lowlight_lime_dicm"


def photographs(name: str) -> list[tuple[str, Image]]:
    """Those of a set as they are, grey, with their names; none where there is no such folder."""
    import cv2

    paths = sorted((folder() / name).glob("*.*"))
    if not paths:
        say(f"no photographs in {folder() / name}: set GRAPHNAV_DATA")
    read = ((path.stem, cv2.imread(str(path))) for path in paths)
    return [(stem, enhancement.grey(image)) for stem, image in read if image is not None]


def pairs(images: list[tuple[str, Image]], noise: Noise, seed: int) -> Iterator[Pair]:
    """One pair of each photograph: both frames moved, so that both are interpolated, each with noise of its own."""
    for number, (name, image) in enumerate(images):
        generator = np.random.default_rng([seed, number])
        moves = drawn_warp(generator), drawn_warp(generator)
        first, second = (noise.added(_seen(image, move), generator) for move in moves)
        yield Pair(name, first, second, moves[1] @ np.linalg.inv(moves[0]))


def drawn_warp(generator: np.random.Generator) -> Array:
    """A small homography: within 2 deg, 3 % of scale, 8 pixels, and 1e-4 a pixel of perspective."""
    angle, scale = np.radians(generator.uniform(-2, 2)), 1 + generator.uniform(-0.03, 0.03)
    turn = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    centre, warp = np.array(SIZE) / 2, np.eye(3)
    warp[:2, :2], warp[:2, 2] = turn, centre - turn @ centre + generator.uniform(-8, 8, 2)
    warp[2, :2] = generator.uniform(-1e-4, 1e-4, 2)
    return warp


def _seen(image: Image, warp: Array) -> Array:
    """The photograph at the paper's size after a warp, in one interpolation, blurred before against aliasing."""
    import cv2

    by_column, by_row = image.shape[1] / SIZE[0], image.shape[0] / SIZE[1]
    enlarged = np.array([[by_column, 0, (by_column - 1) / 2], [0, by_row, (by_row - 1) / 2], [0, 0, 1]])
    soft = cv2.GaussianBlur(image.astype(np.float32), (0, 0), 0.4 * by_column, sigmaY=0.4 * by_row)
    to_frame = warp @ np.linalg.inv(enlarged)
    return np.maximum(cv2.warpPerspective(soft, to_frame, SIZE, borderMode=cv2.BORDER_REFLECT), 0.0)


def by_equation_6(image: Image) -> Image:
    """P as equations 4, 6 and 7 give it, in place of equation 8: S less scattering, by omega (at least an eighth)."""
    share = np.maximum(enhancement.omega(image), 1 / enhancement.DEFAULTS.most_gain)
    return np.clip((image - enhancement.scattering(image)) / share, 0, 255).astype(np.uint8)


def _raw(image: Image) -> Image:
    return image


#: What is compared: name -> image to image.
VARIANTS: Mapping[str, Callable[[Image], Image]] = {
    "raw": _raw,
    "CLAHE": enhancement.clahe,
    "enhanced": enhancement.enhanced,
    "R alone": enhancement.reflection,
    "P alone": enhancement.dedusted,
    "P by equation 6": by_equation_6,
}
#: And raw images seen by detectors with a quarter of the threshold.
FAINT: Mapping[Kind, Kind] = {"sift": "sift-faint", "orb": "orb-faint"}


@dataclass(frozen=True)
class Score:
    """Matches of two frames.

    Attributes
    ----------
    kept, true : by RANSAC, and of these by the known motion too.
    spread : share of the image's cells with a true match.
    true_px : ``(true, 2)`` where in the first frame.
    """

    kept: int
    true: int
    spread: float
    true_px: Array


def cases() -> list[tuple[str, Kind, Kind]]:
    """Variant, kind, detector: all variants by both; raw images by faint detectors too, as the variant `raw, faint`."""
    plain: list[tuple[str, Kind, Kind]] = [(name, kind, kind) for name in VARIANTS for kind in KINDS]
    return plain + [("raw, faint", kind, faint) for kind, faint in FAINT.items()]


def scores(first: Image, second: Image, motion: Motion, confirmed: Confirmed) -> dict[tuple[str, str], Score]:
    """(variant, kind) -> the score of two frames; `confirmed` says which matches the known motion confirms, (N,)."""
    found = {}
    for name, kind, detector in cases():
        change = VARIANTS[name.partition(",")[0]]
        matches = matched(change(first), change(second), detector, motion)
        right = matches.kept & confirmed(matches)
        places = matches.first_px[right]
        found[name, kind] = Score(matches.count, len(places), image_spread(places, SIZE[::-1]), places)
    return found
