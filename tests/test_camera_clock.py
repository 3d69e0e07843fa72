"""Images stamped by a clock of their own: how much later they were taken is found beside an IMU."""

from __future__ import annotations

import dataclasses

import gtsam
import numpy as np
import pytest
from jacobians import ANGLES, central, random_rotation
from test_camera_score import early
from test_factors_mounted_motion import family as motions_of
from test_factors_stereo_tracks import E, world
from test_stereo_in_the_graph import errors, log_of, smoothed

import graphnav as gn
import graphnav.rounds
from factors import so3
from factors.carried import Carried, Moments

#: Sigmas of a single estimate that are taken for an alarm: 1 in 16,000.
SIGMAS = 4.0


def moments(rng: np.random.Generator, count: int, later_s: float) -> Moments:
    turn = so3.exp(0.1 * rng.normal(size=(count, 3)))
    return Moments(later_s, turn, rng.normal(size=(count, 3)), rng.normal(size=(count, 6)))


@pytest.mark.parametrize("angle", ANGLES)
def test_jacobians_of_a_pose_that_is_carried_on(angle: float) -> None:
    rng = np.random.default_rng(1)
    known, rotation, pos = moments(rng, 1, 0.03), random_rotation(rng, angle), rng.normal(size=3)

    def carried(delta: np.ndarray, later_s: float) -> np.ndarray:
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation @ so3.exp(delta[:3]), pos + rotation @ delta[3:]
        return Carried.by(pose[None], known, later_s).pose[0]

    here = Carried.by(np.block([[rotation, pos[:, None]], [np.zeros(3), 1.0]])[None], known, 0.08)

    def difference(pose: np.ndarray) -> np.ndarray:
        back = here.pose[0, :3, :3].T
        return np.concatenate([so3.log(back @ pose[:3, :3]), back @ (pose[:3, 3] - here.pose[0, :3, 3])])

    np.testing.assert_allclose(
        here.by_pose[0], central(lambda d: difference(carried(d, 0.08)), 6), atol=1e-6
    )  # fmt: skip
    by_time = central(lambda d: difference(carried(np.zeros(6), 0.08 + d[0])), 1)
    np.testing.assert_allclose(here.by_time[0], by_time[:, 0], atol=1e-6)


def test_the_families_have_them() -> None:
    """By differences, of readings and of motions, at a time that is not the one along which the motion is known."""
    rng = np.random.default_rng(2)
    tracks, seen = world(3, True)
    tracks = dataclasses.replace(tracks, moments=moments(rng, 6, 0.05))
    motions, between = motions_of(rng, unknown=True)
    motions = dataclasses.replace(motions, moments_i=moments(rng, 2, 0.05), moments_j=moments(rng, 2, 0.05))
    assert motions.camera_key is not None
    between.update(motions.camera_key, rng.normal(0, 0.02, 8))
    for family, values, keys in (
        (tracks, seen, (tracks.pose_key, tracks.point_key, np.full(6, E))),
        (motions, between, (motions.key_i, motions.key_j, np.full(2, motions.camera_key))),
    ):
        _, by = family.residuals(values)
        for found, key in zip(by, keys, strict=True):
            size = found.shape[2]

            def error(delta: np.ndarray, key: int = int(key[1]), family=family, values=values) -> np.ndarray:  # type: ignore[no-untyped-def]
                change = gtsam.VectorValues()
                change.insert(key, delta)
                return family.residuals(values.retract(change))[0][1]

            scale = max(np.abs(found[1]).max(), 1.0)
            np.testing.assert_allclose(found[1] / scale, central(error, size) / scale, atol=1e-5)


@pytest.mark.parametrize("form", ["tight", "loose"])
@pytest.mark.parametrize("later_s", [0.05, -0.1])
def test_the_time_is_found(form: str, later_s: float) -> None:
    run = smoothed(early(log_of(1), later_s, time_sigma_s=0.1), form=form)
    found = run.calibration["camera_time"]
    assert found.unit == "s" and found.sigma < 0.01
    assert abs(found.value - later_s) < SIGMAS * found.sigma
    # a frame before the record has begun may be lost
    assert not [line for line in run.diagnostics.warnings if "outside the IMU record" not in line]
    error, sigma = errors(run, log_of(1))
    assert (np.abs(error[-1]) < SIGMAS * sigma[-1]).all()


def test_isam2_finds_it_too() -> None:
    log = early(log_of(1), 0.05, time_sigma_s=0.1)
    found = [smoothed(log, method).calibration["camera_time"] for method in ("batch", "isam2")]
    assert abs(found[1].value - found[0].value) < 0.1 * found[0].sigma


def test_one_that_does_not_settle_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(graphnav.rounds, "CLOCK_ROUNDS", 1)
    config = gn.Config.from_dict({"batch": {"bias_move_rounds": 1}})
    log = early(log_of(1), 0.05, time_sigma_s=0.1)
    warned = gn.smooth(dataclasses.replace(log, truth=None), config).diagnostics.warnings
    assert [line for line in warned if "still moved at the end" in line and "time_offset_s" in line]
