"""The longwall face: its advance, its cuts and pushes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from graphnav._schema import Array, Record, column, param


@dataclass(frozen=True, eq=False)
class Face(Record):
    """The longwall face and what is known of its advance."""

    SECTION: ClassVar[str] = "face"
    length_m: float = param(positive=True)
    push_m: float = param(0.0)
    push_sigma_m: float = param(0.03, positive=True)
    along_sigma_m: float = param(0.03, positive=True)
    creep_m: float = param(0.0)
    creep_sigma_m: float = param(0.0, nonnegative=True)
    interval_m: float = param(2.0, positive=True)


@dataclass(frozen=True, eq=False)
class Events(Record):
    """Starts and ends of the cuts; cycles count from 1."""

    TABLE: ClassVar[str] = "events"
    STRICT: ClassVar[bool] = False
    t_s: Array = column("t_s")
    kind: Any = column("kind", kind="str")
    cycle: Any = column("cycle", kind="int")

    def __post_init__(self) -> None:
        super().__post_init__()
        for row, kind in enumerate(self.kind):
            if kind not in ("cut_start", "cut_end"):
                raise self.error(f'"{kind}", expected "cut_start" or "cut_end"', row=row, column="kind")


@dataclass(frozen=True, eq=False)
class Push(Record):
    """Measured advance of the conveyor at a face coordinate after a cycle."""

    TABLE: ClassVar[str] = "push"
    STRICT: ClassVar[bool] = False
    t_s: Array = column("t_s")
    cycle: Any = column("cycle", kind="int")
    s_m: Array = column("s_m")
    push_m: Array = column("push_m")
