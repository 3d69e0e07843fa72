"""GTSAM factors of what every log may have: priors, IMU, odometer, rest, closed path, positions.

Each stands with the last keyframe that it needs. LiDAR, UWB and cameras bring their own (`graphnav.graph`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from factors import closed_path, inertial, odometry, position, stationary
from factors.noise import diagonal
from factors.so3 import from_quaternion
from graphnav.log import InitialState
from graphnav.preintegration import Preintegrated
from graphnav.problem import B, C, K, Problem, V, X, creep_cycles

if TYPE_CHECKING:
    import gtsam


@dataclass(frozen=True)
class FactorAt:
    """A factor and the last keyframe it needs: what an incremental solver is fed at that keyframe."""

    keyframe: int
    factor: gtsam.NonlinearFactor


def common_factors(problem: Problem, data: Preintegrated) -> list[FactorAt]:
    """Everything but the odometer's displacements."""
    found = _priors(problem)
    found += [FactorAt(i + 1, factor) for i, factor in enumerate(data.imu_factors)]
    found += _epoch_walks(problem)
    if problem.config.odometer.form == "velocity":
        found += _velocity_factors(problem, data)
    found += _rest_factors(problem)
    found += closed_path_factors(problem)
    for t, pos_n, sigma_n in problem.frontend.fixes:
        i = problem.frontend.index(t)
        found.append(FactorAt(i, position.position_factor(X(i), pos_n, sigma_n)))
    return found


def _priors(problem: Problem) -> list[FactorAt]:
    import gtsam

    initial, noise = problem.initial, problem.noise
    bias = diagonal(np.r_[np.full(3, noise.accel_bias), np.full(3, noise.gyro_bias)])
    found = [
        FactorAt(0, pose_prior(initial)),
        FactorAt(0, gtsam.PriorFactorVector(V(0), initial.vel_n_m_s, diagonal(initial.vel_sigma_m_s))),
        FactorAt(1, gtsam.PriorFactorConstantBias(B(0), gtsam.imuBias.ConstantBias(), bias)),
    ]
    odometer = problem.log.odometer
    if odometer is not None:
        sigmas = np.r_[odometer.scale_sigma, np.radians(odometer.mounting_sigma_deg)]
        found.append(FactorAt(1, gtsam.PriorFactorVector(C(0), np.zeros(4), diagonal(sigmas))))
    return found


def pose_prior(initial: InitialState) -> gtsam.NonlinearFactor:
    """The declared pose at the first keyframe."""
    import gtsam

    rotation = from_quaternion(initial.quat_nb_wxyz)
    cov = np.zeros((6, 6))
    cov[:3, :3] = np.diag(np.radians(initial.att_sigma_deg) ** 2)
    cov[3:, 3:] = rotation.T @ np.diag(initial.pos_sigma_m**2) @ rotation
    pose = gtsam.Pose3(gtsam.Rot3(rotation), initial.pos_n_m)
    return gtsam.PriorFactorPose3(X(0), pose, gtsam.noiseModel.Gaussian.Covariance(cov))


def _epoch_walks(problem: Problem) -> list[FactorAt]:
    """Random walks between epochs.

    A bias or calibration declared constant still gets a walk too small to show: a thousandth of what the gyro or
    accelerometer noise hides within one epoch.
    """
    import gtsam

    noise, config = problem.noise, problem.config
    span = config.imu.bias_epoch_s
    gyro = np.hypot(noise.gyro_bias_walk * np.sqrt(span), 1e-3 * noise.gyro_density / np.sqrt(span))
    accel = np.hypot(noise.accel_bias_walk * np.sqrt(span), 1e-3 * noise.accel_density / np.sqrt(span))
    found = []
    for k in np.flatnonzero(np.diff(problem.bias_epoch)) + 1:
        e = int(problem.bias_epoch[k])
        found.append(FactorAt(int(k) + 1, inertial.bias_walk_factor(B(e - 1), B(e), float(accel), float(gyro))))
    if problem.has_calibration:
        hours = np.sqrt(config.odometer.calibration_epoch_s / 3600)
        mounting = np.radians(config.odometer.mounting_walk_deg_sqrt_h)
        sigmas = hours * np.r_[config.odometer.scale_walk_sqrt_h, np.full(3, mounting)]
        model = diagonal(sigmas)
        for k in np.flatnonzero(np.diff(problem.calibration_epoch)) + 1:
            e = int(problem.calibration_epoch[k])
            found.append(FactorAt(int(k) + 1, gtsam.BetweenFactorVector(C(e - 1), C(e), np.zeros(4), model)))
    return found


