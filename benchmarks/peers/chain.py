"""What both peers share: preintegration sample by sample, dead reckoning, and the factors that are native anyway."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import gtsam
import numpy as np
import numpy.typing as npt
from gtsam.symbol_shorthand import V, X

from factors.earth import earth_rate_n
from graphnav.keyframes import Frontend
from graphnav.log import InitialState, SensorLog

Array = npt.NDArray[np.float64]

#: The rotation that a pose-to-pose factor must be given where only a displacement was measured: of no weight, rad.
FREE_RAD = 1.0
INTEGRATION_COVARIANCE = 1e-8
REST_VELOCITY_M_S, REST_ROTATION_RAD, REST_POSITION_M = 1e-3, np.radians(5e-4), 1e-4


@dataclass(frozen=True)
class Chain:
    """A log cut at its keyframes.

    Attributes
    ----------
    log, frontend : as read, and as graphnav's front end found it.
    start : the declared initial state.
    """

    log: SensorLog
    frontend: Frontend
    start: InitialState

    @property
    def keyframe_s(self) -> Array:
        """(N,) keyframe times."""
        return self.frontend.keyframe_s

    @property
    def pose(self) -> gtsam.Pose3:
        """The declared initial pose."""
        w, x, y, z = self.start.quat_nb_wxyz
        return gtsam.Pose3(gtsam.Rot3.Quaternion(w, x, y, z), self.start.pos_n_m)


def sigmas(*values: float) -> gtsam.noiseModel.Diagonal:
    """Diagonal noise, never GTSAM's "smart" hard constraint for sigmas below 1e-8."""
    return gtsam.noiseModel.Diagonal.Sigmas(np.array(values, float), False)


def imu_params(log: SensorLog) -> gtsam.PreintegrationParams:
    """Datasheet noise, gravity along -up, Earth rate; the integration covariance is that of GTSAM's examples.

    It is 0.1 mm per square root of a second, and holds the problem together: at 1e-12 GTSAM's Cholesky takes the same
    sound log for indeterminate.
    """
    imu, frames = log.imu, log.frames
    assert imu is not None and frames.gravity_m_s2 is not None
    params = gtsam.PreintegrationParams.MakeSharedU(frames.gravity_m_s2)
    gyro = np.radians(imu.gyro_random_walk_deg_sqrt_h) / 60
    accel = imu.accel_random_walk_mg_sqrt_hz * 9.80665e-3
    params.setGyroscopeCovariance(np.eye(3) * gyro**2)
    params.setAccelerometerCovariance(np.eye(3) * accel**2)
    params.setIntegrationCovariance(np.eye(3) * INTEGRATION_COVARIANCE)
    params.setOmegaCoriolis(earth_rate_n(frames.latitude_deg))
    return params


def bias_sigmas(log: SensorLog) -> tuple[float, float]:
    """Turn-on bias of accelerometer, m/s^2, and gyro, rad/s."""
    assert log.imu is not None
    return log.imu.accel_bias_mg * 9.80665e-3, float(np.radians(log.imu.gyro_bias_deg_h) / 3600)


def preintegrated(chain: Chain) -> Iterator[tuple[gtsam.PreintegratedImuMeasurements, float]]:
    """One preintegrated measurement per interval, IMU sample by IMU sample, and the odometer's distance, m.

    A keyframe inside a sample splits it.
    """
    imu, odometer = chain.log.imu, chain.log.odometer
    assert imu is not None and odometer is not None
    pim = gtsam.PreintegratedImuMeasurements(imu_params(chain.log), gtsam.imuBias.ConstantBias())
    times = chain.keyframe_s
    edges = np.union1d(np.concatenate([[imu.start_s], imu.t_s]), times)
    edges = edges[np.concatenate([[True], np.diff(edges) > 1e-6])]
    row = np.clip(np.searchsorted(imu.t_s, (edges[1:] + edges[:-1]) / 2), 0, len(imu) - 1)
    dt = np.diff(edges)
    covered = np.concatenate(
        [[0.0], np.cumsum(np.interp((edges[1:] + edges[:-1]) / 2, odometer.t_s, odometer.speed_m_s) * dt)]
    )
    bounds = np.searchsorted(edges, times - 1e-6).tolist()
    for first, last in pairwise(bounds):
        pim.resetIntegration()
        rows = row[first:last]
        for accel, gyro, step in zip(
            imu.accel_b_m_s2[rows], imu.gyro_b_rad_s[rows], dt[first:last].tolist(), strict=True
        ):
            pim.integrateMeasurement(accel, gyro, step)
        yield pim, float(covered[last] - covered[first])


