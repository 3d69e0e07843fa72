"""Readings of legs side by side in few factors."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from factors.legs import LegFamily
from factors.so3 import exp

RNG_SEED = 7
#: Poses, calibration epochs, legs: their first keys.
POSE, CALIBRATION, LEG = 0, 100, 200


def drawn(poses: list[int], epochs: list[int], legs: list[int], loss: float | None = None) -> LegFamily:
    """Readings of these legs, at these poses, in these epochs."""
    rng = np.random.default_rng(RNG_SEED)
    count = len(poses)
    return LegFamily(
        POSE + np.array(poses, np.int64), LEG + np.array(legs, np.int64), CALIBRATION + np.array(epochs, np.int64),
        exp(rng.normal(0, 0.05, (count, 3))), rng.normal(0, 0.1, (count, 3)), rng.uniform(3, 6, count),
        rng.uniform(-1, 1, count), rng.normal(size=count), rng.normal(0, 0.05, count),
        rng.normal(0, 0.01, (count, 3, 7)), rng.uniform(0.5, 5.0, (count, 2)), np.eye(3), rng.normal(size=3), loss,
    )  # fmt: skip


def states(family: LegFamily) -> gtsam.Values:
    """Some for every variable."""
    rng, values = np.random.default_rng(RNG_SEED), gtsam.Values()
    for key in np.unique(family.pose_key).tolist():
        values.insert(key, gtsam.Pose3(gtsam.Rot3(exp(rng.normal(0, 0.2, 3))), rng.normal(size=3)))
    for key in np.unique(family.calibration_key).tolist():
        values.insert(key, rng.normal(0, 0.01, 8))
    for key in np.unique(family.leg_key).tolist():
        values.insert(key, rng.normal([0, 4, 0, 0], [1, 1, 0.1, 0.1]))
    return values


#: Poses, epochs and legs: more at a pose than go into one factor, a leg twice at one pose (in one factor and in two),
#: an epoch that changes at a pose, poses that come again, a single reading.
CASES = {
    "many at a pose": ([0] * 19 + [1] * 5, [0] * 24, [*range(19), *range(3, 8)]),
    "a leg twice": ([0] * 12, [0] * 12, [4, 5, 4, 4, 6, 7, 8, 9, 10, 4, 5, 11]),
    "an epoch within": ([0] * 6 + [1] * 6, [0, 0, 0, 1, 1, 1, 1, 1, 0, 0, 1, 1], [*range(12)]),
    "poses again": ([0, 1, 0, 1, 1, 0, 0], [0] * 7, [1, 1, 2, 2, 3, 3, 1]),
    "one": ([3], [0], [2]),
}


@pytest.mark.parametrize("loss", [None, 3.0])
@pytest.mark.parametrize("case", CASES)
def test_say_together_what_each_says_alone(case: str, loss: float | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """The information and the error; also where they are linearized some at a time."""
    family = drawn(*CASES[case], loss)
    values = states(family)
    alone = gtsam.GaussianFactorGraph()
    for k in range(len(family.pose_key)):
        family.only(np.array([k])).linearize_into(alone, values)
    ordering = gtsam.Ordering.ColamdGaussianFactorGraph(alone)
    expected, zero = alone.hessian(ordering), values.zeroVectors()
    for block in (512, 1):
        monkeypatch.setattr("factors.legs._BLOCK", block)
        together = gtsam.GaussianFactorGraph()
        family.linearize_into(together, values)
        found = together.hessian(ordering)
        for each, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(each, other, atol=1e-12 * np.abs(other).max())
        assert together.error(zero) == pytest.approx(alone.error(zero), rel=1e-12)


def test_are_as_few_as_may_be() -> None:
    """Nineteen readings of one pose make three factors, of which each has its legs once."""
    family = drawn(*CASES["many at a pose"])
    linear = gtsam.GaussianFactorGraph()
    family.linearize_into(linear, states(family))
    assert [len(linear.at(k).keys()) for k in range(linear.size())] == [10, 10, 5, 7]


def test_the_first_reading_alone_is_that_of_its_factor() -> None:
    """The one-by-one factors of the incremental solver have the same matrices as a group of one."""
    family = drawn(*CASES["one"])
    values, linear = states(family), gtsam.GaussianFactorGraph()
    family.linearize_into(linear, values)
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(family.factors()[0])
    ordering = gtsam.Ordering.ColamdGaussianFactorGraph(linear)
    for each, other in zip(linear.hessian(ordering), graph.linearize(values).hessian(ordering), strict=True):
        np.testing.assert_allclose(each, other, atol=1e-12 * np.abs(other).max())


def test_none_make_no_factor() -> None:
    """A log whose readings were all left out."""
    family = drawn(*CASES["one"]).only(np.zeros(0, np.int64))
    linear = gtsam.GaussianFactorGraph()
    family.linearize_into(linear, gtsam.Values())
    assert linear.size() == 0
