"""What a solution says: trajectory with covariances, calibration with sigmas, warnings."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from factors.so3 import Array, to_quaternion
from graphnav.camera_errors import camera_known
from graphnav.keyframes import SAME_S
from graphnav.leg_priors import lidar_sigmas
from graphnav.legs import LegReadings
from graphnav.log import Lidar, UwbAnchor
from graphnav.markov_errors import slots
from graphnav.problem import SIZES, A, B, C, D, E, K, Problem, T, V, X, creep_cycles
from graphnav.run import (
    ACCEL_NAMES,
    CAMERA_NAMES,
    DEG_H,
    GYRO_NAMES,
    LIDAR_NAMES,
    MG,
    ODOMETER_NAMES,
    Calibration,
    CalibrationHistory,
    Stops,
)
from graphnav.solvers.batch import BatchResult
from graphnav.solvers.covariance import joint_marginals
from graphnav.solvers.joint_keys import joint_covariance
from graphnav.trajectory import ImuBridge, Trajectory

if TYPE_CHECKING:
    from collections.abc import Callable

    import gtsam

#: Share of the detections that may be left out without a word, and sigmas at which a calibration is far off.
_FEW, _FAR = 1e-3, 6.0
#: Sigma from which on the place of a UWB anchor is an estimate worth telling.
_SURVEYED_M = 0.01


def covariances(
    problem: Problem, result: BatchResult, progress: Callable[[float, float], None] | None
) -> dict[int, Array]:
    """Joint covariance of pose and velocity at every keyframe, and of the last bias, calibration and creep."""
    groups: dict[int, tuple[int, ...]] = {X(i): (X(i), V(i)) for i in range(len(problem.keyframe_s))}
    last_bias = B(int(problem.bias_epoch[-1]))
    groups[last_bias] = (last_bias,)
    if problem.has_calibration:
        last = C(int(problem.calibration_epoch[-1]))
        groups[last] = (last,)
    for c in creep_cycles(problem):
        groups[K(c)] = (K(c),)
    if result.values.exists(D(0)):
        groups[D(0)] = (D(0),)
    for a in _anchors(problem, result.values):
        groups[A(a)] = (A(a),)
    if result.values.exists(T(0)):
        groups[T(0)] = (T(0),)
    if result.values.exists(E(0)):
        groups[E(0)] = (E(0),)
    assert result.bayes_tree is not None
    return joint_marginals(result.bayes_tree, result.order, _size(problem), groups, progress)


def _size(problem: Problem) -> Callable[[int], int]:
    """Size of the variable of a key."""
    sizes = SIZES | {ord("m"): slots(problem)}
    return lambda key: sizes[key >> 56]


def _anchors(problem: Problem, values: gtsam.Values) -> list[int]:
    """The anchors that were heard."""
    uwb = problem.log.uwb
    return [] if uwb is None else [a for a in range(len(uwb.anchor)) if values.exists(A(a))]


def stops(problem: Problem, result: BatchResult) -> Stops | None:
    """The states at both ends of every cut, with their joint covariance; None where there is no cut."""
    ends = np.array([t for c in problem.frontend.cycles for t in (c.start_s, c.end_s) if t is not None])
    rows = np.flatnonzero((np.abs(problem.keyframe_s[:, None] - ends) <= SAME_S).any(axis=1))
    if not len(rows):
        return None
    scanner = result.values.exists(D(0))
    keys = [X(int(i)) for i in rows] + [D(0)] * scanner
    assert result.bayes_tree is not None
    cov = joint_covariance(result.bayes_tree, result.order, _size(problem), keys)
    poses = [result.values.atPose3(X(int(i))) for i in rows]
    to_n = np.eye(len(cov))
    for k, pose in enumerate(poses):
        # GTSAM's position perturbation is in the body frame
        to_n[6 * k + 3 : 6 * k + 6, 6 * k + 3 : 6 * k + 6] = pose.rotation().matrix()
    return Stops(
        problem.keyframe_s[rows],
        np.array([pose.translation() for pose in poses]),
        np.array([pose.rotation().matrix() for pose in poses]),
        result.values.atVector(D(0)) if scanner else np.zeros(0),
        to_n @ cov @ to_n.T,
    )


def smoothed_trajectory(problem: Problem, values: gtsam.Values, blocks: dict[int, Array] | None) -> Trajectory:
    """States at all keyframes with their covariances, and the IMU to carry them in between.

    Parameters
    ----------
    values : estimates; blocks : from `covariances`, or None.
    """
    count = len(problem.keyframe_s)
    import gtsam

    poses = gtsam.utilities.extractPose3(gtsam.utilities.allPose3s(values))
    rotation, pos = poses[:, :9].reshape(-1, 3, 3), poses[:, 9:]
    vel = np.array([values.atVector(V(i)) for i in range(count)])
    cov = None
    if blocks is not None:
        cov = np.empty((count, 9, 9))
        for i in range(count):
            cov[i] = blocks[X(i)]
        # GTSAM's position perturbation is in the body frame
        cov[:, 3:6] = rotation @ cov[:, 3:6]
        cov[:, :, 3:6] = cov[:, :, 3:6] @ np.swapaxes(rotation, 1, 2)
    gyro, accel = estimated_biases(problem, values)
    bridge = ImuBridge(problem.imu.samples, gyro, accel, problem.gravity_m_s2, problem.earth_rate_n)
    return Trajectory(problem.keyframe_s, pos, to_quaternion(rotation), vel, cov, bridge)


def estimated_biases(problem: Problem, values: gtsam.Values) -> tuple[Array, Array]:
    """Gyro and accelerometer bias in every interval between keyframes, (N-1, 3) each."""
    epochs = range(int(problem.bias_epoch[-1]) + 1)
    biases = [values.atConstantBias(B(e)) for e in epochs]
    gyro, accel = (np.array([getattr(b, kind)() for b in biases]) for kind in ("gyroscope", "accelerometer"))
    return gyro[problem.bias_epoch], accel[problem.bias_epoch]


def calibration(problem: Problem, values: gtsam.Values, blocks: dict[int, Array] | None) -> dict[str, Calibration]:
    """The last epoch's biases and odometer calibration in datasheet units."""
    found: dict[str, Calibration] = {}

    def put(key: int, value: Array, names: list[tuple[str, float, str]]) -> None:
        sigma = None if blocks is None else np.sqrt(np.diag(blocks[key]))
        for row, (name, unit_size, unit) in enumerate(names):
            found[name] = Calibration(
                float(value[row] / unit_size), None if sigma is None else float(sigma[row] / unit_size), unit
            )

    if problem.has_calibration:
        key = C(int(problem.calibration_epoch[-1]))
        put(key, values.atVector(key), ODOMETER_NAMES)
    key = B(int(problem.bias_epoch[-1]))
    put(key, values.atConstantBias(key).vector(), [*ACCEL_NAMES, *GYRO_NAMES])
    if values.exists(D(0)):
        put(D(0), values.atVector(D(0)), LIDAR_NAMES)
    for a in _anchors(problem, values):
        assert problem.log.uwb is not None
        put(A(a), values.atVector(A(a)), anchor_names(problem.log.uwb.anchor[a]))
    if values.exists(T(0)):
        put(T(0), values.atVector(T(0)), [("uwb_time_offset", 1.0, "s")])
    if values.exists(E(0)):
        assert problem.log.stereo is not None
        put(E(0), values.atVector(E(0)), CAMERA_NAMES)
        for name in camera_known(problem.log.stereo):
            del found[name]
    for c in creep_cycles(problem):
        put(K(c), values.atVector(K(c)), [(f"creep_after_cycle_{c}", 1.0, "m")])
    return found


