"""Headlamps and dust for the ray caster: the lamps' figures, and the light that dust scatters back into each pixel."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from graphnav.simulation.roadheader_figures import CameraSpec, LightSpec

Array = npt.NDArray[np.float64]

#: Airlight is tabulated over ``t / (t + AIR_HALF_M)`` for depth t: 0 at the camera, 1 far away.
AIR_HALF_M, AIR_KNOTS = 2.0, 17
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
    """Light of all lamps at points ``(..., 3)`` of the left camera's frame, on a plate that faces each of them."""
    total = np.zeros(points_c.shape[:-1])
    loss = light.lamp_share * light.extinction_1_m
    for row in lamp_rows(light):
        ray = points_c - row[:3]
        r = np.linalg.norm(ray, axis=-1)
        total += row[6] / r**2 * np.exp((ray @ row[3:6] / r - 1) * row[7] - loss * r)
    return total


def airlight(light: LightSpec, camera: CameraSpec, shift_m: float) -> npt.NDArray[np.float32]:
    """Light scattered back on the way to each depth, ``(AIR_KNOTS, height, width)``.

    Single scattering: the integral of what the lamps send to each point of a ray, times `backscatter` and the
    extinction, less what the way back to the camera takes. It is found on every fourth pixel.
    """
    u, v = (np.arange(0, size + _STEP_PX, _STEP_PX) for size in (camera.width_px, camera.height_px))
    x = (u - (camera.width_px - 1) / 2) / camera.focal_px
    y = (v - (camera.height_px - 1) / 2) / camera.focal_px
    rays = np.stack([*np.meshgrid(x, y), np.ones((len(y), len(x)))], axis=-1)
    length = np.linalg.norm(rays, axis=-1)
    share = np.linspace(0, 1, 8 * (AIR_KNOTS - 1) + 1)
    depth = np.minimum(AIR_HALF_M * share / np.maximum(1 - share, 1e-9), _FAR_M)
    middle, steps = (depth[1:] + depth[:-1]) / 2, np.diff(depth)
    source = light.backscatter * light.extinction_1_m
    parts = [
        step * length * source * irradiance(light, t * rays + [shift_m, 0, 0]) * np.exp(-light.extinction_1_m * t * length)
        for t, step in zip(middle, steps, strict=True)
    ]
    table = np.concatenate([np.zeros((1, *length.shape)), np.cumsum(parts, axis=0)])[::8]
    return _refined(_refined(table, camera.height_px, 1), camera.width_px, 2).astype(np.float32)


def _refined(table: Array, size: int, axis: int) -> Array:
    """Linear between every fourth row (column)."""
    places = np.arange(size) / _STEP_PX
    first = places.astype(int)
    share = np.expand_dims(places - first, tuple(a for a in range(3) if a != axis))
    low, high = np.take(table, first, axis), np.take(table, first + 1, axis)
    refined: Array = low + share * (high - low)
    return refined
