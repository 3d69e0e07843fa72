"""The error-state Kalman filter with closed loop: 19 states, Zheng et al. (2021), equations 9-25 and 28.

Between two keyframes (a second at most) the strapdown solution runs through every IMU sample and the error state
through every odometer sample; at the keyframe the error is fed back. Linearizing about the state of the last feedback
instead of the last odometer sample lets all residuals of an interval be taken at once (docs/decisions/0008 has what it
changes).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from factors import so3
from factors.increments import npt_int
from factors.so3 import Array, from_quaternion
from graphnav.baselines import kalman, strapdown
from graphnav.baselines import measurements as measure
from graphnav.baselines.innovations import Innovations
from graphnav.baselines.inputs import Inputs, Preset
from graphnav.baselines.measurements import FirstPass, Rows
from graphnav.baselines.plan import Advance, advances, fixes, odometer_plan, prior_covariance, walks
from graphnav.baselines.states import PHI, POS, SIZE, VEL, Nominal, refuse_divergence
from graphnav.baselines.tape import AdjointMaps, Estimates

Progress = Callable[[float, float], None]

_SUSPECT = "the imu table before that time, and check the declared initial attitude and sigmas"
#: Keyframes after which memory that is not needed now is let go.
_RELEASE_EVERY = 2000


def pass_keyframes(
    step: Callable[[int], None], last: int, inputs: Inputs, estimates: Estimates, progress: Progress | None
) -> None:
    """Call `step` for the keyframes 1 to `last`, letting go of memory on the way."""
    inputs.imu.release()
    for i in range(1, last + 1):
        step(i)
        if i % _RELEASE_EVERY == 0:
            inputs.imu.release()
            estimates.release()
        if progress is not None and i % 100 == 0:
            progress(i, last + 1)


@dataclass(eq=False)
class Filter:
    """A forward pass, keyframe by keyframe.

    Attributes
    ----------
    inputs, preset : the log and the tuning.
    estimates : at the keyframes passed, after feedback.
    maps : what a smoother needs of the intervals passed, or None.
    passes : first passes of closed-path points by keyframe; a smoother may put better ones in their place.
    """

    inputs: Inputs
    preset: Preset
    estimates: Estimates
    maps: AdjointMaps | None
    passes: dict[int, FirstPass]

    @classmethod
    def start(cls, inputs: Inputs, preset: Preset, *, smoothing: bool) -> Filter:
        """At the first keyframe, with the declared initial state."""
        count = len(inputs.keyframe_s)
        maps = AdjointMaps.empty(count - 1) if smoothing else None
        filter_ = cls(inputs, preset, Estimates.empty(count), maps, {})
        filter_._prepare()
        return filter_

    def _prepare(self) -> None:
        inputs, preset = self.inputs, self.preset
        initial = inputs.initial
        self.nominal = Nominal(
            from_quaternion(initial.quat_nb_wxyz), initial.vel_n_m_s.copy(), initial.pos_n_m.copy(),
            np.zeros(3), np.zeros(3), np.zeros(4),
        )  # fmt: skip
        self.covariance = prior_covariance(inputs, preset)
        self._resting = inputs.resting()
        self._walks = [walks(inputs, resting=rest) for rest in (False, True)]
        self._odometer_bound, self._constrained = odometer_plan(inputs, preset)
        self._closing, self._fixes = advances(inputs), fixes(inputs)
        self._store_at = {first for points in self._closing.values() for first, _ in points}
        self._kept: list[tuple[Array, npt_int, Array, Array]] = []
        self._store(0, self.nominal)

    def run(self, progress: Progress | None = None) -> Iterator[int]:
        """Pass the keyframes one by one; yields the index of each one passed."""
        count = len(self.inputs.keyframe_s)
        self.inputs.imu.release()
        yield 0
        for i in range(1, count):
            self._step(i)
            if i % _RELEASE_EVERY == 0:
                self.inputs.imu.release()
                self.estimates.release()
                if self.maps is not None:
                    self.maps.release()
            if progress is not None and i % 100 == 0:
                progress(i, count)
            yield i

    def innovations(self) -> Innovations:
        """Of all measurements so far."""
        times, kinds, innovation, variance = (np.concatenate(part) for part in zip(*self._kept, strict=True))
        return Innovations(times, kinds, measure.KINDS, innovation, variance)

    def _store(self, i: int, nominal: Nominal) -> None:
        self.estimates.put(i, nominal, self.covariance)
        if i in self._store_at:
            self.passes[i] = FirstPass(nominal, self.covariance.copy())

    def _step(self, i: int) -> None:
        """From keyframe i-1 to keyframe i: navigate, measure, filter, feed back."""
        epoch_s, samples = self._epochs(i)
        resting = bool(self._resting[i - 1])
        rotations, velocities, positions, blocks, noise = strapdown.navigate(
            self.inputs, self.nominal, float(self.inputs.keyframe_s[i - 1]), epoch_s, self._walks[resting],
            resting=resting, noise_scale=self.preset.noise_scale,
        )  # fmt: skip
        ahead = self.nominal.moved(rotations[-1], velocities[-1], positions[-1])
        rows = self._measure(i, epoch_s, samples, rotations, velocities, ahead, resting)
        x = np.zeros(SIZE)
        innovation, variance = np.empty(len(rows.z)), np.empty(len(rows.z))
        a, c, big_c = np.empty((SIZE, SIZE)), np.empty(SIZE), np.empty((SIZE, SIZE))
        kalman.interval(
            blocks, noise, rows.h, rows.epoch, rows.z, x, self.covariance, innovation, variance,
            self.maps is not None, a, c, big_c,
        )  # fmt: skip
        self.nominal = ahead.corrected(x)
        refuse_divergence(self.nominal, float(self.inputs.keyframe_s[i]), _SUSPECT)
        reset = fed_back(ahead, self.nominal)
        self.covariance = reset @ self.covariance @ reset.T
        if self.maps is not None:
            self.maps.put(i - 1, reset @ a, c, big_c)
        self._kept.append((epoch_s[rows.epoch], rows.kind, innovation, variance))
        self._store(i, self.nominal)

    def _epochs(self, i: int) -> tuple[Array, npt_int]:
        """Epochs of an interval (odometer samples and the keyframe at its end), and the odometer rows among them."""
        end = float(self.inputs.keyframe_s[i])
        samples = np.arange(self._odometer_bound[i - 1], self._odometer_bound[i])
        if not len(samples):
            return np.array([end]), samples
        assert self.inputs.log.odometer is not None
        times = self.inputs.log.odometer.t_s[samples]
        if end - times[-1] < 1e-6:
            return np.append(times[:-1], end), samples
        return np.append(times, end), samples

    def _measure(
        self, i: int, epoch_s: Array, samples: npt_int, rotations: Array, velocities: Array, ahead: Nominal,
        resting: bool,
    ) -> Rows:  # fmt: skip
        """All measurements of an interval; what belongs to its keyframe is linearized at the state ahead."""
        inputs, last = self.inputs, len(epoch_s) - 1
        parts = []
        if len(samples) and not resting:
            assert inputs.log.odometer is not None
            which = np.arange(len(samples))
            imu = inputs.imu.samples
            row = np.searchsorted(imu.edge_s, epoch_s[which] - 1e-9) - 1
            rate = imu.gyro_b[row] - self.nominal.gyro_bias_b
            constrained = self._constrained[samples]
            speed = inputs.log.odometer.speed_m_s[samples]
            parts.append(
                measure.odometer_rows(
                    rotations[which], velocities[which], ahead, speed, rate, inputs.log.odometer, which, constrained
                )
            )
        if resting:
            parts.append(measure.rest_rows(inputs, i, ahead, rotations, velocities, last // 2))
        for first, advance in self._closing.get(i, ()):
            parts.append(self._closed_path_rows(first, advance, ahead, last))
        for pos_n, sigma_n in self._fixes.get(i, ()):
            parts.append(measure.position_rows(ahead, pos_n, sigma_n, last))
        return measure.joined(parts)

    def _closed_path_rows(self, first: int, advance: Advance, ahead: Nominal, epoch: int) -> Rows:
        """Sideways and upward the push tells; along the face the machine's stops do, or in the paper every point."""
        along = advance.at_end or self.preset.along_everywhere or self.inputs.config.closed_path.along == "all"
        return measure.closed_path_rows(
            ahead, self.passes[first], advance.advance_m, advance.sigma_m, [0, 1, 2] if along else [0, 2],
            self.preset.first_pass_covariance, epoch,
        )  # fmt: skip


def fed_back(before: Nominal, after: Nominal) -> Array:
    """What feedback does to the errors (19, 19): they keep the direction in which turning the world shows nowhere.

    A turn of n about the vertical makes a velocity error ``phi x v`` and a position error ``phi x p``. Feedback moves v
    and p, so the covariance must move with them, or every correction would seem to tell something of the heading: the
    invariant filter of A. Barrau and S. Bonnabel, IEEE T-AC 62 (2017) 1797, in the paper's states
    (docs/decisions/0008).
    """
    reset = np.eye(SIZE)
    reset[VEL, PHI] = so3.skew(before.vel_n - after.vel_n)
    reset[POS, PHI] = so3.skew(before.pos_n - after.pos_n)
    return reset
