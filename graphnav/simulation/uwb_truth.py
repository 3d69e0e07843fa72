"""What a simulated log does not tell of its ranges."""

from __future__ import annotations

from typing import Any

from graphnav.simulation.face_end import build_machine, face_end_ranger
from graphnav.simulation.ranging import RangeErrors
from graphnav.simulation.scenarios import resolve
from graphnav.simulation.uwb_figures import FaceEndSpec
from graphnav.simulation.world import streams


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
    from graphnav.errors import ConfigError

    spec, of = resolve(scenario, options), streams(seed)
    if not isinstance(spec, FaceEndSpec):
        raise ConfigError(f"{scenario}: no UWB and so no ranges; use face-end-uwb")
    machine, ranger = build_machine(spec, of.machine), face_end_ranger(spec, of, on=1.0)
    t_s, motion, rot_nm = machine.states(0, machine.count)
    ranger.add(t_s, motion, machine.body(rot_nm))
    return ranger.errors()
