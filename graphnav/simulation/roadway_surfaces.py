"""The roadway's surfaces: a box with arches, as the ray caster knows them.

A texture coordinate is a length on the surface itself: along the roadway from its back end, and up from the floor (or
across from the left wall). The faces of all arches on one side share a texture, one strip of it for each arch.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from graphnav.simulation.roadheader_figures import RoadwaySpec

LEFT, RIGHT, FLOOR, ROOF, FACE, ARCH_LEFT, ARCH_RIGHT, ARCH_ROOF, SIDE_LEFT, SIDE_RIGHT, SIDE_ROOF = range(11)
COUNT = 11


class Box(NamedTuple):
    """`RoadwaySpec` as plain numbers; m in n. Compiled code gets it as a tuple, whose cache outlives this class."""

    left: float
    right: float
    floor: float
    roof: float
    back: float
    face: float
    spacing: float
    width: float
    depth: float
    arches: float  # how many


def box(spec: RoadwaySpec) -> Box:
    """The box; its first arch stands one spacing ahead of the back end, the last one before the face."""
    length = spec.face_m - spec.back_m
    return Box(
        -spec.half_width_m,
        spec.half_width_m,
        spec.floor_m,
        spec.roof_m,
        spec.back_m,
        spec.face_m,
        spec.arch_spacing_m,
        spec.arch_width_m,
        spec.arch_depth_m,
        float(np.floor((length - spec.arch_width_m) / spec.arch_spacing_m - 1e-9)),
    )


def extent_m(spec: RoadwaySpec, surface: int) -> tuple[float, float]:
    """Size of a surface's texture along its two coordinates."""
    length, height, width = spec.face_m - spec.back_m, spec.roof_m - spec.floor_m, 2 * spec.half_width_m
    arches = box(spec).arches + 1
    along = {
        FACE: width,
        **dict.fromkeys((ARCH_LEFT, ARCH_RIGHT, ARCH_ROOF), arches * spec.arch_width_m),
        **dict.fromkeys((SIDE_LEFT, SIDE_RIGHT, SIDE_ROOF), arches * spec.arch_depth_m),
    }
    across = width if surface in (FLOOR, ROOF, ARCH_ROOF, SIDE_ROOF) else height
    return along.get(surface, length), across
