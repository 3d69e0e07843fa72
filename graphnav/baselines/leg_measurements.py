"""The paper's measurement of a leg, linearized in the states of its filter, and the linear steps with legs; compiled.

Zheng et al. (INS/LiDAR), equations 11 and 19-24, from `factors.landmark.point_residual`. The filter's states are the
first 15 of `states` and three for the place of each of N legs; errors are truth less estimate. A leg comes into use by
equation 11, and its error then is what the same measurement says: ``0 = E_x dx + E_m dm - noise``, solved for dm.
"""

from __future__ import annotations

import numpy as np

from factors import landmark
from factors.increments import npt_int
from factors.so3 import Array
from graphnav.baselines._compiled import compiled
from graphnav.baselines.kalman import predict, transition, update
from graphnav.baselines.states import PHI, POS

#: States of the inertial navigation (equation 12); a leg's three follow, leg by leg.
INERTIAL = 15
#: Names of the rows of a leg's measurement.
KINDS = ("leg range", "leg bearing", "leg height")


def leg(column: int) -> slice:
    """States of the leg in a column."""
    return slice(INERTIAL + 3 * column, INERTIAL + 3 * column + 3)


def leg_rows(
    rotation_nb: Array,
    pos_n: Array,
    place_n: Array,
    range_m: Array,
    angle_rad: Array,
    sigma: Array,
    rotation_bs: Array,
    lever_arm_b: Array,
) -> tuple[Array, Array]:
    """Whitened measurement rows of N legs at E epochs.

    Parameters
    ----------
    rotation_nb, pos_n : (E, 3, 3) and (E, 3) nominal poses; place_n : (E, N, 3) nominal places of the legs.
    range_m, angle_rad : (E, N) readings.
    sigma : (3,) of range (m), bearing (rad) and height (m).

    Returns
    -------
    h (E, N, 3, 15 + 3 N) and z (E, N, 3).
    """
    count = range_m.shape[1]
    rotation = np.broadcast_to(rotation_nb[:, None], (*range_m.shape, 3, 3))
    pos = np.broadcast_to(pos_n[:, None], place_n.shape)
    error, by_pose, by_place, _ = landmark.point_residual(
        rotation, pos, place_n, np.zeros(8), range_m, angle_rad, rotation_bs, lever_arm_b
    )
    to_b = np.swapaxes(rotation, -1, -2)
    h = np.zeros((*range_m.shape, 3, INERTIAL + 3 * count))
    h[..., PHI] = by_pose[..., :3] @ to_b
    h[..., POS] = by_pose[..., 3:] @ to_b
    for j in range(count):
        h[:, j, :, leg(j)] = by_place[:, j]
    return h / sigma[:, None], -error / sigma


@compiled
def absorb(h: Array, column: int, x: Array, p: Array) -> None:
    """A leg comes into use: mean and covariance of its place, in place, from its first whitened rows (3, n)."""
    n, first = len(x), 15 + 3 * column
    inverse = np.linalg.inv(np.ascontiguousarray(h[:, first : first + 3]))
    gain = -inverse @ np.ascontiguousarray(h[:, :15])
    for i in range(3):
        for j in range(n):
            p[first + i, j] = p[j, first + i] = 0.0
    noise = inverse @ inverse.T
    cross = gain @ np.ascontiguousarray(p[:15])
    own = np.ascontiguousarray(cross[:, :15]) @ gain.T + noise
    x[first : first + 3] = gain @ x[:15]
    p[first : first + 3] = cross
    p[:, first : first + 3] = cross.T
    p[first : first + 3, first : first + 3] = own


@compiled
def interval(
    blocks: Array, noise: Array, h: Array, z: Array, status: npt_int, x: Array, p: Array, innovation: Array,
    variance: Array,
) -> None:  # fmt: skip
    """All epochs between two keyframes: time updates, and at each epoch the legs that come into use or are measured.

    Parameters
    ----------
    blocks : (E, 10, 3, 3) transitions; noise : (E, n, n) process noise.
    h, z : (E, N, 3, n) and (E, N, 3) from `leg_rows`; status : (E, N) of `leg_choice`.
    x, p : error state (n,) and covariance (n, n), updated in place.
    innovation, variance : outputs (E, N, 3); untouched where nothing was measured.
    """
    for e in range(len(blocks)):
        predict(transition(blocks[e]), noise[e], x, p)
        for j in range(status.shape[1]):
            if status[e, j] == 1:
                absorb(h[e, j], j, x, p)
            elif status[e, j] == 2:
                for k in range(3):
                    innovation[e, j, k], variance[e, j, k], _ = update(h[e, j, k], z[e, j, k], x, p)
