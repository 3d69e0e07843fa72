"""The linear core: Kalman filter steps, and what a backward pass needs of them; compiled.

Forward: Zheng et al. (2021), equation 28, row by row in Joseph's form. Backward: the smoother of equations 30-31 in
the form of G. Bierman, "Fixed interval smoothing with discrete measurements", Int. J. Control 18 (1973): with the
adjoint ``l_k`` gathered from later innovations, ``x_k|N = x_k|k + P_k|k l_k`` and
``P_k|N = P_k|k - P_k|k L_k P_k|k``. It is the same estimate, without the inverse of ``P_{k+1|k}`` in equation 31, which
rest and constants make nearly singular; and because the adjoint is linear, what all epochs between two keyframes do to
it is kept as one map (docs/decisions/0007).
"""

from __future__ import annotations

import numpy as np

from factors.increments import npt_int
from factors.so3 import Array
from graphnav.baselines._compiled import compiled

#: State of each block of `strapdown.BLOCKS`: first row, first column.
_ROWS = (3, 3, 0, 0, 0, 0, 6, 6, 6, 6)
_COLUMNS = (3, 9, 3, 0, 9, 12, 3, 0, 9, 12)


@compiled
def transition(blocks: Array) -> Array:
    """Transition matrix (19, 19) from its blocks (10, 3, 3)."""
    phi = np.eye(19)
    for n in range(10):
        for i in range(3):
            for j in range(3):
                phi[_ROWS[n] + i, _COLUMNS[n] + j] = blocks[n, i, j]
    return phi


@compiled
def times_rows(phi: Array, m: Array) -> None:
    """``m <- phi m`` in place; only the first nine rows of phi differ from the identity, and only up to column 15."""
    columns = m.shape[1]
    out = np.zeros((9, columns))
    for i in range(9):
        for k in range(15):
            f = phi[i, k]
            if f != 0.0:
                for j in range(columns):
                    out[i, j] += f * m[k, j]
    m[:9] = out


@compiled
def predict(phi: Array, q: Array, x: Array, p: Array) -> None:
    """Time update of mean and covariance, in place: ``x <- phi x``, ``P <- phi P phi' + Q``.

    Parameters
    ----------
    phi : (19, 19); q, p : (n, n); x : (n,), the first 15 of them those of `states`.
    """
    n = len(x)
    mean = np.zeros(9)
    for i in range(9):
        for k in range(15):
            mean[i] += phi[i, k] * x[k]
    x[:9] = mean
    times_rows(phi, p)
    half = p.T.copy()
    times_rows(phi, half)
    for i in range(n):
        for j in range(i, n):
            value = (half[i, j] + half[j, i]) * 0.5 + q[i, j]
            p[i, j] = value
            p[j, i] = value


@compiled
def update(h: Array, z: float, x: Array, p: Array) -> tuple[float, float, Array]:
    """One whitened scalar measurement ``z = h x + e``, e of unit variance, in place.

    Returns
    -------
    innovation, its variance, and the gain (n,).
    """
    n = len(x)
    ph = np.zeros(n)
    for i in range(n):
        for j in range(n):
            ph[i] += p[i, j] * h[j]
    variance, expected = 1.0, 0.0
    for i in range(n):
        variance += h[i] * ph[i]
        expected += h[i] * x[i]
    innovation = z - expected
    gain = ph / variance
    # Joseph's form: (I - K h) P (I - K h)' + K K', never less than positive
    for i in range(n):
        x[i] += gain[i] * innovation
        for j in range(i, n):
            value = p[i, j] - gain[i] * ph[j] - ph[i] * gain[j] + gain[i] * gain[j] * variance
            p[i, j] = value
            p[j, i] = value
    return innovation, variance, gain


