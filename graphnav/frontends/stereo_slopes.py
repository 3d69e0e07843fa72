"""How disparity changes around features: walls are seen at a slant, so that a patch is not of one disparity.

The neighbours of a feature tell: through their disparities goes a plane, fitted so that those far away or on another
surface count for little (Gauss, Huber), and drawn towards no slope where there are few.
"""

from __future__ import annotations

import numpy as np

from graphnav.frontends.stereo_features import Places

#: Neighbours that are asked, the feature itself among them, how far they may be, and over what distance they fade.
_NEIGHBOURS, _REACH_PX, _FADE_PX = 13, 40.0, 12.0
#: Error of a disparity beyond which it counts less, and slopes that are usual, px per px.
_ERROR_PX, _USUAL = 0.15, 0.05
_ROUNDS = 4


def slopes(uv_px: Places, disparity_px: Places) -> Places:
    """Change of disparity per pixel to the right and down ``(N, 2)`` around features at `uv_px` (N, 2)."""
    if not len(uv_px):
        return np.zeros((0, 2))
    from scipy.spatial import cKDTree

    far, rows = cKDTree(uv_px).query(uv_px, min(_NEIGHBOURS, len(uv_px)), distance_upper_bound=_REACH_PX)
    far, rows = far.reshape(len(uv_px), -1), rows.reshape(len(uv_px), -1)
    none = ~np.isfinite(far)
    near = np.exp(-0.5 * (np.where(none, np.inf, far) / _FADE_PX) ** 2)
    rows = np.where(none, 0, rows)
    apart = uv_px[rows] - uv_px[:, None]
    return _fitted(apart, disparity_px[rows] - disparity_px[:, None], near)


def _fitted(apart: Places, change: Places, near: Places) -> Places:
    """Robust planes ``change = c + g . apart`` over neighbours with the weight `near`, all ``(N, K)``; their g (N, 2)."""
    terms = np.concatenate([np.ones_like(change)[..., None], apart], axis=2)
    prior = np.diag([0.0, *[(_ERROR_PX / _USUAL) ** 2] * 2])
    weight = near
    plane = np.zeros((len(change), 3))
    for _ in range(_ROUNDS):
        weighed = terms * weight[..., None]
        normal = np.swapaxes(weighed, 1, 2) @ terms + prior
        plane = np.linalg.solve(normal, (np.swapaxes(weighed, 1, 2) @ change[..., None]))[..., 0]
        off = np.abs(change - np.einsum("nki,ni->nk", terms, plane))
        weight = near / np.maximum(1.0, off / _ERROR_PX)
    return plane[:, 1:]
