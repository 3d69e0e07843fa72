"""Observability for people: a table with the weakest directions in words, and a figure over time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from graphnav._directions import OBSERVABLE, State
from graphnav._observability import NOT_OBSERVABLE, Observability
from graphnav._schema import Array
from graphnav.report.panels import Clock
from graphnav.report.plan import BLACK, BLUE, GREEN, ORANGE
from graphnav.report.plots import _STYLE, _save
from graphnav.report.terminal import say, table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LINES = ((BLUE, "-"), (ORANGE, "--"), (GREEN, "-."), (BLACK, ":"))
#: Spans of a weakest direction shorter than this share of the log are left out of the list.
_SHORTEST = 0.03
_KINDS = {"causal": "each time from the log up to it", "smoothed": "each time from the whole log"}


def render(observability: Observability) -> None:
    """Show the verdict on each state, the weakest directions at the end and how the weakest changed."""
    o = observability
    causal = o.kind == "causal"
    columns = ["at the end", "known before", "sigma", "ratio", "largest ratio", "verdict"]
    rows = []
    unit = np.array([state.unit_si for state in o.states])
    figures = zip(o.states, o.reference[-1] / unit, o.sigma[-1] / unit, o.ratio[-1], o.ratio.max(axis=0), strict=True)
    for k, (state, before, sigma, ratio, largest) in enumerate(figures):
        row = [f"{state.name} ({state.unit})", *(f"{value:.3g}" for value in (before, sigma, ratio, largest))]
        since = o.since_s[k]
        rows.append([*row, o.verdicts[k], "-" if np.isnan(since) else f"{round(since)} s"][: 7 if causal else 6])
    table(f"Observability, {_KINDS[o.kind]}", columns + ["since"] * causal, rows)
    determined = int((o.information >= 1).sum())
    say(f"calibration: the data outweigh what was declared in {determined} of {len(o.information)} directions")
    say("weakest directions at the end, one sigma of each and its ratio to what was known before:")
    for direction in o.weakest[-1]:
        say(f"  {direction.size:6.3g}  {direction.text}")
    if not o.weakest[-1]:
        say("  none: in every direction the data outweigh what was known before")
    say("the weakest direction over time, at its worst:")
    for start_s, end_s, direction in o.weakest_spans():
        if end_s - start_s >= _SHORTEST * (o.t_s[-1] - o.t_s[0]):
            say(f"  {start_s:.0f} to {end_s:.0f} s: {direction.text}")


def plot(observability: Observability, path: str | Path) -> Path:
    """Draw sigma over what was known before, per state over time.

    Parameters
    ----------
    path : the picture's file; its ending (.png, .pdf, .svg) is the format.

    Returns
    -------
    Path
        The file written.
    """
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    o = observability
    groups = list(dict.fromkeys(state.group for state in o.states))
    with rc_context(_STYLE):
        figure = Figure(figsize=(11.0, 9.0), layout="constrained")
        panels = figure.subplots(int(np.ceil(len(groups) / 2)), 2, sharex=True)
        clock = Clock(o.t_s)
        for axes, group in zip(panels.ravel(), groups, strict=False):
            rows = [k for k, state in enumerate(o.states) if state.group == group]
            _panel(axes, clock(o.t_s), o.ratio[:, rows], [_label(o.states[k]) for k in rows])
            axes.set_title(f"{group[0].upper()}{group[1:]}")
        for axes in panels.ravel()[len(groups) :]:
            axes.set_axis_off()
        for axes in panels.ravel()[len(groups) - 2 : len(groups)]:
            axes.tick_params(labelbottom=True)
            clock.label(axes)
        figure.suptitle(_headline(o), fontsize=11, x=0.01, ha="left")
        return _save(figure, Path(path))


def _panel(axes: Axes, t: Array, ratio: Array, names: list[str]) -> None:
    """Ratios on a logarithmic axis; shaded where they are not observable, a line below which they are."""
    for values, name, (colour, line) in zip(ratio.T, names, _LINES, strict=False):
        axes.semilogy(t, values, color=colour, ls=line, lw=1.2, label=name)
    low, high = min(float(ratio.min()), 0.1) / 1.6, max(float(ratio.max()), 1.0) * 1.6
    axes.axhspan(NOT_OBSERVABLE, high, color=ORANGE, alpha=0.08, lw=0)
    axes.axhline(OBSERVABLE, color=BLACK, lw=0.8, ls=(0, (1, 2)))
    axes.set_ylim(low, high)
    axes.set_ylabel("sigma / known before")
    axes.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 0.98),
        ncols=len(names),
        borderaxespad=0.0,
        handlelength=1.8,
        columnspacing=1.2,
    )


def _label(state: State) -> str:
    """Its name without what the panel's title says."""
    return state.name.removeprefix(f"{state.group} ").removeprefix("mounting angle about ").removeprefix("odometer ")


def _headline(o: Observability) -> str:
    weakest = o.weakest[-1]
    end = weakest[0].text if weakest else "none"
    return (
        f"Observability, {_KINDS[o.kind]}: not observable where shaded, observable below the dotted line\n"
        f"Weakest direction at the end: {end}"
    )
