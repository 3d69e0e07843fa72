"""The tracks that are being followed: one row each."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from graphnav.frontends.patch_alignment import Floats
from graphnav.frontends.stereo_features import Places, Whole


@dataclass(frozen=True)
class TrackState:
    """Tracks that may be seen again.

    Attributes
    ----------
    track : (N,) number of the track.
    uv_px, u_right_px : (N, 2) and (N,) last place, in the left and right image.
    template : (N, P, P) patch at its first sight.
    first_place, normal_1_m : (N, 3) the wall there, see `stereo_warp.Planes`.
    first_rotation, first_pos_m : (N, 3, 3), (N, 3) the camera's pose there, ``X = R X0 + t`` from the first pair's.
    descriptor, pixel_scale : of the feature at its last sight.
    missed : (N,) frames since then.
    """

    track: Whole
    uv_px: Places
    u_right_px: Places
    template: Floats
    first_place: Places
    normal_1_m: Places
    first_rotation: Places
    first_pos_m: Places
    descriptor: npt.NDArray[Any]
    pixel_scale: Places
    missed: Whole

    def __len__(self) -> int:
        return len(self.track)

    @property
    def disparity_px(self) -> Places:
        """Disparities (N,) at the last sight."""
        return self.uv_px[:, 0] - self.u_right_px

    def take(self, rows: npt.NDArray[Any]) -> TrackState:
        """Some of them."""
        return TrackState(**{name: value[rows] for name, value in self._columns()})

    def joined(self, other: TrackState) -> TrackState:
        """These and others."""
        pairs = zip(self._columns(), other._columns(), strict=True)
        return TrackState(**{name: np.concatenate([one, more]) for (name, one), (_, more) in pairs})

    def moved(self, uv_px: Places, u_right_px: Places) -> TrackState:
        """The same tracks at new places."""
        return dataclasses.replace(self, uv_px=uv_px, u_right_px=u_right_px, missed=np.zeros_like(self.missed))

    def _columns(self) -> list[tuple[str, Any]]:
        return [(f.name, getattr(self, f.name)) for f in dataclasses.fields(self)]
