"""Surveyed legs, ``[[lidar.landmark]]``: their priors, their section, and what they add to a shearer's path."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import test_legs_in_the_graph as plain
from scipy import stats

from graphnav.errors import LogError
from graphnav.evaluation import evaluate
from graphnav.leg_priors import leg_priors
from graphnav.log import Landmark
from graphnav.problem import D, L
from graphnav.readers import read, write
from graphnav.simulation.supports import build_supports
from graphnav.simulation.world import build_world, streams
from graphnav.smooth import smooth

SURVEY_M = 0.005


def marks(seed: int = 0, every: int = 3) -> tuple[Landmark, ...]:
    """Every third support surveyed before its first advance, with errors of the declared size in all three axes."""
    of = streams(seed)
    legs = build_supports(build_world(plain.SPEC, of.geometry, of.machine), of.supports)
    rng = np.random.default_rng(seed)
    rows = np.flatnonzero(legs.advance == 0)[::every]
    return tuple(
        Landmark(feature=int(legs.feature[k]), pos_n_m=legs.pos_n_m[k] + rng.normal(0, SURVEY_M, 3), sigma_m=SURVEY_M)
        for k in rows
    )


def surveyed(seed: int, landmark: tuple[Landmark, ...]):
    log = plain.log(seed)
    assert log.lidar is not None
    return replace(log, truth=None, lidar=log.lidar.replace(landmark=landmark))


# Priors ------------------------------------------------------------------------------------------------------


def test_priors_hold_the_surveyed_point_at_its_own_height() -> None:
    """The leg's variable is at another height: through the lean, place and lean have the survey's sigma there alone."""
    lidar = plain.log().lidar
    assert lidar is not None
    mark = Landmark(feature=7, pos_n_m=np.array([3.0, -2.0, 1.5]), sigma_m=SURVEY_M)
    lean = 0.17
    found = leg_priors(lidar.replace(landmark=(mark,)), np.array([5, 7]), np.array([0.0, 0.3]), lean)
    assert [list(prior.keys()) for prior in found] == [[D(0)], [L(0)], [L(1)]]
    free, held = (np.asarray(prior.noiseModel().covariance()) for prior in found[1:])
    assert np.sqrt(np.diag(free)) == pytest.approx([1e4, 1e4, lean, lean])
    to_mark = np.kron([[1.0, 1.5 - 0.3], [0.0, 1.0]], np.eye(2))
    there = to_mark @ held @ to_mark.T
    assert there == pytest.approx(np.diag([SURVEY_M, SURVEY_M, lean, lean]) ** 2, abs=1e-12)
    assert np.asarray(found[2].prior()) == pytest.approx([3.0, -2.0, 0.0, 0.0])


# In the graph ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def judged() -> list[tuple[float, float, float]]:
    """Of each seed: rms horizontal error without and with surveyed legs, and e' P^-1 e in the middle of the log."""
    found = []
    for seed in plain.SEEDS:
        run = smooth(surveyed(seed, marks(seed)))
        errors = evaluate(run.trajectory, plain.log(seed))
        middle = len(run.trajectory.t_s) // 2
        error, cov = errors.error_n_m[middle, :2], run.trajectory.cov[middle, 3:5, 3:5]
        square = float(error @ np.linalg.solve(cov, error))
        found.append((float(np.hypot(*plain.rms(seed, True)[:2])), float(np.hypot(*errors.rms_m[:2])), square))
    return found


def test_surveyed_legs_hold_the_path(judged) -> None:
    without, with_them, _ = np.array(judged).T
    assert (with_them < without).all()
    assert np.sqrt((with_them**2).mean()) < 0.5 * np.sqrt((without**2).mean())


def test_sigmas_are_right_with_surveyed_legs(judged) -> None:
    """NEES of east and north, one draw a seed: false-alarm rate 1e-3."""
    low, high = stats.chi2.interval(1 - 1e-3, 2 * len(judged))
    assert low < sum(square for *_, square in judged) < high


def test_a_survey_of_a_leg_that_is_never_seen_changes_nothing() -> None:
    unseen = Landmark(feature=9999, pos_n_m=np.array([1e3, 0.0, 0.0]), sigma_m=SURVEY_M)
    assert np.array_equal(smooth(surveyed(0, (unseen,))).trajectory.pos_n, plain.run(0).trajectory.pos_n)


# The section -------------------------------------------------------------------------------------------------


def test_surveyed_legs_go_through_a_folder(tmp_path: Path) -> None:
    log = surveyed(0, marks())
    write(log, tmp_path / "log")
    assert "[[lidar.landmark]]" in (tmp_path / "log" / "log.toml").read_text()
    back = read(tmp_path / "log").lidar
    assert back is not None and log.lidar is not None
    assert [mark.feature for mark in back.landmark] == [mark.feature for mark in log.lidar.landmark]
    for mark, written in zip(back.landmark, log.lidar.landmark, strict=True):
        assert np.array_equal(mark.pos_n_m, written.pos_n_m) and mark.sigma_m == written.sigma_m


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ("feature = 1", r"log\.toml \[lidar\], landmark: feature 1 is there twice; keep one of them"),
        ("feature = 1.5", r"log\.toml.*feature"),
        ("feature = 2\nsigma_m = 0.0", r"log\.toml.*sigma_m"),
        ("feature = 2\nkind = 'leg'", r"log\.toml.*kind"),
    ],
    ids=["twice", "half a number", "no sigma", "unknown key"],
)
def test_a_wrong_section_is_named(wrong: str, said: str, tmp_path: Path) -> None:
    mark = Landmark(feature=1, pos_n_m=np.zeros(3), sigma_m=SURVEY_M)
    write(surveyed(0, (mark,)), tmp_path / "log")
    page = tmp_path / "log" / "log.toml"
    lines = ["", "[[lidar.landmark]]", "pos_n_m = [0.0, 0.0, 0.0]", wrong]
    if "sigma_m" not in wrong:
        lines.append("sigma_m = 0.01")
    page.write_text(page.read_text() + "\n".join(lines) + "\n")
    with pytest.raises(LogError, match=said):
        read(tmp_path / "log")
