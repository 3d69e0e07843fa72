"""Where keyframes are placed, and what else the front end finds."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from engine_logs import MEMS, simulated, until
from hypothesis import given
from hypothesis import strategies as st

from graphnav.config import Config
from graphnav.errors import LogError
from graphnav.frontends.cutting_cycles import mileage
from graphnav.keyframes import Frontend, place_keyframes, run_frontend
from graphnav.log import Position, SurveyedPoint


def config(**sections) -> Config:
    return Config.from_dict(sections)


def frontend(**sections) -> Frontend:
    return run_frontend(simulated(), config(**sections))


# policy -----------------------------------------------------------------------------------------------------


def test_the_whole_record_is_covered() -> None:
    found = frontend()
    imu = simulated().imu
    assert imu is not None
    assert found.keyframe_s[0] == imu.start_s
    assert imu.start_s == pytest.approx(0.0, abs=1e-12)
    assert found.keyframe_s[-1] == imu.t_s[-1]
    assert (np.diff(found.keyframe_s) > 1e-3).all()


def test_every_measurement_that_needs_one_has_a_keyframe_at_its_time() -> None:
    found = frontend()
    wanted = [p.first_s for p in found.closed_path] + [p.second_s for p in found.closed_path]
    wanted += [t for t, _, _ in found.fixes]
    wanted += [t for c in found.cycles for t in (c.start_s, c.end_s) if t is not None]
    assert len(wanted) == 2 * 69 + 1 + 8
    for t in wanted:
        assert abs(found.keyframe_s[found.index(t)] - t) < 1e-3


@pytest.mark.parametrize("interval_s", [0.2, 0.5, 1.0, 5.0])
def test_keyframes_are_no_further_apart_than_asked_for(interval_s: float) -> None:
    steps = np.diff(frontend(keyframes={"interval_s": interval_s}).keyframe_s)
    assert steps.max() < 1.3 * interval_s + 1e-9
    assert np.median(steps) <= interval_s + 1e-9


def test_events_may_be_left_out() -> None:
    without = frontend(keyframes={"events": False}, closed_path={"form": "off"}, position={"use": False})
    # every whole second; the last one is left out, 0.02 s before the end of the record
    assert np.allclose(without.keyframe_s[:-1], np.arange(len(without.keyframe_s) - 1), atol=1e-9)
    # an event on a whole second coincides; one between seconds gets its own
    between = [c.end_s for c in without.cycles if c.end_s is not None and abs(c.end_s - round(c.end_s)) > 0.01]
    assert between
    with_events = frontend(closed_path={"form": "off"}, position={"use": False})
    for t in between:
        assert np.abs(with_events.keyframe_s - t).min() < 1e-3
    assert all(np.abs(without.keyframe_s - t).min() > 1e-3 for t in between)


def test_distance_between_keyframes() -> None:
    """0.1 m by odometer: a third of a second at 0.3 m/s, the regular second at rest."""
    log = simulated()
    found = run_frontend(log, config(keyframes={"distance_m": 0.1}))
    assert log.odometer is not None
    way = np.abs(np.diff(np.interp(found.keyframe_s, log.odometer.t_s, mileage(log.odometer))))
    assert way.max() < 0.2  # where it starts, the last part of a second is travelled fastest
    assert np.quantile(way, 0.97) < 0.13
    resting = (found.keyframe_s > 1) & (found.keyframe_s < MEMS.static_s - 1)
    assert np.allclose(np.diff(found.keyframe_s[resting]), 1.0)
    assert (np.diff(found.keyframe_s) > 1e-3).all()


@given(
    st.lists(st.floats(0.0, 30.0), max_size=40),
    st.sampled_from([0.25, 0.5, 1.0, 2.0]),
    st.sampled_from([None, 0.05, 0.3]),
)
def test_any_measurement_times_keep_the_rules(wanted: list[float], interval_s: float, distance_m: float | None) -> None:
    """Ascending, apart, every wanted time met to a millisecond, none further apart than 1.3 intervals."""
    log, chosen = until(simulated(), 70.0), config(keyframes={"interval_s": interval_s, "distance_m": distance_m})
    found = place_keyframes(40.0, 70.0, np.array(wanted, float) + 40.0, chosen, log)
    assert found[0] == 40.0
    assert found[-1] == 70.0
    steps = np.diff(found)
    assert steps.min() > 1e-3 * (1 - 1e-6)
    assert steps.max() < 1.3 * interval_s + 1e-9
    for t in wanted:
        assert np.abs(found - t - 40.0).min() <= 1e-3 + 1e-12


def test_nearest_keyframe() -> None:
    found = Frontend(np.array([0.0, 1.0, 1.5, 4.0]), (), (), np.zeros((0, 2)), ())
    nearest = {-1.0: 0, 0.0: 0, 0.49: 0, 0.51: 1, 1.2: 1, 1.3: 2, 2.7: 2, 2.8: 3, 4.0: 3, 9.0: 3}
    assert {t: found.index(t) for t in nearest} == nearest


# fixes ------------------------------------------------------------------------------------------------------


def with_positions(*t_s: float):
    positions = Position(t_s=list(t_s), pos_n_m=[[t, 0.0, 1.0] for t in t_s], sigma_n_m=[[0.1, 0.2, 0.3] for _ in t_s])
    return dataclasses.replace(simulated(), position=positions, surveyed=())


def test_positions_become_fixes_in_order_of_time() -> None:
    log = dataclasses.replace(
        with_positions(10.0, 20.25, 30.0),
        surveyed=(SurveyedPoint(pos_n_m=[1.0, 2.0, 3.0], sigma_m=0.02, t_s=15.5),),
    )
    found = run_frontend(log, Config())
    assert [t for t, _, _ in found.fixes] == [10.0, 15.5, 20.25, 30.0]
    assert np.array_equal(found.fixes[1][2], [0.02, 0.02, 0.02])
    assert np.array_equal(found.fixes[2][1], [20.25, 0.0, 1.0])
    assert np.array_equal(found.fixes[2][2], [0.1, 0.2, 0.3])


def test_positions_outside_the_imu_record_are_left_out() -> None:
    log = with_positions(-5.0, 0.0, 10.0, 5000.0)
    assert [t for t, _, _ in run_frontend(log, Config()).fixes] == [0.0, 10.0]


def test_positions_may_be_switched_off() -> None:
    assert run_frontend(with_positions(10.0), config(position={"use": False})).fixes == ()


@pytest.mark.parametrize(("end", "cycle", "at_start"), [("far", 1, False), ("near", 1, True)])
def test_a_surveyed_end_is_a_fix_at_the_first_arrival(end: str, cycle: int, at_start: bool) -> None:
    log = simulated()
    log = dataclasses.replace(log, surveyed=(SurveyedPoint(pos_n_m=[1.0, 2.0, 3.0], sigma_m=0.02, end=end),))
    found = run_frontend(log, Config())
    expected = found.cycles[cycle - 1].start_s if at_start else found.cycles[cycle - 1].end_s
    assert [t for t, _, _ in found.fixes] == [expected]


def test_a_surveyed_end_that_is_never_reached_is_no_fix() -> None:
    log = until(simulated(), 150.0)  # within the first cut
    assert run_frontend(log, Config()).fixes == ()


# the rest of the front end ----------------------------------------------------------------------------------


def test_switches() -> None:
    assert frontend(closed_path={"form": "off"}).closed_path == ()
    assert frontend(rest={"use": False}).rest_s.shape == (0, 2)
    assert len(frontend(closed_path={"interval_m": 10.0}).closed_path) == 15
    assert len(frontend(closed_path={"form": "absolute"}).closed_path) == 69


def test_closed_path_needs_an_odometer() -> None:
    log = dataclasses.replace(simulated(), odometer=None)
    found = run_frontend(log, Config())
    assert found.closed_path == ()
    assert len(found.cycles) == 4  # the events are still there


def test_rest_is_found() -> None:
    spans = frontend().rest_s
    assert spans[0, 0] == pytest.approx(0.0, abs=1e-9)
    assert spans[0, 1] == pytest.approx(MEMS.static_s, abs=1.0)
    # the start, two pauses before and after each of the two legs of three oblique cuts, the tail
    assert len(spans) == 1 + 3 * 3 + 1


def test_smoothing_needs_an_imu() -> None:
    with pytest.raises(LogError, match="no imu table"):
        run_frontend(dataclasses.replace(simulated(), imu=None), Config())
