"""The rows of the reproduction: every figure with the paper's beside it where the paper states one."""

from __future__ import annotations

from collections.abc import Iterator

from benchmarks._report import Row, Target, row
from benchmarks.papers import _published as published
from benchmarks.papers._cases import (
    ESTIMATORS,
    FOLLOWED,
    GRAPH,
    HALF_SECOND,
    PRESET_STEPS,
    RECKONED,
    SMALL,
    SWEPT,
)
from benchmarks.papers._results import Results

BASE = "interval 2"
#: What the scenario asks of the graph's median of 20 seeds, and issue 3 of the smoother where theory says they agree.
GRAPH_SEP_M, GRAPH_SEEDS = Target(high=0.07), 20
AGREEMENT = Target(high=1.15, of_ratio=True)
NO_FAILURE = Target(high=0.0)
#: Table 3's lines and what they are here.
TABLE_3: dict[str, tuple[float, ...] | None] = {
    "dead-reckoning none": None,
    "dead-reckoning-cpoem none": None,
    **{f"{method} rest": published.TRADITIONAL for method in RECKONED},
    **{f"{method} rts": published.COMPENSATED for method in RECKONED},
    "rts-online paper": published.PROPOSED,
    "rts-online matched": published.PROPOSED,
    GRAPH: published.PROPOSED,
}
AXES = ("east", "north", "up")


def all_rows(results: Results) -> list[Row]:
    """Every row; what no run gave is left out, and the failures are counted."""
    rows = [row("runs that failed", float(len(results.failed)), "1", target=NO_FAILURE)]
    for part in (_table_3, _intervals, _calibration, _uncorrected, _pars, _agreement, _closed_path, _preset):
        rows += part(results)
    return rows


def _table_3(results: Results) -> Iterator[Row]:
    for name, theirs in TABLE_3.items():
        if not results.has(BASE, name):
            continue
        target = GRAPH_SEP_M if name == GRAPH and results.seeds(BASE) >= GRAPH_SEEDS else None
        for c, sep in enumerate(results.sep_m(BASE, name), 1):
            peer = theirs[c - 1] if theirs is not None else None
            yield row(f"table 3, {name}: SEP of cycle {c}", sep, "m", peer=peer, target=target)


def _errors(results: Results, title: str, log: str, names: tuple[str, ...]) -> Iterator[Row]:
    for name in names:
        if results.has(log, name):
            for axis, value in zip(AXES, results.rms_m(log, name), strict=True):
                yield row(f"{title}, {log}, {name}: rms {axis}", value, "m")
            yield row(f"{title}, {log}, {name}: rms 3-D", results.rms_3d_m(log, name), "m")
            yield row(f"{title}, {log}, {name}: median run's rms 3-D", results.median_rms_m(log, name), "m")


def _intervals(results: Results) -> Iterator[Row]:
    for interval in published.INTERVALS_M:
        log = f"interval {interval}"
        yield from _errors(results, "figures 7-8", log, tuple(ESTIMATORS))
        for name in ESTIMATORS:
            if results.has(log, name) and log != BASE:
                for c, sep in enumerate(results.sep_m(log, name), 1):
                    yield row(f"figures 7-8, {log}, {name}: SEP of cycle {c}", sep, "m")
            if results.has(log, name):
                yield row(f"figures 7-8, {log}, {name}: mean position NEES", results.nees(log, name), "1")


def _calibration(results: Results) -> Iterator[Row]:
    for name in FOLLOWED if results.names() else ():
        final = results.calibration(BASE, name, lambda c: c.final)
        course = results.calibration(BASE, name, lambda c: c.course_rms)
        for k, (parameter, unit) in enumerate(results.names()):
            yield row(f"figures 9-12, {name}: rms error of the last {parameter}", final[k], unit)
            yield row(f"figures 9-12, {name}: rms error of {parameter} from the first cut on", course[k], unit)


def _uncorrected(results: Results) -> Iterator[Row]:
    span = f"{published.PURE_INERTIAL_S:g} s"
    for name in results.told():
        yield row(f"figure 11, biases of {name}: inertial error after {span}", results.inertial_m(name), "m")
    for name in results.told():
        if results.has(BASE, f"dr by {name}"):
            for axis, value in zip(AXES, results.rms_m(BASE, f"dr by {name}"), strict=True):
                yield row(f"figure 13, calibration of {name}: rms {axis} of dead reckoning", value, "m")


def _pars(results: Results) -> Iterator[Row]:
    for par in published.PARS:
        yield from _errors(results, "figures 14-15", f"par {par}", SWEPT)
        for name in SWEPT if results.has(f"par {par}", GRAPH) else ():
            error = results.last_scale_error(f"par {par}", name)
            yield row(f"figures 14-15, par {par}, {name}: rms error of the last odometer_scale", error, "1")


def _agreement(results: Results) -> Iterator[Row]:
    """Without closed path, where theory says that smoother and graph agree."""
    for log, title in ((BASE, "no closed path"), (SMALL, "no closed path, errors a tenth")):
        if not results.has(log, "rts off"):
            continue
        graph = results.rms_3d_m(log, "graph off")
        target = AGREEMENT if log == BASE else None
        yield row(f"{title}: rms of rts matched, graph beside", results.rms_3d_m(log, "rts off"), "m", peer=graph,
                  target=target)  # fmt: skip
        yield row(f"{title}: rms of ekf matched, graph beside", results.rms_3d_m(log, "ekf off"), "m", peer=graph)
        yield row(f"{title}: rms of {HALF_SECOND}, graph beside", results.rms_3d_m(log, HALF_SECOND), "m", peer=graph)
        for name in ("rts off", HALF_SECOND, "graph off"):
            yield row(f"{title}: mean position NEES of {name}", results.nees(log, name), "1")


def _closed_path(results: Results) -> Iterator[Row]:
    """The same with closed path: as a relative factor, and in the papers' form."""
    if not results.has(BASE, "graph absolute"):
        return
    graph = results.rms_3d_m(BASE, GRAPH)
    for name in ("rts-online matched", "rts matched", "graph absolute"):
        value = results.rms_3d_m(BASE, name)
        yield row(f"closed path: rms of {name}, graph with relative factors beside", value, "m", peer=graph)
    for name in ("rts-online matched", "rts matched", "graph absolute", GRAPH):
        yield row(f"closed path: mean position NEES of {name}", results.nees(BASE, name), "1")


def _preset(results: Results) -> Iterator[Row]:
    """What each of the paper's settings does to the matched smoother."""
    for name in PRESET_STEPS:
        if results.has(BASE, name):
            beside = results.rms_3d_m(BASE, "rts-online matched")
            value = results.rms_3d_m(BASE, name)
            yield row(f"rts-online matched but {name}: rms 3-D, matched beside", value, "m", peer=beside)
            yield row(f"rts-online matched but {name}: mean position NEES", results.nees(BASE, name), "1")
