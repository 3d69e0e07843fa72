"""`Trajectory`: states with covariances at keyframes, and at any time between them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from factors import so3
from factors.increments import Samples, compensated_increments
from factors.inertial import cumulate, predict
from factors.relative_pose import Chain, relative
from factors.so3 import Array
from graphnav.errors import GraphnavError

Rows = np.ndarray[tuple[int, ...], np.dtype[np.int64]]

_MINOR_S = 0.05
#: Keyframe intervals propagated at a time: bounds the memory that `at` takes.
_BLOCK = 500


@dataclass(frozen=True, eq=False)
class ImuBridge:
    """What carries a state from one keyframe to the next: the IMU and its estimated biases.

    Attributes
    ----------
    samples : the IMU samples of the whole log.
    gyro_bias_b, accel_bias_b : (N-1, 3) estimates in every interval between keyframes, rad/s and m/s^2.
    gravity_m_s2, earth_rate_n : the navigation frame's gravity and Earth rate, (3,) rad/s.
    """

    samples: Samples
    gyro_bias_b: Array
    accel_bias_b: Array
    gravity_m_s2: float
    earth_rate_n: Array


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Smoothed states.

    Attributes
    ----------
    t_s : (N,) ascending times, s.
    pos_n : (N, 3) position of the body in n, m.
    quat_nb : (N, 4) unit quaternions w, x, y, z, n <- b.
    vel_n : (N, 3) velocity in n, m/s; from a chain of relative poses the mean up to the next keyframe.
    cov : (N, 9, 9) or None; order attitude (body, right perturbation, rad), position (n, m), velocity (n, m/s).
    bridge : what `at` propagates with between keyframes, an IMU or measured motions; without it `at` interpolates.
    """

    t_s: Array
    pos_n: Array
    quat_nb: Array
    vel_n: Array
    cov: Array | None = None
    bridge: ImuBridge | Chain | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        count = len(self.t_s)
        shapes = {
            "t_s": (count,),
            "pos_n": (count, 3),
            "quat_nb": (count, 4),
            "vel_n": (count, 3),
            "cov": (count, 9, 9),
        }
        for name, shape in shapes.items():
            value = getattr(self, name)
            if value is None and name == "cov":
                continue
            array = np.ascontiguousarray(value, dtype=float)
            if array.shape != shape:
                raise ValueError(f"{name} has shape {array.shape}, expected {shape}")
            object.__setattr__(self, name, array)
        if count > 1 and (np.diff(self.t_s) <= 0).any():
            raise ValueError("t_s must ascend")

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def rotation_nb(self) -> Array:
        """(N, 3, 3) rotation matrices R_nb."""
        return so3.from_quaternion(self.quat_nb)

    def at(self, t_s: Array | float) -> Trajectory:
        """The trajectory at any times within its span.

        With a `bridge` the IMU is integrated from the keyframe before each time, and what is left at the keyframe
        after it is spread over the interval (attitude linearly; position and velocity by the cubic that meets both
        states). Where the bridge is a chain of motions these carry the pose, and what is left is spread linearly.
        Without one: cubic Hermite positions and spherical linear attitudes. The covariance between keyframes is the
        linear interpolation of theirs.

        Raises
        ------
        GraphnavError : a time outside the span, or times that do not ascend.
        """
        wanted, times, rows = self._asked(t_s)
        rotation, pos, vel = self._states(times)
        quat, cov = so3.to_quaternion(rotation), self._covariance(times)
        return Trajectory(wanted, pos[rows], quat[rows], vel[rows], None if cov is None else cov[rows])

    def poses_at(self, t_s: Array | float) -> tuple[Array, Array]:
        """Rotations R_nb (K, 3, 3) and positions (K, 3) m as of `at`, which this is the greater part of."""
        _, times, rows = self._asked(t_s)
        rotation, pos, _ = self._states(times)
        return rotation[rows], pos[rows]

    def _asked(self, t_s: Array | float) -> tuple[Array, Array, Rows]:
        """The times as asked for, the different ones of them within the span, and which of these each is."""
        wanted = np.atleast_1d(np.asarray(t_s, float))
        tolerance = 1e-6
        outside = ~((wanted >= self.t_s[0] - tolerance) & (wanted <= self.t_s[-1] + tolerance))
        if outside.any():
            raise GraphnavError(
                f"time {wanted[outside][0]:.6f} s is outside the trajectory's {self.t_s[0]:.6f} .. {self.t_s[-1]:.6f} s"
            )
        if not (np.diff(wanted) > 0).all():
            raise GraphnavError("times must ascend, each once")
        inside = np.clip(wanted, self.t_s[0], self.t_s[-1])
        new = np.diff(inside, prepend=-np.inf) > 0
        return wanted, inside[new], np.cumsum(new) - 1

    def _states(self, times: Array) -> tuple[Array, Array, Array]:
        """Rotations R_nb, positions and velocities at ascending times."""
        if len(self) == 1 or not len(times):
            rows = np.zeros(len(times), np.int64)
            return self.rotation_nb[rows], self.pos_n[rows], self.vel_n[rows]
        if self.bridge is None:
            return self._interpolated(times)
        if isinstance(self.bridge, Chain):
            return self._along(self.bridge, times)
        block = self._interval(times) // _BLOCK
        parts = [self._propagated(part) for part in np.split(times, np.flatnonzero(np.diff(block)) + 1)]
        rotation, pos, vel = (np.concatenate(part) for part in zip(*parts, strict=True))
        return rotation, pos, vel

    def _interval(self, times: Array) -> Rows:
        return np.clip(np.searchsorted(self.t_s, times, side="right") - 1, 0, len(self) - 2)

    def _covariance(self, times: Array) -> Array | None:
        if self.cov is None:
            return None
        if len(self) == 1:
            return self.cov[np.zeros(len(times), np.int64)]
        k = self._interval(times)
        u = ((times - self.t_s[k]) / (self.t_s[k + 1] - self.t_s[k]))[:, None, None]
        return (1 - u) * self.cov[k] + u * self.cov[k + 1]

    def _interpolated(self, times: Array) -> tuple[Array, Array, Array]:
        k = self._interval(times)
        span = (self.t_s[k + 1] - self.t_s[k])[:, None]
        u = (times - self.t_s[k])[:, None] / span
        straight = np.diff(self.pos_n, axis=0)[k]
        pos, vel = _hermite(u, span, straight - span * self.vel_n[k], self.vel_n[k + 1] - self.vel_n[k])
        rotation = self.rotation_nb
        turn = so3.log(so3.transpose(rotation[k]) @ rotation[k + 1])
        pos = self.pos_n[k] + self.vel_n[k] * u * span + pos
        return rotation[k] @ so3.exp(u * turn), pos, self.vel_n[k] + vel

    def _along(self, chain: Chain, times: Array) -> tuple[Array, Array, Array]:
        k, rotation = self._interval(times), self.rotation_nb
        turned, moved = chain.at(self.t_s)
        to_time = relative(turned[k], moved[k], *chain.at(times))
        whole = relative(turned[k], moved[k], turned[k + 1], moved[k + 1])
        u = ((times - self.t_s[k]) / (self.t_s[k + 1] - self.t_s[k]))[:, None]
        left_turn = so3.log(so3.transpose(rotation[k] @ whole[0]) @ rotation[k + 1])
        left_pos = self.pos_n[k + 1] - self.pos_n[k] - (rotation[k] @ whole[1][..., None])[..., 0]
        pos = self.pos_n[k] + (rotation[k] @ to_time[1][..., None])[..., 0] + u * left_pos
        return rotation[k] @ to_time[0] @ so3.exp(u * left_turn), pos, self.vel_n[k]

    def _propagated(self, times: Array) -> tuple[Array, Array, Array]:
        from factors.composition import turned_further

        assert isinstance(self.bridge, ImuBridge)
        bridge = self.bridge
        k = self._interval(times)
        lo, hi = int(k[0]), int(k[-1]) + 1
        keyframes = self.t_s[lo : hi + 1]
        grid = np.union1d(keyframes, times)
        owner = np.searchsorted(keyframes, grid[:-1], side="right") - 1 + lo
        fine = compensated_increments(
            bridge.samples.block(keyframes[0], keyframes[-1]),
            grid,
            _MINOR_S,
            bridge.gyro_bias_b[owner],
            bridge.accel_bias_b[owner],
        )
        at_keyframe = fine.first[np.searchsorted(grid, keyframes)]
        motion = cumulate(replace(fine, first=at_keyframe))
        rotation_nb = so3.from_quaternion(self.quat_nb[lo : hi + 1])

        def carried(rows: Rows, minor: Rows) -> tuple[Array, Array, Array]:
            return predict(
                rotation_nb[rows],
                self.pos_n[lo + rows],
                self.vel_n[lo + rows],
                motion,
                minor,
                bridge.gravity_m_s2,
                bridge.earth_rate_n,
            )

        rows = k - lo
        end_rotation, end_pos, end_vel = carried(np.arange(hi - lo), at_keyframe[1:] - 1)
        left_turn = so3.log(so3.transpose(end_rotation) @ rotation_nb[1:])
        left_pos = self.pos_n[lo + 1 : hi + 1] - end_pos
        left_vel = self.vel_n[lo + 1 : hi + 1] - end_vel
        minor = fine.first[np.searchsorted(grid, times)] - 1
        at_start = np.isin(times, self.t_s[k])
        rotation, pos, vel = carried(rows, np.maximum(minor, 0))
        span = np.diff(keyframes)[rows][:, None]
        u = (times - keyframes[rows])[:, None] / span
        pos_fix, vel_fix = _hermite(u, span, left_pos[rows], left_vel[rows])
        rotation = turned_further(rotation, u * left_turn[rows])
        rotation[at_start] = rotation_nb[rows[at_start]]
        pos, vel = pos + pos_fix, vel + vel_fix
        pos[at_start], vel[at_start] = self.pos_n[k[at_start]], self.vel_n[k[at_start]]
        return rotation, pos, vel

    def without_bridge(self) -> Trajectory:
        """The keyframes alone, without the IMU samples."""
        return replace(self, bridge=None)


def _hermite(u: Array, span: Array, end_pos: Array, end_vel: Array) -> tuple[Array, Array]:
    """The cubic from rest at zero to `end_pos` with velocity `end_vel`, and its time derivative."""
    pos = end_pos * (3 * u**2 - 2 * u**3) + end_vel * span * (u**3 - u**2)
    vel = end_pos * (6 * u - 6 * u**2) / span + end_vel * (3 * u**2 - 2 * u)
    return pos, vel
