"""The light that reaches each pixel: rays to a box with arches, textures, lamps and dust, compiled.

Rays are cut with planes in closed form. Where neighbouring pixels see different surfaces, three rays a pixel smooth the
rim; within a surface the texture's reduction to the pixel's footprint does.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from graphnav.baselines._compiled import compiled, inlined
from graphnav.simulation.roadway_surfaces import ARCH_LEFT, FACE, FLOOR, ROOF, SIDE_LEFT

# The cache of compiled code looks at this file alone: constants of others have to be among the arguments.
AIR_HALF_M = 2.0  # light is tabulated over ``t / (t + AIR_HALF_M)`` for depth t: 0 at the camera, 1 far away
_SIGHT_M = 12.0  # at 15 m visibility a wall farther away gives less than half an electron: no need to look closely
_DIM = 0.25
_APART_PX = 1 / 3
_RIM_M = 8.0  # and 5 electrons, where the dust in front of it gives 60: its rims are lost in noise of 9

# Inside compiled code the surfaces of one kind are counted from the one on the left: left, right, roof.


@inlined
def trace(box: Any, p: Any, dx: float, dy: float, dz: float) -> tuple[int, int, float]:
    """The surface that a ray from `p` meets first, its arch (0 for none) and how many times ``d`` it is away."""
    left, right, floor, roof, back, face, spacing, width, depth, arches = box
    inf = np.inf
    wall = inf if dx == 0 else ((right if dx > 0 else left) - p[0]) / dx
    level = inf if dz == 0 else ((roof if dz > 0 else floor) - p[2]) / dz
    end = inf if dy == 0 else ((face if dy > 0 else back) - p[1]) / dy
    inner_wall = inf if dx == 0 else wall - depth / abs(dx)
    inner_level = level - depth / dz if dz > 0 else level
    inner = min(inner_wall, inner_level)
    if end <= inner:
        return FACE, 0, end
    if inner_level <= inner_wall and dz < 0:
        return FLOOR, 0, level
    side = 2 if inner_level <= inner_wall else (1 if dx > 0 else 0)
    along = p[1] + inner * dy - back
    number = math.floor(along / spacing)
    if 1 <= number <= arches and along - number * spacing < width:
        return ARCH_LEFT + side, number, inner
    outer = min(wall, level, end)
    arch = number + 1 if dy > 0 else number
    if dy != 0 and 1 <= arch <= arches:
        near = back + arch * spacing + (0.0 if dy > 0 else width)
        there = (near - p[1]) / dy
        if there < outer:
            x = p[0] + there * dx
            side = 0 if x < left + depth else (1 if x > right - depth else 2)
            return SIDE_LEFT + side, arch, there
    if end <= wall and end <= level:
        return FACE, 0, end
    if level <= wall:
        return (ROOF if dz > 0 else FLOOR), 0, level
    return (1 if dx > 0 else 0), 0, wall


@inlined
def _level(texels: float, levels: int) -> tuple[int, float]:
    """The reduction for a footprint and the share of the next one: nearly its logarithm to two."""
    level = 0
    while texels > 2 and level < levels - 2:
        texels *= 0.5
        level += 1
    return level, (0.0 if texels < 1 else (1.0 if texels > 2 else texels - 1))


@inlined
def _bilinear(texels: Any, start: int, rows: int, columns: int, x: float, y: float) -> float:
    x = 0.0 if x < 0 else (columns - 1.001 if x > columns - 1.001 else x)
    y = 0.0 if y < 0 else (rows - 1.001 if y > rows - 1.001 else y)
    c, r = int(x), int(y)
    a, b = x - c, y - r
    k = start + r * columns + c
    top = texels[k] + a * (float(texels[k + 1]) - texels[k])
    k += columns
    low = texels[k] + a * (float(texels[k + 1]) - texels[k])
    found: float = top + b * (low - top)
    return found


@inlined
def _lookup(texels: Any, place: Any, surface: int, along: float, across: float, wide: float, high: float) -> float:
    """Texture at a point (texels) over a footprint (texels): linear between texels and between reductions."""
    i, a = _level(wide, place.shape[1])
    j, b = _level(high, place.shape[2])
    x0, y0 = along / (1 << i), across / (1 << j)
    x1, y1 = 0.5 * x0 - 0.5, 0.5 * y0 - 0.5
    x0, y0 = x0 - 0.5, y0 - 0.5
    s, r, c = place[surface, i, j, 0], place[surface, i, j, 1], place[surface, i, j, 2]
    total = (1 - a) * (1 - b) * _bilinear(texels, s, r, c, x0, y0)
    if a > 0:
        s, r, c = place[surface, i + 1, j, 0], place[surface, i + 1, j, 1], place[surface, i + 1, j, 2]
        total += a * (1 - b) * _bilinear(texels, s, r, c, x1, y0)
    if b > 0:
        s, r, c = place[surface, i, j + 1, 0], place[surface, i, j + 1, 1], place[surface, i, j + 1, 2]
        total += (1 - a) * b * _bilinear(texels, s, r, c, x0, y1)
        if a > 0:
            s, r, c = place[surface, i + 1, j + 1, 0], place[surface, i + 1, j + 1, 1], place[surface, i + 1, j + 1, 2]
            total += a * b * _bilinear(texels, s, r, c, x1, y1)
    return total / 255


@inlined
def _seen(
    box: Any,
    texels: Any,
    place: Any,
    texel: float,
    p: Any,
    rot: Any,
    pixel: float,
    x: float,
    y: float,
    glow: Any,
    v: int,
    u: int,
) -> tuple[int, float, float, float]:
    """What a ray of the camera meets: key of surface and arch, depth (m), light from there, airlight.

    `x`, `y` : the ray's direction ``(x, y, 1)`` in the camera; `glow` : the pixel's row of `lamps.glow`.
    """
    dx = rot[0][0] * x + rot[0][1] * y + rot[0][2]
    dy = rot[1][0] * x + rot[1][1] * y + rot[1][2]
    dz = rot[2][0] * x + rot[2][1] * y + rot[2][2]
    surface, arch, t = trace(box, p, dx, dy, dz)
    x_axis, y_axis, z_axis = rot
    left, right, floor, roof, back, _, spacing, width, depth, _ = box
    # The axis of n along the surface's normal, and those along its texture: a row of `rot`, and place and ray along it.
    along, across = p[1] + t * dy - back, p[2] + t * dz - floor
    normal, first, second = x_axis, y_axis, z_axis
    dn, di, dj = dx, dy, dz
    if surface in (FLOOR, ROOF, ARCH_LEFT + 2):
        normal, second = z_axis, x_axis
        across, dn, dj = p[0] + t * dx - left, dz, dx
    elif surface == SIDE_LEFT + 2:
        normal, first, second = y_axis, z_axis, x_axis
        along, across = roof - p[2] - t * dz, p[0] + t * dx - left
        dn, di, dj = dy, dz, dx
    elif surface == FACE or surface >= SIDE_LEFT:
        normal, first = y_axis, x_axis
        along, dn, di = p[0] + t * dx - left, dy, dx
    # the texture's shift by a pixel to the right and by a pixel down
    s, q = t * pixel, 1 / dn
    nr, nd = normal[0] * q, normal[1] * q
    wide = s * (abs(first[0] - di * nr) + abs(first[1] - di * nd))
    high = s * (abs(second[0] - dj * nr) + abs(second[1] - dj * nd))
    if surface >= SIDE_LEFT:
        if surface == SIDE_LEFT + 1:
            along = right - left - along
        along += arch * depth
    elif surface >= ARCH_LEFT:
        along += arch * (width - spacing)
    albedo = _DIM
    if t < _SIGHT_M:
        albedo = _lookup(texels, place, surface, along / texel, across / texel, wide / texel, high / texel)
    far = 1 / (t + AIR_HALF_M)
    b = t * far * (glow.shape[2] - 1)
    k = int(b)
    b -= k
    a = 1 - b
    lit = normal[0] * (a * glow[v, u, k, 0] + b * glow[v, u, k + 1, 0])
    lit += normal[1] * (a * glow[v, u, k, 1] + b * glow[v, u, k + 1, 1])
    lit += normal[2] * (a * glow[v, u, k, 2] + b * glow[v, u, k + 1, 2])
    air = a * glow[v, u, k, 3] + b * glow[v, u, k + 1, 3]
    return surface + 16 * arch, t, albedo * abs(lit) * far * far, air


@compiled
def cast(
    box: Any,
    texels: Any,
    place: Any,
    texel: float,
    p: Any,
    rot: Any,
    camera: Any,
    glow: Any,
    light: Any,
    air: Any,
    depth: Any,
) -> None:
    """Fill the images `light` (from surfaces), `air` (from dust) and `depth` (m).

    They are those of a camera at `p` with attitude `rot` (n from c); `camera` : focal length and centre (px).
    """
    focal, cx, cy = camera
    pixel = 1 / focal
    rows, columns = light.shape
    key = np.empty((rows, columns), np.int16)
    for v in range(rows):
        y = (v - cy) * pixel
        for u in range(columns):
            found = _seen(box, texels, place, texel, p, rot, pixel, (u - cx) * pixel, y, glow, v, u)
            key[v, u], depth[v, u], light[v, u], air[v, u] = found
    for v in range(rows):
        for u in range(columns):
            rim, nearest = False, depth[v, u]
            for q in range(4):
                i = min(max(v + (q - 1) * (q % 2 == 0), 0), rows - 1)
                j = min(max(u + (q - 2) * (q % 2 == 1), 0), columns - 1)
                if key[i, j] != key[v, u]:
                    rim, nearest = True, min(nearest, depth[i, j])
            if not rim or nearest > _RIM_M:
                continue
            total, scattered = light[v, u], air[v, u]
            for side in range(-1, 2, 2):
                x, y = (u + side * _APART_PX - cx) * pixel, (v + side * _APART_PX - cy) * pixel
                found = _seen(box, texels, place, texel, p, rot, pixel, x, y, glow, v, u)
                total += found[2]
                scattered += found[3]
            light[v, u], air[v, u] = total / 3, scattered / 3
