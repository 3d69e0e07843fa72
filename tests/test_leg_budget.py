"""The error budget of positioning by legs, against driving past them with a scanner that has these errors."""

from __future__ import annotations

import numpy as np
import pytest

from graphnav.baselines.leg_budget import LegChoice, ScannerErrors, equation_29, error_budget

#: The paper's table 2.
PAPER = ScannerErrors(0.0006, 0.035, 0.00004, 0.9925 - 1, 0.0531)
CASES = {
    "scale": ScannerErrors(range_scale=6e-4),
    "bias": ScannerErrors(range_bias_m=0.035),
    "angle bias": ScannerErrors(angle_bias_deg=0.0531),
    "angle scale": ScannerErrors(angle_scale=-0.0075),
    "angle square": ScannerErrors(angle_square_per_deg=4e-5),
    "all": PAPER,
}


def driven(errors: ScannerErrors, choice: LegChoice, mileage_m: float) -> np.ndarray:
    """Position error in m (right, forward) after driving: every step is the change of what the scanner reads.

    Equations 4 and 25 without linearization, in small steps; each of the chosen legs is used while it is in range.
    """
    step = 1e-3
    moved = np.arange(0.0, mileage_m, step)
    total = np.zeros(2)
    for k in range(choice.count):
        # the leg's place along the face goes from far to near by one spacing, then the next one follows
        low = choice.nearest_m + k * choice.spacing_m
        inside = moved % choice.spacing_m
        along = low + (choice.spacing_m - inside if choice.ahead else inside)
        along = along if choice.ahead else -along
        before, after = (read(errors, choice.distance_m, y) for y in (along, along - step))
        total += (before - after).sum(axis=0) / choice.count
    return total - [0.0, len(moved) * step]


def read(errors: ScannerErrors, distance_m: float, along: np.ndarray) -> np.ndarray:
    """Where the scanner sees a leg, (N, 2) right and forward (equations 2 and 4)."""
    rho, theta = np.hypot(distance_m, along), np.arctan2(distance_m, along)
    rho = (1 + errors.range_scale) * rho + errors.range_bias_m
    a1, a2, a3 = errors.angle_square_per_deg, 1 + errors.angle_scale, errors.angle_bias_deg
    degrees = np.degrees(theta)
    angle = (np.sqrt(4 * a1 * degrees + a2**2 - 4 * a1 * a3) - a2) / (2 * a1) if a1 else (degrees - a3) / a2
    return np.column_stack([-rho * np.sin(np.radians(angle)), rho * np.cos(np.radians(angle))])


@pytest.mark.parametrize("ahead", [True, False])
@pytest.mark.parametrize("count, nearest_m", [(1, 0.0), (1, 7.5), (3, 0.0)])
@pytest.mark.parametrize("case", CASES)
def test_the_budget_is_what_driving_shows(case: str, count: int, nearest_m: float, ahead: bool) -> None:
    """Within 2 percent: the budget is of first order in the errors, and the largest angle error is 0.02 rad."""
    errors, choice = CASES[case], LegChoice(count=count, nearest_m=nearest_m, ahead=ahead)
    shown = driven(errors, choice, 15.0)
    told = error_budget(errors, choice).after(15.0)["total"][:2]
    np.testing.assert_allclose(told, shown, atol=0.02 * np.linalg.norm(shown) + 1e-5)


def test_equation_29_holds_for_ranges_and_not_for_angles() -> None:
    choice = LegChoice(nearest_m=3.0)
    for case in ("scale", "bias"):
        budgets = [make(CASES[case], choice).after(350.0)["total"] for make in (error_budget, equation_29)]
        np.testing.assert_allclose(*budgets, atol=1e-4 * np.linalg.norm(budgets[0]))
    exact, paper = (make(CASES["angle bias"], choice).after(350.0)["total"] for make in (error_budget, equation_29))
    assert abs(exact[1]) < 1e-12 < 0.1 < abs(paper[1])


def test_the_paper_chooses_well_to_look_far() -> None:
    """Table 2's scanner: a larger least distance makes the longitudinal error smaller (figure 7e)."""
    near, far = (error_budget(PAPER, LegChoice(nearest_m=d)).after(350.0)["total"] for d in (0.0, 7.5))
    assert abs(far[1]) < abs(near[1])


def test_attitude_and_mounting_turn_the_way() -> None:
    budget = error_budget(ScannerErrors(pitch_rad=1e-3, heading_rad=2e-3), LegChoice())
    np.testing.assert_allclose(budget.after(350.0)["total"], [0.7, 0.0, -0.35], atol=1e-12)


@pytest.mark.parametrize("wrong", [{"count": 0}, {"distance_m": 0.0}, {"spacing_m": -1.5}, {"nearest_m": -1.0}])
def test_refuses_what_is_no_choice(wrong: dict) -> None:
    with pytest.raises(ValueError, match="expected at least one leg"):
        error_budget(ScannerErrors(), LegChoice(**wrong))
