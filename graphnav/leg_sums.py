"""The loops of `graphnav.leg_means` over detections, compiled: millions of them.

They let go of the interpreter, so that blocks of detections are brought together side by side. Imported where they are
called: the compiler takes a third of a second to import.
"""

from __future__ import annotations

import math

import numpy as np

from factors.compilation import compiled
from factors.increments import npt_int
from factors.so3 import Array


@compiled
def rows_of(sorted_names: npt_int, wanted: npt_int) -> npt_int:
    """Where each of the wanted names stands, all of which are there; fast where one scan is as the one before."""
    found = np.empty(len(wanted), np.int64)
    count, at = len(sorted_names), -1
    for k in range(len(wanted)):
        at += 1
        if at >= count or sorted_names[at] != wanted[k]:
            at = np.searchsorted(sorted_names, wanted[k])
        found[k] = at
    return found


@compiled
def on_the_ground(
    start: npt_int, scan: npt_int, range_m: Array, angle_rad: Array, frame: Array, scanner_n: Array
) -> tuple[Array, Array]:
    """Mean place of every group in n and what seven errors of the scanner make of it, and the place of every detection.

    Along the ray u, in the scan plane to its left (w) and up from the plane (n) the errors act as `spread` says:
    ``r u, u, -r w, -r t w, -r t^2 w, -r cos(t) n, -r sin(t) n`` at the range r and the angle t.

    Parameters
    ----------
    start : (G + 1,) group g is the rows ``start[g]`` to ``start[g + 1]``.
    scan, range_m, angle_rad : (M,) pose, range and angle of each detection.
    frame, scanner_n : (T, 3, 3), (T, 3) attitude of the scanner, n <- s (right, forward, up), and its place.

    Returns
    -------
    Means (G, 8, 3), the place first; places (M, 3).
    """
    groups = len(start) - 1
    means, place = np.zeros((groups, 8, 3)), np.empty((len(range_m), 3))
    for g in range(groups):
        found = means[g]
        for k in range(start[g], start[g + 1]):
            axes, origin, r, t = frame[scan[k]], scanner_n[scan[k]], range_m[k], angle_rad[k]
            sin, cos = math.sin(t), math.cos(t)
            for i in range(3):
                u = cos * axes[i, 1] - sin * axes[i, 0]
                left = -r * (-cos * axes[i, 0] - sin * axes[i, 1])
                up = -r * axes[i, 2]
                place[k, i] = origin[i] + r * u
                found[0, i] += place[k, i]
                found[1, i] += r * u
                found[2, i] += u
                found[3, i] += left
                found[4, i] += left * t
                found[5, i] += left * t * t
                found[6, i] += up * cos
                found[7, i] += up * sin
        for e in range(8):
            for i in range(3):
                found[e, i] /= start[g + 1] - start[g]
    return means, place


@compiled
def scatter(start: npt_int, place: Array) -> Array:
    """Mean square (G,) of the level distance of each group's places (M, 3) from their mean."""
    found = np.empty(len(start) - 1)
    for g in range(len(found)):
        rows = place[start[g] : start[g + 1]]
        x, y, total = 0.0, 0.0, 0.0
        for k in range(len(rows)):
            x, y = x + rows[k, 0], y + rows[k, 1]
        x, y = x / len(rows), y / len(rows)
        for k in range(len(rows)):
            total += (rows[k, 0] - x) ** 2 + (rows[k, 1] - y) ** 2
        found[g] = total / len(rows)
    return found
