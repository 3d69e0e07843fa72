"""Where motions of a stereo camera end: a chain of them is even in between, and so must the way be."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
import stereo_scene as scene
from scipy.stats import chi2

import graphnav as gn
from factors import so3
from graphnav.config import Config, StereoMotionsConfig
from graphnav.frontends import stereo_odometry
from graphnav.frontends.motion_chain import camera_mounting
from graphnav.frontends.stereo_keyframes import Linker
from graphnav.frontends.stereo_motion import MotionFailure, StereoMotion
from graphnav.frontends.stereo_odometry import StereoMotions, stereo_motions
from graphnav.log import InitialState, SensorLog, Truth
from graphnav.sighted import with_stereo

SEED, SEEDS = 71, range(6)
SETTINGS = StereoMotionsConfig()
RATE_HZ, RESTED = 10.0, 120
#: Speeds up over five frames to 0.1 m a frame.
_STARTING = np.cumsum(0.1 * np.linspace(0.2, 1.0, 5))
AFTER_REST = np.concatenate([np.zeros(RESTED + 1), _STARTING, _STARTING[-1] + 0.1 * np.arange(1, 20)])
#: In the middle of the pause half the time has gone, and half the way: there a motion over all of it looks even.
WITH_PAUSE = np.concatenate([np.linspace(0, 0.2, 3), np.full(60, 0.2), np.linspace(0.2, 2.0, 19)])
EVEN = np.arange(0.0, 6.0, 0.1)


@cache
def driven_log(seed: int, way: str) -> tuple[SensorLog, scene.Drive]:
    """A log with its features, start and truth; no IMU."""
    rng = np.random.default_rng([SEED, seed])
    driven = scene.drive({"rest": AFTER_REST, "pause": WITH_PAUSE, "even": EVEN}[way], RATE_HZ)
    log = scene.stereo_log(scene.tracked(rng, driven, scene.roadway(rng, 2500, 30.0)))
    rotation_bc, pos_b = camera_mounting(log.stereo)
    assert not pos_b.any()
    quat_nb = so3.to_quaternion(driven.rotation @ rotation_bc.T)
    initial = InitialState(
        pos_n_m=driven.pos[0], pos_sigma_m=[1e-4] * 3, quat_nb_wxyz=quat_nb[0], att_sigma_deg=[1e-3] * 3,
        vel_n_m_s=np.zeros(3), vel_sigma_m_s=[0.01] * 3,
    )  # fmt: skip
    truth = Truth(driven.t_s, driven.pos, quat_nb, np.gradient(driven.pos, 1 / RATE_HZ, axis=0))
    return dataclasses.replace(log, initial=initial, truth=truth), driven


def squared_at(log: SensorLog, driven: scene.Drive, frame: int, *, evenly: bool) -> float:
    """Squared error of the place at a frame, by its covariance; three degrees of freedom."""
    found = stereo_motions(log, SETTINGS, evenly=evenly)
    log = dataclasses.replace(log, relative_pose=found.poses, stereo_tracks=None, truth=None)
    state = gn.smooth(log, method="stereo").trajectory.at(driven.t_s[[frame]])
    error = state.pos_n[0] - driven.pos[frame]
    return float(error @ np.linalg.solve(state.cov[0, 3:6, 3:6], error))


def ends(found: StereoMotions) -> np.ndarray:
    assert found.poses is not None and not found.failures
    np.testing.assert_array_equal(found.poses.t_from_s[1:], found.poses.t_to_s[:-1])
    return np.append(found.poses.t_from_s[0], found.poses.t_to_s)


@pytest.mark.parametrize(("way", "frame"), [("rest", RESTED), ("pause", 4), ("pause", 61)])
def test_the_chain_is_where_it_says_during_a_rest(way: str, frame: int) -> None:
    """Six drives: the sum of squared errors is below the chi-square's 1e-4 point, and far above it if nobody asks."""
    logs = [driven_log(seed, way) for seed in SEEDS]
    limit = chi2.isf(1e-4, 3 * len(logs))
    assert sum(squared_at(*log, frame, evenly=True) for log in logs) < limit
    assert sum(squared_at(*log, frame, evenly=False) for log in logs) > 2 * limit


def test_a_motion_ends_with_the_rest_and_few_are_added() -> None:
    """One ends within two frames of it, which are 6 cm; if nobody asks, the nearest end may be anywhere.

    Some 15 motions of a drive, six drives: one is split by chance in 60 such tests, and would pass for it.
    """
    for seed in SEEDS:
        log, driven = driven_log(seed, "rest")
        asked, unasked = (ends(stereo_motions(log, SETTINGS, evenly=evenly)) for evenly in (True, False))
        assert np.abs(asked - driven.t_s[RESTED]).min() < 2.5 / RATE_HZ
        # speeding up over five frames is uneven itself
        assert len(unasked) < len(asked) <= len(unasked) + len(_STARTING) + 1


def test_an_even_drive_has_the_same_motions() -> None:
    """Some 90 motions, each asked three times at four sigmas: one of them is split by chance in 60 such tests."""
    for seed in SEEDS:
        log, _ = driven_log(seed, "even")
        asked, unasked = (stereo_motions(log, SETTINGS, evenly=evenly).poses for evenly in (True, False))
        assert asked is not None and unasked is not None
        np.testing.assert_array_equal(asked.t_to_s, unasked.t_to_s)


class FramesAlike:
    """Frames that all see the same features."""

    def __init__(self, t_s: np.ndarray) -> None:
        self.t_s = t_s

    def __len__(self) -> int:
        return len(self.t_s)

    def shared(self, _first: int, _second: int) -> int:
        return 200


@pytest.mark.parametrize("covered", [3, 5])
def test_frames_that_give_no_motion_are_bridged_however_uneven_the_bridge(covered: int) -> None:
    """The frames behind the first show nothing: an end among them would cost the only motion there is."""
    t_s = np.arange(40) / RATE_HZ
    pos_m = 0.45 * (t_s / t_s[-1]) ** 2

    def motion(first: int, second: int) -> StereoMotion | MotionFailure:
        if not {first, second}.isdisjoint(range(1, covered + 1)):
            return MotionFailure("covered")
        way = np.array([0.0, 0.0, pos_m[second] - pos_m[first]])
        return StereoMotion(np.eye(3), way, 1e-8 * np.eye(6), np.ones(200, bool), 1.0)

    frames: Any = FramesAlike(t_s)
    links = list(Linker(frames, SETTINGS, motion, evenly=True).links())
    assert all(isinstance(link.motion, StereoMotion) for link in links)


def test_it_is_asked_where_nothing_else_tells_the_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not beside an IMU, unless the method goes by the motions alone."""
    asked: list[bool] = []
    real = stereo_odometry.stereo_motions

    def noted(*args: object, **options: object) -> StereoMotions:
        asked.append(bool(options["evenly"]))
        return real(*args, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(stereo_odometry, "stereo_motions", noted)
    log = gn.simulate("roadheader-stereo", seed=1, images=False, tracks=True, rate_hz=1)
    config = Config.from_dict({"stereo": {"form": "loose"}})
    with_stereo(log, config)
    with_stereo(dataclasses.replace(log, imu=None), config)
    gn.smooth(log, method="stereo")
    assert asked == [False, True, True]