def displacement_family(problem: Problem, data: Preintegrated) -> odometry.DisplacementFamily | None:
    """The odometer preintegrated over every interval that has samples, or None where it is not used so."""
    odometer, travel = problem.log.odometer, data.travel
    if odometer is None or travel is None or problem.config.odometer.form != "displacement":
        return None
    used = np.flatnonzero(travel.samples)
    forward = odometer.sigma_m_s * np.sqrt(travel.weight2_s2[used])
    # slip is independent each second: its displacement grows with the square root of time
    slip = odometer.slip_sigma_m_s * np.sqrt(np.diff(problem.keyframe_s)[used])
    return odometry.DisplacementFamily(
        key_i=X(0) + used,
        key_j=X(0) + used + 1,
        calibration_key=C(0) + problem.calibration_epoch[used],
        distance_m=travel.distance_m[used],
        mean_b=travel.mean_b[used],
        sigma_m=np.column_stack([slip, forward, slip]),
        lever_arm_b=odometer.lever_arm_b_m,
    )


def _velocity_factors(problem: Problem, data: Preintegrated) -> list[FactorAt]:
    """The odometer sample nearest each keyframe, where one is near enough to stand for it."""
    odometer = problem.log.odometer
    if odometer is None:
        return []
    t = problem.keyframe_s
    step = float(np.median(np.diff(odometer.t_s)))
    noise = diagonal([odometer.slip_sigma_m_s, odometer.sigma_m_s, odometer.slip_sigma_m_s])
    edge, gyro = problem.imu.samples.edge_s, problem.imu.samples.gyro_b
    found, used = [], -1
    for i in range(len(t)):
        row = int(np.clip(np.searchsorted(odometer.t_s, t[i] - step / 2), 0, len(odometer) - 1))
        if abs(odometer.t_s[row] - t[i]) > 0.51 * step or row == used:
            continue
        used = row
        k = min(max(i - 1, 0), len(t) - 2)
        sample = int(np.clip(np.searchsorted(edge, t[i]) - 1, 0, len(gyro) - 1))
        rate = gyro[sample] - data.gyro_bias_b[k]
        speed = float(odometer.speed_m_s[row])
        key = C(int(problem.calibration_epoch[k]))
        factor = odometry.velocity_factor(X(i), V(i), key, speed, rate, noise, odometer.lever_arm_b_m)
        found.append(FactorAt(max(i, 1), factor))
    return found


def _rest_factors(problem: Problem) -> list[FactorAt]:
    config, t = problem.config.rest, problem.keyframe_s
    attitude = float(np.radians(config.attitude_sigma_deg))
    found = []
    for start, end in problem.frontend.rest_s:
        inside = np.flatnonzero((t >= start - 1e-6) & (t <= end + 1e-6))
        for i in inside:
            found.append(FactorAt(int(i), stationary.zero_velocity_factor(V(int(i)), config.velocity_sigma_m_s)))
        for i in inside[1:]:
            factor = stationary.unmoved_factor(X(i - 1), X(i), attitude, config.position_sigma_m)
            found.append(FactorAt(int(i), factor))
    return found


def closed_path_factors(problem: Problem) -> list[FactorAt]:
    """Relative closed-path factors; the absolute form needs estimates and is added by the solvers.

    Between the ends of the face two passes are matched by the odometer, whose samples the graph already holds: along
    the face they say nothing new there (decision 0003), so that row is left as wide as the face.
    """
    import gtsam

    face = problem.log.face
    if face is None or problem.config.closed_path.form != "relative":
        return []
    at_end, inside = (closed_path.advance_noise(face.push_sigma_m, s) for s in (face.along_sigma_m, face.length_m))
    creeping = creep_cycles(problem)
    found, met = [], set()
    for point in problem.frontend.closed_path:
        i, j = problem.frontend.index(point.first_s), problem.frontend.index(point.second_s)
        calibration = C(int(problem.calibration_epoch[max(i - 1, 0)]))
        noise = at_end if point.at_end or problem.config.closed_path.along == "all" else inside
        if not creeping:
            advance = np.array([point.push_m, face.creep_m, 0.0])
            factor = closed_path.relative_factor(X(i), X(j), calibration, advance, noise)
        else:
            if point.cycle not in met:
                prior = gtsam.noiseModel.Isotropic.Sigma(1, face.creep_sigma_m)
                found.append(FactorAt(j, gtsam.PriorFactorVector(K(point.cycle), np.array([face.creep_m]), prior)))
                met.add(point.cycle)
            advance = np.array([point.push_m, 0.0, 0.0])
            factor = closed_path.creeping_factor(X(i), X(j), calibration, K(point.cycle), advance, noise)
        found.append(FactorAt(j, factor))
    return found
