"""The paper's filter: its measurement matrix, how a leg comes into use, consistency, and the error budget it obeys."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from filter_runs import errors, inputs_of
from leg_logs import ONE_CUT, SMOOTH, beside_legs, blind, misread
from scipy import stats

from factors import so3
from factors.landmark import seen_leg
from graphnav._metrics import truth_at
from graphnav.baselines import leg_measurements as measure
from graphnav.baselines.leg_budget import LegChoice, ScannerErrors, error_budget
from graphnav.baselines.leg_choice import Selection
from graphnav.baselines.leg_filter import LegFilter, Scanner
from graphnav.baselines.states import PHI, POS
from graphnav.config import Config
from graphnav.smooth import smooth

SIGMA = np.array([0.01, np.radians(0.05), 0.01])
PLAIN = Scanner(np.eye(3), np.zeros(3), SIGMA, upright=True, walk_m_sqrt_s=1e-5)
#: No correction, white noise: the model of `leg_logs` to the letter.
WHITE = Config.from_dict(
    {"lidar_filter": {"picm": False, "mode": 2, "distance_m": 4.5, "independent_s": 0.0, "height_walk_m_sqrt_s": 1e-5}}
)


def random_case(seed: int):
    """Poses, places of two legs, readings and a mounting, none of them special."""
    rng = np.random.default_rng(seed)
    rotation, pos = so3.exp(0.3 * rng.standard_normal((3, 3))), rng.standard_normal((3, 3))
    mounting, lever = so3.exp(0.2 * rng.standard_normal(3)), rng.standard_normal(3)
    range_m, angle_rad = rng.uniform(4, 10, (3, 2)), rng.uniform(0.3, 2.8, (3, 2))
    exact = seen_leg(rotation[:, None], pos[:, None], range_m, angle_rad, mounting, lever)
    return rotation, pos, exact + 0.1 * rng.standard_normal(exact.shape), range_m, angle_rad, mounting, lever


# Equations 19-23 --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_h_is_the_derivative_of_the_measurement(seed: int) -> None:
    """By central differences of 1e-6 in every state; a truth that differs by x makes z = h x."""
    rotation, pos, place, range_m, angle_rad, mounting, lever = random_case(seed)
    h, _ = measure.leg_rows(rotation, pos, place, range_m, angle_rad, SIGMA, mounting, lever)

    def z_at(x: np.ndarray) -> np.ndarray:
        turned, moved = so3.exp(x[PHI]) @ rotation, pos + x[POS]
        shifted = place + np.stack([x[measure.leg(0)], x[measure.leg(1)]])
        return measure.leg_rows(turned, moved, shifted, range_m, angle_rad, SIGMA, mounting, lever)[1]

    numeric = np.empty_like(h)
    for k in range(h.shape[-1]):
        step = np.zeros(h.shape[-1])
        step[k] = 1e-6
        numeric[..., k] = -(z_at(step) - z_at(-step)) / 2e-6
    np.testing.assert_allclose(h, numeric, atol=2e-6 * np.abs(h).max())


def test_h_has_the_papers_blocks() -> None:
    """Equation 23: attitude, position and the leg's own columns alone; no velocity, no bias, no other leg."""
    rotation, pos, place, *readings, mounting, lever = random_case(9)
    h, _ = measure.leg_rows(rotation, pos, place, *readings, SIGMA, mounting, lever)
    assert not h[..., 0:3].any() and not h[..., 9:15].any()
    assert not h[:, 0, :, measure.leg(1)].any() and not h[:, 1, :, measure.leg(0)].any()
    np.testing.assert_allclose(h[:, 0, :, measure.leg(0)], -h[:, 0, :, POS], atol=1e-9)


# Equation 11 ------------------------------------------------------------------------------------------------


