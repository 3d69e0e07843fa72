"""The INS/LiDAR paper's filter as a method: a posed problem in, a `Run` out."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from factors.so3 import from_quaternion
from graphnav.baselines.leg_correction import Fitted, Wanted, fit
from graphnav.baselines.leg_filter import LegFilter, Scanner
from graphnav.errors import LogError
from graphnav.filtered import as_inputs, bridged, diagnosed, history, inconsistent, last
from graphnav.run import Calibration, Run
from graphnav.trajectory import Trajectory

if TYPE_CHECKING:
    from graphnav._stages import Stages
    from graphnav.problem import Problem

#: What the posterior correction adds to the scanner's mounting about up.
CORRECTION = "lidar_picm_up"


def run_leg_filter(problem: Problem, method: str, stages: Stages) -> Run:
    """Choose legs and correct the mounting as `lidar_filter` asks, then filter the whole log.

    Raises
    ------
    LogError : no detections of legs, no declared scanner, or nothing to choose by.
    SolveError : the filter diverged.
    """
    scanner, inputs, config = scanner_of(problem), as_inputs(problem), problem.config.lidar_filter
    with stages.stage("assemble"):
        fitted = fit(inputs, scanner, Wanted(config.features, config.mode, config.distance_m, config.picm))
    with stages.stage("solve") as tick:
        forward = LegFilter(inputs, fitted.scanner, fitted.selection)
        forward.run(len(inputs.keyframe_s) - 1, tick)
    estimates, innovations = forward.estimates, forward.innovations()
    with stages.stage("covariance"):
        quat, cov = estimates.house()
        known = history(problem, estimates, odometer=False)
    bridge = bridged(problem, estimates.gyro_bias_b[:-1], estimates.accel_bias_b[:-1])
    trajectory = Trajectory(
        problem.keyframe_s, estimates.pos_n, quat, estimates.vel_n, cov if problem.config.covariance else None, bridge
    )
    diagnostics = replace(diagnosed(problem, method, stages), nis=innovations.to_dict(), history=[_chosen(fitted)])
    diagnostics.warnings.extend(inconsistent(innovations))
    calibration = last(known)
    if config.picm:
        calibration[CORRECTION] = Calibration(float(np.degrees(fitted.eta_rad[2])), None, "deg")
    return Run(trajectory, calibration, diagnostics, problem.config, history=known, innovations=innovations)


def scanner_of(problem: Problem) -> Scanner:
    """The declared scanner, and how its readings are modelled.

    Raises
    ------
    LogError : no detections of legs, or no declared scanner.
    """
    log, config = problem.log, problem.config.lidar_filter
    if log.lidar_points is None or log.lidar is None:
        missing = "lidar_points table" if log.lidar_points is None else "[lidar] section"
        raise LogError(f"no {missing}", where=f"log {log.name}", fix="lidar-ekf needs detected legs: use ekf")
    lidar = log.lidar
    scan_s = float(np.median(np.diff(np.unique(log.lidar_points.t_s)))) if len(log.lidar_points) > 1 else np.inf
    shared = np.sqrt(max(1.0, config.independent_s / scan_s))
    return Scanner(
        rotation_bs=from_quaternion(lidar.T_bs_quat_wxyz),
        lever_arm_b=lidar.T_bs_pos_m,
        sigma=np.array(
            [shared * lidar.range_sigma_m, shared * np.radians(lidar.angle_sigma_deg), config.height_sigma_m]
        ),
        upright=config.leg == "line",
        walk_m_sqrt_s=config.height_walk_m_sqrt_s,
    )


def _chosen(fitted: Fitted) -> dict[str, float]:
    """What was chosen, and where the modes that were tried first arrived at the far end, in m(t0)."""
    selection = fitted.selection
    chosen = {"mode": selection.mode, "features": selection.count, "distance_m": selection.nearest_m}
    for mode, (right, forward, _) in fitted.arrival_m.items():
        chosen |= {f"arrival_right_m_mode_{mode}": float(right), f"arrival_forward_m_mode_{mode}": float(forward)}
    return chosen
