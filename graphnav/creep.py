"""Creep of a longwall face: how far the whole line shifts along itself with each advance.

Two measurements of it, at the stops at one end of the face in successive cycles. The first is the paper's (J. Zheng et
al., "A LiDAR-aided inertial positioning approach for a longwall shearer", section 3.3): the roadway's outer wall is
seen from both stops, registration gives the displacement between them (equation 8), and its component along the face is
the creep (equation 9). The second is the difference of the smoothed positions of the stops.

The face's axis is level and leads from the first stop at the near end to the first one at the far end. The paper takes
the machine's forward axis at the start, which a bend of the conveyor turns by some milliradians: as many millimetres
of a metre's advance.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from factors.so3 import Array
from graphnav._metrics import truth_at
from graphnav.creep_rows import Creep, CreepRow
from graphnav.errors import GraphnavError, LogError
from graphnav.face_line import FaceLine, Seen, level
from graphnav.frontends.cutting_cycles import Cycle, find_cycles
from graphnav.frontends.rest import rest_spans
from graphnav.log import SensorLog
from graphnav.run import Run
from graphnav.stops import at_times, declared_scanner, independent_stops

if TYPE_CHECKING:
    from graphnav._stages import ProgressHook
    from graphnav.config import Config

_Found = TypeVar("_Found")
#: Two measurements of a creep that differ by more than this many sigmas are told of.
_APART_SIGMAS = 4.0
#: A wall that fits worse than this many times its noise is told of.
_POOR_FIT = 2.0


def creep(
    log: SensorLog | str | Path,
    run: Run | None = None,
    *,
    end: str = "near",
    config: Config | None = None,
    progress: ProgressHook | None = None,
) -> Creep:
    """Creep after every cycle, by registration of the roadway's wall and from the smoothed positions.

    What cannot be told, since a stop has no scans or two stops do not see the same wall, is left out with a note.

    Parameters
    ----------
    log : a `SensorLog` with raw scans of the stops at the end, or the folder of one. Its truth is not used.
    run : the smoothed log; None: it is smoothed here, in batch.
    end : "near" or "far": the end of the face whose stops are compared, and whose roadway is looked at.
    config : choices of method for the smoothing; progress : called as ``progress(stage, done, total)``.

    Returns
    -------
    Creep

    Raises
    ------
    LogError
        No [face], no cuts, no scans; no two stops in succession with scans in which the roadway is seen.
    GraphnavError
        An unknown end, a run without covariances, no two stops that see the same wall, or as from `graphnav.smooth`.
    """
    log = _checked(log, end)
    cycles = find_cycles(log)
    stops, axis_s = _stops(cycles, end, log.name), _axis_times(cycles, log.name)
    if run is None:
        from graphnav.smooth import smooth

        run = smooth(log, config, progress=progress)
    scans = log.lidar_scans
    assert log.lidar is not None and scans is not None
    joint = run.stops is not None
    states = run.stops or independent_stops(run.trajectory, run.calibration, _ends(cycles))
    near, far = at_times(states, axis_s)
    line = FaceLine(declared_scanner(states, log.lidar), near, far, log.lidar)
    rest_s = rest_spans(log)

    def look(cycle: int) -> Seen:
        return line.seen(at_times(states, [stops[cycle]])[0], scans, rest_s, end)

    seen, left_out = _all_that_can(look, stops, "the stop of cycle {}")
    pairs = [cycle for cycle in seen if cycle + 1 in seen]

    def advance(cycle: int) -> CreepRow:
        if progress is not None:
            progress("registration", pairs.index(cycle) + 1, len(pairs))
        return line.creep(cycle, seen[cycle], seen[cycle + 1])

    rows, failed = _all_that_can(advance, pairs, "the creep after cycle {}")
    left_out |= failed
    if not rows:
        raise next(iter(left_out.values()))
    notes = [f"{what} is left out: {error}" for what, error in left_out.items()]
    return Creep(log.name, end, tuple(rows.values()), joint, (*notes, *_notes(list(rows.values()), joint)))


def with_truth(found: Creep, log: SensorLog) -> Creep:
    """The same with the true creep of each row, for judging: the true displacement of the stops along the true axis.

    Raises
    ------
    GraphnavError
        The log has no truth, or none at a stop.
    """
    if log.truth is None:
        raise GraphnavError(f"log {log.name} has no truth table to judge by; add truth.parquet or truth.csv")
    cycles = find_cycles(log)
    stops, axis_s = _stops(cycles, found.end, log.name), _axis_times(cycles, log.name)
    known, pos_n, _ = truth_at(log.truth, np.array([*axis_s, *stops.values()]))
    if not known.all():
        raise GraphnavError(f"log {log.name}: truth does not cover all stops at the {found.end} end of the face")
    forward_n = level(pos_n[1] - pos_n[0])
    place_m = dict(zip(stops, pos_n[2:] @ forward_n, strict=True))
    rows = (replace(row, true_m=float(place_m[row.cycle + 1] - place_m[row.cycle])) for row in found.rows)
    return replace(found, rows=tuple(rows))


# Input -----------------------------------------------------------------------------------------------------


def _checked(log: SensorLog | str | Path, end: str) -> SensorLog:
    if end not in ("near", "far"):
        raise GraphnavError(f'end "{end}", expected "near" or "far"')
    if not isinstance(log, SensorLog):
        from graphnav.readers import read

        log = read(log)
    if log.face is None:
        raise LogError("missing", where="log.toml, [face]", fix="creep is that of a longwall face: declare it")
    if log.lidar_scans is None or not len(log.lidar_scans) or log.lidar is None:
        fix = "record raw scans at the ends of the face (in simulation: without --no-scans), and declare [lidar]"
        raise LogError("no scans", where=f"log {log.name}", column="lidar_scans", fix=fix)
    return replace(log, truth=None)


def _stops(cycles: tuple[Cycle, ...], end: str, name: str) -> dict[int, float]:
    """Cycle -> time (s) at which the machine stands at the end, at the start or end of that cycle's cut."""
    times = {c.number: c.end_s if c.forward == (end == "far") else c.start_s for c in cycles}
    stops = {number: time_s for number, time_s in times.items() if time_s is not None}
    if len(stops) < 2 or list(stops) != list(range(min(stops), max(stops) + 1)):
        raise LogError(
            f"cycles with a stop at the {end} end: {list(stops)}; creep needs two or more, one after the other",
            where=f"log {name}",
            column="events",
            fix="give the events of all cuts, or the other end of the face",
        )
    return stops


