"""What the camera says in a graph: relative poses, features that it tracked, or both, and its mounting.

A log that has both has them from two sensors, or from halves of the images: they count as independent.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from factors.carried import CAMERA_ERRORS
from graphnav.camera_errors import camera_prior, camera_unknown
from graphnav.motions import MotionReadings, motion_readings, uses_motions
from graphnav.problem import E, Problem
from graphnav.tracks import TrackReadings, track_readings, uses_tracks

if TYPE_CHECKING:
    import gtsam

    from graphnav.chain_problem import ChainProblem


@dataclass(frozen=True)
class Camera:
    """What takes part, or None each."""

    motions: MotionReadings | None
    tracks: TrackReadings | None

    def insert(self, problem: Problem | ChainProblem, values: gtsam.Values) -> None:
        """Variables that only the camera has, where they are not there yet."""
        if camera_unknown(problem.log.stereo) and not values.exists(E(0)):
            values.insert(E(0), np.zeros(CAMERA_ERRORS))
        if self.tracks is not None:
            self.tracks.insert(values)

    def beside(self, problem: Problem | ChainProblem) -> list[gtsam.NonlinearFactor]:
        """Factors of these variables."""
        stereo = problem.log.stereo
        return [camera_prior(stereo)] if stereo is not None and camera_unknown(stereo) else []

    def far_keys(self) -> list[int]:
        """Keys of poses that are tied to others than their neighbours."""
        return [key for part in (self.motions, self.tracks) if part is not None for key in part.far_keys()]


def uses_camera(problem: Problem) -> bool:
    """Whether anything of a camera takes part."""
    return uses_motions(problem) or uses_tracks(problem)


def camera_readings(problem: Problem) -> Camera | None:
    """What the camera says, between the keyframes at its times; None without one.

    Raises
    ------
    LogError : a motion that takes no time, or whose covariance is none; by row.
    """
    found = Camera(motion_readings(problem), track_readings(problem)) if uses_camera(problem) else None
    return None if found is None or (found.motions is None and found.tracks is None) else found
