"""The table relative_pose as motions of the body; wheels as that table."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from factors import so3
from graphnav.errors import LogError
from graphnav.frontends.motion_chain import body_motions, camera_mounting, motion_chain
from graphnav.log import Frames, RelativePose, SensorLog, Stereo
from graphnav.readers.wheels import FLOOR_M, FLOOR_RAD, upright, wheel_motions

STEREO = Stereo(
    fx_px=1.0, fy_px=1.0, cx_px=0.0, cy_px=0.0, baseline_m=0.1,
    T_bc_pos_m=[0.1, 0.5, 0.2], T_bc_quat_wxyz=[1.0, 0.0, 0.0, 0.0],
)  # fmt: skip


def forward(**sigmas: object) -> RelativePose:
    """A camera that moves 0.2 m along its axis and turns 0.1 rad to the right (about its down axis)."""
    quat = so3.to_quaternion(so3.exp(np.array([0.0, 0.1, 0.0])))
    given = sigmas or {"sigma_m": [0.01], "sigma_rad": [0.02]}
    return RelativePose(t_from_s=[0.0], t_to_s=[1.0], pos_m=[[0.0, 0.0, 0.2]], quat=quat[None], **given)


def test_without_a_stereo_section_the_camera_looks_ahead() -> None:
    motion = body_motions(forward(), None)
    np.testing.assert_allclose(motion.pos[0], [0.0, 0.2, 0.0], atol=1e-15)
    np.testing.assert_allclose(so3.log(motion.rotation[0]), [0.0, 0.0, -0.1], atol=1e-12)
    rotation, pos = camera_mounting(None)
    np.testing.assert_allclose(rotation @ [0.0, 0.0, 1.0], [0.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_array_equal(pos, 0.0)


def test_a_stereo_section_says_how_the_camera_is_fixed() -> None:
    """Its axes are the body's here: it climbs, and turns about its place 0.5 m ahead of the body."""
    motion = body_motions(forward(), STEREO)
    turn = so3.exp(np.array([0.0, 0.1, 0.0]))
    lever = np.array([0.1, 0.5, 0.2])
    np.testing.assert_allclose(motion.pos[0], lever - turn @ lever + np.array([0.0, 0.0, 0.2]), atol=1e-12)
    np.testing.assert_allclose(motion.rotation[0], turn, atol=1e-12)


def test_two_sigmas_are_a_covariance() -> None:
    upper = np.diag([4e-4] * 3 + [1e-4] * 3)[np.triu_indices(6)]
    given, columns = (body_motions(p, None).cov for p in (forward(), forward(cov_upper=upper[None])))
    np.testing.assert_allclose(given, columns, atol=1e-18)
    assert np.diag(given[0])[:3] == pytest.approx(4e-4)


def test_wheels_roll_on_an_arc() -> None:
    """A quarter turn to the left on a circle of 2 m; then with the axle 1 m behind the body, wheels 0.1 rad aside."""
    sigmas = {"sigma_forward_m": 0.01, "sigma_side_m": 0.002, "sigma_turn_rad": 0.03}
    way = np.array([np.pi])
    poses = wheel_motions(np.array([0.0, 5.0]), way, np.array([np.pi / 2]), **sigmas)
    motion = body_motions(poses, None)
    np.testing.assert_allclose(motion.pos[0], [-2.0, 2.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(so3.log(motion.rotation[0]), [0.0, 0.0, np.pi / 2], atol=1e-12)
    expected = [FLOOR_RAD, FLOOR_RAD, 0.03, 0.002, 0.01, FLOOR_M]
    np.testing.assert_allclose(np.sqrt(np.diag(motion.cov[0])), expected, rtol=1e-6)
    apart = wheel_motions(
        np.array([0.0, 5.0]), way, np.array([np.pi / 2]), axle_b_m=(0.0, -1.0, 0.0), yaw_rad=0.1, **sigmas
    )
    rolled = so3.exp(np.array([0.0, 0.0, 0.1])) @ [-2.0, 2.0, 0.0]
    axle = np.array([0.0, -1.0, 0.0])
    expected = axle + rolled - so3.exp(np.array([0.0, 0.0, np.pi / 2])) @ axle
    np.testing.assert_allclose(body_motions(apart, None).pos[0], expected, atol=1e-12)


def test_turns_about_up() -> None:
    np.testing.assert_allclose(
        so3.from_quaternion(upright(np.array([np.pi / 2])))[0] @ [0, 1, 0], [-1, 0, 0], atol=1e-12
    )


def test_motions_that_nearly_meet_follow_each_other() -> None:
    """Stamps of the two columns that differ by rounding; by a tenth of a motion they do not."""
    poses = forward()
    twice = {name: np.repeat(getattr(poses, name), 2, axis=0) for name in ("pos_m", "quat", "sigma_m", "sigma_rad")}
    log = SensorLog(
        name="two",
        frames=Frames(latitude_deg=45.0),
        relative_pose=RelativePose(t_from_s=[0.0, 1.0004], t_to_s=[1.0, 2.0], **twice),
    )
    np.testing.assert_array_equal(motion_chain(log).t_s, [0.0, 1.0004, 2.0])
    short = RelativePose(t_from_s=[0.0, 0.001], t_to_s=[0.0005, 2.0], **twice)
    with pytest.raises(LogError, match="nothing bridges a gap"):
        motion_chain(dataclasses.replace(log, relative_pose=short))
