"""The page of the reproduction: text around tables and pictures, every figure from this run."""

from __future__ import annotations

from pathlib import Path

from benchmarks._report import Before
from benchmarks.papers import _published as published
from benchmarks.papers import _text as text
from benchmarks.papers._cases import ESTIMATORS, FOLLOWED, GRAPH, HALF_SECOND, PRESET_STEPS, SMALL, SWEPT
from benchmarks.papers._results import Results
from benchmarks.papers._rows import BASE, TABLE_3
from benchmarks.papers._sheet import Pictures, filled, metres, number, save, table

NAMES = {
    "dead-reckoning none": "dead reckoning, nothing compensated",
    "dead-reckoning-cpoem none": "the same with closed path",
    "dead-reckoning rest": "dead reckoning, gyro bias from the first rest",
    "dead-reckoning-cpoem rest": "the same with closed path",
    "dead-reckoning rts": "dead reckoning, all compensated by RTS",
    "dead-reckoning-cpoem rts": "the same with closed path",
    **{f"ekf {p}": f"filter alone, {p} preset" for p in ("paper", "matched")},
    **{f"rts-online {p}": f"filter and RTS at the face ends, {p} preset" for p in ("paper", "matched")},
    **{f"rts {p}": f"filter and RTS over the whole log, {p} preset" for p in ("paper", "matched")},
    GRAPH: "factor graph",
    "graph absolute": "graph, closed path as an absolute point (the papers' form)",
    "rts off": "filter and RTS, matched preset",
    "ekf off": "filter alone, matched preset",
    HALF_SECOND: "filter and RTS, the constraint across the machine twice a second",
    "graph off": "factor graph",
    "nothing": "nothing (before compensation)",
    "true": "what was drawn",
}
AXIS_TITLES = ("rms east, m", "rms north, m", "rms up, m")


def write(path: Path, results: Results, pictures: dict[str, Path], before: Before) -> None:
    """Write the page, whole or not at all."""
    page = Page(results, pictures, path.parent)
    parts = [text.TITLE, text.source(results, before)]
    parts += [text.TABLE_3, page.table_3(), page.picture("comparison"), text.why_table_3(results)]
    parts += [text.INTERVALS, page.intervals(), page.picture("intervals-matched"), page.picture("intervals-paper"),
              text.why_intervals(results)]  # fmt: skip
    parts += [text.CALIBRATION, page.calibration(), page.picture("calibration"), text.why_calibration(results)]
    parts += [text.UNCORRECTED, page.uncorrected(), page.picture("uncorrected"), text.why_uncorrected(results)]
    if results.has("par 1", GRAPH):
        parts += [text.settings(results), page.settings(), page.picture("error-settings"), text.why_settings(results)]
    parts += [text.GAINS, page.forms(), text.why_forms(results), page.agreement(), text.why_agreement(results)]
    parts += [text.PRESET, page.preset(), text.why_preset(results)]
    save(path, map(filled, parts))


