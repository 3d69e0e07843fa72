"""The baselines as methods: a posed problem in, a `Run` out, as from the graph."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from factors.so3 import Array, to_quaternion
from graphnav._memory import peak_bytes
from graphnav._stages import Stages
from graphnav.baselines import dead_reckoning as dr
from graphnav.baselines import rts, warm_up
from graphnav.baselines.ekf import Progress
from graphnav.baselines.innovations import Innovations
from graphnav.baselines.inputs import PRESETS, Inputs
from graphnav.baselines.states import ACCEL_BIAS, GYRO_BIAS, MOUNTING, SCALE
from graphnav.baselines.tape import Estimates
from graphnav.errors import LogError
from graphnav.methods import LEG_METHODS, STEREO_METHODS, UWB_METHODS
from graphnav.outcome import warnings
from graphnav.problem import Problem
from graphnav.run import ACCEL_NAMES, GYRO_NAMES, ODOMETER_NAMES, Calibration, CalibrationHistory, Diagnostics, Run
from graphnav.trajectory import ImuBridge, Trajectory

_FILTERS = {"ekf": rts.filtered, "rts": rts.smoothed, "rts-online": rts.smoothed_online}
#: A kind of measurement whose NIS is above this makes a warning.
_INCONSISTENT = 2.0


def as_inputs(problem: Problem) -> Inputs:
    """What the baselines need of a problem."""
    f = problem.frontend
    return Inputs(
        problem.log, problem.config, problem.imu, problem.noise, problem.gravity_m_s2, problem.earth_rate_n,
        f.keyframe_s, f.cycles, f.closed_path, f.rest_s, f.fixes,
    )  # fmt: skip


def run_baseline(problem: Problem, method: str, stages: Stages) -> Run:
    """Run a Kalman filter, its smoother, or dead reckoning.

    Raises
    ------
    LogError : dead reckoning without an odometer.
    SolveError : the filter diverged.
    """
    if method in _FILTERS:
        return _filtered(problem, method, stages)
    return _reckoned(problem, method, stages)


def _filtered(problem: Problem, method: str, stages: Stages) -> Run:
    inputs, preset = as_inputs(problem), PRESETS[problem.config.filter.preset]
    with stages.stage("assemble"):
        warm_up()
    with stages.stage("solve") as tick:
        estimates, innovations = _FILTERS[method](inputs, preset, tick)
    with stages.stage("covariance"):
        quat, cov = estimates.house()
        known = history(problem, estimates, odometer=problem.has_calibration)
    bridge = bridged(problem, estimates.gyro_bias_b[:-1], estimates.accel_bias_b[:-1])
    trajectory = Trajectory(
        problem.keyframe_s, estimates.pos_n, quat, estimates.vel_n, cov if problem.config.covariance else None, bridge
    )
    diagnostics = replace(diagnosed(problem, method, stages), nis=innovations.to_dict())
    diagnostics.warnings.extend(inconsistent(innovations))
    if method == "rts-online" and not any(c.end_s is not None for c in inputs.cycles):
        diagnostics.warnings.append("no cut ends in this log: nothing was smoothed: use rts")
    return Run(trajectory, last(known), diagnostics, problem.config, history=known, innovations=innovations)


def _reckoned(problem: Problem, method: str, stages: Stages) -> Run:
    if problem.log.odometer is None:
        raise LogError("no odometer table", where=f"log {problem.log.name}", fix="dead reckoning needs an odometer")
    inputs = as_inputs(problem)
    with stages.stage("solve") as tick:
        rotation, known = _compensation(problem, inputs, tick)
        track = dr.traditional(inputs, rotation, known, problem.minor_s)
        if method == "dead-reckoning-cpoem":
            track = dr.along_closed_path(inputs, track, known)
    count = len(problem.keyframe_s) - 1
    bridge = bridged(problem, np.broadcast_to(known.gyro_bias_b, (count, 3)), np.zeros((count, 3)))
    trajectory = Trajectory(
        problem.keyframe_s, track.pos_n, to_quaternion(track.rotation_nb), track.vel_n, None, bridge
    )
    values = zip([*GYRO_NAMES, *ODOMETER_NAMES], [*known.gyro_bias_b, *known.calibration], strict=True)
    used = {name: Calibration(float(value / size), None, unit) for (name, size, unit), value in values}
    return Run(trajectory, used, diagnosed(problem, method, stages), problem.config)


def _compensation(problem: Problem, inputs: Inputs, tick: Progress | None) -> tuple[Array, dr.Compensation]:
    """Attitude at the start and the sensor errors that dead reckoning is told, by the configuration."""
    chosen = problem.config.dead_reckoning.compensation
    if chosen == "none":
        return dr.as_declared(inputs)
    rotation, known = dr.at_rest(inputs)
    if chosen == "rts":
        estimates, _ = rts.smoothed(inputs, PRESETS[problem.config.filter.preset], tick)
        known = dr.Compensation(estimates.gyro_bias_b[-1], estimates.calibration[-1])
    return rotation, known


def history(problem: Problem, estimates: Estimates, *, odometer: bool) -> CalibrationHistory:
    """Biases, and the odometer's calibration where it is estimated, at the keyframes, in datasheet units."""
    sigma = estimates.sigmas()
    names = [*ACCEL_NAMES, *GYRO_NAMES]
    values, sigmas = (
        [estimates.accel_bias_b, estimates.gyro_bias_b],
        [sigma[:, ACCEL_BIAS], sigma[:, GYRO_BIAS]],
    )
    if odometer:
        names += ODOMETER_NAMES
        values.append(estimates.calibration)
        sigmas += [sigma[:, SCALE, None], sigma[:, MOUNTING]]
    titles, sizes, units = zip(*names, strict=True)
    return CalibrationHistory(
        problem.keyframe_s, titles, units, np.hstack(values) / np.array(sizes), np.hstack(sigmas) / np.array(sizes)
    )


