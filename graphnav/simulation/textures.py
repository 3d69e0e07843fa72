"""What the roadway's surfaces look like: rock and coal with cracks, mesh, bolts, cables, rubble and rusty arches.

A texture is the share of light that a surface gives back, ``(across, along)`` in texels of equal size.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from graphnav.simulation import roadway_surfaces as on
from graphnav.simulation.roadheader_figures import RoadwaySpec

Image = npt.NDArray[np.float32]

TEXEL_M = 0.006


def textures(spec: RoadwaySpec, rng: np.random.Generator) -> list[Image]:
    """One texture for every surface, in their order; each has a random stream of its own."""
    return [_texture(spec, surface, stream) for surface, stream in enumerate(rng.spawn(on.COUNT))]


def _texture(spec: RoadwaySpec, surface: int, rng: np.random.Generator) -> Image:
    along, across = (round(size / TEXEL_M) for size in on.extent_m(spec, surface))
    shape = (across, along)
    if surface >= on.ARCH_LEFT:
        image = _steel(shape, rng)
    elif surface == on.FLOOR:
        image = _rubble(shape, rng)
    else:
        image = _rock(shape, rng, strata=surface != on.ROOF)
        if surface == on.FACE:
            _grooves(image, rng)
        if surface != on.FACE:
            _mesh(image, rng)
            _plates(image, spec, rng)
        if surface == on.LEFT:
            _cables(image, rng)
    return np.clip(image, 0.01, 1.0)


def noise(
    shape: tuple[int, int], rng: np.random.Generator, slope: float, longest_m: float, stretch: float = 1.0
) -> Image:
    """A random field of unit variance whose amplitude falls with frequency to the power `slope`.

    Wavelengths above `longest_m` are not emphasised further; along the roadway they are `stretch` times as long.
    """
    from scipy import fft

    spectrum = fft.rfft2(rng.standard_normal(shape, dtype=np.float32), workers=1)
    up = fft.fftfreq(shape[0], TEXEL_M)[:, None]
    along = fft.rfftfreq(shape[1], TEXEL_M)[None] * stretch
    frequency = np.sqrt(up**2 + along**2 + longest_m**-2)
    spectrum *= (frequency**-slope).astype(np.float32)
    spectrum[0, 0] = 0.0
    field: Image = fft.irfft2(spectrum, s=shape, workers=1)
    field /= field.std()
    return field


def _rock(shape: tuple[int, int], rng: np.random.Generator, strata: bool) -> Image:
    """Blotches with sharp rims, fine grain, dark cracks, and layers of coal and stone where they are cut across."""
    blotches = np.tanh(6 * noise(shape, rng, 2.0, 0.35, 1.4))
    chips = np.tanh(5 * noise(shape, rng, 1.6, 0.08))
    grain = noise(shape, rng, 0.8, 0.2)
    cracks = np.exp(-((noise(shape, rng, 1.9, 0.6, 2.0) / 0.03) ** 2))
    image = 0.2 * np.exp(0.3 * blotches + 0.25 * chips + 0.4 * grain) * (1 - 0.8 * cracks)
    if strata:
        height = np.arange(shape[0]) * TEXEL_M
        layers = np.interp(height, np.linspace(0, height[-1], 14), rng.uniform(-1, 1, 14))
        waviness = 30 * noise(shape, rng, 2.5, 4.0)[shape[0] // 2]
        rows = np.arange(shape[0])[:, None] + waviness.astype(int)[None]
        image *= np.exp(0.6 * np.sign(layers) * np.abs(layers) ** 0.5)[np.clip(rows, 0, shape[0] - 1)]
    rock: Image = image.astype(np.float32)
    return rock


def _rubble(shape: tuple[int, int], rng: np.random.Generator) -> Image:
    """Dark mud with lighter stones."""
    mud = 0.17 * np.exp(0.35 * noise(shape, rng, 1.6, 1.0))
    stones = noise(shape, rng, 2.4, 0.09)
    lit = 0.42 * np.exp(0.5 * noise(shape, rng, 2.0, 0.12))
    share = np.clip((stones - 0.9) * 6, 0, 1)
    rim = np.exp(-(((stones - 0.9) / 0.12) ** 2))
    image: Image = (((1 - share) * mud + share * lit) * (1 - 0.6 * rim)).astype(np.float32)
    return image


def _steel(shape: tuple[int, int], rng: np.random.Generator) -> Image:
    """Grey with rust and dust."""
    rust = np.tanh(3 * noise(shape, rng, 1.8, 0.3))
    image: Image = (0.42 * np.exp(0.3 * rust + 0.25 * noise(shape, rng, 1.0, 0.2))).astype(np.float32)
    return image


def _grooves(image: Image, rng: np.random.Generator) -> None:
    """Arcs that the picks of the cutting head have left in the face."""
    up, along = (np.arange(size, dtype=np.float32) * TEXEL_M for size in image.shape)
    for _ in range(28):
        centre, radius = rng.uniform([0, -1.5], [4, 5]), rng.uniform(0.5, 1.6)
        away = np.hypot(along[None] - centre[0], up[:, None] - centre[1]) - radius
        image *= 1 - 0.55 * np.exp(-((away / 0.015) ** 2)) + 0.3 * np.exp(-(((away - 0.03) / 0.015) ** 2))


def _mesh(image: Image, rng: np.random.Generator) -> None:
    """Welded wire at every 10 cm, patchily covered with dust, on all but the lowest metre and a half."""
    bare = 0.5 + 0.5 * np.tanh(2 * noise(image.shape, rng, 2.0, 1.0))
    step, wire = 0.1 / TEXEL_M, 1
    first = round(1.5 / TEXEL_M)
    mask = np.zeros(image.shape, bool)
    for line in np.arange(first, image.shape[0] - 1, step):
        mask[round(line) : round(line) + wire] = True
    for line in np.arange(0, image.shape[1] - 1, step):
        mask[first:, round(line) : round(line) + wire] = True
    image[mask] += (0.45 * bare)[mask]


def _plates(image: Image, spec: RoadwaySpec, rng: np.random.Generator) -> None:
    """Bolts' plates midway between the arches, 80 cm apart, with a dark nut; a few are missing."""
    half, nut = round(0.075 / TEXEL_M), round(0.02 / TEXEL_M)
    for along_m in np.arange(0.5, image.shape[1] * TEXEL_M - 0.2, spec.arch_spacing_m):
        for across_m in np.arange(0.5, image.shape[0] * TEXEL_M - 0.2, 0.8):
            i, j = (round((c + rng.uniform(-0.08, 0.08)) / TEXEL_M) for c in (across_m, along_m))
            if rng.random() < 0.15:
                continue
            image[i - half : i + half, j - half : j + half] = rng.uniform(0.35, 0.75)
            image[i - nut : i + nut, j - nut : j + nut] = 0.05


def _cables(image: Image, rng: np.random.Generator) -> None:
    """Three cables along the left wall, hung up at every 2 m."""
    along = np.arange(image.shape[1]) * TEXEL_M
    for height_m, bright in ((2.1, 0.05), (2.22, 0.5), (2.34, 0.08)):
        sag = (0.1 + 0.02 * rng.standard_normal()) * np.sin(np.pi * along / 2.0) ** 2
        rows = np.round((height_m - sag) / TEXEL_M).astype(int)
        for offset in range(-3, 4):
            image[rows + offset, np.arange(image.shape[1])] = bright * (1 - 0.1 * abs(offset))
