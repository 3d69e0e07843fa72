"""LiDAR landmarks: geometry of a leg cut by the scan plane, systematic errors, Jacobians."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from jacobians import ANGLES, analytic, central, factor_jacobian, moved, random_rotation

from factors import landmark, so3
from factors.landmark import ANGLE_BIAS, ANGLE_SCALE, ANGLE_SQUARE, MOUNTING, RANGE_BIAS, RANGE_SCALE
from factors.legs import LegFamily

RNG_SEED = 4


def machine(rng: np.random.Generator, tilt_rad: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    """A pose near upright at any heading."""
    heading = so3.exp(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)]))
    return heading @ so3.exp(rng.normal(0, tilt_rad, 3)), rng.normal(0, 30, 3)


def systematic(rng: np.random.Generator) -> np.ndarray:
    return rng.normal(size=8) * [1e-3, 0.05, 2e-3, 0.01, 5e-3, 0.01, 0.01, 0.01]


def mounting(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    return so3.exp(rng.normal(0, 0.05, 3)), rng.normal(0, 0.5, 3)


def observed(rotation, pos, leg, height, calibration, rotation_bs, lever) -> tuple[float, float]:
    """What an errorless scanner with these systematic errors reads: the plane is met by bisection along the line."""
    to_s = (so3.exp(calibration[MOUNTING]) @ rotation_bs).T
    low, high = pos[2] - 50.0, pos[2] + 50.0

    def in_s(at: float) -> np.ndarray:
        return to_s @ (rotation.T @ (np.array([*(leg[:2] + leg[2:] * (at - height)), at]) - pos) - lever)

    for _ in range(200):
        middle = (low + high) / 2
        low, high = (middle, high) if in_s(middle)[2] < 0 else (low, middle)
    x, y, _ = in_s(low)
    theta = np.arctan2(-x, y)
    a1, a2, a3 = calibration[ANGLE_SQUARE], 1 + calibration[ANGLE_SCALE], calibration[ANGLE_BIAS]
    # equation 4 of the paper
    angle = (theta - a3) / a2 if a1 == 0 else (np.sqrt(4 * a1 * theta + a2**2 - 4 * a1 * a3) - a2) / (2 * a1)
    return (1 + calibration[RANGE_SCALE]) * np.hypot(x, y) + calibration[RANGE_BIAS], angle


@pytest.mark.parametrize("trial", range(20))
def test_a_leg_where_it_stands_leaves_no_residual(trial: int) -> None:
    rng = np.random.default_rng([RNG_SEED, trial])
    rotation, pos = machine(rng)
    rotation_bs, lever = mounting(rng)
    leg, calibration = np.r_[pos[:2] + rng.normal(0, 5, 2), rng.normal(0, 0.2, 2)], systematic(rng)
    height = pos[2] + rng.normal()
    reading = observed(rotation, pos, leg, height, calibration, rotation_bs, lever)
    error, *_ = landmark.leg_residual(
        rotation, pos, leg, calibration, *map(np.asarray, (*reading, height)), rotation_bs, lever
    )
    assert np.abs(error).max() < 1e-11


def test_height_does_not_matter_to_an_upright_leg_seen_from_a_level_machine() -> None:
    heading = so3.exp(np.array([0.0, 0.0, 0.3]))
    leg, none = np.array([3.0, 4.0, 0.0, 0.0]), np.zeros(8)
    flat = [
        landmark.leg_residual(
            heading, np.array([0, 0, z]), leg, none, np.array(5.0), np.array(0.1), np.array(0.5), np.eye(3), np.zeros(3)
        )[0]
        for z in (0.0, 1.7)
    ]
    assert np.array_equal(flat[0], flat[1])
    assert flat[0][0] == pytest.approx(0.0, abs=1e-12)


def test_a_tilted_scan_plane_sees_a_leg_farther_away() -> None:
    """Looking 10 degrees up, a leg 4 m away is met at 4 m / cos 10 deg."""
    pitched = so3.exp(np.array([np.deg2rad(10.0), 0.0, 0.0]))
    error, *_ = landmark.leg_residual(
        pitched, np.zeros(3), np.array([0.0, 4.0, 0.0, 0.0]), np.zeros(8), np.array(4 / np.cos(np.deg2rad(10))),
        np.array(0.0), np.array(0.0), np.eye(3), np.zeros(3),
    )  # fmt: skip
    assert np.abs(error).max() < 1e-12


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("kind", ["leg", "point"])
def test_jacobians(kind: str, angle: float) -> None:
    rng = np.random.default_rng([RNG_SEED, len(kind), round(angle * 1e6)])
    heading = so3.exp(np.array([0.0, 0.0, angle]))
    rotation, pos = heading @ so3.exp(rng.normal(0, 0.1, 3)), rng.normal(0, 20, 3)
    (rotation_bs, lever), calibration = mounting(rng), systematic(rng)
    reading = [np.asarray(4.0), np.asarray(rng.uniform(-3, 3))]
    if kind == "leg":
        function, mark = landmark.leg_residual, np.r_[pos[:2] + rng.normal(0, 4, 2) + [4.0, 0.0], rng.normal(0, 0.2, 2)]
        reading.append(np.asarray(pos[2] + rng.normal()))
    else:
        function, mark = landmark.point_residual, pos + rng.normal(0, 4, 3) + [4.0, 0.0, 0.0]

    def error(rotation_, pos_, mark_, calibration_):
        return function(rotation_, pos_, mark_, calibration_, *reading, rotation_bs, lever)[0]

    _, by_pose, by_mark, by_calibration = function(rotation, pos, mark, calibration, *reading, rotation_bs, lever)
    numeric = [
        central(lambda d: error(*moved(rotation, pos, d), mark, calibration), 6),
        central(lambda d: error(rotation, pos, mark + d, calibration), len(mark)),
        central(lambda d: error(rotation, pos, mark, calibration + d), 8),
    ]
    for exact, differences in zip((by_pose, by_mark, by_calibration), numeric, strict=True):
        np.testing.assert_allclose(exact, differences, atol=2e-7 * max(1.0, np.abs(differences).max()))


def test_bearing_wraps() -> None:
    """A leg straight behind, seen a little to either side of half a turn."""
    for angle in (np.pi - 1e-3, -np.pi + 1e-3):
        error, *_ = landmark.leg_residual(
            np.eye(3), np.zeros(3), np.array([0.0, -4.0, 0.0, 0.0]), np.zeros(8), np.array(4.0), np.array(angle),
            np.array(0.0), np.eye(3), np.zeros(3),
        )  # fmt: skip
        assert abs(error[1]) == pytest.approx(1e-3, rel=1e-6)


def test_broadcasts_over_many() -> None:
    rng = np.random.default_rng(RNG_SEED)
    poses = [machine(rng) for _ in range(5)]
    rotation, pos = np.array([r for r, _ in poses]), np.array([p for _, p in poses])
    (rotation_bs, lever), calibration = mounting(rng), np.array([systematic(rng) for _ in range(5)])
    legs = np.column_stack([pos[:, :2] + 4.0, rng.normal(0, 0.2, (5, 2))])
    planar = [rng.uniform(3, 9, 5), rng.uniform(-1, 1, 5)]
    cases = ((landmark.leg_residual, legs, [*planar, pos[:, 2]]), (landmark.point_residual, pos + 4.0, planar))
    for function, mark, reading in cases:
        together = function(rotation, pos, mark, calibration, *reading, rotation_bs, lever)
        for k in range(5):
            own = [part[k] for part in reading]
            alone = function(rotation[k], pos[k], mark[k], calibration[k], *own, rotation_bs, lever)
            for part, own in zip(together, alone, strict=True):
                np.testing.assert_allclose(part[k], own, rtol=1e-12, atol=1e-12)


def test_seen_leg_is_where_it_is_seen() -> None:
    rng = np.random.default_rng(RNG_SEED)
    rotation, pos = machine(rng)
    rotation_bs, lever = mounting(rng)
    place = landmark.seen_leg(rotation, pos, np.array(6.0), np.array(0.7), rotation_bs, lever)
    reading, none = (np.array(6.0), np.array(0.7)), np.zeros(8)
    leg = np.r_[place[:2], 0.1, -0.1]
    error, *_ = landmark.leg_residual(rotation, pos, leg, none, *reading, place[2], rotation_bs, lever)
    assert np.abs(error).max() < 1e-12
    error, *_ = landmark.point_residual(rotation, pos, place, none, *reading, rotation_bs, lever)
    assert np.abs(error).max() < 1e-12


def test_factor_linearizes_as_the_residual_does() -> None:
    rng = np.random.default_rng(RNG_SEED)
    rotation, pos = machine(rng)
    rotation_bs, lever = mounting(rng)
    values = gtsam.Values()
    values.insert(0, gtsam.Pose3(gtsam.Rot3(rotation), pos))
    values.insert(1, np.r_[pos[:2] + np.array([4.0, 1.0]), 0.1, 0.2])
    values.insert(2, systematic(rng))
    factor = landmark.leg_factor(0, 1, 2, 4.2, 0.3, float(pos[2]), gtsam.noiseModel.Unit.Create(2), rotation_bs, lever)
    jacobian, _ = analytic(factor, values)
    np.testing.assert_allclose(jacobian, factor_jacobian(factor, values), atol=1e-7)


def test_random_attitudes_are_not_special() -> None:
    """The point's residual holds at any attitude, also upside down."""
    rng = np.random.default_rng(RNG_SEED)
    rotation, pos = random_rotation(rng), rng.normal(size=3)
    mark = landmark.seen_leg(rotation, pos, np.array(3.0), np.array(-1.0), np.eye(3), np.zeros(3))
    error, *_ = landmark.point_residual(
        rotation, pos, mark, np.zeros(8), np.array(3.0), np.array(-1.0), np.eye(3), np.zeros(3)
    )
    assert np.abs(error).max() < 1e-12


