"""The light that reaches each pixel: rays to a box with arches, textures, lamps and dust, compiled.

Rays are cut with planes in closed form. Where neighbouring pixels see different surfaces, four rays a pixel smooth the
rim; within a surface the texture's reduction to the pixel's footprint does.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from graphnav.baselines._compiled import compiled
from graphnav.simulation.ripmap import ACROSS_LEVELS, ALONG_LEVELS
from graphnav.simulation.roadway_surfaces import ARCH_LEFT, FACE, FLOOR, ROOF, SIDE_LEFT

# Inside compiled code the surfaces of one kind are counted from the one on the left: left, right, roof.


@compiled
def trace(box: Any, p: Any, dx: float, dy: float, dz: float) -> tuple[int, int, float]:
    """The surface that a ray from `p` meets first, its arch (0 for none) and how many times ``d`` it is away."""
    inf = np.inf
    wall = inf if dx == 0 else ((box.right if dx > 0 else box.left) - p[0]) / dx
    level = inf if dz == 0 else ((box.roof if dz > 0 else box.floor) - p[2]) / dz
    end = inf if dy == 0 else ((box.face if dy > 0 else box.back) - p[1]) / dy
    inner_wall = inf if dx == 0 else wall - box.depth / abs(dx)
    inner_level = level - box.depth / dz if dz > 0 else level
    inner = min(inner_wall, inner_level)
    if end <= inner:
        return FACE, 0, end
    if inner_level <= inner_wall and dz < 0:
        return FLOOR, 0, level
    side = 2 if inner_level <= inner_wall else (1 if dx > 0 else 0)
    along = p[1] + inner * dy - box.back
    number = math.floor(along / box.spacing)
    if 1 <= number <= box.arches and along - number * box.spacing < box.width:
        return ARCH_LEFT + side, number, inner
    outer = min(wall, level, end)
    arch = number + 1 if dy > 0 else number
    if dy != 0 and 1 <= arch <= box.arches:
        near = box.back + arch * box.spacing + (0.0 if dy > 0 else box.width)
        there = (near - p[1]) / dy
        if there < outer:
            x = p[0] + there * dx
            side = 0 if x < box.left + box.depth else (1 if x > box.right - box.depth else 2)
            return SIDE_LEFT + side, arch, there
    if end <= wall and end <= level:
        return FACE, 0, end
    if level <= wall:
        return (ROOF if dz > 0 else FLOOR), 0, level
    return (1 if dx > 0 else 0), 0, wall


@compiled
def _lookup(maps: Any, surface: int, along: float, across: float, wide: float, high: float) -> float:
    """Texture at a point (texels) over a footprint (texels): linear between texels and between reductions."""
    level = min(max(math.log2(wide), 0.0), ALONG_LEVELS - 1.001) if wide > 1 else 0.0
    up = min(max(math.log2(high), 0.0), ACROSS_LEVELS - 1.001) if high > 1 else 0.0
    i0, j0 = int(level), int(up)
    total = 0.0
    for i in range(2):
        share_i = level - i0 if i else 1 - (level - i0)
        x = along / (1 << (i0 + i)) - 0.5
        for j in range(2):
            share = share_i * (up - j0 if j else 1 - (up - j0))
            if share < 1e-3:
                continue
            y = across / (1 << (j0 + j)) - 0.5
            start = maps.start[surface, i0 + i, j0 + j]
            rows, columns = maps.rows[surface, i0 + i, j0 + j], maps.columns[surface, i0 + i, j0 + j]
            xc, yc = min(max(x, 0.0), columns - 1.001), min(max(y, 0.0), rows - 1.001)
            c, r = int(xc), int(yc)
            a, b = xc - c, yc - r
            k = start + r * columns + c
            top = (1 - a) * maps.texels[k] + a * maps.texels[k + 1]
            k += columns
            low = (1 - a) * maps.texels[k] + a * maps.texels[k + 1]
            total += share * ((1 - b) * top + b * low)
    return total / 255


@compiled
def _axes(surface: int) -> tuple[int, int, int]:
    """Axis of n along a surface's normal, along its first and along its second texture coordinate."""
    if surface == FACE:
        return 1, 0, 2
    if surface in (FLOOR, ROOF):
        return 2, 1, 0
    if surface < FACE:
        return 0, 1, 2
    side = (surface - ARCH_LEFT) % 3
    if surface < SIDE_LEFT:
        return (2, 1, 0) if side == 2 else (0, 1, 2)
    return (1, 2, 0) if side == 2 else (1, 0, 2)


