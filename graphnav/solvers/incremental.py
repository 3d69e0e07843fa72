"""Incremental smoothing with iSAM2: a causal estimate at every keyframe, and the smoothed trajectory at the end.

QR inside, and the solver's own linearization point held in Python: callbacks of Python factors then receive that object
instead of a copy of all values.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from factors.carried import CAMERA_ERRORS
from factors.increments import npt_int
from factors.inertial import predict
from factors.so3 import Array
from graphnav.camera import uses_camera
from graphnav.config import Isam2Config
from graphnav.errors import SolveError
from graphnav.graph import fed_in_blocks
from graphnav.initial import States
from graphnav.legs import uses_legs
from graphnav.markov_errors import slots
from graphnav.native_factors import FactorAt
from graphnav.preintegration import Preintegrated
from graphnav.problem import B, C, Problem, V, X, creep_cycles
from graphnav.solvers.absolute import predicted_factor
from graphnav.solvers.incremental_legs import LegFeed, without_legs

if TYPE_CHECKING:
    from collections.abc import Callable

    import gtsam

    from graphnav.frontends.cutting_cycles import ClosedPathPoint


#: Markov errors enter ranges linearly: no threshold on them matters.
_MARKOV = 1e3


@dataclass(frozen=True)
class IncrementalResult:
    """What iSAM2 leaves.

    Attributes
    ----------
    causal : (N) states, each estimated from the measurements up to its own keyframe.
    values : smoothed estimates after the last keyframe, exact to the relinearization thresholds; without the legs
        and the LiDAR's calibration, which are others than in the whole graph.
    predicted : the papers' closed-path priors that were made on the way; none with relative closed-path factors.
    relinearized : variables relinearized over the whole run.
    reeliminated : (U,) variables eliminated anew in every update.
    update_seconds : (U,) time of every update with its reading.
    """

    causal: States
    values: gtsam.Values
    predicted: list[gtsam.NonlinearFactor]
    relinearized: int
    reeliminated: npt_int
    update_seconds: Array


def parameters(config: Isam2Config, slots: int = 0) -> gtsam.ISAM2Params:
    """iSAM2 parameters: QR, and thresholds per kind of variable so that no unit rules the others.

    The check for relinearization needs the solution of all variables; `solve` asks for it ever more rarely as the graph
    grows, so that its cost stays in proportion. The wildfire threshold, one number for metres and rad/s alike, is so
    low that no bias is cut off.

    Parameters
    ----------
    slots : size of the vectors of Markov errors of ranges.
    """
    import gtsam

    params = gtsam.ISAM2Params()
    params.setFactorization("QR")
    params.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(config.wildfire_threshold))
    params.relinearizeSkip = 1 << 30
    thresholds = gtsam.ISAM2ThresholdMap()
    for letter, values in (
        ("x", [config.threshold_attitude_rad] * 3 + [config.threshold_position_m] * 3),
        ("v", [config.threshold_velocity_m_s] * 3),
        ("b", [config.threshold_accel_bias_m_s2] * 3 + [config.threshold_gyro_bias_rad_s] * 3),
        ("c", [config.threshold_scale] + [config.threshold_mounting_rad] * 3),
        ("k", [config.threshold_position_m]),
        ("l", [config.threshold_position_m] * 2 + [config.threshold_lean] * 2),
        ("d", [config.threshold_scale, config.threshold_position_m, *[config.threshold_mounting_rad] * 6]),
        ("a", [config.threshold_position_m] * 4),
        ("e", [config.threshold_mounting_rad] * 3 + [config.threshold_position_m] * 5),
        ("m", [_MARKOV] * slots),
    ):
        thresholds.insert((letter, np.array(values)))
    params.setRelinearizeThreshold(thresholds)
    return params


class _Session:
    """One pass of iSAM2 through the keyframes: the solver, and the latest causal state."""

    def __init__(self, problem: Problem, data: Preintegrated, start: States, config: Isam2Config) -> None:
        import gtsam

        self.problem, self.data = problem, data
        self.isam = gtsam.ISAM2(parameters(config, slots(problem)))
        # held so that callbacks get this object, not a copy of it
        self.theta = self.isam.getLinearizationPoint()
        self.rotation, self.pos, self.vel = start.rotation_nb[0], start.pos_n[0], start.vel_n[0]
        self.pending, self.values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        self.anew = bool(creep_cycles(problem)) or bool(slots(problem)) or uses_camera(problem)
        self.slots = slots(problem)
        self.predicted: list[gtsam.NonlinearFactor] = []
        self.relinearized, self.reeliminated = 0, list[int]()
        self.legs = LegFeed(problem, data) if uses_legs(problem) else None

    def step(self, key: int) -> Array:
        """The solution for one variable relative to its linearization point.

        From its marginal, which needs the cliques above it alone; iSAM2's own estimate would solve for all variables.
        """
        import gtsam

        conditional = self.isam.marginalFactor(key, gtsam.EliminateQR)
        return np.asarray(np.linalg.solve(conditional.R(), conditional.d()))

    def pose(self, i: int) -> Array:
        """Current estimate of the pose at keyframe i, (4, 4)."""
        return np.asarray(self.theta.atPose3(X(i)).retract(self.step(X(i))).matrix())

    def calibration(self, epoch: int) -> Array:
        """Current estimate of the odometer calibration, (4,)."""
        return np.asarray(self.theta.atVector(C(epoch)) + self.step(C(epoch)))

    def add_keyframe(self, i: int) -> None:
        """Insert the variables that keyframe i brings, predicted from the latest estimates."""
        import gtsam

        problem, data = self.problem, self.data
        if i > 0:
            rotation, pos, vel = predict(
                self.rotation[None], self.pos[None], self.vel[None], data.motion, np.array([i - 1]),
                problem.gravity_m_s2, problem.earth_rate_n,
            )  # fmt: skip
            self.rotation, self.pos, self.vel = rotation[0], pos[0], vel[0]
            self._add_bias(i - 1)
            if problem.has_calibration:
                self._add_calibration(i - 1)
        self.values.insert(X(i), gtsam.Pose3(gtsam.Rot3(self.rotation), self.pos))
        self.values.insert(V(i), self.vel)

    def _add_bias(self, interval: int) -> None:
        import gtsam

        epoch = int(self.problem.bias_epoch[interval])
        if self.theta.exists(B(epoch)) or self.values.exists(B(epoch)):
            return
        earlier = gtsam.imuBias.ConstantBias(self.data.accel_bias_b[0], self.data.gyro_bias_b[0])
        if epoch > 0 and self.theta.exists(B(epoch - 1)):
            earlier = self.theta.atConstantBias(B(epoch - 1)).retract(self.step(B(epoch - 1)))
        self.values.insert(B(epoch), earlier)

    def _add_calibration(self, interval: int) -> None:
        epoch = int(self.problem.calibration_epoch[interval])
        if self.theta.exists(C(epoch)) or self.values.exists(C(epoch)):
            return
        known = epoch > 0 and self.theta.exists(C(epoch - 1))
        self.values.insert(C(epoch), self.calibration(epoch - 1) if known else np.zeros(4))

    def add_factor(self, factor: gtsam.NonlinearFactor) -> None:
        """Add a factor, and the variables of creep, ranges and camera that it may be the first to mention."""
        for key in factor.keys() if self.anew else ():
            letter = chr(key >> 56)
            if letter in "kame" and not (self.theta.exists(key) or self.values.exists(key)):
                face = self.problem.log.face
                creep = np.array([face.creep_m if face else 0.0])
                zero = {"k": creep, "a": np.zeros(4), "m": np.zeros(self.slots), "e": np.zeros(CAMERA_ERRORS)}
                self.values.insert(key, zero[letter])
        self.pending.add(factor)

    def add_absolute(self, point: ClosedPathPoint) -> None:
        """The papers' closed-path prior, at the position predicted from the current estimate of the first pass."""
        i = self.problem.frontend.index(point.first_s)
        calibration = self.calibration(int(self.problem.calibration_epoch[max(i - 1, 0)]))
        factor = predicted_factor(self.problem, point, self.pose(i), calibration)
        self.predicted.append(factor)
        self.pending.add(factor)

    def update(self, i: int, relinearize: bool) -> None:
        """Solve with what is pending, and take the estimate of keyframe i."""
        import gtsam

        options = gtsam.ISAM2UpdateParams()
        options.force_relinearize = relinearize
        try:
            result = self.isam.update(self.pending, self.values, options)
        except RuntimeError as error:
            raise SolveError.singular(error) from None
        self.pending, self.values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        self.relinearized += result.getVariablesRelinearized()
        self.reeliminated.append(result.getVariablesReeliminated())
        pose = self.pose(i)
        self.rotation, self.pos = pose[:3, :3], pose[:3, 3]
        self.vel = self.theta.atVector(V(i)) + self.step(V(i))
        if self.legs is not None:
            self.legs.feed(self, i, self.pending, self.values)