def _axis_times(cycles: tuple[Cycle, ...], name: str) -> tuple[float, float]:
    """Times (s) of the stops at the near and the far end of the first complete cut."""
    for c in cycles:
        if c.end_s is not None:
            return (c.start_s, c.end_s) if c.forward else (c.end_s, c.start_s)
    raise LogError("no complete cut", where=f"log {name}", column="events", fix="the face's axis needs one")


def _ends(cycles: tuple[Cycle, ...]) -> Array:
    return np.unique([t for c in cycles for t in (c.start_s, c.end_s) if t is not None])


def _all_that_can(
    find: Callable[[int], _Found], cycles: Iterable[int], name: str
) -> tuple[dict[int, _Found], dict[str, GraphnavError]]:
    """What is found of each cycle, and the errors of those of which nothing is, under the `name` with their number."""
    found, errors = {}, {}
    for cycle in cycles:
        try:
            found[cycle] = find(cycle)
        except GraphnavError as error:
            errors[name.format(cycle)] = error
    return found, errors


def _notes(rows: list[CreepRow], joint: bool) -> tuple[str, ...]:
    notes = []
    if not joint:
        notes.append("the run has no joint covariance of its stops: taken as independent, their sigmas are too large")
    for row in rows:
        apart = abs(row.icp_m - row.graph_m) / float(np.hypot(row.icp_sigma_m, row.graph_sigma_m))
        if apart > _APART_SIGMAS:
            notes.append(f"after cycle {row.cycle} registration and positions are {apart:.1f} sigmas apart")
        if row.residual > _POOR_FIT:
            notes.append(
                f"after cycle {row.cycle} the wall fits {row.residual:.1f} times worse than its noise: changed?"
            )
    return tuple(notes)


class _CallableModule(ModuleType):
    """Module and function share the name ``graphnav.creep``: see `graphnav._PUBLIC`."""

    def __call__(
        self,
        log: SensorLog | str | Path,
        run: Run | None = None,
        *,
        end: str = "near",
        config: Config | None = None,
        progress: ProgressHook | None = None,
    ) -> Creep:
        """See `creep`."""
        return creep(log, run, end=end, config=config, progress=progress)


sys.modules[__name__].__class__ = _CallableModule
