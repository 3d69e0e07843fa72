"""From pairs to tracks: frame by frame the tracks are found again, the wrong ones dropped, and new ones begun.

A place that was proposed (`stereo_following`) is brought to a fraction of a pixel by correlation with the patch at the
track's first sight, in the left and along the row in the right image. What then does not fit the motion of a camera
past points at rest is dropped (RANSAC over three points each). A track that is lost ends: a feature that comes back
later gets a new number, so that a number never stands for two points.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from graphnav.frontends.patch_alignment import aligned, patches, smoothed
from graphnav.frontends.stereo_features import Places, Whole, cell_of, most_per_cell, rank_within
from graphnav.frontends.stereo_following import Flow, Proposal, by_descriptors
from graphnav.frontends.stereo_sides import LEAST_SIMILARITY, MOST_SHIFT_PX, PairWork, Sides
from graphnav.frontends.stereo_state import TrackState
from graphnav.frontends.stereo_step import Step, step
from graphnav.frontends.stereo_warp import Planes, Warps, planes, warps
from graphnav.log import Stereo

if TYPE_CHECKING:
    from graphnav.config import StereoTracksConfig

#: Frames for which a track with a descriptor may be unseen.
_MOST_MISSED = 3
#: New features keep this distance from those that are followed, about.
_APART_PX = 6.0
#: Disparities that differ by more from what the motion makes of the first one: it is the disparity that is believed.
_MOST_OFF = 0.1


@dataclass(frozen=True)
class Sight:
    """Tracks seen in one frame: numbers, and places (N, 2) in the left and (N,) in the right image."""

    t_s: float
    track: Whole
    uv_px: Places
    u_right_px: Places


class Linker:
    """Follows features through the pairs that it is given one after another."""

    def __init__(self, work: PairWork, camera: Stereo) -> None:
        self._work, self._camera = work, camera
        self._flow = Flow()
        self._tracks: TrackState | None = None
        self._next = 1
        self._rotation, self._pos_m = np.eye(3), np.zeros(3)

    @property
    def _settings(self) -> StereoTracksConfig:
        return self._work.settings

    def __call__(self, sides: Sides) -> Sight:
        """The tracks in the next pair."""
        smooth = smoothed(sides.left) if self._settings.subpixel else None
        tracks = self._followed(sides, smooth)
        new = self._begun(sides, tracks, smooth)
        self._tracks = new if tracks is None else tracks.joined(new)
        seen = self._tracks.missed == 0
        shown = self._tracks.take(seen)
        return Sight(sides.t_s, shown.track, shown.uv_px, shown.u_right_px)

    def _followed(self, sides: Sides, smooth: npt.NDArray[np.float32] | None) -> TrackState | None:
        """Tracks of the last pair in the new one, with those that may yet come back."""
        if self._tracks is None:
            self._flow.see(sides)
            return None
        tracks, flow = self._tracks, self._settings.follow == "flow"
        found = self._flow(tracks, sides) if flow else by_descriptors(tracks, sides)
        known = tracks.take(found.rows)
        moved_by = step(self._camera, known.uv_px, known.disparity_px, found.uv_px)
        if moved_by is not None:
            found = found.take(moved_by.fits)
            self._go(moved_by)
        if smooth is not None:
            found = self._refined(tracks, found, sides, smooth)
        found = found.take(self._depth_allowed(found))
        moved = tracks.take(found.rows).moved(found.uv_px, found.u_right_px)
        if flow:
            return moved
        unseen = np.setdiff1d(np.flatnonzero(tracks.missed < _MOST_MISSED), found.rows)
        waiting = tracks.take(unseen)
        return moved.joined(type(tracks)(**{**waiting.__dict__, "missed": waiting.missed + 1}))

    def _go(self, moved_by: Step) -> None:
        """The camera's pose now, as ``X = R X0 + t`` from its frame at the first pair."""
        self._rotation = moved_by.rotation @ self._rotation
        self._pos_m = moved_by.rotation @ self._pos_m + moved_by.pos_m

    def _refined(self, tracks: TrackState, found: Proposal, sides: Sides, smooth: npt.NDArray[np.float32]) -> Proposal:
        """Places by correlation with the first sight."""
        known = tracks.take(found.rows)
        warp = self._warps(known, found.uv_px[:, 0] - found.u_right_px)
        left = aligned(known.template, smooth, found.uv_px, warp.left)
        start = np.column_stack([found.u_right_px + left.uv_px[:, 0] - found.uv_px[:, 0], left.uv_px[:, 1]])
        right = aligned(known.template, smoothed(sides.right), start, warp.right, rows_fixed=True)
        good = np.minimum(left.similarity, right.similarity) >= LEAST_SIMILARITY
        good &= np.abs(left.uv_px - found.uv_px).max(axis=1, initial=0.0) <= MOST_SHIFT_PX
        good &= np.abs(right.uv_px[:, 0] - start[:, 0]) <= MOST_SHIFT_PX
        return Proposal(found.rows, left.uv_px, right.uv_px[:, 0]).take(good)

    def _warps(self, known: TrackState, disparity_px: Places) -> Warps:
        """What became of the patches since their first sight.

        The motion may have been lost since then, or a point's depth at first be wrong: then the disparity now tells how
        much it grew.
        """
        rotation = self._rotation @ np.swapaxes(known.first_rotation, 1, 2)
        pos_m = self._pos_m - np.einsum("nij,nj->ni", rotation, known.first_pos_m)
        found = warps(self._camera, Planes(known.first_place, known.normal_1_m), rotation, pos_m)
        off = disparity_px / found.disparity_px
        off[np.abs(off - 1) < _MOST_OFF] = 1.0
        return Warps(found.left * off[:, None, None], found.right * off[:, None, None], found.disparity_px)

    def _depth_allowed(self, found: Proposal) -> npt.NDArray[np.bool_]:
        far = found.uv_px[:, 0] - found.u_right_px
        return np.asarray((far >= self._settings.min_disparity_px) & (far <= self._work.most_px))

    def _begun(self, sides: Sides, tracks: TrackState | None, smooth: npt.NDArray[np.float32] | None) -> TrackState:
        """New tracks where there are few."""
        seen = np.empty((0, 2)) if tracks is None else tracks.uv_px[tracks.missed == 0]
        rows = free_rows(seen, sides.features.uv_px, self._work.size, self._settings.max_features)
        uv, u_right = sides.features.uv_px[rows], sides.u_right_px[rows]
        number = np.arange(self._next, self._next + len(rows))
        self._next += len(rows)
        template = np.empty((len(rows), 0, 0), np.float32) if smooth is None else patches(smooth, uv)
        # as if square to the view: slopes from the neighbours' disparities made it worse, for features lie on edges
        wall = planes(self._camera, uv, uv[:, 0] - u_right, np.zeros_like(uv))
        return TrackState(
            track=number,
            uv_px=uv,
            u_right_px=u_right,
            template=template,
            first_place=wall.place,
            normal_1_m=wall.normal_1_m,
            first_rotation=np.tile(self._rotation, (len(rows), 1, 1)),
            first_pos_m=np.tile(self._pos_m, (len(rows), 1)),
            descriptor=sides.features.descriptor[rows],
            pixel_scale=sides.features.scale[rows],
            missed=np.zeros(len(rows), np.int64),
        )


def free_rows(seen_px: Places, offered_px: Places, size: tuple[int, int], count: int) -> Whole:
    """Rows of the offered features that are apart from those seen, in cells that are not full, `count` with those."""

    def square(uv: Places) -> Whole:
        places = np.floor(uv / _APART_PX).astype(np.int64)
        return np.asarray(places[:, 1] * (size[0] + 1) + places[:, 0])

    squares = square(offered_px)
    _, first = np.unique(squares, return_index=True)
    rows = np.sort(first[~np.isin(squares[first], square(seen_px))])
    cell = cell_of(offered_px[rows], size)
    held = np.bincount(cell_of(seen_px, size), minlength=int(cell.max(initial=0)) + 1)
    rank = rank_within(cell, np.arange(len(rows)))
    rows = rows[rank + held[cell] < most_per_cell(count)]
    return np.asarray(rows[: max(0, count - len(seen_px))])
