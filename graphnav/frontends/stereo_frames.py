"""The table of tracked features, frame by frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graphnav._schema import Array
from graphnav.frontends.stereo_bundle import Matches
from graphnav.log import StereoTracks

Indices = npt.NDArray[np.intp]


@dataclass(frozen=True)
class TrackedFrames:
    """F frames and the features that each of them sees.

    Attributes
    ----------
    t_s : (F,) ascending; start : (F+1,) first row of each frame.
    track : (N,) ascending within a frame; pixels : (N, 3) u_left, u_right, v.
    """

    t_s: Array
    start: Indices
    track: npt.NDArray[np.int64]
    pixels: Array

    @classmethod
    def of(cls, tracks: StereoTracks) -> TrackedFrames:
        """The rows of a table, frame by frame.

        Raises
        ------
        LogError : a feature that one frame holds twice, by row.
        """
        order = np.lexsort([tracks.track, tracks.t_s])
        t_s, track = tracks.t_s[order], np.asarray(tracks.track, np.int64)[order]
        twice = np.flatnonzero((np.diff(t_s) == 0) & (np.diff(track) == 0))
        if len(twice):
            row = int(order[twice[0] + 1])
            raise tracks.error(
                f"{track[twice[0]]} is there twice at {t_s[twice[0]]:.6f} s",
                row=row,
                column="track",
                fix="one row for a feature in a frame",
            )
        times, start = np.unique(t_s, return_index=True)
        pixels = np.column_stack([tracks.u_left_px, tracks.u_right_px, tracks.v_px])[order]
        return cls(times, np.append(start, len(t_s)).astype(np.intp), track, np.ascontiguousarray(pixels))

    def __len__(self) -> int:
        return len(self.t_s)

    def common(self, i: int, j: int) -> tuple[Indices, Indices]:
        """Rows (K,) of the features that two frames share, in either frame."""
        a, b = slice(self.start[i], self.start[i + 1]), slice(self.start[j], self.start[j + 1])
        first, second = self.track[a], self.track[b]
        if not len(first) or not len(second):
            return np.zeros(0, np.intp), np.zeros(0, np.intp)
        at = np.minimum(np.searchsorted(second, first), len(second) - 1)
        same = second[at] == first
        return np.flatnonzero(same) + self.start[i], at[same] + self.start[j]

    def shared(self, i: int, j: int) -> int:
        """How many features two frames share."""
        return len(self.common(i, j)[0])

    def matches(self, i: int, j: int, sigma_px: float) -> Matches:
        """What two frames read of the features that they share."""
        rows_i, rows_j = self.common(i, j)
        return Matches(self.pixels[rows_i], self.pixels[rows_j], sigma_px)
