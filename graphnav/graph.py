"""From a problem and its condensed sensor data to factors: as one graph for batch, one by one for iSAM2."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from factors import closed_path, inertial, odometry, position, stationary
from factors.advance import AdvanceFamily
from factors.condensed_points import Condensed
from factors.legs import LegFamily
from factors.mounted_motion import MotionFamily
from factors.noise import diagonal
from factors.ranging import RangeFamily
from factors.so3 import from_quaternion
from factors.stereo_tracks import TrackFamily
from graphnav.camera import Camera
from graphnav.leg_priors import leg_priors
from graphnav.legs import LegReadings
from graphnav.log import InitialState, Lidar
from graphnav.motions import MotionReadings
from graphnav.preintegration import Preintegrated
from graphnav.problem import B, C, K, Problem, V, X, creep_cycles
from graphnav.ranges import RangeReadings, RangeStates

if TYPE_CHECKING:
    import gtsam


@dataclass(frozen=True)
class FactorAt:
    """A factor and the last keyframe it needs: what an incremental solver is fed at that keyframe."""

    keyframe: int
    factor: gtsam.NonlinearFactor


@dataclass(frozen=True)
class SmoothingGraph:
    """The whole problem as batch solvers see it: native factors, and the odometer's, LiDAR's and UWB's as arrays.

    Attributes
    ----------
    chain : with legs, the keys of keyframes tied to their neighbours alone, in order of time: what to eliminate first.
    """

    native: gtsam.NonlinearFactorGraph
    displacements: odometry.DisplacementFamily | None
    legs: LegFamily | None = None
    advances: AdvanceFamily | None = None
    chain: list[int] | None = None
    ranges: RangeFamily | None = None
    motions: MotionFamily | None = None
    tracks: TrackFamily | None = None

    def seen_by(self, camera: Camera) -> SmoothingGraph:
        """With what a camera says, or with only some of it."""
        motions, tracks = camera.motions, camera.tracks
        return replace(
            self,
            motions=None if motions is None else motions.family,
            tracks=None if tracks is None else tracks.family,
        )

    def only_legs(self, readings: LegReadings, lidar: Lidar) -> SmoothingGraph:
        """With only some of its readings; legs left without keep their variables."""
        return replace(self, legs=readings.family(lidar))

    def linearize(self, values: gtsam.Values) -> gtsam.GaussianFactorGraph:
        """Whitened linear factors of everything."""
        linear = self._without_tracks(values)
        if self.tracks is not None:
            self.tracks.linearize_into(linear, values)
        return linear

    def condensed(self, values: gtsam.Values) -> tuple[gtsam.GaussianFactorGraph, Condensed | None]:
        """The same with the points of tracked features eliminated, and these points."""
        linear = self._without_tracks(values)
        return linear, None if self.tracks is None else self.tracks.condense_into(linear, values)

    def _without_tracks(self, values: gtsam.Values) -> gtsam.GaussianFactorGraph:
        linear = self.native.linearize(values)
        if self.displacements is not None:
            self.displacements.linearize_into(linear, values)
        if self.legs is not None:
            self.legs.linearize_into(linear, values)
        if self.advances is not None:
            self.advances.linearize_into(linear, values)
        if self.ranges is not None:
            self.ranges.linearize_into(linear, values)
        if self.motions is not None:
            self.motions.linearize_into(linear, values)
        return linear


def build_graph(
    problem: Problem,
    data: Preintegrated,
    legs: LegReadings | None = None,
    advances: AdvanceFamily | None = None,
    ranges: RangeReadings | None = None,
    camera: Camera | None = None,
) -> SmoothingGraph:
    """The problem for a batch solver."""
    import gtsam

    native = gtsam.NonlinearFactorGraph()
    tied: set[int] = set()
    for found in _common_factors(problem, data):
        native.add(found.factor)
        tied.update(_crossed(found))
    if ranges is not None:
        for _, factor in RangeStates.of(problem, ranges).factors(problem):
            native.add(factor)
    if camera is not None:
        for factor in camera.beside(problem):
            native.add(factor)
        tied.update(camera.far_keys())
    family, chain = None, None
    if legs is not None and problem.log.lidar is not None:
        family = legs.family(problem.log.lidar)
        lean = float(np.tan(np.radians(problem.config.lidar.lean_sigma_deg)))
        for prior in leg_priors(problem.log.lidar, legs.feature, legs.place_n[:, 2], lean):
            native.add(prior)
        tied.update(family.pose_key.tolist())
        chain = [key for i in range(len(problem.keyframe_s)) if X(i) not in tied for key in (V(i), X(i))]
    graph = SmoothingGraph(
        native, displacement_family(problem, data), family, advances, chain, None if ranges is None else ranges.family
    )
    return graph if camera is None else graph.seen_by(camera)


def build_factors(
    problem: Problem, data: Preintegrated, ranges: RangeReadings | None = None, motions: MotionReadings | None = None
) -> list[FactorAt]:
    """All factors one by one, in order of the last keyframe they need, for an incremental solver."""
    found = _common_factors(problem, data)
    family = displacement_family(problem, data)
    if family is not None:
        last = (family.key_j - X(0)).tolist()
        found += [FactorAt(j, family.factor(k)) for k, j in enumerate(last)]
    if ranges is not None:
        found += [FactorAt(*each) for each in ranges.factors(problem)]
    if motions is not None:
        found += [FactorAt(*each) for each in motions.factors(problem)]
        found += [FactorAt(0, each) for each in Camera(motions, None).beside(problem)]
    return sorted(found, key=lambda f: f.keyframe)


def fed_in_blocks(problem: Problem, found: list[FactorAt], size: int) -> list[FactorAt]:
    """Feed the closed-path points of a cycle `size` at a time, each block with its last point.

    Every closed-path update re-eliminates the stretch of all earlier cycles since the last one; a few points at once
    cost little more than one.
    """
    feed: dict[int, int] = {}
    for cycle in {p.cycle for p in problem.frontend.closed_path}:
        seconds = [problem.frontend.index(p.second_s) for p in problem.frontend.closed_path if p.cycle == cycle]
        for k in range(0, len(seconds), size):
            block = seconds[k : k + size]
            feed.update(dict.fromkeys(block, max(block)))
    fed = [FactorAt(feed[f.keyframe], f.factor) if _closes(f) else f for f in found]
    return sorted(fed, key=lambda f: f.keyframe)


def _crossed(found: FactorAt) -> list[int]:
    """Keys of the two poses that a factor ties where they are not neighbours."""
    poses = [key for key in found.factor.keys() if key >> 56 == ord("x")]
    return poses if len(poses) == 2 and poses[1] - poses[0] > 1 else []


def _closes(found: FactorAt) -> bool:
    """Whether it is one of the closed path, which has the odometer's calibration too."""
    return bool(_crossed(found)) and any(key >> 56 == ord("c") for key in found.factor.keys())


def _common_factors(problem: Problem, data: Preintegrated) -> list[FactorAt]:
    """Everything but the odometer's displacements."""
    found = _priors(problem)
    found += [FactorAt(i + 1, factor) for i, factor in enumerate(data.imu_factors)]
    found += _epoch_walks(problem)
    if problem.config.odometer.form == "velocity":
        found += _velocity_factors(problem, data)
    found += _rest_factors(problem)
    found += _closed_path_factors(problem)
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


def _closed_path_factors(problem: Problem) -> list[FactorAt]:
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