def family(rng: np.random.Generator, count: int = 3) -> tuple[LegFamily, gtsam.Values]:
    """Readings of different legs at one pose, each taken a known motion away from it."""
    rotation, pos = machine(rng)
    rotation_bs, lever = mounting(rng)
    values = gtsam.Values()
    values.insert(0, gtsam.Pose3(gtsam.Rot3(rotation), pos))
    values.insert(100, systematic(rng))
    for k in range(count):
        values.insert(1 + k, np.r_[pos[:2] + rng.uniform(2, 5, 2), 0.1, 0.2])
    readings = LegFamily(
        np.zeros(count, np.int64), 1 + np.arange(count), np.full(count, 100), so3.exp(rng.normal(0, 0.05, (count, 3))),
        rng.normal(0, 0.1, (count, 3)), rng.uniform(3, 6, count), rng.uniform(-1, 1, count), np.full(count, pos[2]),
        rng.normal(0, 0.05, count), rng.normal(0, 0.01, (count, 3, 7)), rng.uniform(0.01, 0.1, (count, 2)),
        rotation_bs, lever,
    )  # fmt: skip
    return readings, values


def test_readings_one_by_one_are_those_of_the_family() -> None:
    """Also after one of the variables has changed, when what was evaluated together no longer holds."""
    rng = np.random.default_rng(RNG_SEED)
    readings, values = family(rng)
    factors = readings.factors()
    for changed in (None, 2, 100, 0):
        if changed == 0:
            values.update(0, values.atPose3(0).retract(rng.normal(0, 0.1, 6)))
        elif changed is not None:
            values.update(changed, values.atVector(changed) + 0.01)
        expected, *_ = readings.residuals(values)
        for k, factor in enumerate(factors):
            assert list(factor.keys()) == [0, 1 + k, 100]
            np.testing.assert_allclose(factor.unwhitenedError(values), expected[k], atol=1e-13)
            jacobian, right = analytic(factor, values)
            np.testing.assert_allclose(right, -expected[k], atol=1e-13)
            # sigmas of a hundredth make the Jacobians a hundred times larger, and their differences less exact
            np.testing.assert_allclose(jacobian, factor_jacobian(factor, values), atol=2e-5)
