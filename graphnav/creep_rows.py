"""What `graphnav.creep` finds: one row per advance of the face."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class CreepRow:
    """Creep of the face between one cutting cycle and the next, positive towards the far end.

    Attributes
    ----------
    cycle : the creep after this cycle, whose line is compared with the next one's.
    icp_m, icp_sigma_m : by registration of the roadway's wall, equation 9.
    graph_m, graph_sigma_m : from the smoothed positions of the same two stops.
    beams : beams of the second stop on the wall seen from the first.
    residual : rms distance of these from it, in sigmas of the beams.
    true_m : where the log's truth tells it, and it was asked for; else None.
    """

    cycle: int
    icp_m: float
    icp_sigma_m: float
    graph_m: float
    graph_sigma_m: float
    beams: int
    residual: float
    true_m: float | None = None

    @property
    def icp_error_m(self) -> float | None:
        """Registration less truth."""
        return None if self.true_m is None else self.icp_m - self.true_m

    @property
    def graph_error_m(self) -> float | None:
        """Smoothed positions less truth."""
        return None if self.true_m is None else self.graph_m - self.true_m


@dataclass(frozen=True)
class Creep:
    """Creep of a face over a shift.

    Attributes
    ----------
    name, end : the log, and the end of the face ("near", "far") at which the stops are compared.
    rows : one per advance.
    joint : whether the run told what the states of its stops have in common. If not, the sigmas take the states as
        independent and are too large.
    notes : what a reader of the figures must know.
    """

    name: str
    end: str
    rows: tuple[CreepRow, ...]
    joint: bool
    notes: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """The object that ``graphnav creep --json`` prints."""
        rows = [{**asdict(r), "icp_error_m": r.icp_error_m, "graph_error_m": r.graph_error_m} for r in self.rows]
        return {"log": self.name, "end": self.end, "joint": self.joint, "rows": rows, "notes": list(self.notes)}
