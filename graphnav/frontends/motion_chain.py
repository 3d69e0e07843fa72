"""The table `relative_pose` as a chain of motions of the body.

Its rows are motions of the camera c. Where no section [stereo] says how c is fixed to the body it sits at the body's
origin with the axes that the log format has for it by default: x right, y down, z forward.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from factors import so3
from factors.relative_pose import Chain, Motions, seen_from
from graphnav._schema import Array
from graphnav.errors import LogError
from graphnav.log import RelativePose, SensorLog, Stereo

#: A motion that begins this close to the end of the one before it follows it; at most a tenth of that motion.
_SAME_S, _SAME_SHARE = 1e-3, 0.1
#: What the covariance of a motion is multiplied by where it only guides.
_GUIDING = 1e6
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


@dataclass(frozen=True)
class Sightings:
    """K motions of the body in order of time, with gaps between them.

    Attributes
    ----------
    t_from_s, t_to_s : (K,); motions : the K motions.
    begins : (K,) whether it does not begin where the one before it ended; the first one does not.
    """

    t_from_s: Array
    t_to_s: Array
    motions: Motions
    begins: npt.NDArray[np.bool_]

    def only(self, chosen: npt.NDArray[np.bool_]) -> Sightings:
        """Some of them; `begins` follows."""
        rows = np.flatnonzero(chosen)
        begins = self.begins[rows] | (np.diff(rows, prepend=-2) > 1)
        m = self.motions
        return Sightings(
            self.t_from_s[rows], self.t_to_s[rows], Motions(m.rotation[rows], m.pos[rows], m.cov[rows]), begins
        )


def sightings(log: SensorLog) -> Sightings:
    """The motions of a log, which may leave gaps.

    Raises
    ------
    LogError : no motions; motions that overlap, take no time, or have a covariance that is none; by row.
    """
    poses = log.relative_pose
    if poses is None:
        fix = "add the table relative_pose, or stereo images or tracks to get it from"
        raise LogError("no relative_pose table, which this method needs", where=f"log {log.name}", fix=fix)
    check_motions(poses)
    apart = _apart(poses)
    _refuse(poses, apart < 0)
    return Sightings(poses.t_from_s, poses.t_to_s, body_motions(poses, log.stereo), np.append(True, apart != 0))


def held_chain(seen: Sightings, start_s: float) -> tuple[Chain, Array]:
    """The motions as one chain from `start_s` on, with the pose held where there are none; and these gaps (G, 2).

    The pose held over a gap is not better known than to the way that the mean speed (rms of all motions) makes in it,
    and so the attitude.
    """
    before = np.append(start_s, seen.t_to_s[:-1])
    gap_s = np.where(seen.begins, seen.t_from_s - before, 0.0)
    kept = gap_s > _SAME_S
    step_s = seen.t_to_s - seen.t_from_s
    turn, pos = so3.log(seen.motions.rotation), seen.motions.pos
    rate = [np.sqrt(((part / step_s[:, None]) ** 2).mean()) for part in (turn, pos)]
    held = gap_s[kept, None] * np.repeat(rate, 3)
    at = np.flatnonzero(kept)
    m = seen.motions
    motions = Motions(
        np.insert(m.rotation, at, np.eye(3), axis=0),
        np.insert(m.pos, at, 0.0, axis=0),
        np.insert(m.cov, at, (held**2 + 1e-12)[:, :, None] * np.eye(6), axis=0),
    )
    t_s = np.append(start_s if kept[0] else seen.t_from_s[0], np.insert(seen.t_to_s, at, seen.t_from_s[at]))
    return Chain.of(t_s, motions), np.column_stack([before[at], seen.t_from_s[at]])


def motion_chain(log: SensorLog) -> Chain:
    """The motions of a log one behind the other.

    Raises
    ------
    LogError : motions that leave a gap or overlap, take no time, or have a covariance that is none; by row.
    """
    poses = log.relative_pose
    assert poses is not None
    check_motions(poses)
    _refuse(poses, _apart(poses) != 0)
    return Chain.of(np.append(poses.t_from_s, poses.t_to_s[-1]), body_motions(poses, log.stereo))


def guiding_chain(log: SensorLog) -> Chain:
    """The motions of a log one behind the other, of which another sensor's features say the same better.

    They keep the graph in one piece where these say nothing, and else count for a millionth.
    """
    chain = motion_chain(log)
    return Chain(chain.t_s, chain.rotation, chain.pos, chain.cov * _GUIDING)


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


def _apart(poses: RelativePose) -> Array:
    """(K-1,) how far the next motion's start is from a motion's end, s: 0 where it follows, below 0 an overlap."""
    near = np.minimum(_SAME_S, _SAME_SHARE * (poses.t_to_s - poses.t_from_s)[:-1])
    apart = poses.t_from_s[1:] - poses.t_to_s[:-1]
    return np.where(np.abs(apart) > near, apart, 0.0)


def _refuse(poses: RelativePose, wrong: npt.NDArray[np.bool_]) -> None:
    """Name the first motion (K-1,) that does not follow the one before it as it must."""
    if wrong.any():
        row = int(np.argmax(wrong)) + 1
        what = "gap" if poses.t_from_s[row] > poses.t_to_s[row - 1] else "overlap"
        why = "without an IMU nothing bridges a gap" if what == "gap" else "nothing bridges an overlap"
        raise poses.error(
            f"{poses.t_from_s[row]:.6f} s, but the motion before it ends at {poses.t_to_s[row - 1]:.6f} s: {why}",
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
