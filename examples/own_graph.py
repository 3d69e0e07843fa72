"""Use the measurement models in a GTSAM graph of your own: no log folder, no graphnav, only `factors`.

A loader drives a slalom for a minute. Its IMU is preintegrated between keyframes one second apart; its
odometer, with a scale error and mounted a little askew, joins the same keyframes; three surveyed points tie
them down. One graph gives the path and calibrates the odometer.

    python examples/own_graph.py
"""

from __future__ import annotations

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, C, V, X

from factors import earth, inertial, odometry, so3
from factors.increments import Samples, compensated_increments
from factors.inertial import ImuNoise
from factors.position import position_factor

RNG = np.random.default_rng(1)
DT_S, DURATION_S = 0.01, 60.0
GRAVITY_M_S2 = earth.normal_gravity(35.0)
EARTH_RATE_N = earth.earth_rate_n(35.0)
SCALE, ALPHA_RAD = 0.02, np.radians([0.5, 0.0, -1.5])  # what the graph has to find out
SPEED_SIGMA_M_S, SLIP_SIGMA_M_S, SURVEY_SIGMA_M = 0.02, 0.005, 0.01
NOISE = ImuNoise.from_datasheet(
    gyro_random_walk_deg_sqrt_h=0.3,
    accel_random_walk_mg_sqrt_hz=0.05,
    gyro_bias_deg_h=20.0,
    accel_bias_mg=0.5,
)


def drive() -> tuple[np.ndarray, ...]:
    """The true drive on every IMU edge: time, attitude R_nb, velocity and position in n, forward speed."""
    t = np.arange(0, DURATION_S + DT_S / 2, DT_S)
    speed = 1.5 * np.sin(np.pi * np.clip(t / 8, 0, 0.5)) ** 2  # from rest to 1.5 m/s
    yaw = 0.6 * np.sin(0.25 * t)
    rotation_nm = so3.exp(np.outer(yaw, [0, 0, 1]))
    vel_n = speed[:, None] * rotation_nm[:, :, 1]
    pos_n = np.vstack([np.zeros(3), np.cumsum((vel_n[1:] + vel_n[:-1]) / 2 * DT_S, axis=0)])
    return t, rotation_nm @ so3.exp(ALPHA_RAD), vel_n, pos_n, speed


def imu(t: np.ndarray, rotation_nb: np.ndarray, vel_n: np.ndarray) -> Samples:
    """What an IMU with these errors makes of it: mean angular rate and specific force of every sample."""
    turn = so3.transpose(rotation_nb[:-1]) @ so3.exp(EARTH_RATE_N * DT_S) @ rotation_nb[1:]
    middle = rotation_nb[:-1] @ so3.exp(so3.log(so3.transpose(rotation_nb[:-1]) @ rotation_nb[1:]) / 2)
    coriolis = 2 * np.cross(EARTH_RATE_N, (vel_n[1:] + vel_n[:-1]) / 2)
    force_n = np.diff(vel_n, axis=0) / DT_S + coriolis + [0, 0, GRAVITY_M_S2]
    gyro_b = so3.log(turn) / DT_S
    accel_b = np.einsum("kji,kj->ki", middle, force_n)
    for samples, bias, density in (
        (gyro_b, NOISE.gyro_bias, NOISE.gyro_density),
        (accel_b, NOISE.accel_bias, NOISE.accel_density),
    ):
        samples += RNG.normal(0, bias, 3) + RNG.normal(0, density / np.sqrt(DT_S), samples.shape)
    return Samples(t, gyro_b, accel_b)


