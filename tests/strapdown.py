"""Reference integrations of body rate and specific force, independent of the package's own."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

Signal = Callable[[np.ndarray], np.ndarray]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(6)


def means(signal: Signal, edge_s: np.ndarray) -> np.ndarray:
    """Mean of a signal (M,) -> (M, 3) over every interval between edges, (N, 3), by Gauss quadrature."""
    half, middle = np.diff(edge_s) / 2, (edge_s[1:] + edge_s[:-1]) / 2
    return sum(w / 2 * signal(middle + half * x) for x, w in zip(_NODES, _WEIGHTS, strict=True))


def integrate(
    rate_b: Signal,
    force_b: Signal,
    start_s: float,
    end_s: float,
    *,
    step_s: float = 1e-3,
    rotation: np.ndarray | None = None,
    vel_n: np.ndarray | None = None,
    pos_n: np.ndarray | None = None,
    gravity_n: np.ndarray | None = None,
    earth_n: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Attitude, velocity and position after ``R' = R [w]x - [Omega]x R``, ``v' = R f + g - 2 Omega x v``, ``p' = v``.

    Attitude by a fourth-order exponential (Magnus) step, the rest by Simpson's rule and a fourth-order Runge-Kutta
    step in the turning frame: exact to far below what is compared with it.
    """
    gravity = np.zeros(3) if gravity_n is None else gravity_n
    earth = np.zeros(3) if earth_n is None else earth_n
    steps = max(1, int(np.ceil((end_s - start_s) / step_s - 1e-9)))
    h = (end_s - start_s) / steps
    t = start_s + h * np.arange(steps)
    # half steps of attitude, so that the force is known in n at both ends and in the middle
    halves = Rotation.from_rotvec(_magnus(rate_b, np.sort(np.concatenate([t, t + h / 2])), h / 2)).as_matrix()
    turn = Rotation.from_rotvec(-earth * h / 2).as_matrix()
    r = np.eye(3) if rotation is None else rotation
    v = np.zeros(3) if vel_n is None else vel_n
    p = np.zeros(3) if pos_n is None else pos_n
    f0, f1, f2 = force_b(t), force_b(t + h / 2), force_b(t + h)
    for k in range(steps):
        r1 = turn @ r @ halves[2 * k]
        r2 = turn @ r1 @ halves[2 * k + 1]
        a0, a1, a2 = r @ f0[k] + gravity, r1 @ f1[k] + gravity, r2 @ f2[k] + gravity
        k1 = a0 - 2 * np.cross(earth, v)
        k2 = a1 - 2 * np.cross(earth, v + h / 2 * k1)
        k3 = a1 - 2 * np.cross(earth, v + h / 2 * k2)
        k4 = a2 - 2 * np.cross(earth, v + h * k3)
        p = p + h * v + h**2 / 6 * (k1 + k2 + k3)
        v = v + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        r = r2
    return r, v, p


def _magnus(rate_b: Signal, start_s: np.ndarray, h: float) -> np.ndarray:
    """Rotation vectors of steps of length h, fourth order."""
    offset = np.sqrt(3) / 6 * h
    w1, w2 = rate_b(start_s + h / 2 - offset), rate_b(start_s + h / 2 + offset)
    return h / 2 * (w1 + w2) - np.sqrt(3) / 12 * h**2 * np.cross(w2, w1)
