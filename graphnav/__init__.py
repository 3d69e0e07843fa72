"""graphnav: offline factor-graph smoothing of recorded navigation logs.

>>> import graphnav as gn
>>> log = gn.read("shift_042/")        # doctest: +SKIP
>>> run = gn.smooth(log)               # doctest: +SKIP
>>> run.save("out/")                   # doctest: +SKIP

The names below load on first use, so that ``import graphnav`` itself imports none of the heavy packages.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from graphnav.analysis import observe
    from graphnav.bound import bound
    from graphnav.compare import compare
    from graphnav.config import Config
    from graphnav.creep import creep
    from graphnav.evaluation import evaluate
    from graphnav.log import SensorLog
    from graphnav.readers import read, write
    from graphnav.run import Run
    from graphnav.simulation import simulate
    from graphnav.smooth import smooth
    from graphnav.trajectory import Trajectory

__version__ = "0.1.0"

__all__ = [
    "Config",
    "Run",
    "SensorLog",
    "Trajectory",
    "bound",
    "compare",
    "creep",
    "evaluate",
    "observe",
    "read",
    "simulate",
    "smooth",
    "write",
]

#: Public name -> the module that defines it.
#:
#: `smooth` is the name of a function and of its module; `bound`, `compare` and `creep` likewise. Importing a submodule
#: binds it on the package, so after any ``import graphnav.smooth`` the attribute ``graphnav.smooth`` is the
#: module, whatever was there before. The module is therefore callable (see its last lines), and is what
#: ``graphnav.smooth`` always means: ``gn.smooth(log)`` calls its function `smooth`, in whatever order things were
#: imported.
_PUBLIC = {
    "Config": "graphnav.config",
    "Run": "graphnav.run",
    "SensorLog": "graphnav.log",
    "Trajectory": "graphnav.trajectory",
    "bound": "graphnav.bound",
    "compare": "graphnav.compare",
    "creep": "graphnav.creep",
    "evaluate": "graphnav.evaluation",
    "observe": "graphnav.analysis",
    "read": "graphnav.readers",
    "simulate": "graphnav.simulation",
    "smooth": "graphnav.smooth",
    "write": "graphnav.readers",
}


def __getattr__(name: str) -> Any:
    """Import a public name on first use (PEP 562)."""
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = importlib.import_module(_PUBLIC[name])
    if module.__name__ == f"{__name__}.{name}":
        return module  # bound by the import itself
    value = globals()[name] = getattr(module, name)
    return value


def __dir__() -> list[str]:
    """List the public names, loaded or not."""
    return sorted({*globals(), *__all__})
