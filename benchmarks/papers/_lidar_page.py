"""The page of the INS/LiDAR reproduction: text around tables and pictures, every figure from the outcomes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from benchmarks._report import Before
from benchmarks.papers import _lidar_published as published
from benchmarks.papers import _lidar_text as text
from benchmarks.papers._judged import Array
from benchmarks.papers._lidar_cases import (
    AS_PUBLISHED,
    CORRECTED,
    FILTER,
    GRAPH,
    IMPROVED,
    IMPROVED_TOLD,
    TRADITIONAL,
    UNCORRECTED,
    label,
)
from benchmarks.papers._lidar_rows import Results, at_end_2, budget, largest, selection_sets
from benchmarks.papers._sheet import Pictures, filled, metres, number, save, table

NAMES = {
    TRADITIONAL: "traditional dead reckoning",
    IMPROVED: "dead reckoning with closed path",
    IMPROVED_TOLD: "the same, told of the mean creep",
    AS_PUBLISHED: "filter, mode 2, N 1, d 9 m",
    FILTER: "filter, own choice and correction",
    UNCORRECTED: "filter, mode 2, N 1, d 7.5 m",
    CORRECTED: "the same with the posterior correction",
    GRAPH: "factor graph",
}
PUBLISHED = {
    TRADITIONAL: published.TRADITIONAL,
    IMPROVED: published.IMPROVED,
    AS_PUBLISHED: published.PROPOSED,
}
_ENU = ("east", "north", "up")


def write(path: Path, results: Results, pictures: dict[str, Path], before: Before) -> None:
    """Write the page, whole or not at all."""
    page = Page(results, pictures, path.parent)
    parts = [text.TITLE, text.source(results, before), text.WORLDS]
    parts += [text.TABLE_3, page.table_3("paper"), page.cycles(), page.picture("figure-10"), text.why_table_3(results)]
    if results.of_world("scenario"):
        parts += [text.SCENARIO, page.table_3("scenario"), text.why_scenario(results)]
    parts += [text.TABLE_4, page.table_4(), text.why_table_4(results)]
    if all(results.first(world) for world in selection_sets()):
        parts += [text.FIGURE_7, page.selections(), page.picture("figure-7"), text.why_figure_7(results)]
    if results.first("correction"):
        parts += [text.FIGURE_8, page.correction(), page.picture("figure-8"), text.why_figure_8(results)]
    save(path, map(filled, parts))


class Page:
    """Tables and pictures of one set of results."""

    def __init__(self, results: Results, pictures: dict[str, Path], folder: Path) -> None:
        self.results, self.picture = results, Pictures(pictures, text.CAPTIONS, folder).link

    def table_3(self, world: str) -> str:
        """Largest error of any cycle: the paper's, the median of the seeds, and least and most."""
        found, rows = self.results.of_world(world), []
        for name in (TRADITIONAL, IMPROVED, IMPROVED_TOLD, AS_PUBLISHED, FILTER, GRAPH):
            courses = [one.courses[name] for one in found if name in one.courses]
            if not courses:
                continue
            each = np.array([largest(course) for course in courses])
            theirs = f"*{axes(published.largest(PUBLISHED[name]))}*" if name in PUBLISHED else "-"
            spread = [f"{low:.3f} - {high:.3f}" for low, high in zip(each.min(axis=0), each.max(axis=0), strict=True)]
            stops = axes(np.median([at_end_2(course) for course in courses], axis=0))
            nees = [course.nees_position for course in courses if course.nees_position is not None]
            rows.append([NAMES[name], theirs, f"**{axes(np.median(each, axis=0))}**", *spread, stops,
                         number(float(np.mean(nees)) if nees else None), str(len(courses))])  # fmt: skip
        head = ["largest error of any cycle, E / N / H, m", "paper", "median of the seeds",
                *(f"{axis}, least - most" for axis in _ENU), "at end 2, median", "position NEES", "seeds"]  # fmt: skip
        return table(head, rows)

    def cycles(self) -> str:
        """Table 3 as the paper prints it: cycle by cycle, the first seed."""
        one = self.results.first("paper")
        if one is None:
            return ""
        rows = []
        for name, theirs in PUBLISHED.items():
            rows.append([f"*paper: {NAMES[name]}*", *(f"*{axes(row, signed=True)}*" for row in theirs)])
            rows.append([NAMES[name], *(axes(row, signed=True) for row in one.courses[name].largest_m)])
        if GRAPH in one.courses:
            rows.append([NAMES[GRAPH], *(axes(row, signed=True) for row in one.courses[GRAPH].largest_m)])
        return table([f"E / N / H, m (seed {one.seed})", *(f"cycle {k}" for k in range(1, 7))], rows)

    def table_4(self) -> str:
        """Creep: standard, the paper's, ours."""
        rows = [["*standard*", *signed(published.CREEP_STANDARD)], ["*paper*", *signed(published.CREEP)]]
        for world in ("paper", "scenario"):
            for one in self.results.of_world(world):
                of = {"from the filter's positions": FILTER, "from the graph's positions": GRAPH}
                for title, name in of.items():
                    if name in one.courses:
                        rows.append([f"{world}, seed {one.seed}, {title}: error",
                                     *signed(one.courses[name].creep_m - one.creep_m)])  # fmt: skip
                if one.icp_m is not None:
                    rows.append([f"{world}, seed {one.seed}, by registration: error", *signed(one.icp_m - one.creep_m)])
        return table(["creep after cycle, m", *"12345"], rows)

    def selections(self) -> str:
        """Figure 7 in numbers."""
        rows = []
        for world, chosen in selection_sets().items():
            one = self.results.first(world)
            assert one is not None
            for selection in chosen:
                course, expected = one.courses[label(selection)], budget(selection, text.LENGTH_M)
                stops = [axes(course.stop_m[cut], signed=True) for cut in range(3)]
                rows.append([label(selection), axes(expected[:2], signed=True) if expected is not None else "-", *stops,
                             f"{np.abs(course.heading_min - course.heading_min[0]).max():.1f}"])  # fmt: skip
        return table(
            ["E / N / H, m", "equations 25-27, E / N", "first arrival at end 2", "back at end 1", "end 2 again",
             "heading moved by, min"], rows)  # fmt: skip

    def correction(self) -> str:
        """Figure 8 in numbers."""
        one = self.results.first("correction")
        assert one is not None
        rows = []
        for name in (UNCORRECTED, CORRECTED, FILTER, GRAPH):
            if name in one.courses:
                course = one.courses[name]
                rows.append([NAMES[name], *metres(largest(course)),
                             *(axes(course.stop_m[cut], signed=True) for cut in range(3))])  # fmt: skip
        head = [f"largest error, {axis}, m" for axis in _ENU]
        return table(["", *head, "first arrival, E / N / H, m", "back at end 1", "end 2 again"], rows)


def axes(values: Iterable[float] | Array, signed: bool = False) -> str:
    """Values with a slash between, to millimetres."""
    return " / ".join(f"{value:+.3f}" if signed else f"{value:.3f}" for value in values)


def signed(values: Sequence[float] | Array) -> list[str]:
    """To millimetres, with the sign."""
    return [f"{value:+.3f}" for value in values]
