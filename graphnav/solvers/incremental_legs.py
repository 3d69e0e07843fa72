"""LiDAR legs for iSAM2: readings condensed window by window along the path as it is known then.

A window of detections (`graphnav.legs.Windows`) is complete at the first update that reaches its end. Its detections
are brought together along iSAM2's estimates of its keyframes, and the readings are fed with the next update, some
seconds after they were taken. So that the cost of an update stays bounded, a few legs are followed at a time, and one
that was out of view for long is a new variable: one seen again after hours would re-eliminate all that lies between.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from factors.increments import npt_int
from factors.inertial import predict
from factors.noise import diagonal
from factors.so3 import Array, to_quaternion
from graphnav.leg_means import stepped, velocity_variance
from graphnav.leg_priors import calibration_prior, leg_prior, lidar_sigmas
from graphnav.legs import LegReadings, Windows, of_window
from graphnav.preintegration import Preintegrated
from graphnav.problem import D, L, Problem, X
from graphnav.trajectory import ImuBridge, Trajectory

if TYPE_CHECKING:
    import gtsam

#: A leg whose estimate has moved this far, m, from where it is linearized is a new one from then on: with poses that
#: are linearized at the new estimate its readings would be linearized at places that nothing is at.
_STALE_M = 0.1
#: Readings of one calibration or one leg variable: at every update iSAM2 goes through all factors of every variable
#: that it eliminates anew, and the calibration is always among them.
_READINGS = 500
#: From one calibration variable to the next the calibration stays the same, to this share of its declared sigma; and no
#: closer than this, which rounding would not survive.
_SAME, _SAME_LEAST = 1e-4, 1e-8
#: Windows in a row in which a leg may be elsewhere before it counts as moved.
_MISSES = 2


class Estimates(Protocol):
    """What iSAM2 knows at the moment."""

    theta: gtsam.Values

    def step(self, key: int) -> Array:
        """The solution for a variable relative to its linearization point."""

    def pose(self, i: int) -> Array:
        """Pose (4, 4) at keyframe i."""


@dataclass
class _Leg:
    """What stands for a leg at present.

    Attributes
    ----------
    variable : j of ``L(j)``; height_m : its h0.
    keyframe, place_b, sigma_m : where it was last seen, in b at that keyframe; misses : windows since in which the
        number was seen elsewhere; count : readings fed.
    """

    variable: int
    height_m: float
    keyframe: int = 0
    place_b: Array = field(default_factory=lambda: np.zeros(3))
    sigma_m: float = 0.0
    misses: int = 0
    count: int = 0


class LegFeed:
    """Turns windows of detections into factors, new variables and their first values.

    Attributes
    ----------
    epoch : of the calibration, e of ``D(e)``; None before the first window.
    variables, readings : legs and readings fed so far; refused : readings left out, since they lay elsewhere than
        their leg.
    """

    def __init__(self, problem: Problem, data: Preintegrated) -> None:
        log = problem.log
        assert log.lidar is not None and log.lidar_points is not None
        self.problem, self.data, self.lidar, self.points = problem, data, log.lidar, log.lidar_points
        self.windows, self.done = Windows.of(problem), 0
        self.velocity_m2_s2 = velocity_variance(log)
        self.lean = float(np.tan(np.radians(problem.config.lidar.lean_sigma_deg)))
        self.surveyed = {mark.feature: mark for mark in log.lidar.landmark}
        self.legs: dict[int, _Leg] = {}
        self.epoch: int | None = None
        self.since = 0
        self.in_view_since: dict[int, int] = {}
        self.variables = self.readings = self.refused = 0

    def feed(self, estimates: Estimates, i: int, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
        """Add to graph and values what the windows complete at keyframe i bring, to be solved with the next update.

        Parameters
        ----------
        estimates : after the update at keyframe i.
        """
        while self.done < len(self.windows.centre) and self.windows.last[self.done] <= i:
            self._feed_window(self.done, estimates, graph, values)
            self.done += 1

    def _feed_window(
        self, w: int, estimates: Estimates, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values
    ) -> None:
        self._calibrate(estimates, graph, values)
        centre, readings = int(self.windows.centre[w]), self._condensed(w, estimates)
        pose, linearized = _Poses(estimates, False), _Poses(estimates, True)
        use, legs = [], []
        for k, number in enumerate(readings.feature.tolist()):
            place_n, sigma_m = readings.place_n[k], float(readings.sigma[k, 0])
            leg = self._leg(number, centre)
            if leg is not None:
                before_n = pose.place(leg)
                if stepped(before_n, place_n, leg.sigma_m, sigma_m):
                    leg.misses += 1
                    if leg.misses < _MISSES:
                        self.refused += 1
                        continue
                    leg = None
                elif leg.count >= _READINGS or np.linalg.norm(before_n - linearized.place(leg)) > _STALE_M:
                    leg = None
            if leg is None:
                leg = self._new(number, place_n, graph, values)
            rotation, pos = pose.at(centre)
            leg.keyframe, leg.place_b, leg.sigma_m, leg.misses = centre, rotation.T @ (place_n - pos), sigma_m, 0
            leg.count += 1
            use.append(k)
            legs.append(leg)
        self.readings += len(use)
        for factor in self._factors(readings, use, legs, centre):
            graph.add(factor)

    def _calibrate(self, estimates: Estimates, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
        """The scanner's calibration, and after many readings another variable for it that is tied to the one before."""
        import gtsam

        if self.epoch is None:
            self.epoch, self.since = 0, 0
            values.insert(D(0), np.zeros(8))
            graph.add(calibration_prior(self.lidar))
        elif self.readings - self.since >= _READINGS and estimates.theta.exists(D(self.epoch)):
            sigmas = np.maximum(_SAME * lidar_sigmas(self.lidar), _SAME_LEAST)
            values.insert(D(self.epoch + 1), estimates.theta.atVector(D(self.epoch)) + estimates.step(D(self.epoch)))
            graph.add(gtsam.BetweenFactorVector(D(self.epoch), D(self.epoch + 1), np.zeros(8), diagonal(sigmas)))
            self.epoch, self.since = self.epoch + 1, self.readings

    def _factors(
        self, readings: LegReadings, use: list[int], legs: list[_Leg], keyframe: int
    ) -> list[gtsam.CustomFactor]:
        """Factors of the readings to use, each with what stands for its leg."""
        if not use:
            return []
        family = replace(
            readings.only(np.array(use)).family(self.lidar),
            pose_key=np.full(len(use), X(keyframe)),
            calibration_key=np.full(len(use), D(self.epoch or 0)),
            leg_key=np.array([L(leg.variable) for leg in legs]),
            height_m=np.array([leg.height_m for leg in legs]),
        )
        return family.factors()

    def _condensed(self, w: int, estimates: Estimates) -> LegReadings:
        """The readings of a window, along the present estimates of its keyframes."""
        problem, data, windows = self.problem, self.data, self.windows
        lo, hi, centre = int(windows.first[w]), int(windows.last[w]), int(windows.centre[w])
        pose = np.array([estimates.pose(i) for i in range(lo, hi + 1)])
        t_s, rotation, pos = problem.keyframe_s[lo : hi + 1], pose[:, :3, :3], pose[:, :3, 3]
        # the velocities with which the IMU leads from each position to the next
        nav, between = (problem.gravity_m_s2, problem.earth_rate_n), np.arange(lo, hi)
        _, moved, gained = predict(rotation[:-1], pos[:-1], np.zeros((hi - lo, 3)), data.motion, between, *nav)
        vel = (pos[1:] - moved) / np.diff(t_s)[:, None]
        vel = np.concatenate([vel, vel[-1:] + gained[-1:]])
        bridge = ImuBridge(problem.imu.samples, data.gyro_bias_b[lo:hi], data.accel_bias_b[lo:hi], *nav)
        way = Trajectory(t_s, pos, to_quaternion(rotation), vel, None, bridge)
        rows = self._followed(np.arange(windows.row[w], windows.row[w + 1]), w)
        return of_window(problem.log, problem.config, way, rows, centre - lo, self.velocity_m2_s2)

    def _followed(self, rows: npt_int, w: int) -> npt_int:
        """Rows of a window of the legs to use: those followed before, and others in place of those gone out of view.

        The newest first, which stay in view longest; of those that came together, spread over the bearings.
        """
        feature, first = np.unique(self.points.feature[rows], return_index=True)
        seen = feature[np.argsort(self.points.angle_rad[rows][first], kind="stable")].tolist()
        self.in_view_since = {number: self.in_view_since.get(number, w) for number in seen}
        keyframe = int(self.windows.centre[w])
        followed = [k for k, number in enumerate(seen) if self._leg(number, keyframe) is not None]
        while len(followed) < min(self.problem.config.isam2.legs_followed, len(seen)):
            free = [k for k in range(len(seen)) if k not in followed]
            since = [self.in_view_since[seen[k]] for k in free]
            away = [min((abs(k - other) for other in followed), default=0) for k in free]
            followed.append(max(zip(since, away, free, strict=True))[2])
        return rows[np.isin(self.points.feature[rows], [seen[k] for k in followed])]

    def _leg(self, number: int, keyframe: int) -> _Leg | None:
        """What stands for a number, unless it was out of view for long."""
        leg, t_s = self.legs.get(number), self.problem.keyframe_s
        gone = leg is None or t_s[keyframe] - t_s[leg.keyframe] > self.problem.config.isam2.leg_gap_s
        return None if gone else leg

    def _new(self, number: int, place_n: Array, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> _Leg:
        """A variable for a leg that is new, out of view for long, moved or stale."""
        # a survey counts once: one that moved is no longer there, and one seen again would count it twice
        mark = None if number in self.legs else self.surveyed.get(number)
        leg = _Leg(self.variables, float(place_n[2]))
        graph.add(leg_prior(leg.variable, mark, leg.height_m, self.lean))
        values.insert(L(leg.variable), np.array([place_n[0], place_n[1], 0.0, 0.0]))
        self.legs[number] = leg
        self.variables += 1
        return leg


def without_legs(values: gtsam.Values) -> gtsam.Values:
    """Estimates without legs and LiDAR calibration, which are others in the whole graph."""
    import gtsam

    found = gtsam.Values(values)
    for key in values.keys():
        if key >> 56 in (ord("l"), ord("d")):
            found.erase(key)
    return found


class _Poses:
    """Estimates of poses, or where they are linearized, each asked for once."""

    def __init__(self, estimates: Estimates, linearized: bool) -> None:
        self.estimates, self.linearized = estimates, linearized
        self.known: dict[int, tuple[Array, Array]] = {}

    def at(self, i: int) -> tuple[Array, Array]:
        """Rotation (3, 3) and position (3,) at keyframe i."""
        if i not in self.known:
            pose = self.estimates.theta.atPose3(X(i)).matrix() if self.linearized else self.estimates.pose(i)
            self.known[i] = pose[:3, :3], pose[:3, 3]
        return self.known[i]

    def place(self, leg: _Leg) -> Array:
        """Where a leg was last seen, (3,) in n."""
        rotation, pos = self.at(leg.keyframe)
        return np.asarray(pos + rotation @ leg.place_b)
