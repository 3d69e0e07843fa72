"""Registration of a roadway's wall: what it finds, how sure it is, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest
from roadway_walls import needs_open3d, sight, wall
from scipy import stats

from graphnav.errors import GraphnavError
from graphnav.frontends.registration import Expected, Registration, Sight, register

#: Two stops: the machine has been pushed by a metre and has crept back, and stands a little turned.
MOVED = np.array([1.0, -0.2])
TURN = 3e-4
RIGHT_M = 5e-3


@pytest.fixture(autouse=True)
def _open3d() -> None:
    needs_open3d()


def pair(seed: int, corners: np.ndarray | None = None, turn: float = 0.0, moved=MOVED) -> tuple[Sight, Sight]:
    rng = np.random.default_rng(seed)
    corners = wall(rng) if corners is None else corners
    return sight(rng, corners, np.zeros(3)), sight(rng, corners, np.r_[moved, turn])


def expected(shift_m=MOVED, right_m: float = RIGHT_M, turn: float = TURN) -> Expected:
    return Expected(np.asarray(shift_m, float), right_m, turn)


def errors(found: Registration) -> tuple[np.ndarray, np.ndarray]:
    """Of the shift, and in its sigmas."""
    error = found.shift_m - MOVED
    return error, error / np.sqrt(np.diag(found.cov)[:2])


@pytest.mark.parametrize("seed", range(4))
def test_a_known_displacement_is_found(seed: int) -> None:
    """To 2 mm and 5 sigma forward (false-alarm rate 6e-7 each), where it was expected 20 cm off, and turned."""
    found = register(*pair(seed, turn=2 * TURN), expected(MOVED + np.array([0.0, 0.2])))
    error, in_sigmas = errors(found)
    assert abs(error[1]) < 2e-3
    # the turn is expected to be none, which is no noise of the beams: so much of it moves the wall
    assert abs(in_sigmas[1]) < 5 + 2 * TURN * 2.0 / np.sqrt(found.cov[1, 1])
    assert found.matched > 60
    assert 0.7 < found.residual < 1.3


def test_the_start_does_not_matter() -> None:
    one, other = (register(*pair(0), expected(MOVED + np.array([0.0, off]))) for off in (-0.15, 0.2))
    assert np.abs(one.shift_m - other.shift_m).max() < 1e-7


def test_the_covariance_is_right() -> None:
    """Error by sigma, to the right and forward, over 150 walls: false-alarm rate 1e-3 for each mean of squares."""
    squares = np.array([errors(register(*pair(seed), expected()))[1] ** 2 for seed in range(150)])
    low, high = stats.chi2.interval(1 - 1e-3, len(squares))
    assert (low < squares.sum(axis=0)).all() and (squares.sum(axis=0) < high).all(), squares.mean(axis=0)


def test_a_part_of_the_wall_that_has_changed_is_left_out() -> None:
    """Fallen coal before a fifth of the wall."""
    first, second = pair(5)
    heaped = second.points_m.copy()
    heaped[:20, 1] -= 0.04
    found = register(first, Sight(heaped, second.sigma_m), expected())
    assert abs(errors(found)[0][1]) < 1e-3
    assert found.matched < len(second.points_m) - 15


def test_a_wall_that_has_changed_fits_poorly_and_is_less_sure() -> None:
    rng = np.random.default_rng(6)
    corners = wall(rng)
    worn = corners + np.column_stack([np.zeros(len(corners)), 0.02 * rng.standard_normal(len(corners))])
    first, second = sight(rng, corners, np.zeros(3)), sight(rng, worn, np.r_[MOVED, 0.0])
    changed, same = register(first, second, expected()), register(*pair(6), expected())
    assert changed.residual > 3
    assert changed.cov[1, 1] > 5 * same.cov[1, 1]


# Walls that tell too little ----------------------------------------------------------------------------------


@pytest.mark.parametrize("slant", [0.0, 0.2])
def test_a_straight_wall_is_held_across_by_what_is_expected(slant: float) -> None:
    """It tells the shift along its normal alone; an error across, times the slant, is the caller's to add."""
    off = 0.004
    for seed in range(4):
        found = register(
            *pair(seed, wall(np.random.default_rng(seed), 0.0, slant)), expected(MOVED + np.array([off, 0.0]), 2e-3)
        )
        error, _ = errors(found)
        assert error[0] == pytest.approx(off, abs=1e-3)
        assert error[1] == pytest.approx(slant * error[0], abs=5 * np.sqrt(found.cov[1, 1]) + 1e-4)


def test_a_wall_along_the_face_is_refused() -> None:
    rng = np.random.default_rng(8)
    along = np.column_stack([np.full(41, 2.0), np.linspace(4.0, 9.0, 41)])
    sights = [
        Sight(along - np.r_[0.0, by] + 1e-3 * rng.standard_normal((41, 2)) * [1, 0], np.full(41, 1e-3))
        for by in (0.0, 0.2)
    ]
    with pytest.raises(GraphnavError, match="runs along the face and does not tell how far"):
        register(*sights, expected([0.0, 0.2]))


def test_stops_that_do_not_see_the_same_wall_are_refused(capfd: pytest.CaptureFixture[str]) -> None:
    """In one line of ours, and with none of Open3D's on standard output."""
    rng = np.random.default_rng(9)
    first = sight(rng, wall(rng, from_m=-4.0, to_m=-1.0), np.zeros(3))
    second = sight(rng, wall(rng, from_m=0.0, to_m=4.0), np.zeros(3))
    with pytest.raises(GraphnavError, match=r"0 beams of one stop lie on the roadway's wall .* 10 are needed; .*far"):
        register(first, second, expected([0.0, 0.0]))
    assert capfd.readouterr().out == ""