def test_a_new_legs_error_is_that_of_pose_and_reading() -> None:
    """Against 200,000 draws of the pose error and the noise: each entry of the covariance within 5 sigma."""
    rng = np.random.default_rng(1)
    rotation, pos, _, range_m, angle_rad, mounting, lever = random_case(4)
    rotation, pos, range_m, angle_rad = rotation[:1], pos[:1], range_m[:1, :1], angle_rad[:1, :1]
    place = seen_leg(rotation[:, None], pos[:, None], range_m, angle_rad, mounting, lever)
    h, _ = measure.leg_rows(rotation, pos, place, range_m, angle_rad, SIGMA, mounting, lever)
    sigma = np.concatenate([np.full(3, 0.1), np.full(3, 1e-3), np.full(3, 0.02), np.full(6, 1e-3)])
    x, p = np.zeros(18), np.zeros((18, 18))
    p[:15, :15] = np.diag(sigma**2)
    measure.absorb(h[0, 0], 0, x, p)
    count = 200_000
    error, noise = sigma * rng.standard_normal((count, 15)), SIGMA * rng.standard_normal((count, 3))
    true_rotation = so3.exp(error[:, PHI]) @ rotation
    exact = seen_leg(true_rotation, pos + error[:, POS], range_m[0] - noise[:, 0], angle_rad[0] - noise[:, 1],
                     mounting, lever)  # fmt: skip
    exact += noise[:, 2:] * (true_rotation @ mounting)[:, :, 2]
    states = np.concatenate([error, exact - place[0, 0]], axis=1)
    drawn = states.T @ states / count
    spread = np.sqrt((np.outer(np.diag(p), np.diag(p)) + p**2) / count)
    assert (np.abs(drawn - p)[15:] < 5 * spread[15:] + 1e-12).all()


# Consistency ------------------------------------------------------------------------------------------------


def test_errors_are_as_large_as_the_covariances_say() -> None:
    """Twelve logs without systematic errors; position and attitude at the end; false-alarm rate 1e-4.

    One draw each. Noise and start are drawn with the declared sigmas, the track is smooth and the legs are upright.
    """
    found: dict[str, list[float]] = {"position": [], "attitude": []}
    squares: list[np.ndarray] = []
    for seed in range(12):
        log = beside_legs(ONE_CUT, seed)
        run = smooth(blind(log), WHITE, "lidar-ekf")
        attitude, pos = errors(run, log)
        cov = run.trajectory.cov[-1]
        found["position"].append(float(pos[-1] @ np.linalg.solve(cov[3:6, 3:6], pos[-1])))
        found["attitude"].append(float(attitude[-1] @ np.linalg.solve(cov[:3, :3], attitude[-1])))
        innovations = run.innovations
        squares.append(innovations.normalized[innovations.kind < 2] ** 2)
    low, high = stats.chi2.interval(1 - 1e-4 / 3, 36)
    for name, values in found.items():
        assert low < sum(values) < high, f"{name}: {sum(values):.1f}, expected {low:.1f} to {high:.1f}"
    planar = np.concatenate(squares)
    low, high = stats.chi2.interval(1 - 1e-4 / 3, len(planar))
    assert low < planar.sum() < high, f"range and bearing: {planar.mean():.3f} of {len(planar)}"


# Systematic errors ------------------------------------------------------------------------------------------

CASES = {
    "range scale": {"range_scale": 6e-4},
    "range bias": {"range_bias_m": 0.035},
    "angle bias": {"angle_bias_deg": 0.0531},
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("mode", [2, 7])
def test_systematic_errors_cost_what_the_budget_says(case: str, mode: int) -> None:
    """On a straight track without noise: within 3 % of equations 25-27 over the cut, and 1 mm.

    The heading is known: as the machine sets out, the filter would take some of the error for one of the heading.
    """
    straight = dataclasses.replace(ONE_CUT, bend_m=1e-6, undulation_m=1e-6, att_sigma_deg=(1e-5, 1e-5, 1e-5))
    log = misread(beside_legs(straight, 0, noise=False), **CASES[case])
    inputs = inputs_of(blind(log))
    last = inputs.index(inputs.cycles[0].end_s)
    forward = LegFilter(inputs, PLAIN, Selection(1, mode, 4.5))
    forward.run(last)
    _, true_n, _ = truth_at(log.truth, inputs.keyframe_s)
    shown = (forward.estimates.pos_n[last] - true_n[last])[:2]
    expected = error_budget(ScannerErrors(**CASES[case]), LegChoice(nearest_m=4.5, ahead=mode == 7)).after(
        SMOOTH.length_m
    )["total"][:2]
    np.testing.assert_allclose(shown, expected, atol=0.03 * np.linalg.norm(expected) + 1e-3)


def test_a_fixed_point_takes_pitching_for_descent() -> None:
    """With wobble the paper's fixed points lose the height; points that slide on the leg do not."""
    wobbling = dataclasses.replace(ONE_CUT, slip_sigma_m_s=3e-3)
    log = beside_legs(wobbling, 3)
    worst = {}
    for leg in ("line", "point"):
        chosen = WHITE.model_dump()
        chosen["lidar_filter"] |= {"leg": leg, "height_walk_m_sqrt_s": 3e-3}
        worst[leg] = np.abs(errors(smooth(blind(log), Config.from_dict(chosen), "lidar-ekf"), log)[1][:, 2]).max()
    assert worst["line"] < 0.1
    assert worst["point"] > 3 * worst["line"]
