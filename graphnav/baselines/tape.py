"""What a forward pass leaves at every keyframe, and how it becomes states with covariances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.so3 import Array, to_quaternion
from graphnav._memory import allocate, release
from graphnav.baselines.states import PACKED, SIZE, Nominal, house_covariance, packed, unpacked

#: Keyframes whose covariances are unpacked at a time.
_BLOCK = 2000


@dataclass(frozen=True, eq=False)
class Estimates:
    """Estimates at N keyframes: nominal states, and the covariances of their 19 errors, packed.

    Attributes
    ----------
    rotation_nb : (N, 3, 3); vel_n, pos_n, gyro_bias_b, accel_bias_b : (N, 3); calibration : (N, 4).
    covariance : (N, 190) upper triangles, see `states.unpacked`.
    """

    rotation_nb: Array
    vel_n: Array
    pos_n: Array
    gyro_bias_b: Array
    accel_bias_b: Array
    calibration: Array
    covariance: Array

    @classmethod
    def empty(cls, count: int) -> Estimates:
        """Room for `count` keyframes."""
        vel, pos, gyro, accel = np.empty((4, count, 3))
        return cls(
            np.empty((count, 3, 3)), vel, pos, gyro, accel, np.empty((count, 4)), allocate((count, PACKED), float)
        )

    def put(self, i: int, nominal: Nominal, covariance: Array) -> None:
        """Keep the state at keyframe i with its covariance (19, 19)."""
        for name, value in vars(nominal).items():
            getattr(self, name)[i] = value
        self.covariance[i] = packed(covariance)

    def nominal(self, i: int) -> Nominal:
        """The state at keyframe i."""
        names = Nominal.__dataclass_fields__
        return Nominal(**{name: getattr(self, name)[i].copy() for name in names})

    def house(self) -> tuple[Array, Array]:
        """Quaternions (N, 4) and covariances (N, 9, 9) in the house's order and frames."""
        cov = np.empty((len(self.pos_n), 9, 9))
        for lo in range(0, len(cov), _BLOCK):
            rows = slice(lo, lo + _BLOCK)
            cov[rows] = house_covariance(self.rotation_nb[rows], unpacked(self.covariance[rows]))
        return to_quaternion(self.rotation_nb), cov

    def sigmas(self) -> Array:
        """(N, 19) sigmas of all states."""
        diagonal = np.cumsum(np.r_[0, np.arange(SIZE, 1, -1)])
        return np.asarray(np.sqrt(self.covariance[:, diagonal]))

    def release(self) -> None:
        """Let go of the covariances' memory; they stay on file."""
        release(self.covariance)


@dataclass(frozen=True, eq=False)
class AdjointMaps:
    """What every interval between keyframes does to the adjoint of the smoother: see `kalman.interval`.

    Attributes
    ----------
    a : (N-1, 19, 19); c : (N-1, 19); big_c : (N-1, 190) packed.
    """

    a: Array
    c: Array
    big_c: Array

    @classmethod
    def empty(cls, count: int) -> AdjointMaps:
        """Room for `count` intervals."""
        return cls(
            allocate((count, SIZE, SIZE), float), allocate((count, SIZE), float), allocate((count, PACKED), float)
        )

    def put(self, k: int, a: Array, c: Array, big_c: Array) -> None:
        """Keep the map of interval k."""
        self.a[k], self.c[k], self.big_c[k] = a, c, packed(big_c)

    def release(self) -> None:
        """Let go of their memory; they stay on file."""
        release(self.a, self.c, self.big_c)