@compiled
def interval(
    blocks: Array, noise: Array, rows: Array, row_epoch: npt_int, z: Array, x: Array, p: Array,
    innovation: Array, variance: Array, smoothing: bool, a: Array, c: Array, big_c: Array,
) -> None:  # fmt: skip
    """All epochs between two keyframes: time updates, measurements, and the map of the adjoint over them.

    Parameters
    ----------
    blocks : (E, 10, 3, 3) transitions; noise : (E, 19, 19) process noise.
    rows : (M, 19) whitened measurement rows in order of `row_epoch` (M,); z : (M,) whitened measurements.
    x, p : error state and covariance, updated in place.
    innovation, variance : outputs (M,).
    smoothing : whether to fill a, c and big_c: ``l_start = c + a' l_end``, ``L_start = big_c + a' L_end a``.
    """
    if smoothing:
        a[:] = np.eye(19)
        c[:] = 0.0
        big_c[:] = 0.0
    m = 0
    for e in range(len(blocks)):
        phi = transition(blocks[e])
        predict(phi, noise[e], x, p)
        if smoothing:
            times_rows(phi, a)
        while m < len(z) and row_epoch[m] == e:
            innovation[m], variance[m], gain = update(rows[m], z[m], x, p)
            if smoothing:
                absorb(rows[m], innovation[m], variance[m], gain, a, c, big_c)
            m += 1


@compiled
def absorb(h: Array, innovation: float, variance: float, gain: Array, a: Array, c: Array, big_c: Array) -> None:
    """A measurement's part in the adjoint's map, in place."""
    n = len(h)
    seen = np.zeros(n)
    for k in range(n):
        if h[k] != 0.0:
            for i in range(n):
                seen[i] += a[k, i] * h[k]
    for i in range(n):
        c[i] += seen[i] * innovation / variance
        for j in range(n):
            big_c[i, j] += seen[i] * seen[j] / variance
            a[i, j] -= gain[i] * seen[j]


@compiled
def backward(
    a: Array, c: Array, big_c: Array, p: Array, adjoint: Array, big_adjoint: Array
) -> tuple[Array, Array, Array, Array]:
    """One keyframe back: the adjoint over the interval, and the smoothed error and covariance at its start.

    Parameters
    ----------
    a, c, big_c : the interval's map; p : (19, 19) filtered covariance at its start.
    adjoint, big_adjoint : (19,) and (19, 19) at its end.

    Returns
    -------
    adjoint and big_adjoint at the start; smoothed error (19,) and covariance (19, 19).
    """
    before = c + a.T @ adjoint
    big = big_c + a.T @ (big_adjoint @ a)
    big = (big + big.T) * 0.5
    smoothed = p - p @ (big @ p)
    return before, big, p @ before, (smoothed + smoothed.T) * 0.5


@compiled
def process_noise(
    force_n: Array, dt_s: Array, gyro_density: Array, accel_density: Array, walks: Array, resting: bool, out: Array
) -> None:
    """Discrete process noise of each epoch for white gyro and accelerometer noise and a constant force (E, n, n).

    The integral of ``Phi(s) G q G' Phi(s)'`` over the epoch, with attitude noise seen in velocity and position through
    the specific force; walks : (n,) random-walk variances per second of every state, besides.
    """
    out[:] = 0.0
    for e in range(len(dt_s)):
        t = dt_s[e]
        g = 0.0 if resting else gyro_density[e] ** 2
        a = accel_density[e] ** 2
        f = force_n[e]
        square = f[0] * f[0] + f[1] * f[1] + f[2] * f[2]
        q = out[e]
        for i in range(3):
            q[3 + i, 3 + i] = g * t
            q[i, i] = a * t
            q[i, 6 + i] = q[6 + i, i] = a * t * t / 2.0
            q[6 + i, 6 + i] = a * t**3 / 3.0
            for j in range(3):
                # -[f]x and [f]x [f]x' = f'f I - f f'
                lever = 0.0
                if i != j:
                    other = 3 - i - j
                    lever = f[other] if (j - i) % 3 == 1 else -f[other]
                outer = (square if i == j else 0.0) - f[i] * f[j]
                q[i, 3 + j] += g * lever * t * t / 2.0
                q[3 + j, i] += g * lever * t * t / 2.0
                q[6 + i, 3 + j] += g * lever * t**3 / 6.0
                q[3 + j, 6 + i] += g * lever * t**3 / 6.0
                q[i, j] += g * outer * t**3 / 3.0
                q[i, 6 + j] += g * outer * t**4 / 8.0
                q[6 + j, i] += g * outer * t**4 / 8.0
                q[6 + i, 6 + j] += g * outer * t**5 / 20.0
        for i in range(len(walks)):
            q[i, i] += walks[i] * t
