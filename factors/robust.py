"""Losses of residuals that may be outliers: how much each counts, and what the loss is.

P. Huber and E. Ronchetti, Robust Statistics, 2nd ed., 2009 (Huber's loss); M. Black and A. Rangarajan, "On the
Unification of Line Processes, Outlier Rejection, and Robust Statistics", IJCV 19 (1996) (Geman-McClure's, Cauchy's).
All are ``e^2 / 2`` near zero.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from factors.so3 import Array

Loss = Literal["none", "huber", "cauchy", "geman-mcclure"]


def weights(error: Array, loss: Loss, scale: float) -> Array:
    """Weight (...,) of each error by ``rho'(e) / e``; `scale` is where a loss departs from least squares, in sigmas."""
    ratio = (error / scale) ** 2
    if loss == "huber":
        return np.asarray(1 / np.sqrt(np.maximum(ratio, 1)))
    if loss == "cauchy":
        return np.asarray(1 / (1 + ratio))
    if loss == "geman-mcclure":
        return np.asarray(1 / (1 + ratio) ** 2)
    return np.ones_like(ratio)


def losses(error: Array, loss: Loss, scale: float) -> Array:
    """``rho(e)`` (...,)."""
    ratio = (error / scale) ** 2
    if loss == "huber":
        return np.asarray(scale**2 * np.where(ratio <= 1, ratio / 2, np.sqrt(ratio) - 0.5))
    if loss == "cauchy":
        return np.asarray(scale**2 / 2 * np.log1p(ratio))
    if loss == "geman-mcclure":
        return np.asarray(scale**2 / 2 * ratio / (1 + ratio))
    return np.asarray(scale**2 * ratio / 2)


def reweighted(error: Array, by: list[Array], loss: Loss, scale: float) -> tuple[Array, list[Array], float]:
    """Errors (K, R) and Jacobians by the loss of each row's length, and the loss less half their squares, twice."""
    if loss == "none":
        return error, by, 0.0
    length = np.linalg.norm(error, axis=1)
    weight = weights(length, loss, scale)
    excess = float((2 * losses(length, loss, scale) - weight * length**2).sum())
    root = np.sqrt(weight)
    return root[:, None] * error, [root[:, None, None] * each for each in by], excess
