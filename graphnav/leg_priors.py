"""What is known of legs and scanner before any reading: surveyed places, lean, the calibration's declared sigmas.

A leg is a line (`factors.landmark`): east and north at its own height h0, and lean. A point of it surveyed at the
height h says ``place + lean (h - h0) = surveyed``; with the prior on the lean that is one Gaussian on all four numbers.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from factors.increments import npt_int
from factors.noise import diagonal
from factors.so3 import Array
from graphnav.log import Landmark, Lidar
from graphnav.problem import D, L

if TYPE_CHECKING:
    import gtsam

#: Sigma of the place of a leg that nobody surveyed, m.
_ANYWHERE_M = 1e4
#: Sigma of what the declaration holds at zero.
_HELD = 1e-7


def leg_priors(lidar: Lidar, feature: npt_int, height_m: Array, lean_sigma: float) -> list[gtsam.NonlinearFactor]:
    """Priors of the scanner's calibration and of every leg.

    Parameters
    ----------
    lidar : the declared scanner with its surveyed landmarks; those that were never seen have no variable.
    feature : (J,) feature number of each leg variable ``L(j)``.
    height_m : (J,) the height h0 of each.
    lean_sigma : sigma of the lean to east and to north, m per m.
    """
    surveyed = {mark.feature: mark for mark in lidar.landmark}
    found = [calibration_prior(lidar)]
    for j, (number, height) in enumerate(zip(feature.tolist(), height_m.tolist(), strict=True)):
        # one that moved is no longer where it was surveyed
        found.append(leg_prior(j, surveyed.pop(number, None), height, lean_sigma))
    return found


def calibration_prior(lidar: Lidar) -> gtsam.NonlinearFactor:
    """The scanner's calibration as declared."""
    import gtsam

    return gtsam.PriorFactorVector(D(0), np.zeros(8), diagonal(lidar_sigmas(lidar)))


def leg_prior(j: int, mark: Landmark | None, height_m: float, lean_sigma: float) -> gtsam.NonlinearFactor:
    """The leg variable ``L(j)``: surveyed, or anywhere; its lean by `lean_sigma`, m per m, to east and to north."""
    import gtsam

    if mark is not None:
        return gtsam.PriorFactorVector(L(j), *_surveyed(mark, height_m, lean_sigma))
    anywhere = diagonal([_ANYWHERE_M, _ANYWHERE_M, lean_sigma, lean_sigma])
    return gtsam.PriorFactorVector(L(j), np.zeros(4), anywhere)


def _surveyed(mark: Landmark, height_m: float, lean_sigma: float) -> tuple[Array, gtsam.noiseModel.Base]:
    """Mean (4,) and noise of a leg whose surveyed point is at another height than its variable."""
    import gtsam

    above = mark.pos_n_m[2] - height_m
    down = np.kron([[1.0, -above], [0.0, 1.0]], np.eye(2))
    cov = down @ np.diag(np.repeat([mark.sigma_m, lean_sigma], 2) ** 2) @ down.T
    return np.r_[mark.pos_n_m[:2], 0.0, 0.0], gtsam.noiseModel.Gaussian.Covariance(cov)


def lidar_sigmas(lidar: Lidar) -> Array:
    """Declared sigmas (8,) of the LiDAR's calibration; what is not declared is held."""
    degree = np.pi / 180
    declared = [
        lidar.range_scale_sigma,
        lidar.range_bias_sigma_m,
        None if lidar.angle_bias_sigma_deg is None else lidar.angle_bias_sigma_deg * degree,
        lidar.angle_scale_sigma,
        None if lidar.angle_quadratic_sigma_per_deg is None else lidar.angle_quadratic_sigma_per_deg / degree,
    ]
    mounting = np.zeros(3) if lidar.mounting_sigma_deg is None else lidar.mounting_sigma_deg * degree
    sigmas = np.array([0.0 if value is None else value for value in declared] + mounting.tolist())
    return np.asarray(np.maximum(sigmas, _HELD))


def lidar_free(lidar: Lidar) -> npt.NDArray[np.bool_]:
    """Which of the LiDAR's calibration (8,) are estimated: those that are declared above zero."""
    return np.asarray(lidar_sigmas(lidar) > _HELD)
