"""What the baselines take: the log condensed as far as every estimator agrees, and the presets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.inertial import ImuNoise
from factors.so3 import Array
from graphnav.config import Config
from graphnav.frontends.cutting_cycles import ClosedPathPoint, Cycle
from graphnav.frontends.imu_samples import ImuSamples
from graphnav.log import InitialState, SensorLog


@dataclass(frozen=True)
class Inputs:
    """A log with its cycles, rest and keyframes, as the graph has them too.

    Attributes
    ----------
    log, config, imu, noise, gravity_m_s2, earth_rate_n : as in `graphnav.problem.Problem`.
    keyframe_s : (N,) times of the states that are kept; every closed-path point and fix has one of its own.
    cycles, closed_path : from `frontends.cutting_cycles`; rest_s : (K, 2).
    fixes : (time, position (3,), sigma (3,)).
    """

    log: SensorLog
    config: Config
    imu: ImuSamples
    noise: ImuNoise
    gravity_m_s2: float
    earth_rate_n: Array
    keyframe_s: Array
    cycles: tuple[Cycle, ...]
    closed_path: tuple[ClosedPathPoint, ...]
    rest_s: Array
    fixes: tuple[tuple[float, Array, Array], ...]

    @property
    def initial(self) -> InitialState:
        """The declared initial state, whose presence was checked before."""
        assert self.log.initial is not None
        return self.log.initial

    def index(self, t_s: float) -> int:
        """The keyframe nearest to a time."""
        right = int(np.clip(np.searchsorted(self.keyframe_s, t_s), 1, len(self.keyframe_s) - 1))
        return right - 1 if t_s - self.keyframe_s[right - 1] < self.keyframe_s[right] - t_s else right

    def resting(self) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        """(N-1,) whether an interval between keyframes lies within a rest."""
        start, end = self.keyframe_s[:-1] + 1e-6, self.keyframe_s[1:] - 1e-6
        inside = np.zeros(len(start), bool)
        for low, high in self.rest_s:
            inside |= (start >= low) & (end <= high)
        return inside


@dataclass(frozen=True)
class Preset:
    """How the filter is tuned.

    Attributes
    ----------
    prior_scale, noise_scale : factors on the declared initial sigmas and on the IMU's noise densities.
    constraint_every_s : spacing of the rows that hold sideways and upward velocity at zero; 0 for every sample.
    first_pass_covariance : whether a closed-path point is as uncertain as the first pass it is predicted from.
    along_everywhere : whether a closed-path point counts along the face between its ends too.
    """

    prior_scale: float = 1.0
    noise_scale: float = 1.0
    constraint_every_s: float = 1.0
    first_pass_covariance: bool = True
    along_everywhere: bool = False


PRESETS = {
    "matched": Preset(),
    # appendix A: P0 x 3, Q x 5; all of equation 19 at every sample; equation 21 with the declared noise alone
    "paper": Preset(
        prior_scale=3.0,
        noise_scale=5.0,
        constraint_every_s=0.0,
        first_pass_covariance=False,
        along_everywhere=True,
    ),
}
