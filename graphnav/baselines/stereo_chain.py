"""Stereo odometry alone: its motions laid at the initial pose, one behind the other, with covariances.

Equation 16 of the roadheader VIO paper, ``T_{k+1} = T_{k+1,k} T_k``, for the pose of the body in n; the paper carries
no covariance along. Errors are right perturbations: ``P' = Ad(T^-1) P Ad(T^-1)' + Q`` with the motion T and its Q.
"""

from __future__ import annotations

import numpy as np

from factors import so3
from factors.relative_pose import Chain, adjoint, relative
from factors.so3 import Array, from_quaternion, to_quaternion
from graphnav.log import InitialState
from graphnav.trajectory import Trajectory


def laid(chain: Chain, initial: InitialState, t_s: Array) -> Trajectory:
    """The chain from the initial pose on, at times t_s (N,) within it.

    Velocities are the mean ones up to the next time, as from any chain of motions.
    """
    turned, moved = chain.at(t_s)
    start = from_quaternion(initial.quat_nb_wxyz)
    rotation, pos = start @ turned, initial.pos_n_m + moved @ start.T
    turn, way = relative(turned[:-1], moved[:-1], turned[1:], moved[1:])
    span = np.diff(t_s)[:, None]
    vel = np.diff(pos, axis=0) / span
    back = so3.transpose(turn)
    carry = adjoint(back, -(back @ way[..., None])[..., 0])
    noise = chain.between(t_s).cov
    own = _own_covariances(carry, noise, initial, start)
    by_pose, by_noise = _derivatives(rotation, turn, way / span, span[..., None])
    cov = np.empty((len(own), 9, 9))
    cov[:-1] = _sandwich(by_pose[:-1], own[:-1]) + _sandwich(by_noise, noise)
    # the last state: the pose after the last motion, and the mean velocity of the interval before it
    after, by_last = by_pose[-1] @ carry[-1], by_pose[-1].copy()
    after[6:], by_last[6:] = by_pose[-2, 6:], by_noise[-1, 6:]
    cov[-1] = _sandwich(after, own[-2]) + _sandwich(by_last, noise[-1])
    return Trajectory(t_s, pos, to_quaternion(rotation), np.concatenate([vel, vel[-1:]]), cov, chain)


def _own_covariances(carry: Array, noise: Array, initial: InitialState, start: Array) -> Array:
    """(N, 6, 6) of the poses' right perturbations."""
    out = np.zeros((len(noise) + 1, 6, 6))
    out[0, :3, :3] = np.diag(np.radians(initial.att_sigma_deg) ** 2)
    out[0, 3:, 3:] = start.T @ np.diag(initial.pos_sigma_m**2) @ start
    for k in range(len(noise)):
        out[k + 1] = carry[k] @ out[k] @ carry[k].T + noise[k]
    return out


def _derivatives(rotation: Array, turn: Array, vel_b: Array, span_s: Array) -> tuple[Array, Array]:
    """Of attitude, position in n and velocity ``v = R t / dt``: by the pose (N, 9, 6), by the motion (N-1, 9, 6)."""
    by_pose, by_noise = np.zeros((len(rotation), 9, 6)), np.zeros((len(turn), 9, 6))
    by_pose[:, :3, :3], by_pose[:, 3:6, 3:] = np.eye(3), rotation
    by_pose[:-1, 6:, :3] = -rotation[:-1] @ so3.skew(vel_b)
    by_noise[:, 6:, 3:] = rotation[:-1] @ turn / span_s
    return by_pose, by_noise


def _sandwich(by: Array, cov: Array) -> Array:
    return np.asarray(by @ cov @ np.swapaxes(by, -1, -2))
