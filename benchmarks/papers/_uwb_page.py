"""The page of the IMU/UWB reproduction: text around tables and pictures, every figure from this run."""

from __future__ import annotations

from pathlib import Path

from benchmarks._report import Before
from benchmarks.papers import _uwb_published as published
from benchmarks.papers import _uwb_text as text
from benchmarks.papers._sheet import Pictures, filled, number, save, table
from benchmarks.papers._uwb_cases import CASES
from benchmarks.papers._uwb_figures import NAMES
from benchmarks.papers._uwb_rows import (
    AXES,
    Results,
    largest,
    largest_angle,
    mean_error,
    nine_tenths,
    spread,
)


def write(path: Path, results: Results, pictures: dict[str, Path], command: str, before: Before) -> None:
    """Write the page, whole or not at all."""
    page = Page(results, pictures, path.parent)
    parts = [text.TITLE, text.source(results, command, before), text.METHODS]
    for site, figures in (("surface", ("figure-4", "figure-5", "figure-6")),
                          ("underground", ("figure-8", "figure-9", "figure-10", "figure-11"))):  # fmt: skip
        parts += [text.HEADS[site], page.errors(site), text.why(results, site), *map(page.picture, figures)]
    parts += [
        text.ATTITUDE,
        page.attitude(),
        text.why_attitude(results),
        *map(page.picture, ("figure-12", "figure-13")),
    ]
    save(path, map(filled, parts))


class Page:
    """Tables and pictures of one set of results."""

    def __init__(self, results: Results, pictures: dict[str, Path], folder: Path) -> None:
        self.results, self.picture = results, Pictures(pictures, text.CAPTIONS, folder).link

    def errors(self, site: str) -> str:
        """Table 4: absolute errors x and z, the paper's mean beside ours."""
        rows = []
        for case in CASES:
            theirs = published.mean(site, case)
            paper = "-" if theirs is None else f"*{theirs[0]:.3f} / {theirs[1]:.3f}*"
            failed = self.results.failure(site, case)
            if failed is not None:
                rows.append([NAMES[case], paper, failed, "-", "-", "-", "-", "-"])
                continue
            cells = [self._pair(site, case, of) for of in (mean_error, largest, spread, nine_tenths)]
            cells[0] = f"**{cells[0]}**"
            rows.append([NAMES[case], paper, *cells, number(self.results.nees(site, case, 0)), self._share(site, case)])
        head = ["absolute error x / z, m", "paper, mean", "mean", "largest", "standard deviation", "90 % below",
                "position NEES", "mean, of UWB alone"]  # fmt: skip
        return table(head, rows)

    def _pair(self, site: str, case: str, of: object) -> str:
        value = self.results.median(site, case, of)  # type: ignore[arg-type]
        assert value is not None
        return " / ".join(f"{value[axis]:.3f}" for axis in AXES.values())

    def _share(self, site: str, case: str) -> str:
        ours, alone = (self.results.median(site, name, mean_error) for name in (case, "uwb"))
        if ours is None or alone is None:
            return "-"
        return " / ".join(f"{ours[axis] / alone[axis]:.2f}" for axis in AXES.values())

    def attitude(self) -> str:
        """Largest attitude errors and their consistency."""
        rows = []
        for case in CASES:
            if case.startswith("uwb"):
                continue
            cells = [NAMES[case]]
            for site in ("surface", "underground"):
                angle = self.results.median(site, case, largest_angle)
                cells += ["-" if angle is None else f"{float(angle):.2f}", number(self.results.nees(site, case, 1))]
            rows.append(cells)
        head = ["largest attitude error, deg", "surface", "its NEES", "underground", "its NEES"]
        return table(head, rows)
