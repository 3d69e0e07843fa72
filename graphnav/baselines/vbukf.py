"""The variational Bayesian unscented Kalman filter that smooths positions (VB-UKF of Cao et al. (2023)).

The paper's own reference for it ([28], Coal Sci. Technol. 50(8) (2022) 210) is not at hand. This is the standard
algorithm: S. Sarkka and J. Hartikainen, "Non-linear noise adaptive Kalman filtering via variational Bayes", IEEE MLSP
2013, the multivariate form of S. Sarkka and A. Nummenmaa, IEEE T-AC 54 (2009) 596: state Gaussian, covariance of the
measurement noise inverse Wishart, alternated at each measurement until both agree. Integrals are unscented
(J. Uhlmann's symmetric points with kappa = 0). Positions come in as measurements of a machine of nearly constant
velocity. Like the paper it filters, and calls that smoothing: no measurement is used before its time. That model is
linear, for which sigma points are exact: the unscented part changes nothing, the adaptive part does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from factors.so3 import Array

_ROUNDS, _SETTLED = 20, 1e-6
#: Innovations of these positions, by name.
KINDS = ("position",)


@dataclass(frozen=True)
class Adaptation:
    """How the filter is tuned.

    Attributes
    ----------
    accel_density : white acceleration that drives the velocity, m/s^2/sqrt(Hz).
    memory_s : seconds over which the noise's covariance is learnt: rho = exp(-dt / memory_s).
    trust : measurements that the first guess of the covariance is worth.
    """

    accel_density: float
    memory_s: float
    trust: float = 5.0


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Filtered positions.

    Attributes
    ----------
    state : (N, 6) position, velocity; cov : (N, 6, 6).
    noise : (N, 3, 3) estimated covariance of the measurement noise, m^2.
    innovation, variance : (N, 3) whitened by the noise row by row, as in `innovations.Innovations`.
    """

    state: Array
    cov: Array
    noise: Array
    innovation: Array
    variance: Array


def unscented(mean: Array, cov: Array, function: Callable[[Array], Array]) -> tuple[Array, Array, Array]:
    """Mean (d,), covariance (d, d) and cross-covariance (n, d) of a function of a Gaussian.

    Parameters
    ----------
    mean : (n,); cov : (n, n); function : points (2n, n) -> (2n, d).
    """
    spread = np.linalg.cholesky(len(mean) * cov).T
    points = mean + np.concatenate([spread, -spread])
    values = function(points)
    centre = values.mean(axis=0)
    return centre, _outer(values - centre, values - centre), _outer(points - mean, values - centre)


def _outer(a: Array, b: Array) -> Array:
    return np.asarray(a.T @ b / len(a))


def update(
    mean: Array, cov: Array, scale: Array, freedom: float, measured: Array, function: Callable[[Array], Array]
) -> tuple[Array, Array, Array, Array]:
    """One measurement: the alternation of state and noise (Sarkka and Hartikainen 2013, algorithm 1).

    Parameters
    ----------
    mean, cov : predicted state (n,), (n, n); scale, freedom : predicted inverse Wishart (d, d), with the freedom that
        it has after this measurement; measured : (d,); function : the measurement, points (m, n) -> (m, d).

    Returns
    -------
    mean, cov and scale after the measurement, and the covariance of the noise that it was weighed by.
    """
    size = len(measured)
    expected, spread, cross = unscented(mean, cov, function)
    new_mean, new_cov, new_scale = mean, cov, scale
    noise = scale / (freedom - size - 1)
    for _ in range(_ROUNDS):
        noise = new_scale / (freedom - size - 1)
        total = spread + noise
        gain = np.linalg.solve(total, cross.T).T
        before, new_mean = new_mean, mean + gain @ (measured - expected)
        new_cov = cov - gain @ total @ gain.T
        new_cov = (new_cov + new_cov.T) / 2
        centre, left, _ = unscented(new_mean, new_cov, function)
        # the mean of (y - h)(y - h)' over the state
        new_scale = scale + np.outer(measured - centre, measured - centre) + left
        if np.abs(new_mean - before).max() < _SETTLED:
            break
    return new_mean, new_cov, new_scale, noise


def smooth(t_s: Array, pos_n: Array, cov_n: Array, velocity: tuple[Array, Array], adaptation: Adaptation) -> Smoothed:
    """Filter positions; each gives the state at its own time.

    Parameters
    ----------
    t_s : (N,) ascending; pos_n : (N, 3) m; cov_n : (3, 3) first guess of their covariance, m^2.
    velocity : (3,) at the start and its sigma (3,), m/s.
    """
    size = 3
    state = np.concatenate([pos_n[0], velocity[0]])
    cov = np.zeros((6, 6))
    cov[:3, :3], cov[3:, 3:] = cov_n, np.diag(velocity[1] ** 2)
    freedom = size + 1 + adaptation.trust
    scale = cov_n * adaptation.trust
    out = Smoothed(*(np.empty((len(t_s), *shape)) for shape in ((6,), (6, 6), (3, 3), (3,), (3,))))
    _put(out, 0, state, cov, cov_n, cov_n, np.zeros(3))
    for k in range(1, len(t_s)):
        step = float(t_s[k] - t_s[k - 1])
        state, cov = _predicted(state, cov, step, adaptation.accel_density)
        # Sarkka and Hartikainen, equation 14: the mean of the covariance stays, its certainty fades
        fade = float(np.exp(-step / adaptation.memory_s))
        freedom, scale = fade * (freedom - size - 1) + size + 1, fade * scale
        before, spread = state, cov[:3, :3]
        freedom += 1
        state, cov, scale, noise = update(state, cov, scale, freedom, pos_n[k], lambda points: points[:, :3])
        _put(out, k, state, cov, noise, spread + noise, pos_n[k] - before[:3])
    return out


def _predicted(state: Array, cov: Array, step: float, density: float) -> tuple[Array, Array]:
    """Nearly constant velocity over a step, driven by white acceleration."""
    turn = np.kron(np.array([[1.0, step], [0.0, 1.0]]), np.eye(3))
    drive = np.kron(np.array([[step**3 / 3, step**2 / 2], [step**2 / 2, step]]), np.eye(3)) * density**2
    mean, spread, _ = unscented(state, cov, lambda points: points @ turn.T)
    return mean, spread + drive


def _put(out: Smoothed, k: int, state: Array, cov: Array, noise: Array, total: Array, gap: Array) -> None:
    """Keep a state; its innovation row by row, each given those before it."""
    out.state[k], out.cov[k], out.noise[k] = state, cov, noise
    root = np.linalg.cholesky(total)
    diagonal = np.diag(root)
    sigma = np.sqrt(np.diag(noise))
    out.variance[k] = (diagonal / sigma) ** 2
    out.innovation[k] = np.linalg.solve(root, gap) * diagonal / sigma