def anchor_names(anchor: UwbAnchor) -> list[tuple[str, float, str]]:
    """Of an anchor's constant error, and of how far it stands from its declared place where that is not surveyed."""
    places = [f"uwb_anchor_{anchor.id}_{axis}" for axis in ("east", "north", "up")]
    told = anchor.group is not None or anchor.sigma_m >= _SURVEYED_M
    return [(f"uwb_bias_{anchor.id}", 1.0, "m"), *((name, 1.0, "m") for name in places if told)]


def history(problem: Problem, values: gtsam.Values) -> CalibrationHistory:
    """Biases and odometer calibration over the epochs, at the keyframes (the first keyframe has the first epoch's)."""
    gyro, accel = estimated_biases(problem, values)
    parts = [_per_keyframe(accel) / MG, _per_keyframe(gyro) / DEG_H]
    names = [*ACCEL_NAMES, *GYRO_NAMES]
    if problem.has_calibration:
        epochs = np.array([values.atVector(C(e)) for e in range(int(problem.calibration_epoch[-1]) + 1)])
        parts.append(
            _per_keyframe(epochs[problem.calibration_epoch]) / np.array([unit for _, unit, _ in ODOMETER_NAMES])
        )
        names += ODOMETER_NAMES
    titles, _, units = zip(*names, strict=True)
    return CalibrationHistory(problem.keyframe_s, titles, units, np.hstack(parts))


