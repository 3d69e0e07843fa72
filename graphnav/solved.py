"""What comes of solving a posed problem: the solver's outcome, and which readings it rests on."""

from __future__ import annotations

from dataclasses import dataclass, field

from factors.advance import AdvanceFamily
from graphnav.anchor_doubt import Doubt
from graphnav.camera import Camera
from graphnav.camera_score import CameraScore
from graphnav.initial import States
from graphnav.legs import LegReadings
from graphnav.preintegration import Preintegrated
from graphnav.problem import RangeClock
from graphnav.range_clock import ClockScore
from graphnav.ranges import RangeReadings
from graphnav.rival_paths import Rival
from graphnav.solvers import batch


@dataclass
class Said:
    """What sensors say beside IMU and odometer: what takes part, and what was left out since it disagrees.

    Attributes
    ----------
    legs : the readings of legs that are used, or None; legs_left_out : those that disagree.
    ranges : the UWB ranges that are used, or None; ranges_left_out : those that disagree.
    camera : what the camera says that is used, or None; camera_left_out : what disagrees.
    advances : pairs of legs tied by the push of their support, or None.
    """

    legs: LegReadings | None = None
    legs_left_out: LegReadings | None = None
    ranges: RangeReadings | None = None
    ranges_left_out: RangeReadings | None = None
    camera: Camera | None = None
    camera_left_out: Camera | None = None
    advances: AdvanceFamily | None = None


@dataclass(kw_only=True)
class Solved(Said):
    """A solver's outcome, with the readings that it rests on.

    Attributes
    ----------
    result : estimates and their square-root information.
    data : the condensed sensor data that it was solved with.
    biases_moved : whether the biases still moved at the end; clock_moved : whether the time offset of ranges did;
        camera_late : whether the camera's did.
    clock : with which the ranges were carried.
    clock_score : what the ranges say of a time offset that is no variable, or None; camera_score : what all says of
        the camera's angles and clock that are none.
    suspects : where it did not converge, what of the log stands out.
    causal : the states that an incremental solver knew from the past alone, or None.
    doubt : where ranges contradicted each other, which anchor may be wrong; else None.
    rival : a path that ranges fit as well, or None.
    """

    result: batch.BatchResult
    data: Preintegrated
    biases_moved: bool
    causal: States | None = None
    clock_moved: bool = False
    camera_late: bool = False
    clock: RangeClock = field(default_factory=RangeClock)
    clock_score: ClockScore | None = None
    camera_score: CameraScore | None = None
    doubt: Doubt | None = None
    rival: Rival | None = None
    suspects: str = ""