def last(known: CalibrationHistory) -> dict[str, Calibration]:
    """The final calibration."""
    assert known.sigma is not None
    rows = zip(known.names, known.units, known.value[-1].tolist(), known.sigma[-1].tolist(), strict=True)
    return {name: Calibration(value, sigma, unit) for name, unit, value, sigma in rows}


def bridged(problem: Problem, gyro_bias_b: Array, accel_bias_b: Array) -> ImuBridge:
    """What carries the states between keyframes."""
    return ImuBridge(problem.imu.samples, gyro_bias_b, accel_bias_b, problem.gravity_m_s2, problem.earth_rate_n)


def inconsistent(innovations: Innovations) -> list[str]:
    """A warning for every kind of measurement whose innovations are much larger than predicted."""
    found = []
    for kind in innovations.kinds:
        nis = innovations.nis(kind)
        if nis is not None and nis.mean > _INCONSISTENT and nis.mean > nis.high:
            found.append(
                f"innovations of {kind} are {nis.mean:.3g} times what the sigmas say (NIS of {nis.rows} rows, expected"
                f" {nis.low:.2f} to {nis.high:.2f}): its covariances are too small"
            )
    return found


def diagnosed(problem: Problem, method: str, stages: Stages) -> Diagnostics:
    """How a baseline went; it takes one pass and always converges."""
    problem.imu.release()
    unused = []
    if problem.log.lidar_points is not None and problem.config.lidar.use and method not in LEG_METHODS:
        unused.append(f"{method} does not use the table lidar_points: batch, isam2 and lidar-ekf do")
    if problem.log.uwb is not None and problem.config.uwb.use and method not in UWB_METHODS:
        unused.append(f"{method} does not use the table uwb: batch, isam2 and imu-uwb do")
    seen = (problem.log.stereo_pairs, problem.log.stereo_tracks, problem.log.relative_pose)
    if any(table is not None for table in seen) and method not in STEREO_METHODS:
        unused.append(f"{method} does not use the camera: batch, isam2, stereo and vio-kf do")
    return Diagnostics(
        method=method,
        converged=True,
        iterations=1,
        keyframes=len(problem.keyframe_s),
        seconds=stages.total(),
        peak_rss_mb=peak_bytes() / 1e6,
        warnings=warnings(problem, False) + unused,
    )
