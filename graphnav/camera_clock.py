"""The camera's clock: where the body was, and how it moved, when an image was taken that is stamped otherwise."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from factors import so3
from factors.carried import Moments
from graphnav.camera import Camera, uses_camera
from graphnav.outcome import smoothed_trajectory
from graphnav.problem import B, E, Problem, X

if TYPE_CHECKING:
    import gtsam

#: Rounds of a solve in which it may settle: half of a tenth of a second is found in the first.
CLOCK_ROUNDS = 8
#: The gyro's rate at a time is its mean over so much before and after, s.
_AROUND_S = 0.02
#: A clock this near to the one along which it was found is settled, s.
_SETTLED_S = 1e-3
#: What the user should know of one that did not settle.
UNSETTLED = "the camera's time still moved at the end: declare a time_offset_s nearer to it in [stereo]"


def unknown_clock(problem: Problem) -> bool:
    """Whether the time of a camera that takes part is to be found."""
    stereo = problem.log.stereo
    return stereo is not None and stereo.time_sigma_s > 0 and uses_camera(problem)


def camera_later(values: gtsam.Values) -> float:
    """How much later than stamped images are, s; zero where it is no variable."""
    return float(values.atVector(E(0))[7]) if values.exists(E(0)) else 0.0


def camera_settled(before_s: float, after_s: float) -> bool:
    """Whether the second is near enough to the first, along which it was found."""
    return abs(after_s - before_s) <= _SETTLED_S


def on_its_clock(problem: Problem, camera: Camera, values: gtsam.Values) -> Camera:
    """What the camera says, with the body's motion to the times at which, by `values`, its images were taken."""
    moments = _moments(problem, values, camera_later(values))
    motions, tracks = camera.motions, camera.tracks
    if motions is not None:
        of = motions.family
        i, j = (moments.only(keys - X(0)) for keys in (of.key_i, of.key_j))
        motions = replace(motions, family=replace(of, moments_i=i, moments_j=j))
    if tracks is not None:
        seen = tracks.family
        tracks = replace(tracks, family=replace(seen, moments=moments.only(seen.pose_key - X(0))))
    return Camera(motions, tracks)


def _moments(problem: Problem, values: gtsam.Values, later_s: float) -> Moments:
    """Those of all keyframes; the record's ends hold where an image would be outside of it."""
    path = smoothed_trajectory(problem, values, None)
    then_s = np.clip(path.t_s + later_s, *path.t_s[[0, -1]])
    then_s, which = np.unique(then_s, return_inverse=True)
    then = path if later_s == 0.0 else path.at(then_s)
    rotation, back = then.rotation_nb[which], so3.transpose(path.rotation_nb)
    shift_n, velocity_n = then.pos_n[which] - path.pos_n, then.vel_n[which]
    samples, bias = problem.imu.samples, problem.bias_epoch
    rate = np.empty((len(path), 3))
    for i, t_s in enumerate(then_s[which].tolist()):
        start, end = np.clip([t_s - _AROUND_S, t_s + _AROUND_S], *samples.edge_s[[0, -1]])
        rate[i] = samples.mean_rate(start, end) - values.atConstantBias(B(int(bias[max(i - 1, 0)]))).gyroscope()
    velocity = (so3.transpose(rotation) @ velocity_n[..., None])[..., 0]
    shift = (back @ shift_n[..., None])[..., 0]
    return Moments(later_s, back @ rotation, shift, np.column_stack([rate, velocity]))