def _per_keyframe(of_interval: Array) -> Array:
    return np.concatenate([of_interval[:1], of_interval])


def leg_warnings(
    lidar: Lidar, found: dict[str, Calibration], used: LegReadings, left_out: LegReadings | None, t_s: Array
) -> list[str]:
    """What the LiDAR's part in the solution could not use, one line each.

    Parameters
    ----------
    found : the calibration; used, left_out : readings; t_s : (N,) keyframes.
    """
    lines = []
    detections = used.apart + int(used.count.sum()) + (0 if left_out is None else int(left_out.count.sum()))
    if used.apart > _FEW * detections:
        lines.append(
            f"{used.apart} of {detections} LiDAR detections lie apart from the others of their leg and were left out"
        )
    if left_out is not None:
        legs, count = np.unique(left_out.leg, return_counts=True)
        worst = int(legs[np.argmax(count)])
        since = t_s[left_out.keyframe[left_out.leg == worst]].min()
        lines.append(
            f"{len(left_out.leg)} of {len(left_out.leg) + len(used.leg)} readings of {len(legs)} legs disagree with the"
            f" rest and were left out, most of feature {used.feature[worst]}, the first at {since:.0f} s:"
            " legs that moved need new numbers"
        )
    for (name, unit_si, unit), sigma in zip(LIDAR_NAMES, lidar_sigmas(lidar), strict=True):
        if abs(found[name].value) * unit_si > _FAR * sigma:
            lines.append(
                f"{name} came out at {found[name].value:.4g} {unit}, {abs(found[name].value) * unit_si / sigma:.0f}"
                f" times its declared sigma: check [lidar] in log.toml"
            )
    return lines


def warnings(problem: Problem, biases_moved: bool) -> list[str]:
    """What the user should know of the record and the solution, one line each."""
    found = list(problem.notes)
    log, frontend = problem.log, problem.frontend
    bridged = problem.imu.bridged_s
    if len(bridged):
        longest = float(np.diff(bridged, axis=1).max())
        found.append(f"{len(bridged)} holes in the IMU record were bridged, the longest {longest:.3f} s")
    if not len(frontend.rest_s) and log.odometer is not None:
        found.append("no rest found: gyro and accelerometer biases are weakly separable; record a minute at rest first")
    given = (len(log.position) if log.position is not None else 0) + len(log.surveyed)
    unused = given - len(frontend.fixes)
    if unused and problem.config.position.use:
        found.append(
            f"{unused} of {given} positions and surveyed points are outside the IMU record or were never reached"
        )
    if log.face is not None and log.odometer is not None and not frontend.cycles:
        found.append("[face] is declared but no cut was found: no closed path; check events, or face.length_m")
    if log.lidar_points is not None and log.lidar is None:
        found.append("the table lidar_points is not used: declare the scanner in a section [lidar]")
    if log.uwb is not None and log.uwb.scale_sigma is not None:
        found.append("uwb.scale_sigma is not used beside an IMU: ranges count as they are")
    if biases_moved:
        found.append("the biases still moved after the last preintegration: raise batch.bias_move_rounds")
    return found