@compiled
def _radiance(scene: Any, p: Any, rot: Any, focal: float, x: float, y: float, shift: float) -> tuple[int, float, float]:
    """What a ray of the camera sees: key of surface and arch, depth (m), light.

    `x`, `y` : the ray's direction ``(x, y, 1)`` in the camera; `shift` : of the camera from the left one, to the right.
    """
    box, maps = scene.box, scene.maps
    dx = rot[0, 0] * x + rot[0, 1] * y + rot[0, 2]
    dy = rot[1, 0] * x + rot[1, 1] * y + rot[1, 2]
    dz = rot[2, 0] * x + rot[2, 1] * y + rot[2, 2]
    surface, arch, t = trace(box, p, dx, dy, dz)
    n, i, j = _axes(surface)
    d = (dx, dy, dz)
    low = (box.left, box.back, box.floor)
    along, across = p[i] + t * d[i] - low[i], p[j] + t * d[j] - low[j]
    # the texture's shift by a pixel to the right and by a pixel down
    s = t / focal
    ur, ud = s * (rot[i, 0] - d[i] * rot[n, 0] / d[n]), s * (rot[i, 1] - d[i] * rot[n, 1] / d[n])
    vr, vd = s * (rot[j, 0] - d[j] * rot[n, 0] / d[n]), s * (rot[j, 1] - d[j] * rot[n, 1] / d[n])
    if surface >= SIDE_LEFT:
        right, top = surface == SIDE_LEFT + 1, surface == SIDE_LEFT + 2
        if right:
            along = box.right - p[i] - t * d[i]
        if top:
            along = box.roof - p[i] - t * d[i]
        along += arch * box.depth
    elif surface >= ARCH_LEFT:
        along += arch * (box.width - box.spacing)
    texel = scene.texel
    wide, high = math.sqrt(ur * ur + ud * ud) / texel, math.sqrt(vr * vr + vd * vd) / texel
    albedo = _lookup(maps, surface, along / texel, across / texel, wide, high)
    lit = scene.ambient
    xc, yc = t * x + shift, t * y
    for k in range(len(scene.lamps)):
        lamp = scene.lamps[k]
        lx, ly, lz = xc - lamp[0], yc - lamp[1], t - lamp[2]
        r2 = lx * lx + ly * ly + lz * lz
        r = math.sqrt(r2)
        cosine = (lamp[3] * lx + lamp[4] * ly + lamp[5] * lz) / r
        facing = abs(rot[n, 0] * lx + rot[n, 1] * ly + rot[n, 2] * lz) / r
        lit += lamp[6] * facing / r2 * math.exp((cosine - 1) * lamp[7] - scene.lamp_loss * r)
    away = t * math.sqrt(x * x + y * y + 1)
    return surface + 16 * arch, t, albedo * lit * math.exp(-scene.loss * away)


@compiled
def cast(scene: Any, p: Any, rot: Any, camera: Any, light: Any, depth: Any) -> None:
    """Fill the images `light` and `depth` (m) as seen from `p` with attitude `rot` (n from c).

    `camera` : focal length, centre x, centre y (px), shift from the left camera (m).
    """
    focal, cx, cy, shift = camera
    rows, columns = light.shape
    key = np.empty((rows, columns), np.int16)
    for v in range(rows):
        for u in range(columns):
            found = _radiance(scene, p, rot, focal, (u - cx) / focal, (v - cy) / focal, shift)
            key[v, u], depth[v, u], light[v, u] = found[0], found[1], found[2]
    for v in range(rows):
        for u in range(columns):
            k = key[v, u]
            same = k == key[max(v - 1, 0), u] and k == key[min(v + 1, rows - 1), u]
            if same and k == key[v, max(u - 1, 0)] and k == key[v, min(u + 1, columns - 1)]:
                continue
            total = 0.0
            for q in range(4):
                a, b = (q % 2) - 0.5, (q // 2) - 0.5
                du, dv = 0.5 * a + 0.25 * b, 0.5 * b - 0.25 * a
                total += _radiance(scene, p, rot, focal, (u + du - cx) / focal, (v + dv - cy) / focal, shift)[2]
            light[v, u] = total / 4
