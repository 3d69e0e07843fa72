"""Cutting cycles, face coordinate and closed-path points against the simulated truth."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np
import pytest
from engine_logs import MEMS, TWO_CUTS, simulated, until, world

from graphnav.errors import LogError
from graphnav.frontends.cutting_cycles import closed_path_points, face_coordinates, find_cycles, mileage
from graphnav.log import Events, Odometer, Push, SensorLog
from graphnav.simulation.motion import Leg
from graphnav.simulation.scenarios import FULL_SHIFT

SEEDS = range(4)


def cuts(seed: int = 0, spec=MEMS) -> list[Leg]:
    """The true cuts."""
    return [leg for leg in world(spec, seed).timeline.legs if leg.cycle]


def eventless(log: SensorLog) -> SensorLog:
    return dataclasses.replace(log, events=None)


def with_events(log: SensorLog, *rows: tuple[float, str, int]) -> SensorLog:
    t_s, kind, cycle = zip(*rows, strict=True)
    return dataclasses.replace(log, events=Events(t_s=t_s, kind=kind, cycle=cycle))


def with_face(log: SensorLog, **changes) -> SensorLog:
    assert log.face is not None
    return dataclasses.replace(log, face=log.face.replace(**changes))


# cycles -----------------------------------------------------------------------------------------------------


def test_cycles_from_events() -> None:
    found = find_cycles(simulated())
    assert [c.number for c in found] == [1, 2, 3, 4]
    assert [c.forward for c in found] == [True, False, True, False]
    for cycle, leg in zip(found, cuts(), strict=True):
        assert cycle.start_s == pytest.approx(leg.start_s)
        assert cycle.end_s == pytest.approx(leg.end_s)


@pytest.mark.parametrize("seed", SEEDS)
def test_cycles_without_events_agree_within_a_second(seed: int) -> None:
    """Four cuts and no oblique cut among them, whatever the scale factor (5 %, 1 sigma), from stop to stop."""
    found = find_cycles(eventless(simulated(seed=seed)))
    assert [c.number for c in found] == [1, 2, 3, 4]
    assert [c.forward for c in found] == [True, False, True, False]
    for cycle, leg in zip(found, cuts(seed), strict=True):
        assert abs(cycle.start_s - leg.start_s) < 0.5  # the first half second of a start covers a centimetre
        assert abs(cycle.end_s - leg.end_s) < 0.5


@pytest.mark.slow
def test_cycles_of_a_full_shift_without_events() -> None:
    spec = dataclasses.replace(FULL_SHIFT, duration_s=2.4 * 3600)
    log = simulated(spec, 1)
    found = find_cycles(eventless(log))
    true = [leg for leg in world(spec, 1).timeline.legs if leg.cycle]
    assert [c.forward for c in found] == [True, False]
    for cycle, leg in zip(found, true, strict=False):
        assert abs(cycle.start_s - leg.start_s) < 1.0
        assert abs(cycle.end_s - leg.end_s) < 1.0


@pytest.mark.parametrize("events", [True, False])
def test_a_log_that_ends_within_a_cut(events: bool) -> None:
    legs = cuts()
    log = until(simulated(), (legs[1].start_s + 0.8 * (legs[1].end_s - legs[1].start_s)))
    found = find_cycles(log if events else eventless(log))
    assert [c.number for c in found] == [1, 2]
    assert found[0].end_s is not None
    assert found[1].end_s is None


@pytest.mark.parametrize("events", [True, False])
def test_a_log_that_ends_within_the_oblique_cut(events: bool) -> None:
    legs = cuts()
    log = until(simulated(), (legs[0].end_s + legs[1].start_s) / 2)
    found = find_cycles(log if events else eventless(log))
    assert len(found) == 1
    assert found[0].end_s is not None


def test_a_log_that_ends_soon_after_the_start_of_a_cut_has_no_such_cycle_without_events() -> None:
    legs = cuts()
    log = eventless(until(simulated(), legs[1].start_s + 20))
    assert [c.number for c in find_cycles(log)] == [1]


def test_no_cycles_without_face_or_odometer() -> None:
    log = eventless(simulated())
    assert find_cycles(dataclasses.replace(log, face=None)) == ()
    assert find_cycles(dataclasses.replace(log, odometer=None)) == ()


@pytest.mark.parametrize(
    ("rows", "message", "row"),
    [
        ([(60.0, "cut_start", 1), (70.0, "cut_start", 1)], "second cut_start of cycle 1", 2),
        ([(60.0, "cut_end", 3)], "cut_end of cycle 3 without its cut_start", 1),
        ([(60.0, "cut_start", 1), (200.0, "cut_end", 1), (300.0, "cut_end", 1)], "second cut_end of cycle 1", 3),
    ],
)
def test_events_that_do_not_pair_up(rows: list[tuple[float, str, int]], message: str, row: int) -> None:
    with pytest.raises(LogError, match=f"table events, row {row}, kind: {message}"):
        find_cycles(with_events(simulated(), *rows))


def test_mileage_is_the_signed_way() -> None:
    leg = cuts()[0]
    clean = simulated(noise=False)
    assert clean.odometer is not None
    way = mileage(clean.odometer)
    at_end = np.interp(leg.end_s, clean.odometer.t_s, way)
    assert at_end == pytest.approx(MEMS.length_m, abs=0.1)  # short by the cosine of the wobble, 0.1 %
    assert way[-1] == pytest.approx(0.0, abs=0.1)  # four cuts: back where it began
    two = Odometer(t_s=[0.0, 1.0, 3.0], speed_m_s=[1.0, 2.0, -1.0], **_odometer_params(clean))
    assert np.allclose(mileage(two), [0.0, 1.5, 2.5])


def _odometer_params(log: SensorLog) -> dict[str, object]:
    assert log.odometer is not None
    return {f.name: getattr(log.odometer, f.name) for f in log.odometer.param_fields()}


# face coordinate --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", SEEDS)
def test_face_coordinate_against_truth(seed: int) -> None:
    """The unknown scale factor (5 %: 2 m at mid-face) drops out; odometer noise and slip remain.

    Noise of 1 cm/s at 10 Hz is a walk of 4 cm over a cut, half of that when tied at both ends: 0.15 m is 7 sigma.
    """
    log = simulated(seed=seed)
    for found, leg in zip(face_coordinates(log, find_cycles(log)), cuts(seed), strict=True):
        t = np.linspace(leg.start_s + 0.1, leg.end_s - 0.1, 200)
        true = leg.arc.u_of_s(leg.profile.at(t - leg.start_s)[0])
        s = np.interp(t, found.t_s, found.s_m)
        assert np.abs(s - true).max() < 0.15
        ends = [0, MEMS.length_m] if leg.cycle % 2 else [MEMS.length_m, 0]
        assert found.s_m[[0, -1]] == pytest.approx(ends, abs=2e-3)  # the last samples' noise
        for place in (5.0, 20.0, 40.0):
            passed = np.interp(place, np.sort(true), t if leg.cycle % 2 else t[::-1])
            assert found.time_at(place) == pytest.approx(passed, abs=0.15 / MEMS.speed_m_s)


def test_a_cut_that_is_broken_off_takes_the_scale_of_the_others() -> None:
    legs = cuts()
    end = legs[1].start_s + 0.8 * (legs[1].end_s - legs[1].start_s)
    log = until(simulated(), end)
    found = face_coordinates(log, find_cycles(log))[1]
    true = float(legs[1].arc.u_of_s(legs[1].profile.at(np.array([end - legs[1].start_s]))[0])[0])
    assert found.s_m[-1] == pytest.approx(true, abs=0.2)


@pytest.mark.parametrize("length_m", [30.0, 70.0])
def test_a_wrong_face_length_is_refused(length_m: float) -> None:
    log = with_face(simulated(), length_m=length_m)
    with pytest.raises(LogError) as caught:
        face_coordinates(log, find_cycles(log))
    text = str(caught.value)
    assert "[face], length_m: a cut covers 4" in text
    assert f"the face is {length_m:.2f} m" in text
    assert "correct length_m" in text


# closed path ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("interval_m", "count"), [(2.0, 23), (6.0, 8), (10.0, 5), (22.3, 3), (44.6, 2)])
def test_points_per_pair_of_cycles(interval_m: float, count: int) -> None:
    """The ends of the face are always among them; a last full interval too close to the far end is not."""
    log = simulated()
    points = closed_path_points(log, find_cycles(log), interval_m)
    assert len(points) == 3 * count
    assert [p.second_s for p in points] == sorted(p.second_s for p in points)
    for cycle in (1, 2, 3):
        s = sorted(p.s_m for p in points if p.cycle == cycle)
        assert s[0] == 0.0
        assert s[-1] == MEMS.length_m
        assert np.diff(s)[:-1] == pytest.approx(interval_m)
        assert sum(p.at_end for p in points if p.cycle == cycle) == 2
    assert all(p.at_end == (p.s_m in (0.0, MEMS.length_m)) for p in points)


def test_interval_defaults_to_the_logs() -> None:
    log = with_face(simulated(), interval_m=6.0)
    assert len(closed_path_points(log, find_cycles(log))) == 24


@pytest.mark.parametrize("seed", SEEDS)
def test_points_are_the_same_place_one_push_apart(seed: int) -> None:
    """What the closed-path factors state, judged by truth: the push and its 3 cm to the right and up.

    Over 69 points a sigma is known to 9 %: bounds at five of these and at five standard errors of the mean.
    """
    log = simulated(seed=seed)
    cycles = find_cycles(log)
    points = closed_path_points(log, cycles)
    timeline = world(MEMS, seed).timeline
    first, second = (np.array(t) for t in zip(*((p.first_s, p.second_s) for p in points), strict=True))
    assert (second > first).all()
    for p in points:
        at, after = cycles[p.cycle - 1], cycles[p.cycle]
        assert at.end_s is not None and after.end_s is not None
        assert at.start_s - 1e-6 <= p.first_s <= at.end_s + 1e-6
        assert after.start_s - 1e-6 <= p.second_s <= after.end_s + 1e-6
    order = np.argsort(first)
    before = timeline.at(first[order])
    moved = timeline.at(second).pos_n[order] - before.pos_n
    in_m = before.rot_nm.inv().apply(moved)
    assert in_m[:, 0].mean() == pytest.approx(0.4, abs=5 * 0.03 / np.sqrt(69))
    assert in_m[:, 2].mean() == pytest.approx(0.0, abs=5 * 0.03 / np.sqrt(69))
    assert in_m[:, [0, 2]].std(axis=0) == pytest.approx([0.03, 0.03], rel=0.45)
    # along the face: matched by odometer, and by the machine's stops at the ends
    assert np.abs(in_m[:, 1]).max() < 0.2
    ends = np.array([p.at_end for p in points])[order]
    assert np.abs(in_m[ends, 1]).max() < 0.05


def test_a_broken_off_cut_gives_the_points_that_it_passed() -> None:
    legs = cuts()
    log = until(simulated(), legs[1].start_s + 0.8 * (legs[1].end_s - legs[1].start_s))
    points = closed_path_points(log, find_cycles(log))
    s = np.array([p.s_m for p in points])
    assert s.max() == MEMS.length_m  # cycle 2 comes back from the far end
    assert 7 < s.min() < 12
    assert len(points) == 23 - np.ceil(s.min() / 2)
    assert max(p.second_s for p in points) <= log.odometer.t_s[-1]


def test_no_points_without_face_or_with_one_cycle() -> None:
    log = simulated()
    assert closed_path_points(dataclasses.replace(log, face=None), find_cycles(log)) == ()
    assert closed_path_points(log, find_cycles(log)[:1]) == ()
    # cycles that do not follow each other are not compared
    assert closed_path_points(log, (find_cycles(log)[0], find_cycles(log)[2])) == ()


# push -------------------------------------------------------------------------------------------------------


def test_measured_push_replaces_the_declared_one_where_it_was_measured() -> None:
    log = simulated()
    push = Push(
        t_s=[300.0, 301.0, 302.0, 600.0], cycle=[1, 1, 1, 2], s_m=[20.0, 10.0, 30.0, 20.0], push_m=[0.5, 0.3, 0.6, 0.45]
    )
    points = closed_path_points(dataclasses.replace(log, push=push), find_cycles(log))
    by_place = {(p.cycle, round(p.s_m, 6)): p.push_m for p in points}
    assert by_place[1, 10.0] == pytest.approx(0.3)
    assert by_place[1, 14.0] == pytest.approx(0.38)  # between measurements
    assert by_place[1, 26.0] == pytest.approx(0.56)
    assert by_place[1, 8.0] == pytest.approx(0.3)  # one interval beyond the last measurement
    assert by_place[1, 6.0] == 0.4
    assert by_place[1, 34.0] == 0.4
    assert by_place[2, 20.0] == by_place[2, 22.0] == pytest.approx(0.45)
    assert by_place[2, 24.0] == 0.4
    assert {push for (cycle, _), push in by_place.items() if cycle == 3} == {0.4}


def test_two_cut_spec_of_these_tests_has_two_cycles() -> None:
    log = simulated(TWO_CUTS)
    assert len(find_cycles(log)) == len(find_cycles(eventless(log))) == 2
    assert [a.end_s < b.start_s for a, b in pairwise(find_cycles(log))] == [True]


def test_a_reversal_without_a_stop_ends_a_cut_near_its_turn() -> None:
    """No rest next to it: the time at which all but 0.2 % of the cut is covered."""
    log = simulated()
    assert log.odometer is not None
    t = np.arange(1, 4001) / 10
    speed = np.where(t < 160, 0.3, -0.3) * np.clip(np.minimum(np.abs(t - 160), 3) / 3, 0, 1)
    odometer = Odometer(t_s=t, speed_m_s=speed, **_odometer_params(log))
    found = find_cycles(dataclasses.replace(eventless(log), odometer=odometer))
    assert [c.forward for c in found] == [True, False]
    assert found[0].end_s == pytest.approx(160.0, abs=2.0)
    assert found[1].start_s == pytest.approx(160.0, abs=2.0)
