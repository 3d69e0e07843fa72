"""From a problem and its condensed sensor data to factors: as one graph for batch, one by one for iSAM2."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from factors import odometry
from factors.advance import AdvanceFamily
from factors.condensed_points import Condensed
from factors.legs import LegFamily
from factors.mounted_motion import MotionFamily
from factors.ranging import RangeFamily
from factors.stereo_tracks import TrackFamily
from graphnav.camera import Camera
from graphnav.leg_priors import leg_priors
from graphnav.legs import LegReadings
from graphnav.log import Lidar
from graphnav.motions import MotionReadings
from graphnav.native_factors import FactorAt, common_factors, displacement_family
from graphnav.preintegration import Preintegrated
from graphnav.problem import Problem, V, X
from graphnav.ranges import RangeReadings, RangeStates

if TYPE_CHECKING:
    import gtsam


@dataclass(frozen=True)
class SmoothingGraph:
    """The whole problem as batch solvers see it: native factors, and the odometer's, LiDAR's and UWB's as arrays.

    Attributes
    ----------
    chain : with legs, the keys of keyframes tied to their neighbours alone, in order of time: what to eliminate first.
    """

    native: gtsam.NonlinearFactorGraph
    displacements: odometry.DisplacementFamily | None
    legs: LegFamily | None = None
    advances: AdvanceFamily | None = None
    chain: list[int] | None = None
    ranges: RangeFamily | None = None
    motions: MotionFamily | None = None
    tracks: TrackFamily | None = None

    def seen_by(self, camera: Camera) -> SmoothingGraph:
        """With what a camera says, or with only some of it."""
        motions, tracks = camera.motions, camera.tracks
        return replace(
            self,
            motions=None if motions is None else motions.family,
            tracks=None if tracks is None else tracks.family,
        )

    def only_legs(self, readings: LegReadings, lidar: Lidar) -> SmoothingGraph:
        """With only some of its readings; legs left without keep their variables."""
        return replace(self, legs=readings.family(lidar))

    def linearize(self, values: gtsam.Values) -> gtsam.GaussianFactorGraph:
        """Whitened linear factors of everything."""
        linear = self._without_tracks(values)
        if self.tracks is not None:
            self.tracks.linearize_into(linear, values)
        return linear

    def condensed(self, values: gtsam.Values) -> tuple[gtsam.GaussianFactorGraph, Condensed | None]:
        """The same with the points of tracked features eliminated, and these points."""
        linear = self._without_tracks(values)
        return linear, None if self.tracks is None else self.tracks.condense_into(linear, values)

    def _without_tracks(self, values: gtsam.Values) -> gtsam.GaussianFactorGraph:
        linear = self.native.linearize(values)
        if self.displacements is not None:
            self.displacements.linearize_into(linear, values)
        if self.legs is not None:
            self.legs.linearize_into(linear, values)
        if self.advances is not None:
            self.advances.linearize_into(linear, values)
        if self.ranges is not None:
            self.ranges.linearize_into(linear, values)
        if self.motions is not None:
            self.motions.linearize_into(linear, values)
        return linear


def build_graph(
    problem: Problem,
    data: Preintegrated,
    legs: LegReadings | None = None,
    advances: AdvanceFamily | None = None,
    ranges: RangeReadings | None = None,
    camera: Camera | None = None,
) -> SmoothingGraph:
    """The problem for a batch solver."""
    import gtsam

    native = gtsam.NonlinearFactorGraph()
    tied: set[int] = set()
    for found in common_factors(problem, data):
        native.add(found.factor)
        tied.update(_crossed(found))
    if ranges is not None:
        for _, factor in RangeStates.of(problem, ranges).factors(problem):
            native.add(factor)
    if camera is not None:
        for factor in camera.beside(problem):
            native.add(factor)
        tied.update(camera.far_keys())
    family, chain = None, None
    if legs is not None and problem.log.lidar is not None:
        family = legs.family(problem.log.lidar)
        lean = float(np.tan(np.radians(problem.config.lidar.lean_sigma_deg)))
        for prior in leg_priors(problem.log.lidar, legs.feature, legs.place_n[:, 2], lean):
            native.add(prior)
        tied.update(family.pose_key.tolist())
        chain = [key for i in range(len(problem.keyframe_s)) if X(i) not in tied for key in (V(i), X(i))]
    graph = SmoothingGraph(
        native, displacement_family(problem, data), family, advances, chain, None if ranges is None else ranges.family
    )
    return graph if camera is None else graph.seen_by(camera)


def build_factors(
    problem: Problem, data: Preintegrated, ranges: RangeReadings | None = None, motions: MotionReadings | None = None
) -> list[FactorAt]:
    """All factors one by one, in order of the last keyframe they need, for an incremental solver."""
    found = common_factors(problem, data)
    family = displacement_family(problem, data)
    if family is not None:
        last = (family.key_j - X(0)).tolist()
        found += [FactorAt(j, family.factor(k)) for k, j in enumerate(last)]
    if ranges is not None:
        found += [FactorAt(*each) for each in ranges.factors(problem)]
    if motions is not None:
        found += [FactorAt(*each) for each in motions.factors(problem)]
        found += [FactorAt(0, each) for each in Camera(motions, None).beside(problem)]
    return sorted(found, key=lambda f: f.keyframe)


def fed_in_blocks(problem: Problem, found: list[FactorAt], size: int) -> list[FactorAt]:
    """Feed the closed-path points of a cycle `size` at a time, each block with its last point.

    Every closed-path update re-eliminates the stretch of all earlier cycles since the last one; a few points at once
    cost little more than one.
    """
    feed: dict[int, int] = {}
    for cycle in {p.cycle for p in problem.frontend.closed_path}:
        seconds = [problem.frontend.index(p.second_s) for p in problem.frontend.closed_path if p.cycle == cycle]
        for k in range(0, len(seconds), size):
            block = seconds[k : k + size]
            feed.update(dict.fromkeys(block, max(block)))
    fed = [FactorAt(feed[f.keyframe], f.factor) if _closes(f) else f for f in found]
    return sorted(fed, key=lambda f: f.keyframe)


def _crossed(found: FactorAt) -> list[int]:
    """Keys of the two poses that a factor ties where they are not neighbours."""
    poses = [key for key in found.factor.keys() if key >> 56 == ord("x")]
    return poses if len(poses) == 2 and poses[1] - poses[0] > 1 else []


def _closes(found: FactorAt) -> bool:
    """Whether it is one of the closed path, which has the odometer's calibration too."""
    return bool(_crossed(found)) and any(key >> 56 == ord("c") for key in found.factor.keys())
