"""`Trajectory`: at keyframes, between them, at its ends."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from engine_logs import MEMS, TWO_CUTS, simulated, smoothed
from scipy.spatial.transform import Rotation

from factors import so3
from graphnav._metrics import attitude_error, truth_at
from graphnav.errors import GraphnavError
from graphnav.trajectory import Trajectory


def run() -> Trajectory:
    return smoothed(TWO_CUTS).trajectory


def straight_and_turning() -> Trajectory:
    """A made-up trajectory without a bridge: uniform acceleration and turn, which interpolation keeps exactly."""
    t = np.array([0.0, 1.0, 1.5, 4.0])
    pos = np.outer(t**2 / 2, [1.0, -2.0, 0.5]) + np.outer(t, [0.3, 0.0, 0.1])
    vel = np.outer(t, [1.0, -2.0, 0.5]) + np.array([0.3, 0.0, 0.1])
    quat = Rotation.from_rotvec(np.outer(t, [0.1, -0.2, 0.3])).as_quat(scalar_first=True)
    cov = np.array([np.eye(9) * k for k in (1.0, 2.0, 4.0, 8.0)])
    return Trajectory(t, pos, quat, vel, cov)


def error_at(trajectory: Trajectory, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position (m) and attitude errors (rad) at times between keyframes, against truth."""
    truth = simulated(TWO_CUTS).truth
    assert truth is not None
    known, pos, quat = truth_at(truth, t)
    assert known.all()
    found = trajectory.at(t)
    return found.pos_n - pos, attitude_error(found.quat_nb, quat)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


# keyframes --------------------------------------------------------------------------------------------------


def test_keyframes_are_returned_exactly() -> None:
    trajectory = run()
    for kind in (trajectory, trajectory.without_bridge()):
        found = kind.at(trajectory.t_s)
        assert np.array_equal(found.t_s, trajectory.t_s)
        assert np.allclose(found.pos_n, trajectory.pos_n, rtol=0, atol=1e-10)
        assert np.allclose(found.vel_n, trajectory.vel_n, rtol=0, atol=1e-10)
        assert np.abs(attitude_error(found.quat_nb, trajectory.quat_nb)).max() < 1e-10
        assert np.allclose(found.cov, trajectory.cov, rtol=1e-12, atol=0)


def test_no_jump_at_keyframes() -> None:
    """A microsecond before and after: 0.3 m/s, 10 m/s^2 and 0.3 rad/s make no more than a tenth of the bounds."""
    trajectory = run()
    keyframes = trajectory.t_s[1:-1]
    before, after = trajectory.at(keyframes - 1e-6), trajectory.at(keyframes + 1e-6)
    assert np.abs(after.pos_n - before.pos_n).max() < 1e-5
    assert np.abs(after.vel_n - before.vel_n).max() < 1e-4
    assert np.abs(attitude_error(after.quat_nb, before.quat_nb)).max() < 1e-5
    assert np.allclose(before.cov, trajectory.cov[1:-1], rtol=1e-3, atol=1e-12)


@pytest.mark.parametrize("beside_s", [3e-14, 1e-12, 1e-10, 1e-8])
def test_times_that_miss_a_keyframe_by_rounding(beside_s: float) -> None:
    """As ``np.arange(0, 100, 0.1)`` does."""
    trajectory = run()
    for sign in (1, -1):
        t = trajectory.t_s[5:-5] * (1 + sign * 1e-15) + sign * beside_s
        found = trajectory.at(t)
        assert np.abs(found.pos_n - trajectory.pos_n[5:-5]).max() < 1e-6
        assert np.abs(found.vel_n - trajectory.vel_n[5:-5]).max() < 1e-5
        assert np.abs(attitude_error(found.quat_nb, trajectory.quat_nb[5:-5])).max() < 1e-6


def test_poses_are_those_of_the_states() -> None:
    times = np.arange(5.0, 25.0, 0.21)
    for kind in (run(), run().without_bridge(), straight_and_turning()):
        asked = times if kind.t_s[-1] > 25 else times / 10
        states, (rotation, pos) = kind.at(asked), kind.poses_at(asked)
        assert np.array_equal(pos, states.pos_n)
        assert np.abs(rotation - states.rotation_nb).max() < 1e-14


# between keyframes ------------------------------------------------------------------------------------------


def test_errors_between_keyframes_are_those_of_the_keyframes() -> None:
    """Against truth at 20 Hz. What the bridge adds is the noise of the IMU within a second: 0.2 mm, 0.01 deg."""
    trajectory = run()
    t = np.arange(0.05, trajectory.t_s[-1] - 0.05, 0.05)
    between = error_at(trajectory, t)
    at_keyframes = error_at(trajectory, trajectory.t_s[1:-1])
    inside = (t > trajectory.t_s[1]) & (t < trajectory.t_s[-2])
    for b, k, unit in zip(between, at_keyframes, (1e-3, 2e-4), strict=True):
        line = np.column_stack([np.interp(t, trajectory.t_s[1:-1], axis) for axis in k.T])
        assert rms(b) < 1.02 * rms(line) + unit
        # the errors are smooth: near the straight line between those of the keyframes
        assert rms((b - line)[inside]) < 2 * unit


