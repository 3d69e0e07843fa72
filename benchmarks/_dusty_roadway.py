"""A dark and dusty roadway drawn for the enhancement's page: walls of known place, a headlight, a lamp, scattering.

The walls, floor and roof are planes, 4 m wide and 5.5 m high as in the scenario roadheader-stereo; the camera has its
424 x 240 pixels and 87 deg. Light falls off with the distance and away from the headlight's axis; dust dims what is
behind it and shines itself, equation 4 with ``omega = exp(-d / visibility)``. It is no simulator of a log.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from benchmarks._dark_images import SIZE, Noise
from graphnav._schema import Array
from graphnav.frontends._opencv import Image
from graphnav.frontends.image_quality import Matches

FOCAL_PX = SIZE[0] / 2 / np.tan(np.radians(87 / 2))
BASELINE_M = 0.095
_WIDTH_M, _HEIGHT_M, _EYE_M, _END_M = 4.0, 5.5, 1.8, 30.0
_TEXEL_M, _ATTENUATION_M = 0.02, 15.0
#: Scales of the rock's texture, texels; number of the roadway's end among the faces.
_SCALES, _END = (1.0, 3.0, 10.0), 4
#: Grey levels: of white at 1 m in the headlight's axis, of ambient light at 1 m, and of dust as bright as it gets.
_HEADLIGHT, _AMBIENT, _DUST = 3000.0, 60.0, 110.0


@dataclass(frozen=True)
class View:
    """What is seen from one place along the roadway.

    Attributes
    ----------
    light, depth_m : ``(H, W)`` grey levels before noise, and distance along the optical axis.
    """

    light: Array
    depth_m: Array


def view(forward_m: float, seed: int = 0) -> View:
    """The roadway from a place on its axis, looking along it."""
    columns, rows = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    right, down = (columns - SIZE[0] / 2 + 0.5) / FOCAL_PX, (rows - SIZE[1] / 2 + 0.5) / FOCAL_PX
    side = _WIDTH_M / 2 / np.maximum(np.abs(right), 1e-9)
    level = np.where(down > 0, _EYE_M, _HEIGHT_M - _EYE_M) / np.maximum(np.abs(down), 1e-9)
    depth = np.minimum(np.minimum(side, level), _END_M - forward_m)
    on_side, on_end = side <= level, np.minimum(side, level) > _END_M - forward_m
    along, across = depth + forward_m, np.where(on_side, down, right) * depth
    face = np.where(on_end, _END, np.where(on_side, np.where(right > 0, 1, 0), np.where(down > 0, 3, 2)))
    place = np.where(on_end, right * depth, along), np.where(on_end, down * depth, across)
    return View(_lit(_reflectance(place, face, depth, seed), depth, np.hypot(right, down)), depth)


def _lit(reflectance: Array, depth: Array, off_axis: Array) -> Array:
    """Equation 4: what the surface sends back through dust, and what the dust sends."""
    distance = depth * np.hypot(1.0, off_axis)
    cone = np.exp(-((off_axis / 0.6) ** 2))
    share = np.exp(-distance / _ATTENUATION_M)
    lit = (_HEADLIGHT * cone / distance**2 + _AMBIENT / distance) * reflectance
    glow = _DUST * (0.4 + 0.6 * cone) * (1 - share)
    found: Array = lit * share + glow
    return found


def _reflectance(place: tuple[Array, Array], face: Array, depth: Array, seed: int) -> Array:
    """Rock on every face: three scales of noise, of a lognormal spread; the fine ones fade where pixels are larger."""
    found = np.zeros(face.shape)
    pixel = depth / FOCAL_PX / _TEXEL_M * np.where(face < _END, np.maximum(depth / 3, 1.0), 1.0)
    for number in np.unique(face):
        on = face == number
        spots = [place[1][on] / _TEXEL_M, place[0][on] / _TEXEL_M]
        for scale, rock in zip(_SCALES, _rock(seed, int(number)), strict=True):
            seen = scipy.ndimage.map_coordinates(rock, spots, order=1, mode="grid-wrap")
            found[on] += seen * np.exp(-0.5 * (pixel[on] / scale / 2) ** 2)
    return np.clip(0.3 * np.exp(0.45 * found), 0.02, 1.0)


@lru_cache(maxsize=16)
def _rock(seed: int, face: int) -> tuple[Array, ...]:
    """Noise of unit deviation at each scale, 10 m by 41 m."""
    generator = np.random.default_rng([seed, face])
    made = [scipy.ndimage.gaussian_filter(generator.standard_normal((512, 2048)), s, mode="wrap") for s in _SCALES]
    return tuple(rock / rock.std() for rock in made)


def frames(noise: Noise, seed: int, step_m: float = 0.15) -> tuple[Image, Image, View]:
    """Two frames with a step forward between them, and the first's view."""
    generator = np.random.default_rng([seed, 99])
    start = float(generator.uniform(0, 8))
    views = view(start, seed), view(start + step_m, seed)
    first, second = (noise.added(one.light, generator) for one in views)
    return first, second, views[0]


def moved(points_px: Array, seen: View, step_m: float = 0.15) -> Array:
    """``(N, 2)`` where the walls at the first frame's points are in the second."""
    centre = np.array(SIZE) / 2 - 0.5
    depth = scipy.ndimage.map_coordinates(seen.depth_m, points_px[:, ::-1].T, order=1, mode="nearest")
    return centre + (points_px - centre) * (depth / (depth - step_m))[:, None]


def confirmed(found: Matches, seen: View) -> NDArray[np.bool_]:
    """``(N,)`` which matches are within two pixels of where the walls are."""
    right: NDArray[np.bool_] = np.linalg.norm(moved(found.first_px, seen) - found.second_px, axis=1) <= 2.0
    return right


def disparity_px(points_px: Array, seen: View) -> Array:
    """``(N,)`` that a stereo pair would have there: f b / d, equation 10."""
    depth = scipy.ndimage.map_coordinates(seen.depth_m, points_px[:, ::-1].T, order=1, mode="nearest")
    found: Array = FOCAL_PX * BASELINE_M / depth
    return found
