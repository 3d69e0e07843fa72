"""The papers' closed path: absolute priors at positions predicted from the last cycle's estimate.

Kept for comparison. It counts the information of each cycle again in the next one; the relative factors do not.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from factors import closed_path, so3
from factors.so3 import Array
from graphnav.frontends.cutting_cycles import ClosedPathPoint
from graphnav.graph import SmoothingGraph
from graphnav.problem import C, Problem, X
from graphnav.solvers import batch

if TYPE_CHECKING:
    import gtsam


def predicted_factor(
    problem: Problem, point: ClosedPathPoint, first_pose: Array, calibration: Array
) -> gtsam.NonlinearFactor:
    """Prior on the second pass over a point, from the estimate of the first (Zheng et al. 2021, equations 6 and 21).

    Parameters
    ----------
    first_pose : (4, 4) T_nb at the first pass; calibration : (4,) [scale, alpha rad].
    """
    import gtsam

    face = problem.log.face
    assert face is not None
    to_n = first_pose[:3, :3] @ so3.transpose(so3.exp(calibration[1:]))
    predicted = first_pose[:3, 3] + to_n @ np.array([point.push_m, face.creep_m, 0.0])
    sigma_m = np.array([face.push_sigma_m, face.along_sigma_m, face.push_sigma_m])
    noise = gtsam.noiseModel.Gaussian.Covariance(to_n @ np.diag(sigma_m**2) @ to_n.T)
    return closed_path.absolute_factor(X(problem.frontend.index(point.second_s)), predicted, noise)


def solve_cycle_by_cycle(problem: Problem, graph: SmoothingGraph, result: batch.BatchResult) -> batch.BatchResult:
    """Add each cycle's predictions from the estimate so far and solve again, in the order the cycles were cut.

    Zheng et al. (2021), figure 4: the positions of the optimal points of the next cycle are set when a cycle is
    smoothed.
    """
    config = problem.config.batch
    for cycle in sorted({p.cycle for p in problem.frontend.closed_path}):
        for point in (p for p in problem.frontend.closed_path if p.cycle == cycle):
            i = problem.frontend.index(point.first_s)
            calibration = result.values.atVector(C(int(problem.calibration_epoch[max(i - 1, 0)])))
            pose = result.values.atPose3(X(i)).matrix()
            graph.native.add(predicted_factor(problem, point, pose, calibration))
        again = batch.solve(
            graph, result.values, max_iterations=config.max_iterations, tolerance_sigma=config.tolerance_sigma
        )
        result = batch.BatchResult(
            again.values, again.bayes_tree, result.iterations + again.iterations, again.converged, again.order
        )
    return result