def test_the_bridge_knows_what_interpolation_cannot() -> None:
    """The machine wobbles at 1 Hz, 2 deg: keyframes a second apart say little of what is between."""
    trajectory = run()
    moving = (30.0 + 5.0, 30.0 + 60.0)
    t = np.arange(*moving, 0.05)
    with_bridge, without = (rms(error_at(x, t)[1]) for x in (trajectory, trajectory.without_bridge()))
    assert without > 10 * with_bridge


def test_velocity_is_the_derivative_of_position() -> None:
    trajectory = run()
    t = np.arange(40.0, 60.0, 0.01)
    found = trajectory.at(t)
    slope = np.gradient(found.pos_n, t, axis=0)[5:-5]
    away = np.abs(t[5:-5, None] - trajectory.t_s).min(axis=1) > 0.03  # velocity bends at keyframes
    assert np.abs(slope - found.vel_n[5:-5])[away].max() < 2e-3


def test_interpolation_without_a_bridge() -> None:
    trajectory = straight_and_turning()
    t = np.array([0.0, 0.3, 1.0, 1.2, 1.5, 3.9, 4.0])
    found = trajectory.at(t)
    assert np.allclose(found.pos_n, np.outer(t**2 / 2, [1.0, -2.0, 0.5]) + np.outer(t, [0.3, 0.0, 0.1]), atol=1e-12)
    assert np.allclose(found.vel_n, np.outer(t, [1.0, -2.0, 0.5]) + np.array([0.3, 0.0, 0.1]), atol=1e-12)
    assert np.allclose(found.rotation_nb, so3.exp(np.outer(t, [0.1, -0.2, 0.3])), atol=1e-12)
    assert found.cov is not None
    assert np.allclose(found.cov[:, 0, 0], [1.0, 1.3, 2.0, 2.8, 4.0, 4 + 4 * 2.4 / 2.5, 8.0])
    assert found.bridge is None


def test_covariance_between_keyframes_is_between_theirs() -> None:
    trajectory = run()
    middle = (trajectory.t_s[1:] + trajectory.t_s[:-1]) / 2
    found = trajectory.at(middle)
    assert np.allclose(found.cov, (trajectory.cov[1:] + trajectory.cov[:-1]) / 2, rtol=1e-9)


def test_a_few_times_give_what_many_give() -> None:
    """Whatever else is asked for in the same call, and across the blocks in which a long log is worked on."""
    trajectory = smoothed(MEMS).trajectory
    assert len(trajectory) > 2 * 500
    t = np.sort(np.random.default_rng(1).uniform(0.0, trajectory.t_s[-1], 300))
    t = np.sort(np.concatenate([t, trajectory.t_s[[499, 500, 501, 1000]]]))
    many = trajectory.at(t)
    for k in range(0, len(t), 13):
        one = trajectory.at(t[k])
        # more times divide the integration more finely, which shows in some ten micrometres
        assert np.allclose(one.pos_n[0], many.pos_n[k], rtol=0, atol=5e-5)
        assert np.allclose(one.vel_n[0], many.vel_n[k], rtol=0, atol=5e-5)
        assert np.abs(attitude_error(one.quat_nb, many.quat_nb[k : k + 1])).max() < 1e-9
    some = trajectory.at(t[100:140])
    assert np.allclose(some.pos_n, many.pos_n[100:140], rtol=0, atol=5e-5)


# limits -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("t", [-0.1, 4.001, np.nan, np.inf])
@pytest.mark.parametrize("bridge", [True, False])
def test_times_outside_are_refused(t: float, bridge: bool) -> None:
    trajectory = run() if bridge else straight_and_turning()
    if bridge and t > 0:
        t += trajectory.t_s[-1]
    with pytest.raises(GraphnavError, match=r"time .* s is outside the trajectory's -?0\.000000 \.\. "):
        trajectory.at(np.array([1.0, t]))


def test_rounding_at_the_ends_is_no_error() -> None:
    for trajectory in (run(), straight_and_turning()):
        found = trajectory.at(np.array([trajectory.t_s[0] - 1e-9, trajectory.t_s[-1] + 1e-9]))
        assert np.allclose(found.pos_n, trajectory.pos_n[[0, -1]], atol=1e-9)


@pytest.mark.parametrize("times", [[2.0, 1.0], [1.0, 1.0]])
def test_times_must_ascend(times: list[float]) -> None:
    with pytest.raises(GraphnavError, match="times must ascend, each once"):
        run().at(np.array(times))


def test_no_times_give_an_empty_trajectory() -> None:
    for trajectory in (run(), straight_and_turning()):
        assert len(trajectory.at(np.zeros(0))) == 0


def test_a_single_keyframe() -> None:
    one = straight_and_turning().at(np.array([1.0]))
    assert len(one) == 1
    again = one.at(1.0)
    assert np.array_equal(again.pos_n, one.pos_n)
    assert np.array_equal(again.cov, one.cov)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"pos_n": np.zeros((4, 2))}, r"pos_n has shape \(4, 2\), expected \(4, 3\)"),
        ({"quat_nb": np.zeros((3, 4))}, r"quat_nb has shape \(3, 4\), expected \(4, 4\)"),
        ({"cov": np.zeros((4, 6, 6))}, r"cov has shape \(4, 6, 6\), expected \(4, 9, 9\)"),
        ({"t_s": np.array([0.0, 1.0, 1.0, 2.0])}, "t_s must ascend"),
    ],
)
def test_wrong_shapes_are_refused(change: dict[str, np.ndarray], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(straight_and_turning(), **change)
