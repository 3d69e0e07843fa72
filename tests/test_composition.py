"""The compiled loops over motions beside the same in arrays."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_increments import shaken

from factors import so3
from factors.composition import turned_further
from factors.increments import compensated_increments
from factors.inertial import Motion, cumulate, predict


@pytest.mark.parametrize("angle", [0.0, 1e-12, 9.9e-4, 1.01e-3, 1.0, np.pi - 1e-9, np.pi, 4.0])
def test_turns_are_those_of_the_exponential(angle: float) -> None:
    """On both sides of where the series ends (1e-3 rad), and near half a turn."""
    rng = np.random.default_rng(0)
    rotation, axis = Rotation.random(20, random_state=1).as_matrix(), rng.normal(size=(20, 3))
    phi = angle * axis / np.linalg.norm(axis, axis=1)[:, None]
    assert np.abs(turned_further(rotation, phi) - rotation @ Rotation.from_rotvec(phi).as_matrix()).max() < 2e-15


def test_predictions_are_those_of_arrays() -> None:
    """On a world that turns a thousand times as fast as ours, so that its every term is seen."""
    motion = cumulate(compensated_increments(shaken(), np.array([0.0, 0.7, 2.3, 3.0]), 0.02))
    rng, gravity, earth_n = np.random.default_rng(2), 9.8, np.array([0.0, 0.06, 0.04])
    index = motion.first[1:] - 1
    rotation, pos = Rotation.random(3, random_state=3).as_matrix(), rng.normal(0, 50, (3, 3))
    vel, t = rng.normal(0, 3, (3, 3)), motion.elapsed_s[index][:, None]
    down = np.array([0.0, 0.0, -gravity])
    by_v = np.einsum("kij,kj->ki", rotation, motion.velocity_b[index])
    by_p = np.einsum("kij,kj->ki", rotation, motion.position_b[index])
    free = vel * t + down * t**2 / 2 + by_p
    found = predict(rotation, pos, vel, motion, index, gravity, earth_n)
    assert np.abs(found[0] - so3.exp(-earth_n * t) @ rotation @ motion.rotation[index]).max() < 1e-14
    assert np.abs(found[1] - pos - free + np.cross(earth_n, t * by_p + vel * t**2 + down * t**3 / 3)).max() < 1e-12
    assert np.abs(found[2] - vel - down * t - by_v + np.cross(earth_n, t * by_v - by_p + 2 * free)).max() < 1e-12


def test_states_that_do_not_match_the_motions_are_refused() -> None:
    """Compiled loops do not look at bounds."""
    motion = Motion(np.array([0, 1]), np.ones(1), np.eye(3)[None], np.zeros((1, 3)), np.zeros((1, 3)))
    with pytest.raises(ValueError, match="broadcast"):
        predict(
            np.tile(np.eye(3), (2, 1, 1)), np.zeros((2, 3)), np.zeros((2, 3)), motion, np.array([0]), 9.8, np.zeros(3)
        )
