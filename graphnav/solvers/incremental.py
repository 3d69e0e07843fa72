"""Incremental smoothing with iSAM2: a causal estimate at every keyframe, and the smoothed trajectory at the end.

QR inside, and the solver's own linearization point held in Python: callbacks of Python factors then receive that object
instead of a copy of all values.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from factors.inertial import predict
from factors.so3 import Array
from graphnav.config import Isam2Config
from graphnav.errors import SolveError
from graphnav.graph import B, C, FactorAt, Preintegrated, Problem, V, X
from graphnav.initial import States

if TYPE_CHECKING:
    from collections.abc import Callable

    import gtsam


@dataclass(frozen=True)
class IncrementalResult:
    """What iSAM2 leaves.

    Attributes
    ----------
    causal : (N) states, each estimated from the measurements up to its own keyframe.
    values : final smoothed estimates.
    relinearized, reeliminated : variables treated over the whole run.
    update_seconds : (U,) time of every update.
    """

    causal: States
    values: gtsam.Values
    relinearized: int
    reeliminated: int
    update_seconds: Array


def parameters(config: Isam2Config) -> gtsam.ISAM2Params:
    """iSAM2 parameters: QR, thresholds per kind of variable so that no unit rules the others."""
    import gtsam

    params = gtsam.ISAM2Params()
    params.setFactorization("QR")
    params.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(config.wildfire_threshold))
    params.relinearizeSkip = config.relinearize_skip
    attitude, position = config.threshold_attitude_rad, config.threshold_position_m
    thresholds = gtsam.ISAM2ThresholdMap()
    for letter, values in (
        ("x", [attitude] * 3 + [position] * 3),
        ("v", [config.threshold_velocity_m_s] * 3),
        ("b", [config.threshold_accel_bias_m_s2] * 3 + [config.threshold_gyro_bias_rad_s] * 3),
        ("c", [config.threshold_scale] + [config.threshold_mounting_rad] * 3),
        ("k", [position]),
    ):
        thresholds.insert((letter, np.array(values)))
    params.setRelinearizeThreshold(thresholds)
    params.enableRelinearization = True
    params.evaluateNonlinearError = False
    params.cacheLinearizedFactors = True
    params.enablePartialRelinearizationCheck = False
    return params


class _Session:
    """One pass of iSAM2 through the keyframes."""

    def __init__(self, problem: Problem, data: Preintegrated, start: States, config: Isam2Config) -> None:
        import gtsam

        self.problem, self.data, self.config = problem, data, config
        self.isam = gtsam.ISAM2(parameters(config))
        # held so that callbacks get this object, not a copy of it
        self.theta = self.isam.getLinearizationPoint()
        self.rotation, self.pos, self.vel = start.rotation_nb[0], start.pos_n[0], start.vel_n[0]
        self.known: set[int] = set()
        self.relinearized = self.reeliminated = 0

    def new_values(self, i: int, batch: gtsam.Values) -> None:
        """Insert the variables that keyframe i brings, predicted from the latest estimates."""
        import gtsam

        problem, data = self.problem, self.data
        if i > 0:
            row = np.array([i - 1])
            rotation, pos, vel = predict(
                self.rotation[None], self.pos[None], self.vel[None], data.motion, row,
                problem.gravity_m_s2, problem.earth_rate_n,
            )  # fmt: skip
            self.rotation, self.pos, self.vel = rotation[0], pos[0], vel[0]
            e = int(problem.bias_epoch[i - 1])
            if B(e) not in self.known:
                default = gtsam.imuBias.ConstantBias(data.accel_bias_b[0], data.gyro_bias_b[0])
                batch.insert(B(e), self.isam.calculateEstimateConstantBias(B(e - 1)) if B(e - 1) in self.known and e > 0 else default)
                self.known.add(B(e))
            if problem.has_calibration:
                c = int(problem.calibration_epoch[i - 1])
                if C(c) not in self.known:
                    earlier = C(c - 1) if c > 0 else -1
                    batch.insert(C(c), self.isam.calculateEstimateVector(earlier) if earlier in self.known else np.zeros(4))
                    self.known.add(C(c))
        batch.insert(X(i), gtsam.Pose3(gtsam.Rot3(self.rotation), self.pos))
        batch.insert(V(i), self.vel)

    def update(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
        try:
            result = self.isam.update(graph, values)
        except RuntimeError as error:
            raise SolveError(f"iSAM2 met a singular system: {str(error).strip().splitlines()[0]}") from None
        self.relinearized += result.getVariablesRelinearized()
        self.reeliminated += result.getVariablesReeliminated()

    def read(self, i: int) -> None:
        """Take the latest estimate of keyframe i.

        From its marginal, which needs the cliques above it alone; iSAM2's own estimate would first solve for all variables.
        """
        import gtsam

        steps = {}
        for key in (X(i), V(i)):
            conditional = self.isam.marginalFactor(key, gtsam.EliminateQR)
            steps[key] = np.linalg.solve(conditional.R(), conditional.d())
        pose = self.theta.atPose3(X(i)).retract(steps[X(i)]).matrix()
        self.rotation, self.pos = pose[:3, :3], pose[:3, 3]
        self.vel = self.theta.atVector(V(i)) + steps[V(i)]


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
    factors : sorted by keyframe, as `build_factors` returns them.
    start : state at the first keyframe.

    Notes
    -----
    A keyframe that is not the last of its update is reported by prediction from the update before.
    """
    import time

    import gtsam

    session = _Session(problem, data, start, config)
    count = len(problem.keyframe_s)
    causal = States(np.empty((count, 3, 3)), np.empty((count, 3)), np.empty((count, 3)))
    position, seconds = 0, []
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for i in range(count):
        session.new_values(i, values)
        while position < len(factors) and factors[position].keyframe == i:
            factor = factors[position].factor
            for key in factor.keys():
                if key >> 56 == ord("k") and key not in session.known:
                    face = problem.log.face
                    values.insert(key, np.array([face.creep_m if face else 0.0]))
                    session.known.add(key)
            graph.add(factor)
            position += 1
        due = (i + 1) % config.keyframes_per_update == 0 or i == count - 1
        # the first interval brings the bias that the priors hold: one update for both keyframes
        if due and i > 0:
            began = time.perf_counter()
            session.update(graph, values)
            graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
            session.read(i)
            seconds.append(time.perf_counter() - began)
        causal.rotation_nb[i], causal.pos_n[i], causal.vel_n[i] = session.rotation, session.pos, session.vel
        if progress is not None and (i % 50 == 0 or i == count - 1):
            progress(i + 1, count)
    final = session.isam.calculateEstimate()
    return IncrementalResult(causal, final, session.relinearized, session.reeliminated, np.array(seconds))