class Page:
    """Tables and pictures of one set of results."""

    def __init__(self, results: Results, pictures: dict[str, Path], folder: Path) -> None:
        self.results, self.picture = results, Pictures(pictures, text.CAPTIONS, folder).link

    def table_3(self) -> str:
        """SEP per cycle, the paper's lines above ours."""
        theirs = {
            "paper: traditional method without compensation": published.TRADITIONAL,
            "paper: traditional method with compensation": published.COMPENSATED,
            "paper: filter and RTS": published.PROPOSED,
        }
        rows = [[f"*{name}*", *(f"*{value:.2f}*" for value in sep)] for name, sep in theirs.items()]
        rows += [[NAMES[name], *metres(self.results.sep_m(BASE, name))] for name in TABLE_3]
        return table(["SEP, m (median of the seeds)", "A1", "A2", "A3", "A4"], rows)

    def intervals(self) -> str:
        """Rms per axis and SEP per cycle."""
        rows = []
        for name in ESTIMATORS:
            for interval in published.INTERVALS_M:
                log = f"interval {interval}"
                sep = " / ".join(metres(self.results.sep_m(log, name)))
                nees = self.results.nees(log, name)
                rows.append([NAMES[name], f"{interval}", *metres(self.results.rms_m(log, name)), sep, number(nees)])
        head = ["", "interval, m", *AXIS_TITLES, "SEP of A1 / A2 / A3 / A4, m", "position NEES"]
        return table(head, rows)

    def calibration(self) -> str:
        """Rms error of the last estimate, and in brackets that of the whole course."""
        rows = []
        for k, (parameter, unit) in enumerate(self.results.names()):
            cells = [f"{parameter.replace('_', ' ')}{'' if unit == '1' else f', {unit}'}"]
            for name in FOLLOWED:
                last = self.results.calibration(BASE, name, lambda c: c.final)[k]
                course = self.results.calibration(BASE, name, lambda c: c.course_rms)[k]
                cells.append(f"{number(last)} ({number(course)})")
            rows.append(cells)
        return table(["rms error of the last estimate (from the first cut on)", *map(short, FOLLOWED)], rows)

    def uncorrected(self) -> str:
        """Pure inertial navigation and dead reckoning by calibration."""
        rows = []
        for name in self.results.told():
            reckoned = f"dr by {name}"
            axes = metres(self.results.rms_m(BASE, reckoned)) if self.results.has(BASE, reckoned) else ["", "", ""]
            rows.append([NAMES[name], f"{self.results.inertial_m(name):,.0f}", *axes])
        head = [
            "calibration of",
            "inertial error after 300 s, m (median)",
            *(f"dead reckoning: {a}" for a in AXIS_TITLES),
        ]
        return table(head, rows)

    def settings(self) -> str:
        """Rms 3-D error and, beside it, the scale's error, by setting."""
        rows = []
        for par in published.PARS:
            log = f"par {par}"
            if self.results.has(log, GRAPH):
                errors = [f"{self.results.rms_3d_m(log, name):.3f}" for name in SWEPT]
                scale = [f"{self.results.last_scale_error(log, name):.4f}" for name in ("rts-online matched", GRAPH)]
                rows.append([f"Par {par}", *errors, *scale])
        head = ["rms 3-D error, m", *map(short, SWEPT), "scale error: RTS, matched", "graph"]
        return table(head, rows)

    def forms(self) -> str:
        """Closed path by form."""
        names = (GRAPH, "graph absolute", "rts-online matched", "rts matched")
        rows = [[NAMES[n], f"{self.results.rms_3d_m(BASE, n):.3f}", number(self.results.nees(BASE, n))] for n in names]
        return table(["with closed path", "rms 3-D, m", "position NEES"], rows)

    def agreement(self) -> str:
        """Without closed path, with the errors as they are and a tenth of them."""
        rows = []
        for name in ("graph off", "rts off", HALF_SECOND, "ekf off"):
            cells = [NAMES[name]]
            for log in (BASE, SMALL):
                graph, own = self.results.rms_3d_m(log, "graph off"), self.results.rms_3d_m(log, name)
                cells += [f"{own:.3f}", f"{own / graph:.2f}", number(self.results.nees(log, name))]
            rows.append(cells)
        head = ["without closed path", "rms 3-D, m", "by the graph's", "NEES"]
        return table([*head, *(f"{h}, errors a tenth" for h in head[1:])], rows)

    def preset(self) -> str:
        """One of the paper's settings at a time."""
        rows = [[NAMES["rts-online matched"], *self._of("rts-online matched")]]
        rows += [[f"... but {name}", *self._of(name)] for name in PRESET_STEPS]
        rows.append([NAMES["rts-online paper"], *self._of("rts-online paper")])
        return table(["", "rms 3-D, m", "position NEES"], rows)

    def _of(self, name: str) -> list[str]:
        return [f"{self.results.rms_3d_m(BASE, name):.3f}", number(self.results.nees(BASE, name))]


def short(name: str) -> str:
    """For the head of a column."""
    method, _, preset = name.partition(" ")
    return {"ekf": "filter", "rts-online": "RTS", GRAPH: "graph"}[method] + (f", {preset}" if preset else "")
