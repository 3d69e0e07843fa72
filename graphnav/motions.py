"""Relative poses of a log beside its IMU: motions of the camera between keyframes of their own, as factors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from factors.increments import npt_int
from factors.mounted_motion import MotionFamily
from factors.relative_pose import seen_from
from factors.so3 import Array
from graphnav.camera_errors import camera_unknown
from graphnav.frontends.motion_chain import camera_motions, camera_mounting, check_motions
from graphnav.leg_means import npt_bool
from graphnav.log import RelativePose
from graphnav.problem import E, Problem, X

if TYPE_CHECKING:
    import gtsam

#: A keyframe this close to the end of a motion is at it (see `graphnav.keyframes.SAME_S`).
_SAME_S = 2e-3


@dataclass(frozen=True)
class MotionReadings:
    """Relative poses that take part.

    Attributes
    ----------
    row : (K,) of the table relative_pose.
    family : the same motions as factors.
    """

    row: npt_int
    family: MotionFamily

    def only(self, rows: npt_int | npt_bool) -> MotionReadings:
        """Some of them."""
        return MotionReadings(self.row[rows], self.family.only(rows))

    def far_keys(self) -> list[int]:
        """Keys of poses that are tied to others than their neighbours."""
        far = self.family.key_j - self.family.key_i > 1
        return [*self.family.key_i[far].tolist(), *self.family.key_j[far].tolist()]

    def factors(self, problem: Problem) -> list[tuple[int, gtsam.NonlinearFactor]]:
        """Everything one by one, each with the last keyframe it needs.

        On its way an incremental solver cannot come back to a motion; where wrong ones are looked for, Huber's loss,
        which has one minimum, holds them off.
        """
        config = problem.config.relative_pose
        family = self.family if config.loss == "none" else replace(self.family, loss="huber", scale=config.loss_sigmas)
        last = (family.key_j - X(0)).tolist()
        return [(j, family.factor(k)) for k, j in enumerate(last)]


# The way by the camera alone, for initial values --------------------------------------------------------------------


@dataclass(frozen=True)
class Steps:
    """Steps of the body between keyframes, one behind the other: first, last (K,), moved_b (K, 3) m in b at `first`."""

    first: npt_int
    last: npt_int
    moved_b: Array


def camera_steps(problem: Problem) -> Steps | None:
    """Those of the log's relative poses; of motions that overlap, each that begins after the one before has ended."""
    readings = guiding_readings(problem)
    if readings is None or not len(readings.row):
        return None
    family = readings.family
    moved = seen_from(family.measured, family.rotation_bc, family.pos_bc).pos
    kept, end = [], 0
    first, last = family.key_i - X(0), family.key_j - X(0)
    for k in np.lexsort((last, first)).tolist():
        if first[k] >= end:
            kept.append(k)
            end = int(last[k])
    return Steps(first[kept], last[kept], moved[kept])


def stepped(steps: Steps, keyframe_s: Array, rotation_nb: Array, pos_n: Array, vel_n: Array) -> tuple[Array, Array]:
    """Positions and velocities (N, 3) by steps, with attitudes (N, 3, 3) from elsewhere.

    Velocity is constant within a step; where there is none, it is that of the step before.
    """
    pos, vel = np.empty((len(keyframe_s), 3)), np.empty((len(keyframe_s), 3))
    pos[0], vel[:] = pos_n, vel_n
    done = 0
    for first, last, moved in zip(steps.first.tolist(), steps.last.tolist(), steps.moved_b, strict=True):
        _carry_on(pos, vel, keyframe_s, done, first, vel[done])
        speed = rotation_nb[first] @ moved / (keyframe_s[last] - keyframe_s[first])
        _carry_on(pos, vel, keyframe_s, first, last, speed)
        done = last
    _carry_on(pos, vel, keyframe_s, done, len(keyframe_s) - 1, vel[done])
    return pos, vel


def _carry_on(pos: Array, vel: Array, t_s: Array, first: int, last: int, speed: Array) -> None:
    """At one velocity from keyframe `first`, which is known, to `last`."""
    pos[first : last + 1] = pos[first] + (t_s[first : last + 1] - t_s[first])[:, None] * speed
    vel[first : last + 1] = speed


def uses_motions(problem: Problem) -> bool:
    """Whether relative poses take part."""
    return problem.log.relative_pose is not None and problem.config.relative_pose.use


def motion_readings(problem: Problem) -> MotionReadings | None:
    """The log's relative poses within the record, between the keyframes at their times.

    Raises
    ------
    LogError : a motion that takes no time, or whose covariance is none; by row.
    """
    poses = problem.log.relative_pose
    return None if poses is None or not uses_motions(problem) else _readings(problem, poses)


def guiding_readings(problem: Problem) -> MotionReadings | None:
    """What there is of motions to find the way by: the log's own, or those that only guide."""
    guide = problem.frontend.guide
    return motion_readings(problem) if guide is None else _readings(problem, guide)


def _readings(problem: Problem, poses: RelativePose) -> MotionReadings:
    stereo = problem.log.stereo
    check_motions(poses)
    ends = [nearest(problem.keyframe_s, t_s) for t_s in (poses.t_from_s, poses.t_to_s)]
    inside = (poses.t_from_s >= problem.keyframe_s[0] - _SAME_S) & (poses.t_to_s <= problem.keyframe_s[-1] + _SAME_S)
    rows = np.flatnonzero(inside & (ends[1] > ends[0]))
    motions = camera_motions(poses)
    family = MotionFamily(
        X(0) + ends[0], X(0) + ends[1], E(0) if camera_unknown(stereo) else None, motions, *camera_mounting(stereo)
    )
    return MotionReadings(rows, family.only(rows))


def nearest(keyframe_s: Array, t_s: Array) -> npt_int:
    """The keyframe (K,) nearest to each time (K,)."""
    right = np.clip(np.searchsorted(keyframe_s, t_s), 1, len(keyframe_s) - 1)
    return np.asarray(right - (t_s - keyframe_s[right - 1] < keyframe_s[right] - t_s), np.int64)