def solve(
    problem: Problem,
    data: Preintegrated,
    factors: list[FactorAt],
    start: States,
    config: Isam2Config,
    progress: Callable[[float, float], None] | None = None,
) -> IncrementalResult:
    """Feed the factors keyframe by keyframe.

    Parameters
    ----------
    problem, data : the problem and its condensed sensor data.
    factors : sorted by keyframe, as `build_factors` returns them.
    start : state at the first keyframe.
    config : thresholds, and how many keyframes share an update; one that is not the last of its update is reported by
        prediction from the update before.
    progress : called with keyframes done and in all.

    Raises
    ------
    SolveError : a singular system.
    """
    factors = fed_in_blocks(problem, factors, config.closed_path_block)
    session = _Session(problem, data, start, config)
    count = len(problem.keyframe_s)
    causal = States(np.empty((count, 3, 3)), np.empty((count, 3)), np.empty((count, 3)))
    absolute = problem.frontend.closed_path if problem.config.closed_path.form == "absolute" else ()
    predicted = [(problem.frontend.index(point.second_s), point) for point in absolute]
    fed, next_check, seconds = 0, config.relinearize_skip, []
    for i in range(count):
        session.add_keyframe(i)
        while fed < len(factors) and factors[fed].keyframe == i:
            session.add_factor(factors[fed].factor)
            fed += 1
        while predicted and predicted[0][0] == i:
            session.add_absolute(predicted.pop(0)[1])
        # the first keyframe waits for the second, whose interval brings the bias that the priors hold
        if i > 0 and ((i + 1) % config.keyframes_per_update == 0 or i == count - 1):
            began = time.perf_counter()
            relinearize = i >= next_check
            if relinearize:
                next_check = i + max(config.relinearize_skip, int(config.relinearize_growth * i))
            session.update(i, relinearize)
            seconds.append(time.perf_counter() - began)
        causal.rotation_nb[i], causal.pos_n[i], causal.vel_n[i] = session.rotation, session.pos, session.vel
        if progress is not None and (i % 50 == 0 or i == count - 1):
            progress(i + 1, count)
    final = session.isam.calculateEstimate()
    if session.legs is not None:
        final = without_legs(final)
    return IncrementalResult(
        causal, final, session.predicted, session.relinearized, np.array(session.reeliminated), np.array(seconds)
    )
