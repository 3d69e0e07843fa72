"""From log, configuration and keyframes to factors and initial values.

Variables: ``X(i)`` pose T_nb and ``V(i)`` velocity at keyframe i, ``B(e)`` IMU bias and ``C(e)`` odometer calibration
[scale, mounting angles] in epochs, ``K(c)`` creep after cycle c. Epochs keep every variable's number of factors
bounded.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from factors import closed_path, inertial, odometry, position, stationary
from factors.earth import earth_rate_n, normal_gravity
from factors.increments import compensated_increments, npt_int
from factors.inertial import ImuNoise, Motion, cumulate
from factors.noise import diagonal
from factors.odometry import Travel
from factors.so3 import Array, from_quaternion
from graphnav.config import Config
from graphnav.errors import LogError
from graphnav.frontends.imu_samples import ImuSamples, imu_samples
from graphnav.initial import States, dead_reckoning, levelled, rest_bias
from graphnav.keyframes import Frontend
from graphnav.log import InitialState, SensorLog

if TYPE_CHECKING:
    from collections.abc import Callable

    import gtsam

Progress = "Callable[[float, float], None]"

#: Keyframe intervals preintegrated at a time: bounds the memory of the increments.
_BLOCK = 500


def X(i: int) -> int:
    """Key of the pose at keyframe i."""
    return _symbol("x", i)


def V(i: int) -> int:
    """Key of the velocity at keyframe i."""
    return _symbol("v", i)


def B(e: int) -> int:
    """Key of the IMU bias in epoch e."""
    return _symbol("b", e)


def C(e: int) -> int:
    """Key of the odometer calibration in epoch e."""
    return _symbol("c", e)


def K(c: int) -> int:
    """Key of the creep after cycle c."""
    return _symbol("k", c)


def _symbol(letter: str, index: int) -> int:
    # gtsam.symbol without its call overhead: a letter in the top byte
    return (ord(letter) << 56) | index


@dataclass(frozen=True)
class Problem:
    """What stays fixed while solving.

    Attributes
    ----------
    log, config, frontend : inputs.
    imu : contiguous samples; noise, gravity_m_s2, earth_rate_n : their model.
    minor_s : minor interval of the two-speed algorithm, s.
    bias_epoch, calibration_epoch : (N-1,) epoch of each interval between keyframes.
    """

    log: SensorLog
    config: Config
    frontend: Frontend
    imu: ImuSamples
    noise: ImuNoise
    gravity_m_s2: float
    earth_rate_n: Array
    minor_s: float
    bias_epoch: npt_int
    calibration_epoch: npt_int

    @property
    def keyframe_s(self) -> Array:
        """(N,) keyframe times."""
        return self.frontend.keyframe_s

    @property
    def initial(self) -> InitialState:
        """The declared initial state (its presence is checked when the problem is posed)."""
        assert self.log.initial is not None
        return self.log.initial

    @property
    def has_calibration(self) -> bool:
        """Whether the odometer and its calibration take part."""
        return self.log.odometer is not None


@dataclass(frozen=True)
class Preintegrated:
    """Sensor data condensed between keyframes at given biases.

    Attributes
    ----------
    gyro_bias_b, accel_bias_b : (N-1, 3) biases preintegrated at.
    imu_factors : N-1 GTSAM factors.
    motion : end-of-interval motion, one minor interval each.
    travel : odometer over the intervals, or None.
    """

    gyro_bias_b: Array
    accel_bias_b: Array
    imu_factors: list[gtsam.NonlinearFactor]
    motion: Motion
    travel: Travel | None


@dataclass(frozen=True)
class FactorAt:
    """A factor and the last keyframe it needs: what an incremental solver is fed at that keyframe."""

    keyframe: int
    factor: gtsam.NonlinearFactor


def pose_problem(log: SensorLog, config: Config, frontend: Frontend) -> Problem:
    """Check what smoothing needs and fix the models.

    Raises
    ------
    LogError : no IMU, no initial state, a hole in a record.
    """
    if log.imu is None:
        raise LogError("no imu table", where=f"log {log.name}", fix="smoothing needs an IMU")
    if log.initial is None:
        raise LogError("missing", where="log.toml, [initial]", fix="give the initial pose with its sigmas")
    imu = log.imu
    noise = ImuNoise.from_datasheet(
        gyro_random_walk_deg_sqrt_h=imu.gyro_random_walk_deg_sqrt_h,
        accel_random_walk_mg_sqrt_hz=imu.accel_random_walk_mg_sqrt_hz,
        gyro_bias_deg_h=imu.gyro_bias_deg_h,
        accel_bias_mg=imu.accel_bias_mg,
        gyro_bias_walk_deg_h_sqrt_h=imu.gyro_bias_walk_deg_h_sqrt_h,
        accel_bias_walk_mg_sqrt_h=imu.accel_bias_walk_mg_sqrt_h,
    )
    gravity = log.frames.gravity_m_s2 or normal_gravity(log.frames.latitude_deg, log.frames.height_m)
    samples = imu_samples(imu, config.imu.max_gap_s)
    rate = np.linalg.norm(imu.gyro_b_rad_s[:: max(1, len(imu) // 50_000)], axis=1)
    usual_rate = max(float(np.quantile(rate, 0.95)), 1e-6)
    minor_s = max(imu.dt_s, min(config.imu.minor_interval_s, config.imu.minor_angle_rad / usual_rate))
    _check_odometer_gaps(log, config)
    t = frontend.keyframe_s
    return Problem(
        log, config, frontend, samples, noise, float(gravity), earth_rate_n(log.frames.latitude_deg), minor_s,
        _epochs(t, config.imu.bias_epoch_s), _epochs(t, config.odometer.calibration_epoch_s),
    )  # fmt: skip


def _epochs(t: Array, span_s: float) -> npt_int:
    return np.asarray(np.floor((t[:-1] - t[0]) / span_s + 1e-9), dtype=np.int64)


def _check_odometer_gaps(log: SensorLog, config: Config) -> None:
    if log.odometer is None or log.imu is None or log.position is not None:
        return
    t = np.concatenate([[log.imu.start_s], log.odometer.t_s, [log.imu.t_s[-1]]])
    row = int(np.argmax(np.diff(t)))
    if np.diff(t)[row] > config.odometer.max_gap_s:
        raise log.odometer.error(
            f"no samples for {np.diff(t)[row]:.1f} s after t = {t[row]:.1f} s, the IMU bridges at most"
            f" {config.odometer.max_gap_s:g} s",
            row=min(row, len(log.odometer) - 1),
            column="t_s",
            fix="smooth the parts before and after it as two logs, or raise odometer.max_gap_s",
        )


def preintegrate(
    problem: Problem, gyro_bias_b: Array, accel_bias_b: Array, progress: Callable[[float, float], None] | None = None
) -> Preintegrated:
    """Condense IMU and odometer between keyframes, in blocks of keyframes.

    Parameters
    ----------
    gyro_bias_b, accel_bias_b : (3,) or (N-1, 3) biases to preintegrate at, rad/s and m/s^2.
    """
    import gtsam

    t, count = problem.keyframe_s, len(problem.keyframe_s) - 1
    gyro_bias_b = np.broadcast_to(gyro_bias_b, (count, 3))
    accel_bias_b = np.broadcast_to(accel_bias_b, (count, 3))
    params = inertial.preintegration_params(problem.noise, problem.gravity_m_s2, problem.earth_rate_n)
    imu_factors: list[gtsam.NonlinearFactor] = []
    motions: list[Motion] = []
    travels: list[Travel] = []
    odometer = problem.log.odometer
    for lo in range(0, count, _BLOCK):
        hi = min(lo + _BLOCK, count)
        bounds = t[lo : hi + 1]
        block = problem.imu.block(bounds[0], bounds[-1])
        increments = compensated_increments(block, bounds, problem.minor_s, gyro_bias_b[lo:hi], accel_bias_b[lo:hi])
        motion = cumulate(increments)
        motions.append(_ends(motion))
        if odometer is not None:
            rows = slice(np.searchsorted(odometer.t_s, bounds[0]), np.searchsorted(odometer.t_s, bounds[-1] + 1e-6))
            travels.append(odometry.preintegrate_speed(odometer.t_s[rows], odometer.speed_m_s[rows], bounds, motion))
        per_interval = _interval_params(problem, bounds, params)
        pims = inertial.preintegrations(increments, per_interval, gyro_bias_b[lo:hi], accel_bias_b[lo:hi])
        for i, pim in enumerate(pims, start=lo):
            imu_factors.append(gtsam.ImuFactor(X(i), V(i), X(i + 1), V(i + 1), B(int(problem.bias_epoch[i])), pim))
        if progress is not None:
            progress(hi, count)
    travel = (
        Travel(*(np.concatenate(parts) for parts in zip(*(_fields(x) for x in travels), strict=True)))
        if travels
        else None
    )
    joined = [np.concatenate(parts) for parts in zip(*(_fields(m)[1:] for m in motions), strict=True)]
    return Preintegrated(gyro_bias_b, accel_bias_b, imu_factors, Motion(np.arange(count + 1), *joined), travel)


def _fields(x: Motion | Travel) -> list[Array]:
    return list(vars(x).values())


def _ends(motion: Motion) -> Motion:
    last = motion.first[1:] - 1
    first = np.arange(len(last) + 1)
    return Motion(
        first, motion.elapsed_s[last], motion.rotation[last], motion.velocity_b[last], motion.position_b[last]
    )


def _interval_params(
    problem: Problem, bounds: Array, params: gtsam.PreintegrationParams
) -> gtsam.PreintegrationParams | list[gtsam.PreintegrationParams]:
    """Larger noise in intervals with bridged samples: there the signal is a guess."""
    bridged = problem.imu.bridged_s
    touching = bridged[(bridged[:, 1] > bounds[0]) & (bridged[:, 0] < bounds[-1])]
    if not len(touching):
        return params
    # independent holes add up in variance
    guessed = np.zeros(len(bounds) - 1)
    for a, b in touching:
        length = np.minimum(b, bounds[1:]) - np.maximum(a, bounds[:-1])
        guessed += np.maximum(length, 0.0) ** 2
    out = [params] * len(guessed)
    for k in np.flatnonzero(guessed):
        share = np.sqrt(guessed[k] / (bounds[k + 1] - bounds[k]))
        noise = replace(
            problem.noise,
            gyro_density=float(np.hypot(problem.noise.gyro_density, problem.imu.gyro_spread * share)),
            accel_density=float(np.hypot(problem.noise.accel_density, problem.imu.accel_spread * share)),
        )
        out[k] = inertial.preintegration_params(noise, problem.gravity_m_s2, problem.earth_rate_n)
    return out


def start_state(problem: Problem) -> tuple[States, Array]:
    """Declared initial state, levelled by the first rest, and the gyro bias (3,) that the rest shows."""
    initial, rest = problem.initial, problem.frontend.rest_s
    rotation = from_quaternion(initial.quat_nb_wxyz)
    rotation = levelled(
        problem.imu.samples,
        rest,
        rotation,
        float(problem.keyframe_s[0]),
        float(np.radians(initial.att_sigma_deg[:2].max())),
        problem.noise.accel_bias / problem.gravity_m_s2,
    )
    bias = rest_bias(problem.imu.samples, rest, rotation, problem.earth_rate_n)
    if np.abs(bias).max() > 5 * problem.noise.gyro_bias:
        bias = np.zeros(3)
    return States(rotation[None], initial.pos_n_m[None], initial.vel_n_m_s[None]), bias


def initial_values(problem: Problem, data: Preintegrated, start: States) -> gtsam.Values:
    """Dead-reckoned states, preintegration biases and zero calibration as GTSAM values."""
    import gtsam

    states = dead_reckoning(
        problem.log, problem.keyframe_s, data.motion, data.travel, start, problem.frontend.fixes,
        problem.gravity_m_s2, problem.earth_rate_n,
    )  # fmt: skip
    values = gtsam.Values()
    for i in range(len(problem.keyframe_s)):
        values.insert(X(i), gtsam.Pose3(gtsam.Rot3(states.rotation_nb[i]), states.pos_n[i]))
        values.insert(V(i), states.vel_n[i])
    first_of_epoch = np.searchsorted(problem.bias_epoch, np.arange(problem.bias_epoch[-1] + 1))
    for e, k in enumerate(first_of_epoch):
        values.insert(B(e), gtsam.imuBias.ConstantBias(data.accel_bias_b[k], data.gyro_bias_b[k]))
    if problem.has_calibration:
        for e in range(int(problem.calibration_epoch[-1]) + 1):
            values.insert(C(e), np.zeros(4))
    face = problem.log.face
    for c in creep_cycles(problem):
        values.insert(K(c), np.array([face.creep_m if face else 0.0]))
    return values


def creep_cycles(problem: Problem) -> list[int]:
    """Cycles after which an unknown creep is estimated: all with closed-path points, where creep is declared."""
    face = problem.log.face
    if face is None or face.creep_sigma_m == 0 or problem.config.closed_path.form != "relative":
        return []
    return sorted({p.cycle for p in problem.frontend.closed_path})


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

    initial = problem.initial
    rotation = from_quaternion(initial.quat_nb_wxyz)
    cov = np.zeros((6, 6))
    cov[:3, :3] = np.diag(np.radians(initial.att_sigma_deg) ** 2)
    cov[3:, 3:] = rotation.T @ np.diag(initial.pos_sigma_m**2) @ rotation
    pose = gtsam.Pose3(gtsam.Rot3(rotation), initial.pos_n_m)
    noise = problem.noise
    bias = diagonal(np.r_[np.full(3, noise.accel_bias), np.full(3, noise.gyro_bias)])
    found = [
        FactorAt(0, gtsam.PriorFactorPose3(X(0), pose, gtsam.noiseModel.Gaussian.Covariance(cov))),
        FactorAt(0, gtsam.PriorFactorVector(V(0), initial.vel_n_m_s, diagonal(initial.vel_sigma_m_s))),
        FactorAt(1, gtsam.PriorFactorConstantBias(B(0), gtsam.imuBias.ConstantBias(), bias)),
    ]
    odometer = problem.log.odometer
    if odometer is not None:
        sigmas = np.r_[odometer.scale_sigma, np.radians(odometer.mounting_sigma_deg)]
        found.append(FactorAt(1, gtsam.PriorFactorVector(C(0), np.zeros(4), diagonal(sigmas))))
    return found


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


@dataclass(frozen=True)
class SmoothingGraph:
    """The whole problem as batch solvers see it: native factors, and the odometer's as arrays."""

    native: gtsam.NonlinearFactorGraph
    displacements: odometry.DisplacementFamily | None

    def linearize(self, values: gtsam.Values) -> gtsam.GaussianFactorGraph:
        """Whitened linear factors of everything."""
        linear = self.native.linearize(values)
        if self.displacements is not None:
            self.displacements.linearize_into(linear, values)
        return linear


def build_graph(problem: Problem, data: Preintegrated) -> SmoothingGraph:
    """The problem for a batch solver."""
    import gtsam

    native = gtsam.NonlinearFactorGraph()
    for found in _common_factors(problem, data):
        native.add(found.factor)
    return SmoothingGraph(native, displacement_family(problem, data))


def build_factors(problem: Problem, data: Preintegrated) -> list[FactorAt]:
    """All factors one by one, in order of the last keyframe they need, for an incremental solver."""
    found = _common_factors(problem, data)
    family = displacement_family(problem, data)
    if family is not None:
        last = (family.key_j - X(0)).tolist()
        found += [FactorAt(j, family.factor(k)) for k, j in enumerate(last)]
    return sorted(found, key=lambda f: f.keyframe)


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
