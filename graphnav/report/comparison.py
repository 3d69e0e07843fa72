"""Methods side by side for people: the terminal's table and the figure."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from graphnav._schema import Array
from graphnav.comparison import COLUMNS, TRUTH, Comparison, MethodRow
from graphnav.report import panels
from graphnav.report.plan import BLACK, BLUE, GREEN, ORANGE
from graphnav.report.plots import _STYLE, _save, _split
from graphnav.report.terminal import say, table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import SubFigure

_SPARSE = (0, (2.0, 5.0))
#: Colour (Okabe and Ito), dashes and width by place in the table; sparse dashes show a wide line that they lie on.
_LINES: tuple[tuple[str, Any, float], ...] = (
    (BLUE, "-", 2.4),
    (ORANGE, _SPARSE, 1.4),
    (GREEN, "-", 2.4),
    ("#CC79A7", _SPARSE, 1.4),
    ("#56B4E9", "-", 1.0),
    ("#E69F00", "-", 1.0),
    (BLACK, ":", 1.0),
    ("#7F7F7F", "-", 1.0),
    ("#882255", "-", 1.0),
    ("#332288", "-", 1.0),
    ("#999933", "-", 1.0),
    ("#44AA99", (0, (3.0, 1.5)), 1.4),
    ("#117733", "-", 1.0),
    ("#AA4499", "-", 1.0),
    ("#661100", (0, (3.0, 1.5)), 1.4),
)
#: Methods whose errors differ by more than this factor share no linear axis.
_SPREAD = 8.0


def show(comparison: Comparison) -> None:
    """Print the table and its notes, on standard error."""
    rows = [[cell.replace(" / ", " ") for cell in row.cells()] for row in comparison.rows]
    table(comparison.title, [name.replace(" / ", " ") for name in COLUMNS], rows, width=140)
    for note in comparison.notes():
        say(f"note: {note}")


def plot(comparison: Comparison, path: str | Path) -> Path:
    """Draw errors over time, one panel per axis, and the SEP of every cycle.

    Where one method's errors dwarf another's, the error axes are linear about zero and logarithmic beyond (over seeds,
    where errors are rms values, logarithmic), and so is the SEP axis; the titles say so.

    Parameters
    ----------
    path : the picture's file; its ending (.png, .pdf, .svg) is the format.

    Raises
    ------
    GraphnavError : the picture cannot be written, or no method gave anything to draw.
    """
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    from graphnav.errors import GraphnavError

    shown = [row for row in comparison.rows if row.curve is not None]
    if not shown:
        raise GraphnavError(f"{path}: every method failed, there is nothing to draw")
    with rc_context(_STYLE):
        figure = Figure(figsize=(11.0, 10.5), layout="constrained")
        if comparison.cycles:
            above, below = _split(figure, 2, 1, height_ratios=(3.0, 1.2))
            _seps(below, shown)
        else:
            (above,) = _split(figure, 1, 1)
        _errors(above, comparison, shown)
        figure.suptitle(comparison.title, fontsize=11, x=0.01, ha="left")
        return _save(figure, Path(path))


def _errors(figure: SubFigure, comparison: Comparison, shown: list[MethodRow]) -> None:
    """One panel per axis, all methods in each, cycles shaded."""
    axes_of = figure.subplots(3, 1, sharex=True)
    clock = panels.Clock(max((row.curve.t_s for row in shown if row.curve is not None), key=np.ptp))
    for axis, (axes, name) in enumerate(zip(axes_of, ("East", "North", "Up"), strict=True)):
        for row, (colour, dashes, width) in zip(shown, _LINES, strict=False):
            if row.curve is not None:
                error = row.curve.error_n_m[:, axis]
                axes.plot(clock(row.curve.t_s), error, ls=dashes, color=colour, lw=width, label=row.method)
        axes.set_ylabel(f"{name} (m)")
        sizes = [np.abs(row.curve.error_n_m[:, axis]) for row in shown if row.curve is not None]
        if comparison.seeds:
            _positive_scale(axes, sizes)
        else:
            axes.axhline(0, color=BLACK, lw=0.6)
            _scale(axes, sizes)
    axes_of[0].set_title(_errors_title(comparison, axes_of[0].get_yscale()))
    panels.shade(list(axes_of), comparison.cycles, clock)
    figure.legend(*axes_of[0].get_legend_handles_labels(), loc="outside upper left", ncols=len(shown))
    clock.label(axes_of[-1])


def _errors_title(comparison: Comparison, scale: str) -> str:
    what = "Position error" if comparison.reference == TRUTH else f"Position less that of {comparison.reference}"
    rms = ", rms over the seeds" if comparison.seeds else ""
    return what + rms + {"symlog": " (linear about zero, logarithmic beyond)", "log": " (logarithmic)"}.get(scale, "")


def _scale(axes: Axes, sizes: list[Array]) -> None:
    """A linear axis, or one that is logarithmic beyond what the best methods reach."""
    reach = np.array([size.max() for size in sizes])
    small = reach[reach > 0]
    if len(small) == 0 or small.max() <= _SPREAD * small.min():
        return
    from matplotlib.ticker import FuncFormatter, NullLocator

    linear = float(small.min())
    axes.set_yscale("symlog", linthresh=linear, linscale=1.0)
    decades = 10.0 ** np.arange(np.floor(np.log10(linear)), np.ceil(np.log10(small.max())) + 1)
    marks = [step * decade for decade in decades for step in (1, 3) if linear <= step * decade <= small.max()]
    half = float(f"{linear / 2:.1g}")
    axes.set_yticks(sorted({0.0, *(sign * tick for tick in (half, *marks) for sign in (-1, 1))}))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def _positive_scale(axes: Axes, sizes: list[Array]) -> None:
    """For errors without a sign: from zero, or logarithmic where methods differ much."""
    reach = [float(size.max()) for size in sizes if size.max() > 0]
    if reach and max(reach) > _SPREAD * min(reach):
        axes.set_yscale("log")
        axes.set_ylim(float(np.percentile(np.concatenate(sizes), 0.5)) / 1.5 or None, max(reach) * 1.5)
        _plain_marks(axes)
    else:
        axes.set_ylim(bottom=0)


def _plain_marks(axes: Axes) -> None:
    """Plain numbers at 1 and 3 of every decade."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def _seps(figure: SubFigure, shown: list[MethodRow]) -> None:
    """Grouped bars: the SEP of every cycle and method, the value on each bar."""
    axes = figure.subplots()
    numbers = sorted({cycle.cycle for row in shown for cycle in row.per_cycle})
    width = 0.84 / len(shown)
    values = []
    for place, (row, (colour, *_)) in enumerate(zip(shown, _LINES, strict=False)):
        found = {cycle.cycle: cycle.sep_m for cycle in row.per_cycle}
        x = [k + (place - (len(shown) - 1) / 2) * width for k, n in enumerate(numbers) if n in found]
        heights = [found[n] for n in numbers if n in found]
        values += heights
        axes.bar(x, heights, width * 0.92, color=colour, label=row.method)
        for left, height in zip(x, heights, strict=True):
            axes.annotate(f"{height:.3f}" if height < 1 else f"{height:.2f}", (left, height), xytext=(0, 1.5),
                          textcoords="offset points", ha="center", va="bottom", fontsize=6.5)  # fmt: skip
    positive = [value for value in values if value > 0]
    logarithmic = bool(positive) and max(positive) > _SPREAD * min(positive)
    if logarithmic:
        axes.set_yscale("log")
        axes.set_ylim(min(positive) / 2, max(positive) * 2)
        _plain_marks(axes)
    axes.set_xticks(range(len(numbers)), [f"cycle {n}" for n in numbers])
    axes.grid(axis="x", visible=False)
    axes.set_ylabel("SEP (m)")
    axes.set_title("SEP: median of the 3-D error in each cycle" + (" (logarithmic)" if logarithmic else ""))
