"""Relative poses: the motion of a body between two times, as wheels or a camera measure it.

A chain of motions that follow each other is the counterpart of the IMU's samples: `Chain.between` condenses it to one
motion with covariance from keyframe to keyframe, whatever their times, and `between_factor` ties two poses with it.

Covariances are those of the right perturbation ``T = measured Exp(e)``, rotation before translation, rad and m. Within
a motion the velocity is taken as constant and its error as white: a part of a motion has that part of its covariance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from factors import so3
from factors.increments import npt_int
from factors.so3 import Array

if TYPE_CHECKING:
    import gtsam


@dataclass(frozen=True)
class Motions:
    """K motions ``T_from_to``: rotation (K, 3, 3), pos (K, 3) m, cov (K, 6, 6)."""

    rotation: Array
    pos: Array
    cov: Array


@dataclass(frozen=True)
class Chain:
    """Motions that follow each other without a gap.

    Attributes
    ----------
    t_s : (M+1,) times between which they were measured.
    rotation, pos : (M+1, 3, 3), (M+1, 3) poses at these times as seen from the first.
    cov : (M, 6, 6) of each motion.
    """

    t_s: Array
    rotation: Array
    pos: Array
    cov: Array

    @classmethod
    def of(cls, t_s: Array, motions: Motions) -> Chain:
        """Put motions one behind the other; t_s (M+1,)."""
        count = len(motions.pos)
        rotation, pos = np.empty((count + 1, 3, 3)), np.zeros((count + 1, 3))
        rotation[0] = np.eye(3)
        for k in range(count):
            rotation[k + 1] = rotation[k] @ motions.rotation[k]
            pos[k + 1] = pos[k] + rotation[k] @ motions.pos[k]
        return cls(t_s, rotation, pos, motions.cov)

    def at(self, t_s: Array) -> tuple[Array, Array]:
        """Poses (N, 3, 3), (N, 3) at times within the chain, as seen from its first."""
        k = self._motion(t_s)
        share = ((t_s - self.t_s[k]) / (self.t_s[k + 1] - self.t_s[k]))[:, None]
        rotation, pos = relative(self.rotation[k], self.pos[k], self.rotation[k + 1], self.pos[k + 1])
        turn = so3.log(rotation)
        rate = np.linalg.solve(so3.left_jacobian(turn), pos[..., None])
        moved = (so3.left_jacobian(share * turn) @ (share[..., None] * rate))[..., 0]
        return self.rotation[k] @ so3.exp(share * turn), self.pos[k] + _rotated(self.rotation[k], moved)

    def between(self, t_s: Array) -> Motions:
        """Motions from each time to the next: t_s (N,) ascending, within the chain; N-1 motions."""
        rotation, pos = self.at(t_s)
        motion = relative(rotation[:-1], pos[:-1], rotation[1:], pos[1:])
        # the pieces into which both the keyframes and the motions' own ends divide the chain
        inside = self.t_s[(self.t_s > t_s[0]) & (self.t_s < t_s[-1])]
        edge = np.union1d(t_s, inside)
        owner = np.searchsorted(t_s, edge[:-1], side="right") - 1
        k = self._motion((edge[1:] + edge[:-1]) / 2)
        share = np.diff(edge) / (self.t_s[k + 1] - self.t_s[k])
        end_rotation, end_pos = self.at(edge[1:])
        to_piece = relative(rotation[owner + 1], pos[owner + 1], end_rotation, end_pos)
        carried = adjoint(*to_piece)
        cov = np.zeros((len(t_s) - 1, 6, 6))
        np.add.at(cov, owner, carried @ (share[:, None, None] * self.cov[k]) @ so3.transpose(carried))
        return Motions(*motion, cov)

    def _motion(self, t_s: Array) -> npt_int:
        return np.clip(np.searchsorted(self.t_s, t_s, side="right") - 1, 0, len(self.t_s) - 2)


def relative(rotation_i: Array, pos_i: Array, rotation_j: Array, pos_j: Array) -> tuple[Array, Array]:
    """``T_i^-1 T_j`` of poses (..., 3, 3), (..., 3)."""
    back = so3.transpose(rotation_i)
    return back @ rotation_j, _rotated(back, pos_j - pos_i)


def adjoint(rotation: Array, pos: Array) -> Array:
    """(..., 6, 6): ``T Exp(e) T^-1 = Exp(Ad e)``, rotation before translation."""
    out = np.zeros((*pos.shape[:-1], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = rotation
    out[..., 3:, :3] = so3.skew(pos) @ rotation
    return out


def seen_from(motions: Motions, rotation_bc: Array, pos_bc: Array) -> Motions:
    """Motions of a body from those of a camera (or wheels) c that is fixed to it: ``T_bc T T_bc^-1``."""
    rotation = rotation_bc @ motions.rotation @ rotation_bc.T
    pos = pos_bc + motions.pos @ rotation_bc.T - rotation @ pos_bc
    carried = adjoint(rotation_bc, pos_bc)
    return Motions(rotation, pos, carried @ motions.cov @ carried.T)


def between_factor(key_i: int, key_j: int, rotation: Array, pos: Array, cov: Array) -> gtsam.NonlinearFactor:
    """A measured motion between two poses, ``e = Log(measured^-1 T_i^-1 T_j)`` (native `BetweenFactorPose3`).

    Parameters
    ----------
    rotation, pos, cov : (3, 3), (3,) m and (6, 6), positive definite.
    """
    import gtsam

    noise = gtsam.noiseModel.Gaussian.Covariance(cov, False)  # never "smart": see factors.noise
    return gtsam.BetweenFactorPose3(key_i, key_j, gtsam.Pose3(gtsam.Rot3(rotation), pos), noise)


def _rotated(rotation: Array, vectors: Array) -> Array:
    out: Array = (rotation @ vectors[..., None])[..., 0]
    return out
