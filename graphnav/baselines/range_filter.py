"""The paper's system: a 15-state error-state Kalman filter with squared ranges (Cao et al. (2023), equations 1-26).

Attitude, velocity, position and first-order Gauss-Markov biases on the strapdown solution of `strapdown` (which knows
the turning Earth, as the paper's Euler steps of equation 9 do not). Every range counts at its own time and about the
error known so far; the error is fed back and reset at keyframes (equation 26). One thing the paper does not have: at
rest the velocity is zero and the gyro shows its bias. Nothing else tells the heading of a tag on the IMU's own axis,
which a MEMS gyro of 0.2 deg/s would lose by 20 deg in two minutes; the paper reports 2 deg.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors import so3
from factors.increments import npt_int
from factors.so3 import Array, from_quaternion
from graphnav.baselines import measurements as measure
from graphnav.baselines import strapdown
from graphnav.baselines.ekf import Progress, pass_keyframes
from graphnav.baselines.innovations import Innovations
from graphnav.baselines.inputs import PRESETS, Inputs
from graphnav.baselines.plan import prior_covariance, walks
from graphnav.baselines.squared_range import INERTIAL, interval
from graphnav.baselines.states import ACCEL_BIAS, GYRO_BIAS, PHI, POS, SIZE, VEL, Nominal, refuse_divergence
from graphnav.baselines.tape import Estimates

#: Names of the measurements of this filter.
KINDS = ("squared range", "zero velocity", "zero rate")


@dataclass(frozen=True, eq=False)
class RangeTable:
    """Ranges as the filter takes them, in order of time (M).

    Attributes
    ----------
    t_s, range_m : (M,); anchor_n, lever_arm_b : (M, 3).
    sigma_m, rest_sigma_m : (M,) moving and at rest.
    """

    t_s: Array
    range_m: Array
    anchor_n: Array
    lever_arm_b: Array
    sigma_m: Array
    rest_sigma_m: Array


@dataclass(frozen=True)
class Tuning:
    """Tuning.

    Attributes
    ----------
    keep_per_s : (6,) rates 1/mu at which gyro and accelerometer biases forget (equation 1); zero for constants.
    drive : (6,) variance per second of what drives them.
    gate_sigmas : ranges farther off are left out; the paper has no such gate.
    """

    keep_per_s: Array
    drive: Array
    gate_sigmas: float = np.inf

    @classmethod
    def of(cls, inputs: Inputs, bias_time_s: float | None, gate_sigmas: float | None) -> Tuning:
        """Biases that are stationary with the declared turn-on sigma.

        With a time constant given, it says how fast they move; without, the declared bias walk does, and what is
        declared constant is constant.
        """
        noise = inputs.noise
        variance = np.repeat([noise.gyro_bias**2, noise.accel_bias**2], 3)
        walk = walks(inputs, resting=False)[GYRO_BIAS.start : ACCEL_BIAS.stop]
        drive = walk if bias_time_s is None else 2 * variance / bias_time_s
        return cls(drive / (2 * variance), drive, np.inf if gate_sigmas is None else gate_sigmas)


class RangeFilter:
    """A forward pass, keyframe by keyframe.

    Attributes
    ----------
    estimates : at the keyframes passed, after feedback.
    nominal, covariance : the state now, and the covariance (15, 15) of its errors.
    rejected : ranges left out.
    """

    def __init__(self, inputs: Inputs, ranges: RangeTable, tuning: Tuning, start: tuple[Array, Array] | None) -> None:
        initial = inputs.initial
        self.inputs, self.ranges, self.tuning, self.rejected = inputs, ranges, tuning, 0
        self.nominal = Nominal(
            from_quaternion(initial.quat_nb_wxyz), initial.vel_n_m_s.copy(), initial.pos_n_m.copy(),
            np.zeros(3), np.zeros(3), np.zeros(4),
        )  # fmt: skip
        self.covariance = prior_covariance(inputs, PRESETS["matched"])[:INERTIAL, :INERTIAL].copy()
        if start is not None:
            self.nominal = self.nominal.moved(self.nominal.rotation_nb, self.nominal.vel_n, start[0])
            self.covariance[POS, POS] = start[1]
        self._bound = np.searchsorted(ranges.t_s, inputs.keyframe_s + 1e-6)
        self._resting = inputs.resting()
        self._walks = [walks(inputs, resting=rest)[:INERTIAL] for rest in (False, True)]
        for walk in self._walks:
            walk[GYRO_BIAS.start : ACCEL_BIAS.stop] = tuning.drive
        self._kept: list[tuple[Array, Array, Array, Array]] = []
        self.estimates = Estimates.empty(len(inputs.keyframe_s))
        self._store(0)

    def run(self, progress: Progress | None = None) -> None:
        """Pass all keyframes."""
        pass_keyframes(self._step, len(self.inputs.keyframe_s) - 1, self.inputs, self.estimates, progress)

    def innovations(self) -> Innovations:
        """Of all measurements that counted."""
        parts = [np.concatenate(part) for part in zip(*self._kept, strict=True)]
        order = np.argsort(parts[0], kind="stable")
        times, kinds, innovation, variance = (part[order] for part in parts)
        return Innovations(times, kinds.astype(np.int64), KINDS, innovation, variance)

    def _store(self, i: int) -> None:
        full = np.zeros((SIZE, SIZE))
        full[:INERTIAL, :INERTIAL] = self.covariance
        self.estimates.put(i, self.nominal, full)

    def _step(self, i: int) -> None:
        """From keyframe i-1 to keyframe i: navigate, measure, filter, feed back."""
        resting, mine = bool(self._resting[i - 1]), slice(self._bound[i - 1], self._bound[i])
        epoch_s, at = self._epochs(i, self.ranges.t_s[mine])
        rotations, velocities, positions, blocks, noise = strapdown.navigate(
            self.inputs, self.nominal, float(self.inputs.keyframe_s[i - 1]), epoch_s, self._walks[resting],
            resting=resting,
        )  # fmt: skip
        ahead = self.nominal.moved(rotations[-1], velocities[-1], positions[-1])
        rows = measure.joined([])
        if resting:
            rows = measure.rest_rows(self.inputs, i, ahead, rotations, velocities, len(epoch_s) // 2)
        span = np.diff(epoch_s, prepend=self.inputs.keyframe_s[i - 1])
        keep = np.exp(-span[:, None] * self.tuning.keep_per_s)
        sigma = (self.ranges.rest_sigma_m if resting else self.ranges.sigma_m)[mine]
        lever = np.einsum("mij,mj->mi", rotations[at], self.ranges.lever_arm_b[mine])
        x, counts = np.zeros(INERTIAL), (len(at), len(at), len(rows.z), len(rows.z))
        innovation, variance, row_innovation, row_variance = (np.empty(count) for count in counts)
        interval(
            blocks, noise, keep, at, positions[at] + lever, lever, self.ranges.anchor_n[mine],
            self.ranges.range_m[mine], sigma, self.tuning.gate_sigmas,
            np.ascontiguousarray(rows.h[:, :INERTIAL]), rows.epoch, rows.z,
            x, self.covariance, innovation, variance, row_innovation, row_variance,
        )  # fmt: skip
        self._feed_back(ahead, x)
        refuse_divergence(self.nominal, float(self.inputs.keyframe_s[i]), "the tables imu and uwb before that time")
        used = variance > 0
        self.rejected += int((~used).sum())
        kind = np.where(rows.kind == measure.ZERO_RATE, 2, 1)
        self._kept.append((epoch_s[at][used], np.zeros(used.sum()), innovation[used], variance[used]))
        self._kept.append((epoch_s[rows.epoch], kind.astype(float), row_innovation, row_variance))
        self._store(i)

    def _epochs(self, i: int, times: Array) -> tuple[Array, npt_int]:
        """Epochs of an interval (times of ranges and the keyframe at its end), and each range's epoch among them."""
        end = float(self.inputs.keyframe_s[i])
        start = float(self.inputs.keyframe_s[i - 1])
        # what is a hair before the keyframe, or falls on the one before, would make an epoch of no length
        snapped = np.where((end - times < 1e-6) | (times - start < 1e-6), end, times)
        epoch_s = np.unique(np.append(snapped, end))
        return epoch_s, np.searchsorted(epoch_s, snapped)

    def _feed_back(self, before: Nominal, x: Array) -> None:
        """Equation 26, and of `ekf.fed_back` the part for the velocity: at rest no turn of the world shows.

        Not the part for the position: beside anchors that stand in n such a turn does show, and keeping it hidden made
        every correction of the position a story about the heading.
        """
        self.nominal = before.corrected(np.concatenate([x, np.zeros(4)]))
        reset = np.eye(INERTIAL)
        reset[VEL, PHI] = so3.skew(before.vel_n - self.nominal.vel_n)
        self.covariance = reset @ self.covariance @ reset.T
