"""Headlamps and dust for the ray caster: the lamps' figures, and the light that dust scatters back into each pixel."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from graphnav.simulation.ray_caster import AIR_HALF_M
from graphnav.simulation.roadheader_figures import CameraSpec, LightSpec

Array = npt.NDArray[np.float64]

_KNOTS = 21
_STEP_PX = 4
_FAR_M = 200.0


def lamp_rows(light: LightSpec) -> Array:
    """``(L, 8)``: place, unit vector of the aim (left camera), power, and 1 / spread^2 of ``exp((cos - 1) / s^2)``."""
    rows = []
    for lamp in light.lamps:
        aim = np.array(lamp.aim_c) / np.linalg.norm(lamp.aim_c)
        rows.append([*lamp.place_c_m, *aim, lamp.power, np.deg2rad(lamp.spread_deg) ** -2])
    return np.array(rows)


def irradiance(light: LightSpec, points_c: Array) -> Array:
    """Light at points ``(..., 3)`` of the left camera's frame; times a plate's normal, what it gets.

    Each lamp adds what falls on a plate that faces it, along the way to it.
    """
    total = np.zeros(points_c.shape)
    loss = light.lamp_share * light.extinction_1_m
    for row in lamp_rows(light):
        ray = points_c - row[:3]
        r = np.linalg.norm(ray, axis=-1, keepdims=True)
        total -= row[6] * ray / r**3 * np.exp((ray @ row[3:6, None] / r - 1) * row[7] - loss * r)
    return total


def glow(light: LightSpec, camera: CameraSpec, shift_m: float) -> npt.NDArray[np.float32]:
    """What lamps and dust make of each pixel of one camera at each depth, ``(height, width, knots, 4)``.

    Lamps and camera ride on the same machine, so that it is always the same. First `irradiance`, as it arrives from
    there and times ``(t + AIR_HALF_M)^2`` (which makes it nearly straight between the knots). Last, airlight: single
    scattering, the integral over the ray of what the lamps send to each point of it, times `backscatter` and the
    extinction, less what the way back to the camera takes. Found on every fourth pixel.
    """
    u, v = (np.arange(0, size + _STEP_PX, _STEP_PX) for size in (camera.width_px, camera.height_px))
    x = (u - (camera.width_px - 1) / 2) / camera.focal_px
    y = (v - (camera.height_px - 1) / 2) / camera.focal_px
    rays = np.stack([*np.meshgrid(x, y), np.ones((len(y), len(x)))], axis=-1)
    length = np.linalg.norm(rays, axis=-1, keepdims=True)

    def arriving(t: float) -> Array:
        found: Array = irradiance(light, t * rays + [shift_m, 0.0, 0.0]) * np.exp(-light.extinction_1_m * t * length)
        return found

    share = np.linspace(0, 1, 8 * (_KNOTS - 1) + 1)
    depth = np.minimum(AIR_HALF_M * share / np.maximum(1 - share, 1e-9), _FAR_M)
    knots = [arriving(t) * (t + AIR_HALF_M) ** 2 for t in depth[::8]]
    source = light.backscatter * light.extinction_1_m * length[..., 0]
    middle, steps = (depth[1:] + depth[:-1]) / 2, np.diff(depth)
    parts = [step * source * np.linalg.norm(arriving(t), axis=-1) for t, step in zip(middle, steps, strict=True)]
    air = np.concatenate([np.zeros((1, *source.shape)), np.cumsum(parts, axis=0)])[::8]
    table = np.concatenate([np.stack(knots, axis=2), np.moveaxis(air, 0, 2)[..., None]], axis=-1).astype(np.float32)
    return _refined(_refined(table, camera.height_px, 0), camera.width_px, 1)


def _refined(table: npt.NDArray[np.float32], size: int, axis: int) -> npt.NDArray[np.float32]:
    """Linear between every fourth row (column)."""
    places = np.arange(size) / _STEP_PX
    first = places.astype(int)
    other = tuple(a for a in range(table.ndim) if a != axis)
    share = np.expand_dims(places - first, other).astype(np.float32)
    low, high = np.take(table, first, axis), np.take(table, first + 1, axis)
    refined: npt.NDArray[np.float32] = low + share * (high - low)
    return refined
