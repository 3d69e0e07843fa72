"""What a simulated log does not tell of its ranges."""

from __future__ import annotations

from typing import Any

from graphnav.errors import ConfigError
from graphnav.simulation.carrier import carrier_ranger
from graphnav.simulation.face_end import build_machine, face_end_ranger
from graphnav.simulation.ranging import RangeErrors, Ranger
from graphnav.simulation.roadheader_figures import RoadheaderSpec
from graphnav.simulation.scenarios import resolve
from graphnav.simulation.uwb_figures import FaceEndSpec
from graphnav.simulation.world import Machine, build_world, streams

_NO_UWB = "no UWB and so no ranges; use face-end-uwb, or uwb among the sensors"


def uwb_truth(scenario: str, seed: int = 0, **options: Any) -> RangeErrors:
    """The parts of the range errors of a simulated log, for scoring alone.

    Parameters
    ----------
    scenario, seed, **options : as the log was simulated with.

    Raises
    ------
    ConfigError
        Unknown scenario or option, a value out of range, or a scenario without UWB.
    """
    spec, of = resolve(scenario, options), streams(seed)
    if isinstance(spec, RoadheaderSpec):
        raise ConfigError(f"{scenario}: {_NO_UWB}")
    if isinstance(spec, FaceEndSpec):
        machine: Machine = build_machine(spec, of.machine)
        ranger: Ranger | None = face_end_ranger(spec, of, on=1.0)
    else:
        machine = world = build_world(spec, of.geometry, of.machine)
        ranger = carrier_ranger(world, of, on=1.0)
    if ranger is None:
        raise ConfigError(f"{scenario}: {_NO_UWB}")
    for first, last in machine.blocks():
        t_s, motion, rot_nm = machine.states(first, last)
        ranger.add(t_s, motion, machine.body(rot_nm))
    return ranger.errors()
