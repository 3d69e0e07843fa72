"""Features that the stereo camera tracks, as points of the graph seen from keyframes at the times of its frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from factors import lookup
from factors.increments import npt_int
from factors.stereo import StereoCamera, triangulate
from factors.stereo_tracks import TrackFamily
from graphnav.camera_errors import camera_unknown
from graphnav.frontends.motion_chain import camera_mounting
from graphnav.leg_means import npt_bool
from graphnav.log import Stereo
from graphnav.problem import E, P, X

if TYPE_CHECKING:
    import gtsam

    from graphnav.chain_problem import ChainProblem
    from graphnav.problem import Problem

#: A keyframe this close to a frame is at it (see `graphnav.keyframes.SAME_S`), s.
_SAME_S = 2e-3
#: Smallest disparity from which a place is first guessed, px.
_DISPARITY_PX = 0.5


@dataclass(frozen=True)
class TrackReadings:
    """Readings of tracked features that take part.

    Attributes
    ----------
    row : (K,) of the table stereo_tracks.
    family : the same readings as factors; P(j) is the feature with the j-th smallest number.
    """

    row: npt_int
    family: TrackFamily

    def only(self, rows: npt_int | npt_bool) -> TrackReadings:
        """Some of them, without features that then are seen from one keyframe alone and say nothing."""
        return _seen_twice(TrackReadings(self.row[rows], self.family.only(rows)))

    def without(self, rows: npt_bool) -> TrackReadings:
        """The others, whatever they say."""
        return TrackReadings(self.row[~rows], self.family.only(~rows))

    def insert(self, values: gtsam.Values) -> None:
        """Places of the features, where they are not there yet: as their nearest view has them from its pose."""
        family = self.family
        disparity = family.pixels[:, 0] - family.pixels[:, 1]
        order = np.lexsort((-disparity, family.point_key))
        nearest = order[np.unique(family.point_key[order], return_index=True)[1]]
        pixels = family.pixels[nearest]
        pixels[:, 1] = np.minimum(pixels[:, 1], pixels[:, 0] - _DISPARITY_PX)
        point_b = triangulate(family.camera, pixels) @ family.rotation_bc.T + family.pos_bc
        pose = lookup.poses(values, family.pose_key[nearest])
        point_n = (pose[:, :3, :3] @ point_b[:, :, None])[..., 0] + pose[:, :3, 3]
        for key, place_n in zip(family.point_key[nearest].tolist(), point_n, strict=True):
            if not values.exists(key):
                values.insert(key, place_n)

    def prune(self, values: gtsam.Values) -> None:
        """Drop the places of features that are read no more."""
        used = set(self.family.point_key.tolist())
        for key in values.keys():
            if key >> 56 == ord("p") and key not in used:
                values.erase(key)

    def far_keys(self) -> list[int]:
        """Keys of poses that are tied to others than their neighbours."""
        found: list[int] = np.unique(self.family.pose_key).tolist()
        return found


def uses_tracks(problem: Problem | ChainProblem) -> bool:
    """Whether readings of features take part."""
    log = problem.log
    return log.stereo_tracks is not None and log.stereo is not None and problem.config.stereo.form != "off"


def track_readings(problem: Problem | ChainProblem) -> TrackReadings | None:
    """The readings from keyframes of all features seen from two keyframes or more; None where there are none."""
    tracks, stereo, t_s = problem.log.stereo_tracks, problem.log.stereo, problem.keyframe_s
    if tracks is None or stereo is None or not uses_tracks(problem):
        return None
    right = np.clip(np.searchsorted(t_s, tracks.t_s), 1, len(t_s) - 1)
    at = right - (tracks.t_s - t_s[right - 1] < t_s[right] - tracks.t_s)
    rows = np.flatnonzero(np.abs(t_s[at] - tracks.t_s) < _SAME_S)
    family = TrackFamily(
        X(0) + at[rows],
        P(0) + np.unique(tracks.track[rows], return_inverse=True)[1],
        E(0) if camera_unknown(stereo) else None,
        np.column_stack([tracks.u_left_px, tracks.u_right_px, tracks.v_px])[rows],
        stereo.sigma_px,
        camera_of(stereo),
        *camera_mounting(stereo),
    )
    readings = _seen_twice(TrackReadings(rows, family))
    return readings if len(readings.row) else None


def _seen_twice(readings: TrackReadings) -> TrackReadings:
    _, which, count = np.unique(readings.family.point_key, return_inverse=True, return_counts=True)
    kept = count[which] > 1
    return TrackReadings(readings.row[kept], readings.family.only(kept))


def camera_of(stereo: Stereo) -> StereoCamera:
    """The declared pair."""
    return StereoCamera(stereo.fx_px, stereo.fy_px, stereo.cx_px, stereo.cy_px, stereo.baseline_m)
