"""The paper's measurement: the squared range, less its square from the inertial position; and the steps with it.

Cao et al., "Research on shearer positioning experiment based on IMU and UWB", Coal Sci. Technol. 51(6) (2023) 217,
equations 20-25; the graph's own measurement is the range itself. The paper's errors are estimate less truth, here they
are truth less estimate (`states`), and the tag may sit beside the IMU: its true place is ``t + dp + phi x (R l)``. Its
term in the square of the range error is left out, as there: it is 1 % of the noise at three metres. Compiled.
"""

from __future__ import annotations

import numpy as np

from factors.increments import npt_int
from factors.so3 import Array
from graphnav.baselines._compiled import compiled
from graphnav.baselines.kalman import predict, transition, update
from graphnav.baselines.strapdown import cross

#: States: velocity, attitude, position, gyro and accelerometer biases, in the order of `states`.
INERTIAL = 15


@compiled
def squared_range(
    tag_n: Array, lever_n: Array, anchor_n: Array, range_m: float, x: Array, h: Array
) -> float:  # fmt: skip
    """Measured less predicted square of a range (m^2) at the error ``x`` (15,), and its derivative in ``h`` (15,).

    Equations 22 and 25: the derivative is taken at the error known so far, so that the second-order term counts.

    Parameters
    ----------
    tag_n, lever_n : (3,) nominal place of the tag and of the lever arm ``R l``, in n; anchor_n : (3,).
    """
    apart = tag_n + x[6:9] + cross(x[3:6], lever_n) - anchor_n
    h[:] = 0.0
    h[6:9] = 2.0 * apart
    h[3:6] = 2.0 * cross(lever_n, apart)
    gap: float = range_m * range_m - (apart[0] * apart[0] + apart[1] * apart[1] + apart[2] * apart[2])
    return gap


@compiled
def decayed(keep: Array, x: Array, p: Array) -> None:
    """First-order Gauss-Markov biases over an epoch, in place: equation 9; keep : (6,) what stays of each bias."""
    for i in range(6):
        x[9 + i] *= keep[i]
        for j in range(15):
            p[9 + i, j] *= keep[i]
            p[j, 9 + i] *= keep[i]


@compiled
def interval(
    blocks: Array, noise: Array, keep: Array,
    range_epoch: npt_int, tag_n: Array, lever_n: Array, anchor_n: Array, range_m: Array, sigma_m: Array, gate: float,
    rows: Array, row_epoch: npt_int, z: Array,
    x: Array, p: Array, innovation: Array, variance: Array, row_innovation: Array, row_variance: Array,
) -> None:  # fmt: skip
    """All epochs between two keyframes: time updates, ranges and other measurements, each at its own time.

    Parameters
    ----------
    blocks : (E, 10, 3, 3) transitions; noise : (E, 15, 15); keep : (E, 6) as in `decayed`.
    range_epoch, range_m, sigma_m : (M,); tag_n, lever_n, anchor_n : (M, 3); in order of their epochs.
    gate : ranges whose innovation is beyond this many sigmas are left out, their variance told as negative.
    rows, row_epoch, z : (K, 15), (K,), (K,) whitened rows besides.
    x, p : error state and covariance, updated in place; the last four : outputs, in sigmas of the noise.
    """
    h = np.empty(15)
    m, k = 0, 0
    for e in range(len(blocks)):
        predict(transition(blocks[e])[:15, :15].copy(), noise[e], x, p)
        decayed(keep[e], x, p)
        while m < len(range_m) and range_epoch[m] == e:
            gap = squared_range(tag_n[m], lever_n[m], anchor_n[m], range_m[m], x, h)
            sigma = 2.0 * range_m[m] * sigma_m[m]
            white, seen = h / sigma, gap / sigma
            expected = 1.0 + white @ (p @ white)
            innovation[m], variance[m] = seen, expected
            if seen * seen > gate * gate * expected:
                variance[m] = -expected
            else:
                update(white, seen + white @ x, x, p)
            m += 1
        while k < len(z) and row_epoch[k] == e:
            row_innovation[k], row_variance[k], _ = update(rows[k], z[k], x, p)
            k += 1


def warm_up() -> None:
    """Compile the loop, or load it compiled, so that a first run is not timed with it."""
    none, no_rows, nowhere = np.empty(0), np.empty(0, np.int64), np.empty((0, 3))
    # a log's arrays are read-only
    none.flags.writeable = False
    interval(
        np.zeros((1, 10, 3, 3)), np.zeros((1, 15, 15)), np.ones((1, 6)), no_rows, nowhere, nowhere, nowhere, none,
        np.empty(0), np.inf, np.empty((0, 15)), no_rows, np.empty(0), np.zeros(15), np.eye(15), np.empty(0),
        np.empty(0), np.empty(0), np.empty(0),
    )  # fmt: skip
