"""The table `relative_pose` as a chain of motions of the body.

Its rows are motions of the camera c. Where no section [stereo] says how c is fixed to the body it sits at the body's
origin with the axes that the log format has for it by default: x right, y down, z forward.
"""

from __future__ import annotations

import numpy as np

from factors import so3
from factors.relative_pose import Chain, Motions, seen_from
from graphnav._schema import Array
from graphnav.log import RelativePose, SensorLog, Stereo

#: A motion that begins this close to the end of the one before it follows it; at most a tenth of that motion.
_SAME_S, _SAME_SHARE = 1e-3, 0.1
_UPPER = np.triu_indices(6)


def camera_mounting(stereo: Stereo | None) -> tuple[Array, Array]:
    """Rotation (3, 3) and place (3,) of c in b: the declared ones, or the log format's default."""
    if stereo is not None:
        return so3.from_quaternion(stereo.T_bc_quat_wxyz), stereo.T_bc_pos_m
    fields = Stereo.__dataclass_fields__
    quat, pos = (np.array(fields[name].default) for name in ("T_bc_quat_wxyz", "T_bc_pos_m"))
    return so3.from_quaternion(quat), pos


def camera_motions(poses: RelativePose) -> Motions:
    """Motions of c with their covariances, one for each row."""
    return Motions(so3.from_quaternion(poses.quat), poses.pos_m, _covariances(poses))


def body_motions(poses: RelativePose, stereo: Stereo | None) -> Motions:
    """Motions of b with their covariances, one for each row."""
    return seen_from(camera_motions(poses), *camera_mounting(stereo))


def motion_chain(log: SensorLog) -> Chain:
    """The motions of a log one behind the other.

    Raises
    ------
    LogError : motions that leave a gap or overlap, take no time, or have a covariance that is none; by row.
    """
    poses = log.relative_pose
    assert poses is not None
    check_motions(poses)
    _check_chain(poses)
    return Chain.of(np.append(poses.t_from_s, poses.t_to_s[-1]), body_motions(poses, log.stereo))


def check_motions(poses: RelativePose) -> None:
    """Refuse motions that take no time, and covariances that are none; by row."""
    backward = poses.t_to_s <= poses.t_from_s
    if backward.any():
        row = int(np.argmax(backward))
        problem = f"{poses.t_to_s[row]:.6f} s is not after t_from_s = {poses.t_from_s[row]:.6f} s"
        raise poses.error(problem, row=row, column="t_to_s", fix="state when the motion ends")
    smallest = np.linalg.eigvalsh(_covariances(poses))[:, 0]
    if (smallest <= 0).any():
        row = int(np.argmax(smallest <= 0))
        raise poses.error(
            f"the covariance is not positive definite (smallest eigenvalue {smallest[row]:.3g})",
            row=row,
            column="c_00 ... c_55",
            fix="give every direction an error of its own, however small",
        )


def _check_chain(poses: RelativePose) -> None:
    near = np.minimum(_SAME_S, _SAME_SHARE * (poses.t_to_s - poses.t_from_s)[:-1])
    apart = np.abs(poses.t_from_s[1:] - poses.t_to_s[:-1]) > near
    if apart.any():
        row = int(np.argmax(apart)) + 1
        what = "gap" if poses.t_from_s[row] > poses.t_to_s[row - 1] else "overlap"
        raise poses.error(
            f"{poses.t_from_s[row]:.6f} s, but the motion before it ends at {poses.t_to_s[row - 1]:.6f} s: without an"
            f" IMU nothing bridges a{'n' if what == 'overlap' else ''} {what}",
            row=row,
            column="t_from_s",
            fix="let every motion begin where the last one ends, or smooth the parts as logs of their own",
        )


def _covariances(poses: RelativePose) -> Array:
    """(K, 6, 6) from the columns c_00 ... c_55, or from the two sigmas."""
    cov = np.zeros((len(poses), 6, 6))
    if poses.cov_upper is not None:
        cov[:, _UPPER[0], _UPPER[1]] = poses.cov_upper
        cov[:, _UPPER[1], _UPPER[0]] = poses.cov_upper
        return cov
    assert poses.sigma_m is not None and poses.sigma_rad is not None
    axes = np.arange(3)
    cov[:, axes, axes] = poses.sigma_rad[:, None] ** 2
    cov[:, axes + 3, axes + 3] = poses.sigma_m[:, None] ** 2
    return cov
