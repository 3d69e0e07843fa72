"""The stereo paper's filter: inertial navigation less chained stereo odometry (roadheader VIO, equations 20-32).

15 error states (equation 25) on the strapdown solution of `strapdown`, fed back at keyframes as in `ekf`. Motions seen
by the camera are laid one behind the other (equation 16), and what this pose and the inertial one differ by is measured
(equation 26). The paper takes the chained pose's error for white, though it is the sum of all errors before it: the
filter believes the chain the more the longer it lasts. With `Tuning.relative` each motion is measured by itself,
between the pose at its end and a copy of the pose at its start, six more states (S. Roumeliotis and J. Burdick,
"Stochastic cloning", ICRA 2002), with its own covariance.

Where the paper is silent: the standing start aligns (zero velocity, the gyro shows its bias), nothing later does; the
chain begins there, and begins anew at the inertial pose after a gap. Biases are the body's, the paper's those in n.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from factors import so3
from factors.so3 import Array, from_quaternion
from graphnav.baselines import kalman, strapdown
from graphnav.baselines import measurements as measure
from graphnav.baselines.ekf import Progress, pass_keyframes
from graphnav.baselines.innovations import Innovations
from graphnav.baselines.inputs import PRESETS, Inputs
from graphnav.baselines.measurements import Rows
from graphnav.baselines.plan import prior_covariance, walks
from graphnav.baselines.states import PHI, POS, SIZE, VEL, Nominal, refuse_divergence
from graphnav.baselines.stereo_rows import (
    CLONE_PHI,
    CLONE_POS,
    INERTIAL,
    WITH_CLONE,
    Place,
    chained_rows,
    motion_rows,
)
from graphnav.baselines.tape import Estimates
from graphnav.frontends.motion_chain import Sightings

_SAME_S = 1e-6
#: A rest that begins this soon is the standing start; a motion that begins this little before the IMU counts.
_AT_START_S, _EARLY_S = 2.0, 1e-3
#: Names of the measurements of this filter, in the order of `stereo_rows` and, from the third on, of `measurements`.
KINDS = ("stereo attitude", "stereo position", "zero velocity", "zero rate")


@dataclass(frozen=True)
class Tuning:
    """How motions are measured.

    Attributes
    ----------
    attitude_sigma_rad, position_sigma_m : of a chained pose, white.
    relative : each motion by itself, with its own covariance.
    """

    attitude_sigma_rad: float
    position_sigma_m: float
    relative: bool = False


class VioFilter:
    """A forward pass, keyframe by keyframe; without motions the inertial navigation alone.

    Attributes
    ----------
    estimates : at the keyframes passed, after feedback.
    nominal, covariance : the state now, and the covariance (n, n) of its errors.
    used : motions that count.
    """

    def __init__(self, inputs: Inputs, seen: Sightings | None, tuning: Tuning) -> None:
        initial = inputs.initial
        self.inputs, self.tuning = inputs, tuning
        self.nominal = Nominal(
            from_quaternion(initial.quat_nb_wxyz), initial.vel_n_m_s.copy(), initial.pos_n_m.copy(),
            np.zeros(3), np.zeros(3), np.zeros(4),
        )  # fmt: skip
        self._size = WITH_CLONE if tuning.relative else INERTIAL
        self.covariance = np.zeros((self._size, self._size))
        self.covariance[:INERTIAL, :INERTIAL] = prior_covariance(inputs, PRESETS["matched"])[:INERTIAL, :INERTIAL]
        self._walks = [np.resize(walks(inputs, resting=rest)[:INERTIAL], self._size) for rest in (False, True)]
        for walk in self._walks:
            walk[INERTIAL:] = 0.0
        self._aligning = _standing_start(inputs)
        self._seen = None if seen is None else _usable(seen, inputs, self._aligning)
        self.used = 0 if self._seen is None else len(self._seen.t_to_s)
        self._plan_events()
        self._kept: list[tuple[float, int, float, float]] = []
        self.estimates = Estimates.empty(len(inputs.keyframe_s))
        self._anchor = self._cloned = Place(self.nominal.rotation_nb, self.nominal.pos_n)
        self._copy(self._anchor, np.zeros(self._size))
        self._store(0)

    def _plan_events(self) -> None:
        """Ends of motions (number + 1), and starts of those that follow no other (0), in order of time."""
        self._event_s, self._event = np.zeros(0), np.zeros(0, np.int64)
        if self._seen is not None:
            first = self._seen.t_from_s[self._seen.begins]
            times, what = np.append(self._seen.t_to_s, first), np.append(np.arange(1, self.used + 1), 0 * first)
            # at one time the motion that ends comes first
            order = np.lexsort((what == 0, times))
            self._event_s, self._event = times[order], what[order].astype(np.int64)
        self._bound = np.searchsorted(self._event_s, self.inputs.keyframe_s + _SAME_S)

    def run(self, progress: Progress | None = None) -> None:
        """Pass all keyframes."""
        pass_keyframes(self._step, len(self.inputs.keyframe_s) - 1, self.inputs, self.estimates, progress)

    def innovations(self) -> Innovations:
        """Of all measurements."""
        t_s, kind, innovation, variance = np.array(self._kept, float).reshape(-1, 4).T
        return Innovations(t_s, kind.astype(np.int64), KINDS, innovation, variance)

    def _store(self, i: int) -> None:
        full = np.zeros((SIZE, SIZE))
        full[:INERTIAL, :INERTIAL] = self.covariance[:INERTIAL, :INERTIAL]
        self.estimates.put(i, self.nominal, full)

    def _step(self, i: int) -> None:
        """From keyframe i-1 to keyframe i: navigate, measure epoch by epoch, feed back."""
        resting = bool(self._aligning[i - 1])
        start, end = float(self.inputs.keyframe_s[i - 1]), float(self.inputs.keyframe_s[i])
        mine = slice(self._bound[i - 1], self._bound[i])
        times = self._event_s[mine]
        times = np.where(end - times < _SAME_S, end, times)
        epoch_s = np.unique(np.append(times, end))
        rotations, velocities, positions, blocks, noise = strapdown.navigate(
            self.inputs, self.nominal, start, epoch_s, self._walks[resting], resting=resting
        )
        ahead = self.nominal.moved(rotations[-1], velocities[-1], positions[-1])
        rest = measure.joined([])
        if resting:
            rest = measure.rest_rows(self.inputs, i, ahead, rotations, velocities, (len(epoch_s) - 1) // 2)
        x = np.zeros(self._size)
        for e, t_s in enumerate(epoch_s):
            kalman.predict(kalman.transition(blocks[e]), noise[e], x, self.covariance)
            self._take(_of_epoch(rest, e, self._size), t_s, x)
            for event in self._event[mine][times == t_s]:
                self._see(int(event), Place(rotations[e], positions[e]), t_s, x)
        self._feed_back(ahead, x)
        refuse_divergence(self.nominal, end, "the tables imu and relative_pose before that time")
        self._store(i)

    def _see(self, event: int, here: Place, t_s: float, x: Array) -> None:
        """A motion ends here, or a chain begins."""
        if event == 0:
            self._anchor = here.corrected(x[PHI], x[POS])
        else:
            assert self._seen is not None
            motions, m, tuning = self._seen.motions, event - 1, self.tuning
            if tuning.relative:
                rows = motion_rows(self._cloned, here, motions.rotation[m], motions.pos[m], motions.cov[m])
            else:
                self._anchor = self._anchor.moved(motions.rotation[m], motions.pos[m])
                rows = chained_rows(self._anchor, here, tuning.attitude_sigma_rad, tuning.position_sigma_m)
            self._take(rows, t_s, x)
        self._copy(here, x)

    def _take(self, rows: Rows, t_s: float, x: Array) -> None:
        """Rows one after the other, equations 30-32."""
        for h, z, kind in zip(rows.h, rows.z, rows.kind, strict=True):
            innovation, variance, _ = kalman.update(h, z, x, self.covariance)
            self._kept.append((t_s, kind, innovation, variance))

    def _copy(self, here: Place, x: Array) -> None:
        """The pose here becomes the one that the next motion starts from; its error is the same now."""
        if not self.tuning.relative:
            return
        same = np.eye(self._size)
        same[CLONE_PHI, :], same[CLONE_POS, :] = same[PHI, :], same[POS, :]
        self._cloned = here
        x[:] = same @ x
        self.covariance = same @ self.covariance @ same.T

    def _feed_back(self, before: Nominal, x: Array) -> None:
        """Correct the state and forget the error.

        Errors keep the direction in which a turn of the world does not show, as in `ekf.fed_back`; a chain that is laid
        in n shows it in the position, single motions do not.
        """
        self.nominal = before.corrected(np.concatenate([x[:INERTIAL], np.zeros(4)]))
        reset = np.eye(self._size)
        reset[VEL, PHI] = so3.skew(before.vel_n - self.nominal.vel_n)
        if self.tuning.relative:
            reset[POS, PHI] = so3.skew(before.pos_n - self.nominal.pos_n)
            self._cloned = self._cloned.corrected(x[CLONE_PHI], x[CLONE_POS])
            reset[CLONE_POS, CLONE_PHI] = so3.skew(-x[CLONE_POS])
        self.covariance = reset @ self.covariance @ reset.T


def _standing_start(inputs: Inputs) -> npt.NDArray[np.bool_]:
    """(N-1,) intervals of the rest that the log starts with."""
    at_start = len(inputs.rest_s) > 0 and inputs.rest_s[0, 0] - inputs.keyframe_s[0] < _AT_START_S
    until = inputs.rest_s[0, 1] if at_start else -np.inf
    return inputs.resting() & (inputs.keyframe_s[1:] <= until + _SAME_S)


def _usable(seen: Sightings, inputs: Inputs, aligning: npt.NDArray[np.bool_]) -> Sightings:
    """Motions within the IMU's record that end after the standing start."""
    t = inputs.keyframe_s
    stood = np.flatnonzero(aligning)
    after = t[stood[-1] + 1] if len(stood) else t[0]
    return seen.only(
        (seen.t_from_s > t[0] - _EARLY_S) & (seen.t_to_s > after + _SAME_S) & (seen.t_to_s < t[-1] + _SAME_S)
    )


def _of_epoch(rows: Rows, e: int, size: int) -> Rows:
    """The rows of an epoch, for the states of this filter."""
    mine = rows.epoch == e
    h = np.zeros((int(mine.sum()), size))
    h[:, :INERTIAL] = rows.h[mine, :INERTIAL]
    return Rows(h, rows.z[mine], rows.epoch[mine], rows.kind[mine])