def displacement(turn: gtsam.Rot3, distance_m: float) -> Array:
    """The odometer's distance along the body's forward axis, turned by half of the interval's rotation, (3,) in b."""
    half = gtsam.Rot3.Expmap(gtsam.Rot3.Logmap(turn) / 2)
    return np.asarray(half.matrix()[:, 1] * distance_m)


def dead_reckoned(chain: Chain, turns: list[gtsam.Rot3], moves: list[Array]) -> gtsam.Values:
    """Poses and velocities from gyro and odometer, started at the declared initial state."""
    odometer, times = chain.log.odometer, chain.keyframe_s
    assert odometer is not None
    earth_n = earth_rate_n(chain.log.frames.latitude_deg)
    speed = np.interp(times, odometer.t_s, odometer.speed_m_s)
    values, pose = gtsam.Values(), chain.pose
    values.insert(X(0), pose)
    values.insert(V(0), chain.start.vel_n_m_s)
    for i, turn in enumerate(turns):
        rotation, position = pose.rotation(), pose.translation()
        carried = gtsam.Rot3.Expmap(-earth_n * (times[i + 1] - times[i])).compose(rotation).compose(turn)
        pose = gtsam.Pose3(carried, position + rotation.matrix() @ moves[i])
        values.insert(X(i + 1), pose)
        values.insert(V(i + 1), carried.matrix()[:, 1] * speed[i + 1])
    return values


def common_factors(chain: Chain) -> gtsam.NonlinearFactorGraph:
    """Priors, rest, surveyed points and the closed path: native factors in either peer."""
    graph, start, frontend = gtsam.NonlinearFactorGraph(), chain.start, chain.frontend
    # the position prior is isotropic in this scenario, so it needs no turning into the body frame
    graph.add(gtsam.PriorFactorPose3(X(0), chain.pose, sigmas(*np.radians(start.att_sigma_deg), *start.pos_sigma_m)))
    graph.add(gtsam.PriorFactorVector(V(0), start.vel_n_m_s, sigmas(*start.vel_sigma_m_s)))
    for t_s, pos_n, sigma_n in frontend.fixes:
        graph.add(gtsam.PoseTranslationPrior3D(X(frontend.index(t_s)), pos_n, sigmas(*sigma_n)))
    still = sigmas(*[REST_ROTATION_RAD] * 3, *[REST_POSITION_M] * 3)
    for begin, end in frontend.rest_s:
        inside = np.flatnonzero((chain.keyframe_s >= begin - 1e-6) & (chain.keyframe_s <= end + 1e-6)).tolist()
        for i in inside:
            graph.add(gtsam.PriorFactorVector(V(i), np.zeros(3), sigmas(*[REST_VELOCITY_M_S] * 3)))
        for i in inside[1:]:
            graph.add(gtsam.BetweenFactorPose3(X(i - 1), X(i), gtsam.Pose3(), still))
    _add_closed_path(graph, chain)
    return graph


def _add_closed_path(graph: gtsam.NonlinearFactorGraph, chain: Chain) -> None:
    """The push between two passes over one point, as a pose-to-pose factor whose rotation is left free."""
    face, frontend = chain.log.face, chain.frontend
    if face is None:
        return
    for point in frontend.closed_path:
        along = face.along_sigma_m if point.at_end else face.length_m
        noise = sigmas(*[FREE_RAD] * 3, face.push_sigma_m, along, face.push_sigma_m)
        push = gtsam.Pose3(gtsam.Rot3(), np.array([point.push_m, face.creep_m, 0.0]))
        first, second = frontend.index(point.first_s), frontend.index(point.second_s)
        graph.add(gtsam.BetweenFactorPose3(X(first), X(second), push, noise))
