"""The paper's automatic choice and its posterior correction of the mounting, on logs whose errors are known."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from engine_logs import until
from filter_runs import inputs_of
from leg_logs import FAULTLESS, ONE_CUT, beside_legs, blind, misread

from factors import so3
from graphnav.baselines import leg_correction
from graphnav.baselines.inputs import Inputs
from graphnav.baselines.leg_choice import Selection
from graphnav.baselines.leg_correction import Wanted, arrival, correction, face_axes, fit, turned
from graphnav.baselines.leg_filter import Scanner
from graphnav.errors import LogError
from graphnav.log import SensorLog

PLAIN = Scanner(np.eye(3), np.zeros(3), np.array([0.01, np.radians(0.05), 0.01]), upright=True, walk_m_sqrt_s=1e-5)
STRAIGHT = dataclasses.replace(ONE_CUT, bend_m=1e-6, undulation_m=1e-6, att_sigma_deg=(1e-5, 1e-5, 1e-5))


def straight(mounting_deg: float = 0.0) -> SensorLog:
    """A cut of 24 m without noise past legs, by a scanner that is turned about up."""
    lidar = dataclasses.replace(FAULTLESS, mounting_deg=(0.0, 0.0, mounting_deg))
    return blind(beside_legs(dataclasses.replace(STRAIGHT, lidar=lidar), 0, noise=False))


# Equations 30-32 --------------------------------------------------------------------------------------------


def test_eta_is_the_slope_of_the_first_cut() -> None:
    assert correction(np.array([0.35, 349.0, 0.1]), 350.0) == pytest.approx([0.0, 0.0, 1e-3])


def test_a_filter_that_came_out_to_the_right_is_turned_to_the_left() -> None:
    ahead = turned(np.eye(3), np.array([0.0, 0.0, 0.01])) @ [0.0, 1.0, 0.0]
    assert ahead == pytest.approx([-np.sin(0.01), np.cos(0.01), 0.0])


@pytest.mark.parametrize("mounting_deg", [0.5, -0.3])
def test_the_correction_finds_a_mounting_error(mounting_deg: float) -> None:
    """Without other errors eta is the mounting error, to 1 %, and with it the first arrival is on the line."""
    inputs = inputs_of(straight(mounting_deg))
    fitted = fit(inputs, PLAIN, Wanted(mode=2, distance_m=4.5))
    place = fitted.arrival_m[2]
    assert place[0] == pytest.approx(np.radians(mounting_deg) * 24.0, rel=0.01)
    assert np.degrees(fitted.eta_rad) == pytest.approx([0.0, 0.0, mounting_deg], rel=0.01, abs=1e-12)
    assert so3.log(fitted.scanner.rotation_bs) == pytest.approx(fitted.eta_rad)
    assert abs(arrival(inputs, fitted.scanner, fitted.selection, inputs.cycles[0])[0]) < 2e-3


def test_the_face_leads_to_the_surveyed_end_or_along_the_declared_attitude() -> None:
    """A declared heading 0.5 deg off leaves the line to a surveyed end as it is, and turns it without one."""
    log = straight()
    quat = so3.to_quaternion(so3.exp(np.array([0.0, 0.0, np.radians(0.5)])))
    off = dataclasses.replace(log, initial=log.initial.replace(quat_nb_wxyz=quat))
    assert face_axes(inputs_of(off)) == pytest.approx(np.eye(3), abs=1e-6)
    unsurveyed = face_axes(inputs_of(dataclasses.replace(off, surveyed=())))
    assert unsurveyed == pytest.approx(so3.exp(np.array([0.0, 0.0, np.radians(0.5)])), abs=1e-9)


# Steps 1-4 --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "errors, mode",
    [
        ({"range_scale": 6e-4, "range_bias_m": 0.035, "angle_quadratic_per_deg": 4e-5, "angle_scale": -0.0075,
          "angle_bias_deg": 0.0531}, 2),
        ({"angle_quadratic_per_deg": 4e-5}, 7),
    ],
    ids=["table 2", "angle square alone"],
)  # fmt: skip
def test_the_mode_that_arrives_at_the_length_is_chosen(errors: dict[str, float], mode: int) -> None:
    """By `leg_budget`: the paper's scanner is best with legs behind, one with the quadratic error with legs ahead."""
    fitted = fit(inputs_of(misread(straight(), **errors)), PLAIN, Wanted())
    assert fitted.selection == Selection(1, mode, 9.0)
    missed = {tried: abs(place[1] - 24.0) for tried, place in fitted.arrival_m.items()}
    assert missed.keys() == {2, 7}
    assert missed[mode] == min(missed.values())


def test_what_the_user_fixes_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    inputs = inputs_of(straight(0.5))
    assert fit(inputs, PLAIN, Wanted(count=3, mode=4)).selection == Selection(3, 4, 6.0)
    monkeypatch.setattr(leg_correction, "arrival", lambda *_: pytest.fail("nothing is left to be tried"))
    fixed = fit(inputs, PLAIN, Wanted(2, 5, 1.0, picm=False))
    assert fixed.selection == Selection(2, 5, 1.0)
    assert fixed.scanner is PLAIN and not fixed.eta_rad.any() and not fixed.arrival_m
    assert fit(inputs, PLAIN, Wanted(mode=7, picm=False)).selection == Selection(1, 7, 9.0)


# Nothing to choose by ---------------------------------------------------------------------------------------


def broken_off() -> Inputs:
    return inputs_of(until(straight(), 40.0))


def test_a_log_without_an_arrival_is_refused_unless_all_is_fixed() -> None:
    with pytest.raises(LogError, match=r"no cut arrives at the far end; set lidar_filter.mode"):
        fit(broken_off(), PLAIN, Wanted())
    assert fit(broken_off(), PLAIN, Wanted(1, 2, 9.0, picm=False)).selection.mode == 2


def test_a_log_without_a_face_is_refused_unless_its_length_is_not_needed() -> None:
    inputs = inputs_of(dataclasses.replace(straight(), face=None))
    with pytest.raises(LogError, match=r"no \[face\] section; declare face.length_m"):
        fit(inputs, PLAIN, Wanted(mode=2, distance_m=9.0))
    assert fit(inputs, PLAIN, Wanted(mode=2, picm=False)).selection == Selection(1, 2, 9.0)
