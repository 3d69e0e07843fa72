"""The 19 error states of the filter, and the nominal state that they correct.

Zheng et al. (2021), equation 12: ``x = [dv_n, phi_n, dp_n, gyro bias, accel bias, mounting, scale]``. The paper's
errors are estimate less truth; here every error is truth less estimate, so that it is the correction to apply, and
the misalignment is a rotation of n: ``R_true = Exp(phi) R``. Its link to the house's right perturbation in b is
``theta_b = R^T phi``; the mounting angles are those of `factors.odometry` (the paper's delta-alpha is their negative).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from factors import so3
from factors.so3 import Array
from graphnav.errors import SolveError

SIZE = 19
VEL, PHI, POS = slice(0, 3), slice(3, 6), slice(6, 9)
GYRO_BIAS, ACCEL_BIAS = slice(9, 12), slice(12, 15)
MOUNTING, SCALE = slice(15, 18), 18

#: No machine is as fast; a filter that says so is lost.
_FASTEST_M_S = 1000.0
_UPPER = np.triu_indices(SIZE)
#: Length of a packed symmetric matrix.
PACKED = len(_UPPER[0])


@dataclass(frozen=True)
class Nominal:
    """What the error states correct.

    Attributes
    ----------
    rotation_nb : (3, 3); vel_n, pos_n : (3,); gyro_bias_b, accel_bias_b : (3,), rad/s and m/s^2.
    calibration : (4,) [scale, mounting angles rad] of the odometer.
    """

    rotation_nb: Array
    vel_n: Array
    pos_n: Array
    gyro_bias_b: Array
    accel_bias_b: Array
    calibration: Array

    def corrected(self, x: Array) -> Nominal:
        """The state after the error (19,) is taken out."""
        return Nominal(
            so3.exp(x[PHI]) @ self.rotation_nb,
            self.vel_n + x[VEL],
            self.pos_n + x[POS],
            self.gyro_bias_b + x[GYRO_BIAS],
            self.accel_bias_b + x[ACCEL_BIAS],
            self.calibration + np.concatenate([x[SCALE:], x[MOUNTING]]),
        )

    def moved(self, rotation_nb: Array, vel_n: Array, pos_n: Array) -> Nominal:
        """The same sensors in another place."""
        return replace(self, rotation_nb=rotation_nb, vel_n=vel_n, pos_n=pos_n)


def refuse_divergence(nominal: Nominal, t_s: float, suspect: str) -> None:
    """Stop a filter that is lost; `suspect` : where to look."""
    speed = float(np.abs(nominal.vel_n).max())
    if not (speed < _FASTEST_M_S and np.isfinite(nominal.rotation_nb).all()):
        raise SolveError(
            f"the filter diverged at {t_s:.1f} s (speed {speed:.3g} m/s): look for wild values in {suspect}"
        )


def packed(matrix: Array) -> Array:
    """Upper triangle (190,) of a symmetric matrix (19, 19)."""
    return matrix[_UPPER]


def unpacked(upper: Array) -> Array:
    """Symmetric matrices (..., 19, 19) of upper triangles (..., 190)."""
    out = np.empty((*upper.shape[:-1], SIZE, SIZE))
    out[..., _UPPER[0], _UPPER[1]] = upper
    out[..., _UPPER[1], _UPPER[0]] = upper
    return out


def house_covariance(rotation_nb: Array, covariance: Array) -> Array:
    """Covariance in the house's order: attitude (body, right perturbation), position, velocity; (..., 9, 9).

    Parameters
    ----------
    rotation_nb : (..., 3, 3); covariance : (..., 19, 19).
    """
    rows = np.r_[3:6, 6:9, 0:3]
    cov = covariance[..., rows[:, None], rows]
    to_b = so3.transpose(rotation_nb)
    cov[..., :3, :] = to_b @ cov[..., :3, :]
    cov[..., :, :3] = cov[..., :, :3] @ rotation_nb
    return np.asarray(cov)
