"""The page of the roadheader's reproduction: text around tables and pictures, every figure from this run."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks._report import Before
from benchmarks.papers import _vio_published as published
from benchmarks.papers import _vio_text as text
from benchmarks.papers._judged import Array
from benchmarks.papers._sheet import Pictures, filled, number, save, table
from benchmarks.papers._vio_cases import CASES, ENHANCED, ENHANCED_FILTER, ENHANCED_LOOSE, GRAPH, LOOSE, RAW
from benchmarks.papers._vio_features import ENHANCERS
from benchmarks.papers._vio_figures import NAMES
from benchmarks.papers._vio_published import AXES, UNITS
from benchmarks.papers._vio_rows import STATISTICS, Results, asked, largest, rms_3d


def write(path: Path, results: Results, pictures: dict[str, Path], command: str, before: Before) -> None:
    """Write the page, whole or not at all."""
    page = Page(results, pictures, path.parent)
    parts = [
        text.TITLE, text.source(results, command, before), text.METHODS,
        text.ASKED, page.asked(), text.why_asked(results),
        text.TABLE_6, page.statistics(), text.why(results), *map(page.picture, ("figure-14", "way")),
        text.CONSISTENCY, page.consistency(), text.why_consistency(results),
        *map(page.picture, ("errors-filter", "errors-graph")),
        text.FEATURES, page.features(), text.why_features(results), *map(page.picture, ("figure-8", "figure-9")),
        text.GAIN, page.gain(), text.why_gain(results),
    ]  # fmt: skip
    save(path, map(filled, parts))


def cell(value: float, k: int) -> str:
    """A figure of an axis: tenths of millimetres, thousandths of a degree."""
    return f"{value:.4f}" if UNITS[k] == "m" else f"{value:.3f}"


def cells(values: Array | published.Six) -> list[str]:
    """Those of the six axes."""
    return [cell(float(value), k) for k, value in enumerate(values)]


class Page:
    """Tables and pictures of one set of results."""

    def __init__(self, results: Results, pictures: dict[str, Path], folder: Path) -> None:
        self.results, self.picture = results, Pictures(pictures, text.CAPTIONS, folder).link

    def asked(self) -> str:
        """The graph's largest errors against what is asked of them."""
        ours, limits, bound = self.results.median(GRAPH, largest), asked(self.results), self.results.bound()
        rows = []
        for k, axis in enumerate(AXES):
            met = "-" if ours is None else "yes" if ours[k] <= limits[k] else "**no**"
            told = ["-" if values is None else cell(float(values[k]), k) for values in (ours, bound)]
            rows.append([f"{axis}, {UNITS[k]}", *cells_of(k, published.LARGEST["vio-kf"], published.ASKED), told[1],
                         cell(float(limits[k]), k), f"**{told[0]}**", met])  # fmt: skip
        head = ["", "paper, largest", "half of it", "largest sigma of the bound", "asked", "graph, largest", "met"]
        return table(head, rows)

    def statistics(self) -> str:
        """Table 6, the paper's beside ours."""
        rows = []
        for name, (of, paper) in STATISTICS.items():
            for method in ("sins", "vio-kf"):
                rows.append([f"*{name}, paper's {'SINS' if method == 'sins' else 'method'}*",
                             *(f"*{value}*" for value in cells(np.abs(paper[method])))])  # fmt: skip
            for case in CASES:
                values = self.results.median(case, of)
                if values is not None and case not in (RAW, ENHANCED, ENHANCED_FILTER, ENHANCED_LOOSE):
                    rows.append([f"{name}, {NAMES[case]}", *cells(values)])
        failed = [f"\n\n{NAMES[case]} failed: {why}." for case in CASES if (why := self.results.failure(case))]
        return table(["", *(f"{a}, {u}" for a, u in zip(AXES, UNITS, strict=True))], rows) + "".join(failed)

    def consistency(self) -> str:
        """NEES by case."""
        rows = []
        for case in CASES:
            if self.results.courses(case):
                rows.append([NAMES[case], *(number(self.results.nees(case, which)) for which in (0, 1))])
        return table(["", "position NEES", "attitude NEES"], rows)

    def features(self) -> str:
        """Matches, tracks and speed by enhancement."""
        r, rows = self.results, []
        raw = r.matched("none")
        for name, said in ENHANCERS.items():
            kept, true = r.matched(name), r.matched(name, true=True)
            rows.append([
                said,
                *(["-"] * 3 if not len(kept) else
                  [f"{kept.mean():.0f}", f"{kept.mean() / max(raw.mean(), 1e-9):.2f}", f"{true.mean():.0f}"]),
                *(number(value) for value in (r.front(name, "features"), r.front(name, "length"),
                                              r.front(name, "pairs_per_s"))),
                number(r.enhancement_ms.get(name)),
            ])  # fmt: skip
        head = ["images", "matches kept by RANSAC", "of raw", "and true", "tracked features in a pair",
                "frames of a track", "pairs a second", "enhancement, ms a frame"]  # fmt: skip
        return table(head, rows)

    def gain(self) -> str:
        """Accuracy with and without enhancement."""
        rows = []
        for case in ("vio-kf", ENHANCED_FILTER, LOOSE, ENHANCED_LOOSE, GRAPH, RAW, ENHANCED):
            rms, most = self.results.median(case, rms_3d), self.results.median(case, largest)
            if rms is not None and most is not None:
                rows.append([NAMES[case], f"{1e3 * float(rms):.1f}", *cells(most)])
        head = ["largest errors", "rms 3-D, mm", *(f"{a}, {u}" for a, u in zip(AXES, UNITS, strict=True))]
        return table(head, rows)


def cells_of(k: int, *rows: published.Six) -> list[str]:
    """One axis of several rows."""
    return [cell(row[k], k) for row in rows]
