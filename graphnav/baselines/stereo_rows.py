"""What stereo odometry tells the filter: a chained pose, or one motion between two poses; whitened rows.

Errors are those of `states`: truth less estimate, the misalignment a rotation of n, ``R_true = Exp(phi) R``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors import mounted_motion, so3
from factors.relative_pose import Motions
from factors.so3 import Array
from graphnav.baselines.measurements import Rows
from graphnav.baselines.states import PHI, POS

#: States of the inertial navigation, and with the copy of an earlier pose behind them: its misalignment and position.
INERTIAL, WITH_CLONE = 15, 21
CLONE_PHI, CLONE_POS = slice(15, 18), slice(18, 21)
ATTITUDE, POSITION = range(2)


@dataclass(frozen=True)
class Place:
    """A pose of the body: rotation_nb (3, 3), pos_n (3,)."""

    rotation_nb: Array
    pos_n: Array

    @property
    def matrix(self) -> Array:
        """(1, 4, 4), as the residuals of `factors` take a pose."""
        out = np.eye(4)
        out[:3, :3], out[:3, 3] = self.rotation_nb, self.pos_n
        return out[None]

    def corrected(self, phi: Array, dp: Array) -> Place:
        """With its errors (3,), (3,) taken out."""
        return Place(so3.exp(phi) @ self.rotation_nb, self.pos_n + dp)

    def moved(self, rotation: Array, pos: Array) -> Place:
        """After a motion (3, 3), (3,): equation 16, for the pose of the body in n."""
        return Place(self.rotation_nb @ rotation, self.pos_n + self.rotation_nb @ pos)


def chained_rows(chained: Place, here: Place, attitude_sigma_rad: float, position_sigma_m: float) -> Rows:
    """Attitude and position of the chain less the inertial ones (equation 26), which the errors are: H is one (27)."""
    turn = so3.log(chained.rotation_nb @ here.rotation_nb.T)
    h = np.zeros((6, INERTIAL))
    h[:3, PHI], h[3:, POS] = np.eye(3) / attitude_sigma_rad, np.eye(3) / position_sigma_m
    return _rows(h, np.concatenate([turn / attitude_sigma_rad, (chained.pos_n - here.pos_n) / position_sigma_m]))


def motion_rows(start: Place, here: Place, rotation: Array, pos: Array, cov: Array) -> Rows:
    """A motion (3, 3), (3,) of the body with its covariance (6, 6), between the copied pose and this one.

    The graph's own `mounted_motion.residual`; its derivatives are by right perturbations.
    """
    measured = Motions(rotation[None], pos[None], cov[None])
    error, by_start, by_here, _ = mounted_motion.residual(
        start.matrix, here.matrix, np.zeros((1, 6)), np.eye(3), np.zeros(3), measured
    )
    h = np.zeros((6, WITH_CLONE))
    to_start, to_here = start.rotation_nb.T, here.rotation_nb.T
    h[:, CLONE_PHI], h[:, CLONE_POS] = by_start[0, :, :3] @ to_start, by_start[0, :, 3:] @ to_start
    h[:, PHI], h[:, POS] = by_here[0, :, :3] @ to_here, by_here[0, :, 3:] @ to_here
    root = np.linalg.cholesky(cov)
    return _rows(np.linalg.solve(root, h), np.linalg.solve(root, -error[0]))


def _rows(h: Array, z: Array) -> Rows:
    return Rows(h, z, np.zeros(6, np.int64), np.repeat([ATTITUDE, POSITION], 3))
