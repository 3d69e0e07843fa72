"""Points eliminated as arrays: the same error, step and covariances as with the points in the linear graph."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from jacobians import random_rotation

from factors import condensed_points, stereo_tracks
from factors.stereo import StereoCamera, project
from factors.stereo_tracks import TrackFamily

CAMERA = StereoCamera(223.0, 224.0, 211.5, 119.5, 0.095)
E, SIGMA_PX = gtsam.symbol("e", 0), 0.5
POSES, POINTS = 30, 60


def X(i: int) -> int:
    return gtsam.symbol("x", i)


def P(j: int) -> int:
    return gtsam.symbol("p", j)


def world(seed: int, mounted: bool, **changes: object) -> tuple[TrackFamily, gtsam.Values]:
    """A drive along the camera's axis past points that are each seen for 2 to 12 poses; values are off by a little."""
    rng = np.random.default_rng(seed)
    declared, place = random_rotation(rng), rng.normal(size=3)
    rotation_nc = random_rotation(rng)
    rotation_nb = rotation_nc @ declared.T
    values, rows = gtsam.Values(), []
    places_c = np.column_stack([rng.uniform(-0.05, 0.05, (POSES, 2)), 0.2 * np.arange(POSES)])
    for i, place_c in enumerate(places_c):
        pose = gtsam.Pose3(gtsam.Rot3(rotation_nb), rotation_nc @ place_c - rotation_nb @ place)
        values.insert(X(i), pose.retract(0.01 * rng.normal(size=6)))
    for j in range(POINTS):
        first, count = int(rng.integers(0, POSES - 12)), int(rng.integers(2, 13))
        point = places_c[first] + np.array([rng.uniform(-1, 1), rng.uniform(-1, 1), rng.uniform(4, 8)])
        values.insert(P(j), rotation_nc @ point + 0.02 * rng.normal(size=3))
        for i in range(first, first + count):
            rows.append((X(i), P(j), project(CAMERA, point - places_c[i]) + rng.normal(0, SIGMA_PX, 3)))
    values.insert(E, rng.normal(0, 0.01, 8))
    shuffled = rng.permutation(len(rows))
    pose_key, point_key = (np.array([rows[k][at] for k in shuffled]) for at in (0, 1))
    family = TrackFamily(
        pose_key, point_key, E if mounted else None, np.array([rows[k][2] for k in shuffled]), SIGMA_PX, CAMERA,
        declared, place, **changes,
    )  # fmt: skip
    return family, values


def priors(family: TrackFamily, sigma: float) -> gtsam.GaussianFactorGraph:
    """What else is known: every pose, and the camera's errors."""
    graph = gtsam.GaussianFactorGraph()
    sizes = {X(i): 6 for i in range(POSES)} | ({} if family.camera_key is None else {E: 8})
    for key, size in sizes.items():
        model = gtsam.noiseModel.Unit.Create(size)
        graph.push_back(gtsam.JacobianFactor(key, np.eye(size) / sigma, np.zeros(size), model))
    return graph


def information(linear: gtsam.GaussianFactorGraph) -> np.ndarray:
    """Of poses, the camera's errors, and points, in this order."""
    order = gtsam.Ordering()
    for key in sorted(linear.keyVector(), key=lambda key: ("xep".index(chr(key >> 56)), key)):
        order.push_back(key)
    return linear.hessian(order)[0]


@pytest.mark.parametrize("loss", ["none", "geman-mcclure"])
@pytest.mark.parametrize("mounted", [False, True])
def test_it_is_the_same_problem(mounted: bool, loss: str) -> None:
    family, values = world(1, mounted, loss=loss)
    whole, left = priors(family, 0.1), priors(family, 0.1)
    family.linearize_into(whole, values)
    points = family.condense_into(left, values)
    assert points is not None
    at_start = whole.error(values.zeroVectors())
    assert left.error(values.zeroVectors()) + points.gain == pytest.approx(at_start, rel=1e-9)
    expected, found = whole.optimize(), left.optimize()
    assert not found.exists(P(0))
    points.complete(found)
    for key in whole.keyVector():
        np.testing.assert_allclose(found.at(key), expected.at(key), atol=1e-7 * max(np.abs(expected.at(key)).max(), 1))
    assert left.error(found) == pytest.approx(whole.error(expected), rel=1e-9)


def test_the_covariances_are_the_same() -> None:
    """Of poses known to 1 m alone, so that what features say of them is far more than that."""
    family, values = world(2, True)
    whole, left = priors(family, 1.0), priors(family, 1.0)
    family.linearize_into(whole, values)
    family.condense_into(left, values)
    expected, found = (np.linalg.inv(information(each)) for each in (whole, left))
    sigma = np.sqrt(found.diagonal())
    assert sigma[: 6 * POSES].min() < 0.25  # features tie all of them together
    size = len(found)
    np.testing.assert_allclose((expected[:size, :size] - found) / np.outer(sigma, sigma), 0.0, atol=1e-6)


def test_factors_are_few() -> None:
    """One for each group of points, in place of one for each reading, and no point among their keys."""
    family, values = world(3, False)
    linear = gtsam.GaussianFactorGraph()
    family.condense_into(linear, values)
    assert linear.size() < POINTS < len(family.pose_key)
    assert not set(linear.keyVector()) & set(family.point_key.tolist())


def test_points_apart_are_condensed_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    """Grouping is a matter of speed: with groups of a pose, or all in one, the information is the same."""
    family, values = world(4, True)
    informations = []
    for near in (1, 1000):
        monkeypatch.setattr(condensed_points, "_NEAR", near)
        linear = priors(family, 1.0)
        family.condense_into(linear, values)
        informations.append(information(linear))
    scale = np.sqrt(informations[0].diagonal())
    np.testing.assert_allclose(*(each / np.outer(scale, scale) for each in informations), atol=1e-11)


def test_a_point_behind_all_cameras_stays_where_it_is() -> None:
    family, values = world(5, False)
    seen = np.unique(family.pose_key[family.point_key == P(0)])
    behind = values.atPose3(int(seen[0])).transformFrom(family.pos_bc - family.rotation_bc @ [0.0, 0.0, 50.0])
    values.update(P(0), behind)
    linear = priors(family, 1e-3)
    points = family.condense_into(linear, values)
    assert points is not None
    step = linear.optimize()
    points.complete(step)
    assert np.abs(step.at(P(0))).max() < 1e-12
    assert np.abs(step.at(P(1))).max() > 1e-6


def test_without_readings_there_is_nothing_to_condense() -> None:
    family, values = world(6, False)
    assert replace(family).only(np.zeros(0, int)).condense_into(gtsam.GaussianFactorGraph(), values) is None


def test_a_point_seen_from_nearly_everywhere_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is left of it would tie every pose to every other: the linear graph is that with the points."""
    family, values = world(7, mounted=False)
    monkeypatch.setattr(stereo_tracks, "_MOST_POSES", 11)
    kept, whole = gtsam.GaussianFactorGraph(), gtsam.GaussianFactorGraph()
    assert family.condense_into(kept, values) is None
    family.linearize_into(whole, values)
    assert kept.keyVector() == whole.keyVector()
    assert kept.error(values.zeroVectors()) == whole.error(values.zeroVectors())
