"""Names of simulated logs: scenario, options and seed, made and read back.

``shearer-mems_seed3``, ``shearer-mems_interval_m=6_par=2_seed3``: options at their default are left out.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from graphnav.simulation.scenarios import BUILDERS

_SAID = ("no", "yes")
_OPTION = r"_[a-z][a-z_]*=[^_=]+"
_NAME = re.compile(rf"(?P<scenario>[a-z0-9-]+)(?P<options>({_OPTION})*?)(_seed(?P<seed>\d+))?")


@dataclass(frozen=True)
class Simulated:
    """What a log was simulated from; the seed is None where the name tells none."""

    scenario: str
    options: dict[str, Any]
    seed: int | None


def log_name(scenario: str, options: Mapping[str, Any], seed: int | None) -> str:
    """The name of the log that a scenario with options gives for a seed; of all its logs where that is None."""
    defaults = _defaults(scenario)
    changed = {name: value for name, value in options.items() if _text(value) != _text(defaults.get(name))}
    told = "".join(f"_{name}={_text(changed[name])}" for name in sorted(changed))
    return scenario + told + ("" if seed is None else f"_seed{seed}")


def parse_name(name: str) -> Simulated | None:
    """What a log of this name was simulated from; None for a name that `log_name` does not make."""
    found = _NAME.fullmatch(name)
    if found is None or found["scenario"] not in BUILDERS:
        return None
    defaults, options = _defaults(found["scenario"]), {}
    for part in re.findall(_OPTION, found["options"]):
        option, text = part[1:].split("=")
        if option not in defaults:
            return None
        try:
            options[option] = _value(text, defaults[option])
        except ValueError:
            return None
    return Simulated(found["scenario"], options, None if found["seed"] is None else int(found["seed"]))


def _defaults(scenario: str) -> dict[str, Any]:
    """Options of a scenario with their defaults; none for a name that is no scenario."""
    if scenario not in BUILDERS:
        return {}
    return {name: p.default for name, p in inspect.signature(BUILDERS[scenario]).parameters.items()}


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return _SAID[value]
    if isinstance(value, float | int):
        return repr(int(value)) if float(value).is_integer() else repr(float(value))
    return str(value).replace(" ", "") if isinstance(value, str) or value is None else ",".join(value)


def _value(text: str, default: Any) -> Any:
    if isinstance(default, bool):
        return bool(_SAID.index(text))  # ValueError for any other word
    return tuple(text.split(",")) if isinstance(default, tuple) else type(default)(text)
