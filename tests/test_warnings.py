"""Warnings of a run: few, and each leads somewhere."""

from __future__ import annotations

import dataclasses

from engine_logs import SHORT, simulated

from graphnav.config import Config
from graphnav.log import Position
from graphnav.smooth import smooth


def test_a_sound_log_gives_no_warning() -> None:
    assert smooth(simulated(SHORT)).diagnostics.warnings == []


def test_positions_outside_the_record_are_counted() -> None:
    log = simulated(SHORT)
    assert log.imu is not None
    start = log.initial.pos_n_m  # type: ignore[union-attr]
    late = Position(t_s=[1.0, log.imu.t_s[-1] + 5.0], pos_n_m=[start, start], sigma_n_m=[[0.1] * 3] * 2)
    found = smooth(dataclasses.replace(log, position=late)).diagnostics.warnings
    total = 2 + len(log.surveyed)
    assert any(f"of {total} positions and surveyed points are outside the IMU record" in w for w in found), found


def test_a_face_without_cuts_is_said() -> None:
    log = simulated(SHORT)
    assert log.face is not None
    found = smooth(dataclasses.replace(log, events=None, face=log.face.replace(length_m=4460.0))).diagnostics.warnings
    assert any("no cut was found" in w for w in found), found


def test_biases_that_still_move_are_said() -> None:
    """A gyro bias far from what the first rest shows, because rest is not used, and one round only."""
    log = simulated(SHORT)
    assert log.imu is not None
    biased = log.imu.replace(gyro_b_rad_s=log.imu.gyro_b_rad_s + 0.02, gyro_bias_deg_h=8000.0)
    log = dataclasses.replace(log, imu=biased)
    configs = [Config.from_dict({"rest": {"use": False}, "batch": {"bias_move_rounds": n}}) for n in (1, 3)]
    once, thrice = (smooth(log, chosen).diagnostics.warnings for chosen in configs)
    assert any("the biases still moved" in w for w in once), once
    assert not any("the biases still moved" in w for w in thrice), thrice