def build(samples: Samples, odo_t_s: np.ndarray, odo_m_s: np.ndarray, surveyed: dict[int, np.ndarray]):
    """The graph over keyframes X (pose), V (velocity), one bias B(0) and one odometer calibration C(0)."""
    keyframe_s = np.arange(0, DURATION_S + 0.5, 1.0)
    increments = compensated_increments(samples, keyframe_s, minor_s=0.05)
    motion = inertial.cumulate(increments)
    travel = odometry.preintegrate_speed(odo_t_s, odo_m_s, keyframe_s, motion)
    params = inertial.preintegration_params(NOISE, GRAVITY_M_S2, EARTH_RATE_N)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()

    def prior(sigmas):
        return gtsam.noiseModel.Diagonal.Sigmas(np.asarray(sigmas, float))

    rotation, pos_n, vel_n = np.eye(3), np.zeros(3), np.zeros(3)
    graph.addPriorPose3(X(0), gtsam.Pose3(), prior([0.02, 0.02, 0.05, 0.01, 0.01, 0.01]))
    graph.addPriorVector(V(0), vel_n, prior([0.001] * 3))
    bias = [NOISE.accel_bias] * 3 + [NOISE.gyro_bias] * 3
    graph.addPriorConstantBias(B(0), gtsam.imuBias.ConstantBias(), prior(bias))
    graph.addPriorVector(C(0), np.zeros(4), prior([0.05, *np.radians([3.0, 0.1, 3.0])]))
    values.insert(B(0), gtsam.imuBias.ConstantBias())
    values.insert(C(0), np.zeros(4))
    last = increments.first[1:] - 1  # the minor interval that ends each interval
    for k, pim in enumerate(inertial.preintegrations(increments, params, np.zeros(3), np.zeros(3))):
        graph.add(gtsam.ImuFactor(X(k), V(k), X(k + 1), V(k + 1), B(0), pim))
        noise = prior([SLIP_SIGMA_M_S, SPEED_SIGMA_M_S * np.sqrt(travel.weight2_s2[k]), SLIP_SIGMA_M_S])
        keys, distance_m = (X(k), X(k + 1), C(0)), float(travel.distance_m[k])
        lever_arm_b = np.zeros(3)
        graph.add(odometry.displacement_factor(*keys, distance_m, travel.mean_b[k], noise, lever_arm_b))
    for k in range(len(keyframe_s)):  # start from dead reckoning
        values.insert(X(k), gtsam.Pose3(gtsam.Rot3(rotation), pos_n))
        values.insert(V(k), vel_n)
        if k < len(last):
            state = (rotation[None], pos_n[None], vel_n[None], motion, last[k : k + 1])
            rotation, pos_n, vel_n = (s[0] for s in inertial.predict(*state, GRAVITY_M_S2, EARTH_RATE_N))
    for k, measured_n in surveyed.items():
        graph.add(position_factor(X(k), measured_n, SURVEY_SIGMA_M))
    return graph, values


def main() -> None:
    """Simulate, build, solve and show."""
    t, rotation_nb, vel_n, pos_n, speed = drive()
    every = slice(10, None, 10)  # 10 Hz
    odo_m_s = (1 + SCALE) * speed[every] + RNG.normal(0, SPEED_SIGMA_M_S, len(speed[every]))
    surveyed = {k: pos_n[100 * k] + RNG.normal(0, SURVEY_SIGMA_M, 3) for k in (0, 30, 60)}
    graph, values = build(imu(t, rotation_nb, vel_n), t[every], odo_m_s, surveyed)

    params = gtsam.LevenbergMarquardtParams()
    params.setLinearSolverType("MULTIFRONTAL_QR")  # Cholesky gives up on long inertial chains
    result = gtsam.LevenbergMarquardtOptimizer(graph, values, params).optimize()
    solved = gtsam.Marginals(graph, result)
    sigma = np.sqrt(np.diag(solved.marginalCovariance(C(0))))
    scale, *alpha = result.atVector(C(0))
    error = np.array([result.atPose3(X(k)).translation() - pos_n[100 * k] for k in range(61)])
    print(f"scale error      {scale:+.4f} +- {sigma[0]:.4f}      (true {SCALE:+.4f})")
    for axis, name in enumerate(("right", "forward", "up")):
        found, spread, true = np.degrees([alpha[axis], sigma[1 + axis], ALPHA_RAD[axis]])
        print(f"mounting {name:8s}{found:+.3f} +- {spread:.3f} deg    (true {true:+.3f})")
    print(f"position rms     {np.sqrt((error**2).sum(axis=1).mean()):.4f} m over {speed.sum() * DT_S:.0f} m")


if __name__ == "__main__":
    main()
