"""The pictures of the roadheader's reproduction: figures 8, 9 and 14 of the paper, errors with their bands, the way."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.papers._figures import _COLOURS, _STYLE, _grid, _save
from benchmarks.papers._judged import Array
from benchmarks.papers._vio_cases import GRAPH, LOOSE, RELATIVE, Course, Found
from benchmarks.papers._vio_features import ENHANCERS, Shown
from benchmarks.papers._vio_published import AXES, UNITS
from benchmarks.papers._vio_rows import Results

#: Case -> colour, width; drawn in this order.
_LINES = {
    "sins": ("#B8B8B8", 1.0),
    "vio-kf": (_COLOURS[1], 1.1),
    GRAPH: (_COLOURS[2], 1.5),
}
NAMES = {
    "sins": "SINS alone",
    "stereo": "stereo odometry alone",
    "vio-kf": "the paper's filter",
    "vio-kf, enhanced": "the paper's filter, enhanced images",
    RELATIVE: "filter on relative poses",
    LOOSE: "graph, loose",
    "batch, loose, enhanced": "graph, loose, enhanced images",
    GRAPH: "graph, tight (batch)",
    "batch, raw images": "graph, tight, raw images",
    "batch, enhanced": "graph, tight, enhanced images",
}
_ENHANCED_COLOURS = {"none": "#808080", "clahe": _COLOURS[5], "retinex-dust": _COLOURS[0]}
_BANDED = {"errors-filter": ("vio-kf", RELATIVE), "errors-graph": (LOOSE, GRAPH)}


def draw(results: Results, pair: dict[str, Shown], folder: Path) -> dict[str, Path]:
    """All pictures that the results allow, of the first seed but for figure 8; name -> file."""
    from matplotlib import rc_context

    folder.mkdir(parents=True, exist_ok=True)
    made: dict[str, Any] = {}
    first = results.found[0]
    with rc_context(_STYLE):
        if _known(first, tuple(_LINES)):
            made["figure-14"], made["way"] = poses(first), way(first)
        for name, cases in _BANDED.items():
            if _known(first, cases):
                made[name] = errors(first, cases)
        if len(results.matched("none")):
            made["figure-8"] = histograms(results)
        if pair:
            made["figure-9"] = matched(pair)
        return {name: _save(picture, folder / f"{name}.png") for name, picture in made.items()}


def _known(one: Found, cases: tuple[str, ...]) -> dict[str, Course]:
    """Courses that succeeded."""
    every = {case: one.courses.get(case) for case in cases}
    return {case: course for case, course in every.items() if isinstance(course, Course)}


def _legend(figure: Any, at: Any, columns: int = 5) -> None:
    figure.legend(*at.get_legend_handles_labels(), loc="outside lower center", ncols=columns)


def poses(one: Found) -> Any:
    """Figure 14 a-f: position and attitude over time; what leaves the axes is SINS alone."""
    figure, axes = _grid(3, 2, (9.5, 7.0), sharex=True)
    known = _known(one, tuple(_LINES))
    for k, (axis, unit) in enumerate(zip(AXES, UNITS, strict=True)):
        at = axes[k % 3, k // 3]
        for case, course in known.items():
            colour, width = _LINES[case]
            at.plot(course.t_s, course.pose[:, k], color=colour, lw=width, label=NAMES[case])
        course = next(iter(known.values()))
        true = course.pose[:, k] - course.error[:, k]
        at.plot(course.t_s, true, color="black", lw=0.8, ls=(0, (4, 2)), label="truth")
        at.set_ylabel(f"{axis}, {unit}")
        at.set_title(f"({'abcdef'[k]})", loc="left")
        _frame(at, [true, *(course.pose[:, k] for case, course in known.items() if case != "sins")])
    for at in axes[2]:
        at.set_xlabel("time, s")
    _legend(figure, axes[0, 0])
    return figure


def _frame(at: Any, values: list[Array]) -> None:
    low, high = min(v.min() for v in values), max(v.max() for v in values)
    margin = 0.08 * (high - low) + 1e-9
    at.set_ylim(low - margin, high + margin)


def errors(one: Found, cases: tuple[str, ...]) -> Any:
    """Errors over time with the three sigmas that each method states."""
    figure, axes = _grid(3, 2, (9.5, 7.0), sharex=True)
    for k, (axis, unit) in enumerate(zip(AXES, UNITS, strict=True)):
        at = axes[k % 3, k // 3]
        scale, unit = (1e3, "mm") if unit == "m" else (1.0, unit)
        for (case, course), colour in zip(_known(one, cases).items(), (_COLOURS[1], _COLOURS[2]), strict=False):
            at.plot(course.t_s, scale * course.error[:, k], color=colour, lw=1.0, label=NAMES[case])
            if course.sigma is not None:
                reach = 3 * scale * course.sigma[:, k]
                said = f"3 sigmas of {NAMES[case]}"
                at.fill_between(course.t_s, -reach, reach, color=colour, alpha=0.18, lw=0, label=said)
        at.set_ylabel(f"error in {axis}, {unit}")
    for at in axes[2]:
        at.set_xlabel("time, s")
    _legend(figure, axes[0, 0])
    return figure


def way(one: Found) -> Any:
    """The way seen from above, and what each method errs to the side of it."""
    figure, axes = _grid(2, 1, (8.5, 4.6), sharex=True)
    known = _known(one, tuple(_LINES))
    true = next(iter(known.values())).pose - next(iter(known.values())).error
    for case, course in known.items():
        colour, width = _LINES[case]
        axes[0, 0].plot(course.pose[:, 1], course.pose[:, 0], color=colour, lw=width, label=NAMES[case])
        axes[1, 0].plot((course.pose - course.error)[:, 1], 1e3 * course.error[:, 0], color=colour, lw=width)
    axes[0, 0].plot(true[:, 1], true[:, 0], color="black", lw=0.8, ls=(0, (4, 2)), label="truth")
    axes[0, 0].set_ylabel("x, to the right, m")
    axes[1, 0].set_ylabel("error in x, mm")
    _frame(axes[0, 0], [true[:, 0], *(c.pose[:, 0] for case, c in known.items() if case != "sins")])
    _frame(axes[1, 0], [1e3 * c.error[:, 0] for case, c in known.items() if case != "sins"])
    axes[1, 0].set_xlim(true[:, 1].min() - 0.3, true[:, 1].max() + 0.3)  # SINS alone leaves it
    axes[1, 0].set_xlabel("y, along the roadway, m")
    _legend(figure, axes[0, 0])
    return figure


def histograms(results: Results) -> Any:
    """Figure 8: how many matches RANSAC keeps of a pair of frames, raw and enhanced."""
    figure, axes = _grid(1, 1, (7.5, 3.0))
    at = axes[0, 0]
    every = {name: results.matched(name) for name in ENHANCERS}
    top = max(values.max() for values in every.values())
    edges = np.linspace(0.0, np.ceil(top / 20) * 20, 31)
    for name, values in every.items():
        colour, label = _ENHANCED_COLOURS[name], f"{ENHANCERS[name]}, mean {values.mean():.0f}"
        at.hist(values, edges, color=colour, alpha=0.35, label=label)
        at.hist(values, edges, color=colour, histtype="step", lw=1.2)
        at.axvline(values.mean(), color=colour, lw=1.0, ls="--")
    at.set_xlabel("matched features that RANSAC keeps")
    at.set_ylabel("pairs of frames")
    at.legend()
    return figure


def matched(pair: dict[str, Shown]) -> Any:
    """Figure 9: the matches of one pair of frames, coloured by their depth."""
    figure, axes = _grid(len(pair), 1, (8.5, 2.6 * len(pair)))
    for at, (name, one) in zip(axes[:, 0], pair.items(), strict=True):
        width = one.first.shape[1]
        at.imshow(np.hstack([one.first, one.second]), cmap="gray", vmin=0, vmax=255)
        x = np.column_stack([one.first_px[:, 0], one.second_px[:, 0] + width]).T
        y = np.column_stack([one.first_px[:, 1], one.second_px[:, 1]]).T
        for k in range(0, x.shape[1], 4):
            at.plot(x[:, k], y[:, k], color=_COLOURS[5], lw=0.5, alpha=0.7)
        points = at.scatter(x.ravel(), y.ravel(), 7, np.tile(one.depth_m, 2), cmap="viridis_r", vmin=1, vmax=12)
        at.set_title(f"{ENHANCERS[name]}: {x.shape[1]} matches, every fourth joined", loc="left")
        at.set_xticks([])
        at.set_yticks([])
        at.grid(False)
        figure.colorbar(points, ax=at, label="depth, m", shrink=0.85)
    return figure
