"""Synthetic dark and dusty images whose light, dust and reflectance are known."""

from __future__ import annotations

import numpy as np
import scipy.ndimage

from graphnav.frontends._opencv import Image

SHAPE = (240, 424)


def texture(seed: int = 0, shape: tuple[int, int] = SHAPE) -> np.ndarray:
    """Reflectance from 0 to 1 with the same contrast all over, and something black in every window."""
    noise = np.random.default_rng(seed).standard_normal(shape)
    field = scipy.ndimage.gaussian_filter(noise, 1.5) + scipy.ndimage.gaussian_filter(noise[::-1], 3.0)
    field /= field.std()
    return np.clip(0.5 + 0.25 * field, 0.0, 1.0)


def headlight(shape: tuple[int, int] = SHAPE, brightest: float = 200.0, darkest: float = 8.0) -> np.ndarray:
    """Illumination that falls off smoothly from one side, grey levels."""
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    apart = np.hypot((columns - 0.2 * shape[1]) / shape[1], (rows - 0.5 * shape[0]) / shape[1])
    return darkest + (brightest - darkest) * np.exp(-((apart / 0.3) ** 2))


def clear_share(shape: tuple[int, int] = SHAPE) -> np.ndarray:
    """Omega of equation 4: 1 on the left, 0.25 on the right."""
    across = np.linspace(0.0, 1.0, shape[1])
    return np.broadcast_to(1.0 - 0.75 * across**2, shape)


def seen(light: np.ndarray, seed: int | None = None, read: float = 1.0, shot: float = 0.05) -> Image:
    """Rounded to a camera's grey levels; with a seed its noise too, of variance ``read^2 + shot * level``."""
    if seed is not None:
        noise = np.random.default_rng(seed).standard_normal(light.shape)
        light = light + np.sqrt(read**2 + shot * light) * noise
    return np.clip(np.rint(light), 0, 255).astype(np.uint8)


def correlation(first: np.ndarray, second: np.ndarray) -> float:
    return float(np.corrcoef(first.ravel(), second.ravel())[0, 1])
