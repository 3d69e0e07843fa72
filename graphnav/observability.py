"""Which states a log makes observable: joint covariances from the graph, and what they say (`analyse`).

"Smoothed" is what the whole log says about the state at a time; "causal" is what the log up to that time says, from the
graph cut off there. Both are linearised at the estimates, as a Kalman filter's covariances are.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from factors.so3 import Array, from_quaternion
from graphnav._directions import CLOCK_STATE, FACE_STATES, LIDAR_STATES, STATES, Direction, State
from graphnav._observability import Observability, analyse
from graphnav.baselines.states import unpacked
from graphnav.camera import Camera
from graphnav.leg_priors import lidar_free, lidar_sigmas
from graphnav.legs import LegReadings
from graphnav.preintegration import Preintegrated
from graphnav.problem import Problem, X
from graphnav.ranges import RangeReadings
from graphnav.solvers.joint_states import Progress, graph_covariances

if TYPE_CHECKING:
    import gtsam

    from factors.advance import AdvanceFamily
    from graphnav.baselines.tape import Estimates

__all__ = [
    "CLOCK_STATE",
    "FACE_STATES",
    "LIDAR_STATES",
    "STATES",
    "Direction",
    "Observability",
    "State",
    "analyse",
    "of_covariances",
    "of_filter",
    "of_graph",
]


def of_graph(
    problem: Problem,
    data: Preintegrated,
    values: gtsam.Values,
    *,
    legs: LegReadings | None = None,
    advances: AdvanceFamily | None = None,
    ranges: RangeReadings | None = None,
    camera: Camera | None = None,
    causal: bool = False,
    count: int | None = None,
    progress: Progress | None = None,
) -> Observability:
    """Observability of a solved problem.

    Parameters
    ----------
    problem, data, values : as solved. The papers' absolute closed-path priors are not part of the graph: they count
        information twice.
    legs, advances : the readings of LiDAR legs that it was solved with, and pairs of them.
    ranges : the UWB ranges that it was solved with; camera : what the camera said.
    causal : False takes each state from the whole log, True from the log up to its time.
    count : keyframes to look at; None for 200 evenly spread, or 40 where causal (each costs an elimination), closer
        together at the start, where most is learnt.

    Raises
    ------
    SolveError : a variable without information.
    """
    keyframes = _spread(problem, count or 40, 2) if causal else _spread(problem, count or 200, 1)
    covariance = graph_covariances(
        problem, data, values, keyframes,
        legs=legs, advances=advances, ranges=ranges, camera=camera, causal=causal, progress=progress,
    )  # fmt: skip
    pos_n = np.array([values.atPose3(X(i)).translation() for i in range(len(problem.keyframe_s))])
    kind = "causal" if causal else "smoothed"
    return of_covariances(problem, problem.keyframe_s[keyframes], covariance, pos_n, kind)


def of_filter(problem: Problem, estimates: Estimates, kind: str = "causal", count: int = 200) -> Observability:
    """Observability from a Kalman filter's covariances ("causal"), or from its smoother's ("smoothed").

    Parameters
    ----------
    count : keyframes to look at, evenly spread.
    """
    keyframes = _spread(problem, count, 1)
    size = 15 + 4 * problem.has_calibration
    covariance = unpacked(estimates.covariance[keyframes])[:, :size, :size]
    return of_covariances(problem, problem.keyframe_s[keyframes], covariance, estimates.pos_n, kind)


def _spread(problem: Problem, count: int, power: int) -> list[int]:
    """Keyframes from the first to the last, closer together at the start with a higher power."""
    last = len(problem.keyframe_s) - 1
    found: list[int] = np.unique((np.linspace(0, 1, max(count, 2)) ** power * last).round().astype(int)).tolist()
    return found


def of_covariances(problem: Problem, t_s: Array, covariance: Array, pos_n: Array, kind: str) -> Observability:
    """Observability from covariances of any estimator of the problem.

    What moves is turned to the face where there is one: the direction of its first cut.

    Parameters
    ----------
    t_s : (T,) ascending; covariance : (T, 19, 19) of `STATES` (15 without an odometer), with 8 more for `LIDAR_STATES`
        where legs take part; of these the ones whose sigma is not declared are left out, for they are held. One more,
        the last, where the time offset of UWB ranges is estimated.
    pos_n : (N, 3) estimated positions at the problem's keyframes.
    kind : "smoothed" or "causal".
    """
    size = 15 + 4 * problem.has_calibration
    further = covariance.shape[-1] - size
    scanner, clock = further >= len(LIDAR_STATES), further % len(LIDAR_STATES) == 1
    reference = reference_covariance(problem, t_s, scanner, clock)
    heading_rad = _first_cut(problem, pos_n)
    states = (STATES if heading_rad is None else FACE_STATES)[:size] + LIDAR_STATES * scanner + (CLOCK_STATE,) * clock
    turn = np.eye(covariance.shape[-1])
    if heading_rad is not None:
        s, c = np.sin(heading_rad), np.cos(heading_rad)
        for at in (0, 3, 6):
            turn[at : at + 2, at : at + 2] = [[c, s], [-s, c]]
    if scanner and problem.log.lidar is not None:
        free = np.r_[np.ones(size, bool), lidar_free(problem.log.lidar), np.ones(int(clock), bool)]
        turn, states = turn[free], tuple(state for state, kept in zip(states, free, strict=True) if kept)
    turned, known = (turn @ matrix @ turn.T for matrix in (covariance, reference))
    sigma = np.sqrt(np.diagonal(known, axis1=1, axis2=2))
    return analyse(t_s, turned, sigma, states, kind)


def reference_covariance(problem: Problem, t_s: Array, scanner: bool = False, clock: bool = False) -> Array:
    """What is known of the states without the log's data, (T, 19, 19) (15 without an odometer, 8 more with a scanner).

    One more with a `clock` of UWB ranges.

    Attitude and position: as declared for the start. Velocity: as declared, or the machine's usual speed where that is
    more, which is all that is known of a machine under way. Biases, mounting and scale: the declared sigmas with their
    declared walk. The LiDAR's calibration and the UWB's clock: the declared sigmas.
    """
    log, initial, noise = problem.log, problem.initial, problem.noise
    rotation = from_quaternion(initial.quat_nb_wxyz)
    usual = 0.0 if log.odometer is None else float(np.sqrt(np.mean(log.odometer.speed_m_s**2)))
    elapsed = np.asarray(t_s, float)[:, None] - problem.keyframe_s[0]
    ones = np.ones(3)
    gyro = noise.gyro_bias**2 + noise.gyro_bias_walk**2 * elapsed * ones
    accel = noise.accel_bias**2 + noise.accel_bias_walk**2 * elapsed * ones
    calibration = [gyro, accel]
    if log.odometer is not None:
        config = problem.config.odometer
        mounting_walk = np.radians(config.mounting_walk_deg_sqrt_h)
        walk = np.r_[mounting_walk * ones, config.scale_walk_sqrt_h] ** 2 / 3600
        start = np.r_[np.radians(log.odometer.mounting_sigma_deg), log.odometer.scale_sigma] ** 2
        calibration.append(start + walk * elapsed)
    if scanner and log.lidar is not None:
        calibration.append(lidar_sigmas(log.lidar) ** 2 * np.ones_like(elapsed))
    if clock:
        calibration.append(problem.config.uwb.time_offset_sigma_s**2 * np.ones_like(elapsed))
    own = np.concatenate(calibration, axis=1)
    found = np.zeros((len(own), 9 + own.shape[1], 9 + own.shape[1]))
    found[:, :3, :3] = np.diag(np.maximum(initial.vel_sigma_m_s, usual) ** 2)
    found[:, 3:6, 3:6] = rotation @ np.diag(np.radians(initial.att_sigma_deg) ** 2) @ rotation.T
    found[:, 6:9, 6:9] = np.diag(initial.pos_sigma_m**2)
    rows = np.arange(9, found.shape[1])
    found[:, rows, rows] = own
    return found


def _first_cut(problem: Problem, pos_n: Array) -> float | None:
    """Heading of the first cut towards the far end, from north towards west; None without a face or a whole cut."""
    whole = [c for c in problem.frontend.cycles if c.start_s is not None and c.end_s is not None]
    if problem.log.face is None or not whole:
        return None
    ends = [problem.frontend.index(t) for t in (whole[0].start_s, whole[0].end_s) if t is not None]
    east, north, _ = (pos_n[ends[1]] - pos_n[ends[0]]) * (1.0 if whole[0].forward else -1.0)
    return float(np.arctan2(-east, north))
