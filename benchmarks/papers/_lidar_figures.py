"""The pictures of the INS/LiDAR reproduction: figures 7, 8 and 10."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from benchmarks.papers._figures import _COLOURS, _STYLE, _grid, _save
from benchmarks.papers._lidar_cases import (
    AS_PUBLISHED,
    CORRECTED,
    FILTER,
    GRAPH,
    IMPROVED,
    IMPROVED_TOLD,
    TRADITIONAL,
    UNCORRECTED,
    Course,
    Found,
    label,
)
from benchmarks.papers._lidar_rows import Results, selection_sets

_TITLES = ("east, m", "north, m", "up, m", "heading, minutes of arc")
_NINE = (*_COLOURS, "black", "#56B4E9", "#882255")
_LINES = {
    TRADITIONAL: ("#B0B0B0", "-"),
    IMPROVED: (_COLOURS[0], "-"),
    IMPROVED_TOLD: (_COLOURS[0], "--"),
    AS_PUBLISHED: (_COLOURS[5], "-"),
    UNCORRECTED: (_COLOURS[5], "-"),
    CORRECTED: (_COLOURS[1], "-"),
    FILTER: (_COLOURS[3], "--"),
    GRAPH: (_COLOURS[2], "-"),
}
#: What an error of the scale of dead reckoning would hide is drawn without it.
_FRAMED = (FILTER, AS_PUBLISHED, GRAPH)


def draw(results: Results, folder: Path) -> dict[str, Path]:
    """All pictures that the results allow; name -> file."""
    from matplotlib import rc_context

    folder.mkdir(parents=True, exist_ok=True)
    made: dict[str, Path] = {}
    with rc_context(_STYLE):
        for name, figure in (
            ("figure-7", selections(results)),
            ("figure-8", correction(results)),
            ("figure-10", comparison(results)),
        ):
            if figure is not None:
                made[name] = _save(figure, folder / f"{name}.png")
    return made


def selections(results: Results) -> Any:
    """Figure 7: errors over three cuts by mode, by number of legs and by least distance."""
    rows = [(results.first(world), chosen) for world, chosen in selection_sets().items()]
    if any(one is None for one, _ in rows):
        return None
    figure, axes = _grid(3, 4, (12.0, 7.6), sharex=True)
    for at, (one, chosen), what in zip(axes, rows, ("mode", "N", "d"), strict=True):
        assert one is not None
        for selection, colour in zip(chosen, _NINE, strict=False):
            count, mode, distance_m = selection
            text = {"mode": f"mode {mode}", "N": f"N = {count}", "d": f"d = {distance_m:g} m"}[what]
            _draw(at, one.courses[label(selection)], colour, "-", text)
        _spans(at, one)
        fixed = {"mode": "N = 3, d = 0", "N": "mode 2, d = 0", "d": "mode 2, N = 1"}[what]
        at[0].set_ylabel(fixed)
        at[3].legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    _titles(axes)
    return figure


def correction(results: Results) -> Any:
    """Figure 8: with and without the posterior correction; the graph beside."""
    one = results.first("correction")
    if one is None:
        return None
    figure, axes = _grid(1, 4, (12.0, 3.0))
    _courses(axes[0], one, list(one.courses))
    _titles(axes)
    _legend(figure, axes[0, 0], 4)
    return figure


def comparison(results: Results) -> Any:
    """Figure 10: all methods, in the paper's world and in the scenario; below each, again without dead reckoning."""
    worlds = [(title, results.first(world)) for world, title in (("paper", "paper's world"), ("scenario", "scenario"))]
    known = [(title, one) for title, one in worlds if one is not None]
    if not known:
        return None
    figure, axes = _grid(2 * len(known), 4, (12.0, 4.4 * len(known)), sharex=True)
    for k, (title, one) in enumerate(known):
        _courses(axes[2 * k], one, list(one.courses))
        _courses(axes[2 * k + 1], one, [name for name in one.courses if name in _FRAMED])
        axes[2 * k, 0].set_ylabel(title)
        axes[2 * k + 1, 0].set_ylabel("without dead reckoning")
    _titles(axes)
    _legend(figure, axes[0, 0], 6)
    return figure


def _courses(at: Any, one: Found, names: list[str]) -> None:
    for name in names:
        _draw(at, one.courses[name], *_LINES[name], name)
    _spans(at, one)


def _draw(at: Any, course: Course, colour: str, line: str, text: str) -> None:
    """East, north, up and heading error of one course into four panels."""
    for panel, values in zip(at, (*course.error_m.T, course.heading_min), strict=True):
        panel.plot(course.t_s / 3600, values, color=colour, linestyle=line, label=text)


def _spans(at: Any, one: Found) -> None:
    for panel in at:
        for start, end in one.cuts:
            panel.axvspan(start / 3600, end / 3600, color="#F2F2F2", zorder=0)


def _titles(axes: Any) -> None:
    for panel, title in zip(axes[0], _TITLES, strict=True):
        panel.set_title(title, loc="left")
    for panel in axes[-1]:
        panel.set_xlabel("time, h")


def _legend(figure: Any, panel: Any, columns: int) -> None:
    handles, names = panel.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=columns)
