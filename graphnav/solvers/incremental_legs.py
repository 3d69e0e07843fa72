"""LiDAR legs for iSAM2: readings condensed window by window along the path as it is known then.

A window of detections (`graphnav.legs.Windows`) is complete at the first update that reaches its end. Its detections are
brought together along iSAM2's estimates of its keyframes, and the readings are fed with the next update, some seconds
after they were taken. A leg that was out of view for long is a new variable: one seen again after hours would
re-eliminate all that lies between.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from factors.inertial import predict
from factors.so3 import Array, to_quaternion
from graphnav.leg_means import stepped, velocity_variance
from graphnav.leg_priors import calibration_prior, leg_prior
from graphnav.legs import LegReadings, Windows, of_window
from graphnav.preintegration import Preintegrated
from graphnav.problem import D, L, Problem, X
from graphnav.trajectory import ImuBridge, Trajectory

if TYPE_CHECKING:
    import gtsam

#: Windows in a row in which a leg may be elsewhere before it counts as moved.
_MISSES = 2


class Estimates(Protocol):
    """What iSAM2 knows at the moment."""

    theta: gtsam.Values

    def pose(self, i: int) -> Array:
        """Pose (4, 4) at keyframe i."""


@dataclass
class _Leg:
    """What stands for a leg at present.

    Attributes
    ----------
    variable : j of ``L(j)``; height_m : its h0.
    keyframe, place_b, sigma_m : where it was last seen, in b at that keyframe; misses : windows since in which the
        number was seen elsewhere.
    """

    variable: int
    height_m: float
    keyframe: int
    place_b: Array
    sigma_m: float
    misses: int = 0


class LegFeed:
    """Turns windows of detections into factors, new variables and their first values.

    Attributes
    ----------
    variables, readings : legs and readings fed so far; refused : readings left out, since they lay elsewhere than
        their leg.
    """

    def __init__(self, problem: Problem, data: Preintegrated) -> None:
        log = problem.log
        assert log.lidar is not None
        self.problem, self.data, self.lidar = problem, data, log.lidar
        self.windows, self.done = Windows.of(problem), 0
        self.velocity_m2_s2 = velocity_variance(log)
        self.lean = float(np.tan(np.radians(problem.config.lidar.lean_sigma_deg)))
        self.surveyed = {mark.feature: mark for mark in log.lidar.landmark}
        self.legs: dict[int, _Leg] = {}
        self.variables = self.readings = self.refused = 0

    def feed(self, estimates: Estimates, i: int, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
        """Add to graph and values what the windows complete at keyframe i bring, to be solved with the next update."""
        while self.done < len(self.windows.centre) and self.windows.last[self.done] <= i:
            self._feed_window(self.done, estimates, graph, values)
            self.done += 1

    def _feed_window(
        self, w: int, estimates: Estimates, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values
    ) -> None:
        if not (estimates.theta.exists(D(0)) or values.exists(D(0))):
            values.insert(D(0), np.zeros(8))
            graph.add(calibration_prior(self.lidar))
        centre = int(self.windows.centre[w])
        readings = self._condensed(w, estimates)
        pose = {centre: estimates.pose(centre)}
        use, variable, height = [], [], []
        for k, number in enumerate(readings.feature.tolist()):
            sigma_m = float(readings.sigma[k, 0])
            place_b = _into(pose[centre], readings.place_n[k])
            leg = self._leg(number, centre)
            if leg is not None:
                if leg.keyframe not in pose:
                    pose[leg.keyframe] = estimates.pose(leg.keyframe)
                before_n = pose[leg.keyframe][:3, :3] @ leg.place_b + pose[leg.keyframe][:3, 3]
                if stepped(before_n, readings.place_n[k], leg.sigma_m, sigma_m):
                    leg.misses += 1
                    if leg.misses < _MISSES:
                        self.refused += 1
                        continue
                    leg = None
            if leg is None:
                leg = self._new(number, readings.place_n[k], graph, values)
            leg.keyframe, leg.place_b, leg.sigma_m, leg.misses = centre, place_b, sigma_m, 0
            use.append(k)
            variable.append(leg.variable)
            height.append(leg.height_m)
        if use:
            found = readings.family(self.lidar).only(np.array(use))
            keys = {"pose_key": np.full(len(use), X(centre)), "leg_key": L(0) + np.array(variable)}
            for factor in replace(found, **keys, height_m=np.array(height)).factors():
                graph.add(factor)
            self.readings += len(use)

    def _condensed(self, w: int, estimates: Estimates) -> LegReadings:
        """The readings of a window, along the present estimates of its keyframes."""
        problem, data, windows = self.problem, self.data, self.windows
        lo, hi = int(windows.first[w]), int(windows.last[w])
        pose = np.array([estimates.pose(i) for i in range(lo, hi + 1)])
        t_s, rotation, pos = problem.keyframe_s[lo : hi + 1], pose[:, :3, :3], pose[:, :3, 3]
        # the velocities with which the IMU leads from each position to the next
        nav = problem.gravity_m_s2, problem.earth_rate_n
        _, unmoved, gained = predict(rotation[:-1], pos[:-1], np.zeros((hi - lo, 3)), data.motion, np.arange(lo, hi), *nav)
        vel = (pos[1:] - unmoved) / np.diff(t_s)[:, None]
        vel = np.concatenate([vel, vel[-1:] + gained[-1:]])
        bridge = ImuBridge(problem.imu.samples, data.gyro_bias_b[lo:hi], data.accel_bias_b[lo:hi], *nav)
        way = Trajectory(t_s, pos, to_quaternion(rotation), vel, None, bridge)
        rows = np.arange(windows.row[w], windows.row[w + 1])
        return of_window(problem.log, problem.config, way, rows, int(windows.centre[w]) - lo, self.velocity_m2_s2)

    def _leg(self, number: int, keyframe: int) -> _Leg | None:
        """The leg of a number, unless it was out of view for long."""
        leg, t_s = self.legs.get(number), self.problem.keyframe_s
        gone = leg is None or t_s[keyframe] - t_s[leg.keyframe] > self.problem.config.isam2.leg_gap_s
        return None if gone else leg

    def _new(
        self, number: int, place_n: Array, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values
    ) -> _Leg:
        height, j = float(place_n[2]), self.variables
        # a survey counts once: one that moved is no longer there, and for one seen again it would count twice
        mark = None if number in self.legs else self.surveyed.get(number)
        graph.add(leg_prior(j, mark, height, self.lean))
        values.insert(L(j), np.array([place_n[0], place_n[1], 0.0, 0.0]))
        self.legs[number] = _Leg(j, height, 0, place_n, 0.0)
        self.variables += 1
        return self.legs[number]


def _into(pose: Array, place_n: Array) -> Array:
    """A place (3,) of n in the frame b of a pose (4, 4)."""
    return np.asarray(pose[:3, :3].T @ (place_n - pose[:3, 3]))
