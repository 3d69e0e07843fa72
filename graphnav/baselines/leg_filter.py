"""The paper's filter: inertial navigation corrected by legs of the roof supports (Zheng et al., INS/LiDAR, section 4).

15 + 3 N states (equation 12) on the strapdown solution of `strapdown`, fed back at keyframes as in `ekf`; every scan
within an interval is taken at its own time. Odometer, rest and closed path have no part in it. The scanner's systematic
errors are no states: they stay in the position (equation 29), and so does what is wrong with its mounting.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors import so3
from factors.increments import npt_int
from factors.landmark import seen_leg
from factors.so3 import Array, from_quaternion
from graphnav.baselines import strapdown
from graphnav.baselines.ekf import Progress, pass_keyframes
from graphnav.baselines.innovations import Innovations
from graphnav.baselines.inputs import PRESETS, Inputs
from graphnav.baselines.leg_choice import FRESH, MEASURED, Selection, choose
from graphnav.baselines.leg_measurements import INERTIAL, KINDS, interval, leg, leg_rows
from graphnav.baselines.plan import prior_covariance, walks
from graphnav.baselines.states import PHI, POS, SIZE, VEL, Nominal, refuse_divergence
from graphnav.baselines.tape import Estimates

#: A leg in use is given up when it seems nearer than it may by this many sigmas of the range.
_MARGIN_SIGMAS = 5.0


@dataclass(frozen=True)
class Scanner:
    """How legs are measured.

    Attributes
    ----------
    rotation_bs, lever_arm_b : (3, 3) and (3,) mounting that is believed in.
    sigma : (3,) noise of range (m), bearing (rad) and height above the scan plane (m).
    upright : whether the point that is seen slides up and down the leg as the scan plane turns. The paper's points are
        fixed: 9 m away a machine that pitches by half a degree sees another point, 8 cm higher, and takes it for its
        own descent.
    walk_m_sqrt_s : random walk of a leg's height.
    """

    rotation_bs: Array
    lever_arm_b: Array
    sigma: Array
    upright: bool
    walk_m_sqrt_s: float


class LegFilter:
    """A forward pass, keyframe by keyframe.

    Attributes
    ----------
    estimates : at the keyframes passed, after feedback.
    nominal, covariance : the state now, and the covariance (n, n) of its errors.
    """

    def __init__(self, inputs: Inputs, scanner: Scanner, selection: Selection) -> None:
        points, lidar, initial = inputs.log.lidar_points, inputs.log.lidar, inputs.initial
        assert points is not None and lidar is not None
        self.inputs, self.scanner = inputs, scanner
        self.chosen = choose(points, inputs.cycles, selection, _MARGIN_SIGMAS * lidar.range_sigma_m)
        self._bound = np.searchsorted(self.chosen.t_s, inputs.keyframe_s + 1e-6)
        self.nominal = Nominal(
            from_quaternion(initial.quat_nb_wxyz), initial.vel_n_m_s.copy(), initial.pos_n_m.copy(),
            np.zeros(3), np.zeros(3), np.zeros(4),
        )  # fmt: skip
        size = INERTIAL + 3 * selection.count
        self.covariance = np.zeros((size, size))
        self.covariance[:INERTIAL, :INERTIAL] = prior_covariance(inputs, PRESETS["matched"])[:INERTIAL, :INERTIAL]
        self._walks = np.concatenate([walks(inputs, resting=False)[:INERTIAL], np.zeros(3 * selection.count)])
        self._walks[INERTIAL + 2 :: 3] = scanner.walk_m_sqrt_s**2
        self._place_n = np.zeros((selection.count, 3))
        self._kept: list[tuple[Array, Array, Array, Array]] = []
        self.estimates = Estimates.empty(len(inputs.keyframe_s))
        self._store(0)

    def run(self, last: int, progress: Progress | None = None) -> None:
        """Pass the keyframes up to `last`, included."""
        pass_keyframes(self._step, last, self.inputs, self.estimates, progress)

    def innovations(self) -> Innovations:
        """Of all measurements so far."""
        times, kinds, innovation, variance = (np.concatenate(part) for part in zip(*self._kept, strict=True))
        return Innovations(times, kinds.astype(np.int64), KINDS, innovation, variance)

    def _store(self, i: int) -> None:
        full = np.zeros((SIZE, SIZE))
        full[:INERTIAL, :INERTIAL] = self.covariance[:INERTIAL, :INERTIAL]
        self.estimates.put(i, self.nominal, full)

    def _step(self, i: int) -> None:
        """From keyframe i-1 to keyframe i: navigate, measure, filter, feed back."""
        low, high = self._bound[i - 1], self._bound[i]
        epoch_s, status, readings = self._scans(i, low, high)
        rotations, velocities, positions, blocks, noise = strapdown.navigate(
            self.inputs, self.nominal, float(self.inputs.keyframe_s[i - 1]), epoch_s, self._walks, resting=False
        )
        place_n = self._follow(rotations, positions, status, readings)
        s = self.scanner
        h, z = leg_rows(rotations, positions, place_n, *readings, s.sigma, s.rotation_bs, s.lever_arm_b)
        x, innovation, variance = np.zeros(len(self.covariance)), np.empty(z.shape), np.empty(z.shape)
        interval(blocks, noise, h, z, status, x, self.covariance, innovation, variance)
        self._feed_back(self.nominal.moved(rotations[-1], velocities[-1], positions[-1]), x)
        refuse_divergence(
            self.nominal, float(self.inputs.keyframe_s[i]), "the tables imu and lidar_points before that time"
        )
        epoch, column = np.nonzero(status == MEASURED)
        self._kept.append(
            (
                np.repeat(epoch_s[epoch], 3), np.tile(np.arange(3, dtype=np.int8), len(epoch)),
                innovation[epoch, column].ravel(), variance[epoch, column].ravel(),
            )
        )  # fmt: skip
        self._store(i)

    def _scans(self, i: int, low: int, high: int) -> tuple[Array, npt_int, tuple[Array, Array]]:
        """Epochs of an interval (scans and the keyframe at its end), the status of the legs in them, their readings."""
        points, end = self.inputs.log.lidar_points, float(self.inputs.keyframe_s[i])
        assert points is not None
        times, status, row = self.chosen.t_s[low:high], self.chosen.status[low:high], self.chosen.row[low:high]
        if len(times) and end - times[-1] < 1e-6:
            times = np.append(times[:-1], end)
        else:
            times, none = np.append(times, end), np.zeros((1, status.shape[1]), np.int64)
            status, row = np.concatenate([status, none]), np.concatenate([row, none])
        used = status > 0
        # a leg in front stands in for those that are not there: their rows are not used
        return times, status, (np.where(used, points.range_m[row], 1.0), np.where(used, points.angle_rad[row], 0.0))

    def _follow(self, rotations: Array, positions: Array, status: npt_int, readings: tuple[Array, Array]) -> Array:
        """Nominal places (E, N, 3) of the legs in use."""
        s = self.scanner
        axis = np.concatenate([self.nominal.rotation_nb[None], rotations]) @ s.rotation_bs[:, 2]
        origin = np.concatenate([self.nominal.pos_n[None], positions])
        place_n = np.empty((*status.shape, 3))
        for e in range(len(status)):
            if s.upright:
                left_plane = (self._place_n - origin[e]) @ (axis[e + 1] - axis[e])
                self._place_n[:, 2] -= left_plane / axis[e + 1, 2]
            for j in np.flatnonzero(status[e] == FRESH):
                range_m, angle_rad = readings[0][e, j], readings[1][e, j]
                self._place_n[j] = seen_leg(
                    rotations[e], positions[e], range_m, angle_rad, s.rotation_bs, s.lever_arm_b
                )
            place_n[e] = self._place_n
        return place_n

    def _feed_back(self, before: Nominal, x: Array) -> None:
        """Take the error out of the state; errors keep the direction that a turn of the world shows: `ekf.fed_back`."""
        after = before.corrected(np.concatenate([x[:INERTIAL], np.zeros(4)]))
        reset = np.eye(len(x))
        reset[VEL, PHI] = so3.skew(before.vel_n - after.vel_n)
        reset[POS, PHI] = so3.skew(before.pos_n - after.pos_n)
        for j in range(len(self._place_n)):
            reset[leg(j), PHI] = so3.skew(-x[leg(j)])
            self._place_n[j] += x[leg(j)]
        self.nominal, self.covariance = after, reset @ self.covariance @ reset.T
