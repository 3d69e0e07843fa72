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
    step = relative(turned[:-1], moved[:-1], turned[1:], moved[1:])
    noise = chain.between(t_s).cov
    own = _own_covariances(step, noise, initial, start)
    span = np.diff(t_s)[:, None]
    vel = np.diff(pos, axis=0) / span
    cov = _house(rotation, own, step[1], step[0], noise, span)
    return Trajectory(t_s, pos, to_quaternion(rotation), np.concatenate([vel, vel[-1:]]), cov, chain)


def _own_covariances(step: tuple[Array, Array], noise: Array, initial: InitialState, start: Array) -> Array:
    """(N, 6, 6) of the poses' right perturbations."""
    out = np.zeros((len(noise) + 1, 6, 6))
    out[0, :3, :3] = np.diag(np.radians(initial.att_sigma_deg) ** 2)
    out[0, 3:, 3:] = start.T @ np.diag(initial.pos_sigma_m**2) @ start
    back = so3.transpose(step[0])
    carry = adjoint(back, -(back @ step[1][..., None])[..., 0])
    for k in range(len(noise)):
        out[k + 1] = carry[k] @ out[k] @ carry[k].T + noise[k]
    return out


def _house(rotation: Array, own: Array, way: Array, turn: Array, noise: Array, span_s: Array) -> Array:
    """(N, 9, 9): attitude, position in n and mean velocity, ``v = R t / dt`` with the motion's t and its noise."""
    by_pose = np.zeros((len(own), 9, 6))
    by_pose[:, :3, :3], by_pose[:, 3:6, 3:] = np.eye(3), rotation
    by_pose[:-1, 6:, :3] = -rotation[:-1] @ so3.skew(way / span_s)
    cov = by_pose @ own @ so3.transpose(by_pose)
    by_motion = rotation[:-1] @ turn / span_s[..., None]
    cov[:-1, 6:, 6:] += by_motion @ noise[:, 3:, 3:] @ so3.transpose(by_motion)
    # the last mean velocity is that of the interval before it
    cov[-1, 6:, 6:] = cov[-2, 6:, 6:]
    return np.asarray(cov)
