"""Positions from ranges: exact ranges, mirrors, dilution of precision, consistency, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from jacobians import central

from graphnav.errors import GraphnavError
from graphnav.frontends import trilateration
from graphnav.frontends.trilateration import coplanar, fix, fixes, usable

#: Tables 3 and 5 of Cao et al. (2023).
SURFACE = np.array([(1.112, 0.471, 1.375), (0.442, 1.483, 1.556), (1.925, 1.551, 1.913), (1.073, 0.542, 2.532)])
UNDERGROUND = np.array([(1.251, 3.352, -0.251), (0.0, 0.0, 0.0), (-0.110, 2.375, 0.311), (-1.223, 2.758, 0.349)])
PLANE = np.array([(0.0, 0.0, 1.0), (4.0, 0.0, 1.0), (0.0, 3.0, 1.0), (4.0, 3.0, 1.0)])
LINE = np.outer(np.arange(4.0), [1.0, 2.0, 0.5])


def distances(anchors: np.ndarray, pos: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.asarray(pos)[..., None, :] - anchors, axis=-1)


# Exact ranges -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("anchors", [SURFACE, UNDERGROUND])
def test_exact_ranges_give_the_position(anchors: np.ndarray) -> None:
    pos = np.random.default_rng(1).uniform(-6, 9, (300, 3))
    found = fixes(anchors, distances(anchors, pos), 0.01, near_n=pos)
    assert found.converged.all()
    assert found.pos_n == pytest.approx(pos, abs=1e-6)
    assert np.abs(found.residual_m).max() < 1e-7


def test_one_epoch_is_the_batch_of_one() -> None:
    pos = np.array([0.5, 6.0, 0.0])
    one, many = fix(SURFACE, distances(SURFACE, pos), 0.02), fixes(SURFACE, distances(SURFACE, pos[None]), 0.02)
    assert one.pos_n.shape == (3,)
    for name in ("pos_n", "cov", "pdop", "residual_m"):
        assert getattr(one, name) == pytest.approx(getattr(many, name)[0])


def test_missing_ranges_are_left_out() -> None:
    anchors, pos = np.vstack([SURFACE, [(3.0, 2.0, -1.0)]]), np.array([0.5, 4.0, 0.0])
    ranges = distances(anchors, pos)
    ranges[1] = np.nan
    found = fix(anchors, ranges, 0.02)
    assert found.pos_n == pytest.approx(pos, abs=1e-6)
    assert np.isnan(found.residual_m).tolist() == [False, True, False, False, False]
    assert fix(anchors[[0, 2, 3, 4]], ranges[[0, 2, 3, 4]], 0.02).cov == pytest.approx(found.cov)


def test_a_surer_range_counts_for_more() -> None:
    pos, anchors = np.array([0.5, 4.0, 0.0]), np.vstack([SURFACE, [(3.0, 2.0, -1.0)]])
    ranges = distances(anchors, pos) + np.array([0.3, 0, 0, 0, 0])
    errors = [np.linalg.norm(fix(anchors, ranges, np.r_[sigma, np.full(4, 0.02)]).pos_n - pos) for sigma in (0.02, 2.0)]
    assert errors[1] < 0.01 * errors[0]


# Mirrors ----------------------------------------------------------------------------------------------------


def test_anchors_in_a_plane_leave_two_positions_and_that_is_told() -> None:
    assert coplanar(PLANE)
    assert not coplanar(SURFACE)
    low, high = np.array([1.0, 2.0, -0.5]), np.array([1.0, 2.0, 2.5])
    found = fix(PLANE, distances(PLANE, low), 0.02)
    assert found.ambiguous
    pair = sorted([found.pos_n.tolist(), found.mirror_n.tolist()], key=lambda p: p[2])
    assert np.array(pair) == pytest.approx(np.array([low, high]), abs=1e-6)
    for near in (low, high):
        chosen = fix(PLANE, distances(PLANE, low), 0.02, near_n=near + 0.3)
        assert chosen.pos_n == pytest.approx(near, abs=1e-6)
        assert not chosen.ambiguous


def test_three_anchors_are_a_plane() -> None:
    found = fix(SURFACE[:3], distances(SURFACE[:3], np.array([0.5, 4.0, 0.0])), 0.02)
    assert found.ambiguous


def test_ranges_choose_the_side_where_they_can() -> None:
    anchors = PLANE + np.array([[0, 0, 0.8], [0, 0, 0], [0, 0, 0], [0, 0, 0]])
    pos = np.array([1.0, 2.0, -0.5])
    found = fix(anchors, distances(anchors, pos), 0.02, near_n=np.array([1.0, 2.0, 2.5]))
    assert found.pos_n == pytest.approx(pos, abs=1e-6)
    assert found.mirror_n[2] > 1.0
    assert found.mirror_cost > found.cost + 9


def test_one_minimum_is_its_own_mirror() -> None:
    found = fix(SURFACE, distances(SURFACE, np.array([0.5, 3.0, 0.0])), 0.02)
    assert found.mirror_n == pytest.approx(found.pos_n, abs=1e-6)
    assert not found.ambiguous


def test_beside_the_plane_of_the_anchors_height_is_unknown_not_infinite() -> None:
    found = fix(PLANE, distances(PLANE, np.array([1.0, 2.0, 1.0])), 0.02)
    assert np.isfinite(found.cov).all()
    assert found.vdop > 20 * found.hdop


# Uncertainty ------------------------------------------------------------------------------------------------


def test_directions_are_the_derivative_of_the_ranges() -> None:
    pos, ranges = np.array([0.5, 4.0, 0.3]), np.zeros((1, 4))
    _, direction = trilateration._residual(pos[None], SURFACE, ranges)
    measured = central(lambda d: trilateration._residual((pos + d)[None], SURFACE, ranges)[0][0], 3)
    assert -direction[0] == pytest.approx(measured, abs=1e-7)


def test_dilution_of_precision_over_a_square() -> None:
    """Anchors at the corners of a square of half-diagonal d, the tag h under its middle: sigmas in closed form."""
    h, d = 2.0, 3.0
    anchors = np.array([(d, 0, h), (-d, 0, h), (0, d, h), (0, -d, h)], float)
    found = fix(anchors, distances(anchors, np.zeros(3)), 0.1, near_n=np.array([0.0, 0.0, -0.1]))
    slant = np.hypot(h, d)
    assert found.hdop == pytest.approx(slant / d)
    assert found.vdop == pytest.approx(slant / (2 * h))
    assert found.pdop == pytest.approx(np.hypot(found.hdop, found.vdop))
    assert found.gdop == found.pdop
    assert np.sqrt(np.diag(found.cov)) == pytest.approx(
        0.1 * slant * np.array([1 / d / 2**0.5, 1 / d / 2**0.5, 0.5 / h])
    )


def test_errors_are_as_large_as_the_covariances_say() -> None:
    """NEES of 3,000 fixes: chi-square of 9,000, false alarm 1 in 10^4; the cost likewise, of one range too many."""
    rng, count, sigma = np.random.default_rng(7), 3000, 0.013
    pos = np.column_stack([np.full(count, 0.5), np.linspace(7, 2, count), np.zeros(count)])
    found = fixes(SURFACE, distances(SURFACE, pos) + sigma * rng.standard_normal((count, 4)), sigma, near_n=pos)
    error = found.pos_n - pos
    nees = np.mean(np.einsum("ei,eij,ej->e", error, np.linalg.inv(found.cov), error)) / 3
    assert abs(nees - 1) < 3.9 * np.sqrt(2 / (3 * count))
    assert abs(found.cost.mean() - 1) < 3.9 * np.sqrt(2 / count)


# Refusals ---------------------------------------------------------------------------------------------------


def test_two_anchors_and_anchors_on_a_line_are_refused() -> None:
    with pytest.raises(GraphnavError, match="ranges to 2 anchors, a position needs 3 at least, and 4 to be unique"):
        fix(SURFACE[:2], np.ones(2), 0.1)
    with pytest.raises(GraphnavError, match="the anchors lie on one line: their ranges leave a circle of positions"):
        fix(LINE, distances(LINE, np.array([1.0, 0.0, 3.0])), 0.1)


def test_usable_epochs() -> None:
    anchors = np.vstack([LINE[:3], [(0.0, 0.0, 5.0)]])
    there = np.array([[1, 1, 1, 1], [1, 1, 1, 0], [1, 1, 0, 1], [1, 0, 0, 1]], bool)
    assert usable(anchors, there).tolist() == [True, False, True, False]
