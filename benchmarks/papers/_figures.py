"""The pictures of the reproduction."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.papers import _published as published
from benchmarks.papers._cases import GRAPH, SWEPT
from benchmarks.papers._judged import Found
from benchmarks.papers._results import Results

DPI = 90
AXES = ("east", "north", "up")
_STYLE: dict[Any, Any] = {
    "font.size": 8.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#E0E0E0",
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    "axes.titlesize": 8.5,
    "legend.frameon": False,
    "legend.fontsize": 7.5,
    "lines.linewidth": 1.0,
}
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#7F7F7F", "#E69F00")
LABELS = {"ekf": "filter", "rts-online": "filter and RTS", GRAPH: "graph"}


def draw(results: Results, folder: Path) -> dict[str, Path]:
    """All pictures that the results allow; name -> file."""
    from matplotlib import rc_context

    folder.mkdir(parents=True, exist_ok=True)
    pictures: dict[str, Callable[[Results], Any]] = {
        "intervals-matched": lambda r: intervals(r, "matched"),
        "intervals-paper": lambda r: intervals(r, "paper"),
        "calibration": calibration,
        "uncorrected": uncorrected,
        "error-settings": error_settings,
        "comparison": comparison,
    }
    made: dict[str, Path] = {}
    with rc_context(_STYLE):
        for name, picture in pictures.items():
            figure = picture(results)
            if figure is not None:
                made[name] = _save(figure, folder / f"{name}.png")
    return made


def _save(figure: Any, path: Path) -> Path:
    """Write a picture with a palette, which makes it half the size."""
    from io import BytesIO

    from PIL import Image

    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI)
    Image.open(buffer).convert("RGB").quantize(256, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE).save(
        path, optimize=True
    )
    return path


def _grid(rows: int, columns: int, size: tuple[float, float], **options: Any) -> tuple[Any, Any]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def _cycles(axes: Any, found: Found, label: bool = False) -> None:
    """Cutting cycles as grey spans, A1-A4."""
    for number, (start, end) in enumerate(found.cycles, 1):
        axes.axvspan(start, end, color="#F2F2F2", zorder=0)
        if label:
            axes.annotate(f"A{number}", ((start + end) / 2, 0.98), xycoords=("data", "axes fraction"), ha="center",
                          va="top", color="#808080", fontsize=7)  # fmt: skip


def intervals(results: Results, preset: str) -> Any:
    """Figures 7-8: errors over time by interval of the closed-path points; the graph has no preset."""
    known = [results.drawn(f"interval {interval}") for interval in published.INTERVALS_M]
    logs = [log for log in known if log is not None]
    columns = [f"ekf {preset}", f"rts-online {preset}"] + ([GRAPH] if preset == "matched" else [])
    if len(logs) < len(known):
        return None
    figure, axes = _grid(3, len(columns), (3.6 * len(columns) + 0.4, 5.6), sharex=True)
    for j, name in enumerate(columns):
        for i, axis in enumerate(AXES):
            for log, interval, colour in zip(logs, published.INTERVALS_M, _COLOURS, strict=False):
                one = log.judged[name]
                assert one.t_s is not None and one.error_n_m is not None
                axes[i, j].plot(one.t_s, one.error_n_m[:, i], color=colour, label=f"{interval} m")
            _cycles(axes[i, j], logs[0], label=i == 0)
            axes[i, j].set_ylabel(f"{axis}, m" if j == 0 else "")
        axes[0, j].set_title(f"{LABELS[name.split()[0]]}{'' if name == GRAPH else f', {preset} preset'}", loc="left")
        axes[2, j].set_xlabel("time, s")
    handles, names = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, [f"closed-path points every {name}" for name in names], loc="outside lower center", ncols=3)
    return figure


def calibration(results: Results) -> Any:
    """Figures 9, 10 and 12: estimates over time, matched preset, against what was drawn."""
    found = results.drawn()
    if found is None or found.known is None:
        return None
    figure, axes = _grid(4, 3, (10.5, 7.2), sharex=True)
    for k in range(len(found.names)):
        at = axes.flat[k]
        for name, colour in zip(("ekf matched", "rts-online matched", GRAPH), _COLOURS, strict=False):
            one = found.calibrated[name]
            assert one.t_s is not None and one.value is not None
            at.plot(one.t_s, one.value[:, k], color=colour, label=LABELS[name.split()[0]])
            settled = one.value[one.t_s > found.cycles[0][0], k]
            at.set_ylim(*_reach([*at.get_ylim()] if name != "ekf matched" else [], settled, found.known[k]))
        at.axhline(found.known[k], color="black", linestyle=":", label="drawn")
        _cycles(at, found)
        at.set_title(f"{found.names[k].replace('_', ' ')}{'' if found.units[k] == '1' else f', {found.units[k]}'}",
                     loc="left")  # fmt: skip
    for at in axes.flat[len(found.names) :]:
        at.set_axis_off()
    axes[-1, 0].set_xlabel("time, s")
    handles, names = axes[0, 0].get_legend_handles_labels()
    axes[-1, 1].legend(handles, names, loc="upper left")
    return figure


def _reach(before: list[float], values: Any, known: float) -> tuple[float, float]:
    """Limits that show what happens from the first cut on, and the truth."""
    low, high = min([*before, float(np.min(values)), known]), max([*before, float(np.max(values)), known])
    room = 0.05 * (high - low) if not before else 0.0
    return low - room, high + room


def uncorrected(results: Results) -> Any:
    """Figures 11 and 13: pure inertial navigation, and dead reckoning, by whose calibration they are told."""
    found = results.drawn()
    if found is None or not found.inertial:
        return None
    figure, axes = _grid(1, 3, (10.8, 3.2))
    told = {
        "nothing": ("before", _COLOURS[4], "-"),
        "true": ("drawn", "black", ":"),
        "ekf matched": (LABELS["ekf"], _COLOURS[0], "-"),
        "rts-online matched": (LABELS["rts-online"], _COLOURS[1], "-"),
        GRAPH: (LABELS[GRAPH], _COLOURS[2], "-"),
    }
    for name, (label, colour, line) in told.items():
        error = np.linalg.norm(found.inertial[name], axis=1)
        axes[0, 0].semilogy(np.arange(1, len(error) + 1), error, color=colour, linestyle=line, label=label)
        if name == "nothing":
            continue
        one = found.judged[f"dr by {name}"]
        assert one.t_s is not None and one.error_n_m is not None
        for at, column in ((axes[0, 1], 0), (axes[0, 2], 1)):
            at.plot(one.t_s, one.error_n_m[:, column], color=colour, linestyle=line)
    axes[0, 0].set_title("pure inertial navigation, 3-D error, m", loc="left")
    for at, axis in ((axes[0, 1], "east"), (axes[0, 2], "north")):
        at.set_title(f"dead reckoning, {axis} error, m", loc="left")
        _cycles(at, found)
    for at in axes.flat:
        at.set_xlabel("time, s")
    handles, names = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=5, title="told the calibration of")
    return figure


def error_settings(results: Results) -> Any:
    """Figures 14-15: rms 3-D error by added error setting."""
    pars = [par for par in published.PARS if results.has(f"par {par}", GRAPH)]
    if not pars:
        return None
    figure, axes = _grid(1, 1, (9.0, 3.2))
    marks = {"ekf": ("s", _COLOURS[0]), "rts-online": ("o", _COLOURS[1]), GRAPH: ("D", _COLOURS[2])}
    for name in SWEPT:
        method, _, preset = name.partition(" ")
        mark, colour = marks[method]
        values = [results.rms_3d_m(f"par {par}", name) for par in pars]
        label = f"{LABELS[method]}{f', {preset} preset' if preset else ''}"
        line = "--" if preset == "paper" else "-"
        axes[0, 0].semilogy(pars, values, color=colour, marker=mark, linestyle=line, markersize=4, label=label)
    axes[0, 0].set_xticks(pars, [f"Par {par}" for par in pars])
    axes[0, 0].set_ylabel("rms 3-D error, m")
    axes[0, 0].legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def comparison(results: Results) -> Any:
    """Figure 16: errors over time of table 3's methods."""
    found = results.drawn()
    if found is None or "dead-reckoning rest" not in found.judged:
        return None
    lines = {
        "dead-reckoning rest": ("dead reckoning", _COLOURS[4]),
        "dead-reckoning-cpoem rts": ("dead reckoning, closed path, compensated", _COLOURS[0]),
        "rts-online paper": ("filter and RTS, paper preset", _COLOURS[5]),
        "rts-online matched": ("filter and RTS, matched preset", _COLOURS[1]),
        GRAPH: ("graph", _COLOURS[2]),
    }
    figure, axes = _grid(2, 3, (10.8, 4.6), sharex=True)
    for name, (label, colour) in lines.items():
        one = found.judged[name]
        assert one.t_s is not None and one.error_n_m is not None
        for j, axis in enumerate(AXES):
            axes[0, j].set_title(axis, loc="left")
            axes[0, j].plot(one.t_s, one.error_n_m[:, j], color=colour, label=label)
            if name != "dead-reckoning rest":
                axes[1, j].plot(one.t_s, one.error_n_m[:, j], color=colour)
    for at in axes.flat:
        _cycles(at, found)
    axes[0, 0].set_ylabel("error, m")
    axes[1, 0].set_ylabel("error without the first, m")
    for at in axes[1]:
        at.set_xlabel("time, s")
    handles, names = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=5)
    return figure
