"""Which frames of a camera become keyframes."""

from __future__ import annotations

import numpy as np

from graphnav._schema import Array
from graphnav.log import StereoTracks


def view_times(tracks: StereoTracks, moved_px: float, shared: float) -> Array:
    """Times of the frames to take as keyframes: where the picture has changed since the one before.

    The first and the last frame, and every frame whose features have moved by more than `moved_px` (median) since the
    last one taken, or fewer than a share `shared` of whose features are still seen. At rest there are none between.
    """
    edges = np.flatnonzero(np.diff(tracks.t_s, prepend=-np.inf))
    ends = np.append(edges[1:], len(tracks))
    taken = [0]
    last = slice(edges[0], ends[0])
    for frame in range(1, len(edges)):
        now = slice(edges[frame], ends[frame])
        _, one, two = np.intersect1d(tracks.track[last], tracks.track[now], return_indices=True)
        moved = np.hypot(
            tracks.u_left_px[last][one] - tracks.u_left_px[now][two], tracks.v_px[last][one] - tracks.v_px[now][two]
        )
        if len(one) < shared * (last.stop - last.start) or np.median(moved) > moved_px:
            # the frame before still shares more: take it, unless it is the one taken last
            frame = max(frame - 1, taken[-1] + 1) if len(one) < shared * (last.stop - last.start) else frame
            taken.append(frame)
            last = slice(edges[frame], ends[frame])
    if taken[-1] != len(edges) - 1:
        taken.append(len(edges) - 1)
    return np.asarray(tracks.t_s[edges[taken]])
