"""Solutions that nothing corrects: pure inertial navigation and dead reckoning, each told somebody's calibration."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.papers._judged import Array


def pure_inertial(problem: Any, log: Any, gyro_bias_b: Array, accel_bias_b: Array, until_s: float) -> Array:
    """Error (T, 3) at every second of strapdown navigation from the true state at the start of the log (figure 11).

    It starts at the truth, so that what remains is the error of the biases and the white noise.

    Parameters
    ----------
    problem : posed; log : the same log with its truth; gyro_bias_b, accel_bias_b : (3,), rad/s and m/s^2.
    """
    from factors.so3 import from_quaternion
    from graphnav._metrics import truth_states
    from graphnav.baselines import strapdown

    start = float(problem.keyframe_s[0])
    t_s = start + np.arange(1.0, until_s + 0.5)
    _, pos, quat, vel = truth_states(log.truth, np.concatenate([[start], t_s]))
    rotations, velocities, positions = np.empty((len(t_s), 3, 3)), np.empty((len(t_s), 3)), np.empty((len(t_s), 3))
    blocks, force = np.empty((len(t_s), strapdown.BLOCKS, 3, 3)), np.empty((len(t_s), 3))
    samples = problem.imu.samples
    strapdown.advance(
        samples.edge_s, samples.gyro_b, samples.accel_b, start, t_s, from_quaternion(quat[:1])[0], vel[0], pos[0],
        gyro_bias_b, accel_bias_b, problem.gravity_m_s2, problem.earth_rate_n, False,
        rotations, velocities, positions, blocks, force,
    )  # fmt: skip
    return np.asarray(positions - pos[1:])


def reckoned(problem: Any, gyro_bias_b: Array, calibration: Array) -> Any:
    """Dead reckoning with a gyro bias (3,) and odometer calibration (4,) taken out beforehand (figure 13).

    It starts at the attitude that levelling at rest gives, with the declared heading.
    """
    from factors.so3 import to_quaternion
    from graphnav.baselines import dead_reckoning as dr
    from graphnav.filtered import as_inputs
    from graphnav.trajectory import Trajectory

    inputs = as_inputs(problem)
    rotation, _ = dr.at_rest(inputs)
    track = dr.traditional(inputs, rotation, dr.Compensation(gyro_bias_b, calibration), problem.minor_s)
    return Trajectory(problem.keyframe_s, track.pos_n, to_quaternion(track.rotation_nb), track.vel_n)


def smoothed(problem: Any, **changes: Any) -> Any:
    """The online RTS smoother with the matched preset but for some of its settings; a trajectory."""
    return _trajectory(problem, "smoothed_online", changes)


def smoothed_whole(problem: Any, **changes: Any) -> Any:
    """The same over the whole log."""
    return _trajectory(problem, "smoothed", changes)


def _trajectory(problem: Any, smoother: str, changes: dict[str, Any]) -> Any:
    from graphnav.baselines import rts
    from graphnav.baselines.inputs import Preset
    from graphnav.filtered import as_inputs
    from graphnav.trajectory import Trajectory

    estimates, _ = getattr(rts, smoother)(as_inputs(problem), Preset(**changes))
    quat, cov = estimates.house()
    return Trajectory(problem.keyframe_s, estimates.pos_n, quat, estimates.vel_n, cov)
