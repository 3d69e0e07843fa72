"""Central differences for residuals and for GTSAM factors, and random states to take them at."""

from __future__ import annotations

from collections.abc import Callable

import gtsam
import numpy as np

from factors import so3

STEP = 1e-6

#: Rotation angles at which Jacobians are looked at: none, tiny, ordinary, and up to half a turn.
ANGLES = (0.0, 1e-9, 1e-5, 1e-3, 0.3, 2.0, np.pi - 1e-3, np.pi - 1e-7, np.pi)


def central(error: Callable[[np.ndarray], np.ndarray], size: int, step: float = STEP) -> np.ndarray:
    """``d error(delta) / d delta`` at ``delta = 0``, (rows, size)."""
    columns = []
    for axis in range(size):
        delta = np.zeros(size)
        delta[axis] = step
        columns.append((np.asarray(error(delta)) - np.asarray(error(-delta))) / (2 * step))
    return np.column_stack(columns)


def moved(rotation: np.ndarray, pos: np.ndarray, delta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A pose after the perturbation of the conventions: ``R Exp(omega)``, ``p + R v``."""
    return rotation @ so3.exp(delta[:3]), pos + rotation @ delta[3:]


def factor_jacobian(factor: gtsam.NonlinearFactor, values: gtsam.Values, step: float = STEP) -> np.ndarray:
    """All columns of a factor's Jacobian in the order of its keys, by differences through `Values.retract`."""
    sizes = values.zeroVectors()

    def error(key: int, delta: np.ndarray) -> np.ndarray:
        change = gtsam.VectorValues()
        change.insert(key, delta)
        return np.asarray(factor.unwhitenedError(values.retract(change)))

    return np.hstack([central(lambda d, k=k: error(k, d), len(sizes.at(k)), step) for k in factor.keys()])


def analytic(factor: gtsam.NonlinearFactor, values: gtsam.Values) -> tuple[np.ndarray, np.ndarray]:
    """Whitened Jacobian, keys in the factor's order, and right-hand side that the factor itself gives."""
    return factor.linearize(values).jacobian()


def random_rotation(rng: np.random.Generator, angle: float | None = None) -> np.ndarray:
    """A rotation about a random axis, by a random or a given angle (rad)."""
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    return so3.exp(axis * (rng.uniform(0, np.pi) if angle is None else angle))
