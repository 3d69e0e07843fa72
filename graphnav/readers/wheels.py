"""Motion of a robot on wheels or tracks as the table `relative_pose`: planar steps, held to the floor."""

from __future__ import annotations

import numpy as np

from factors import so3
from factors.relative_pose import Motions, seen_from
from graphnav._schema import Array
from graphnav.frontends.motion_chain import camera_mounting
from graphnav.log import RelativePose

#: Wheels stay on the floor: what a motion may rise or tilt, a random walk of a few millimetres and tenths of a degree
#: over thousands of them. Above zero, so that every direction has an error of its own.
FLOOR_M, FLOOR_RAD = 1e-4, 1e-4
_UPPER = np.triu_indices(6)


def wheel_motions(
    t_s: Array,
    forward_m: Array,
    turn_rad: Array,
    *,
    sigma_forward_m: Array | float,
    sigma_side_m: Array | float,
    sigma_turn_rad: Array | float,
    axle_b_m: Array | tuple[float, float, float] = (0.0, 0.0, 0.0),
    yaw_rad: float = 0.0,
) -> RelativePose:
    """Motions of the body along arcs, in the log format's default camera axes.

    Parameters
    ----------
    t_s : (M+1,) s; forward_m, turn_rad : (M,) way along the arc and turn counter-clockwise between these times.
    sigma_forward_m, sigma_side_m, sigma_turn_rad : (M,) or common, of the axle's motion.
    axle_b_m : (3,) the middle of the axle, which does not move sideways, in b.
    yaw_rad : direction in which the wheels roll, counter-clockwise from b's forward axis.
    """
    count = len(forward_m)
    turn = np.column_stack([np.zeros((count, 2)), turn_rad])
    chord = np.column_stack([np.zeros(count), forward_m, np.zeros(count)])
    sigma = np.empty((count, 6))
    sigma[:, :2], sigma[:, 5] = FLOOR_RAD, FLOOR_M
    sigma[:, 2], sigma[:, 3], sigma[:, 4] = sigma_turn_rad, sigma_side_m, sigma_forward_m
    of_axle = Motions(
        so3.exp(turn), (so3.left_jacobian(turn) @ chord[..., None])[..., 0], sigma[:, :, None] ** 2 * np.eye(6)
    )
    rotation_bc, pos_bc = camera_mounting(None)
    of_body = seen_from(of_axle, so3.exp(np.array([0.0, 0.0, yaw_rad])), np.asarray(axle_b_m, float))
    of_camera = seen_from(of_body, rotation_bc.T, -rotation_bc.T @ pos_bc)
    return RelativePose(
        t_from_s=t_s[:-1],
        t_to_s=t_s[1:],
        pos_m=of_camera.pos,
        quat=so3.to_quaternion(of_camera.rotation),
        cov_upper=of_camera.cov[:, _UPPER[0], _UPPER[1]],
    )


def upright(yaw_rad: Array) -> Array:
    """Quaternions (N, 4) of turns about up; zero looks north."""
    zero = np.zeros(len(yaw_rad))
    return np.column_stack([np.cos(yaw_rad / 2), zero, zero, np.sin(yaw_rad / 2)])
