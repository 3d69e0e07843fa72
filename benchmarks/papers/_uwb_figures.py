"""The pictures of the IMU/UWB reproduction: figures 4-6 and 8-13 of the paper, of the first seed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.papers._figures import _COLOURS, _STYLE, _grid, _save
from benchmarks.papers._judged import Array
from benchmarks.papers._uwb_cases import GRAPH, Course, Found
from benchmarks.papers._uwb_rows import AXES, Results, largest, mean_error, spread

#: Case -> colour, width.
_LINES = {
    "uwb": ("#B8B8B8", 0.7),
    "uwb-vbukf": (_COLOURS[5], 1.0),
    "imu-uwb": (_COLOURS[0], 1.2),
    "imu-uwb-vbukf": (_COLOURS[1], 1.0),
    GRAPH: (_COLOURS[2], 1.6),
}
NAMES = {
    "uwb": "UWB alone",
    "uwb-vbukf": "VB-UKF on UWB",
    "imu-uwb": "IMU + UWB",
    "imu-uwb-vbukf": "VB-UKF on IMU + UWB",
    "imu-uwb, Markov counted": "IMU + UWB, Markov errors counted",
    GRAPH: "factor graph (batch)",
}
_ANCHORS = ("1", "2", "3", "4")


def draw(results: Results, folder: Path) -> dict[str, Path]:
    """All pictures that the results allow; name -> file."""
    from matplotlib import rc_context

    folder.mkdir(parents=True, exist_ok=True)
    surface, underground = (results.at(site)[:1] for site in ("surface", "underground"))
    made: dict[str, Path] = {}
    pictures: dict[str, tuple[list[Found], Callable[[Found], Any]]] = {
        "figure-4": (surface, trajectories),
        "figure-5": (surface, errors),
        "figure-6": (surface, shares),
        "figure-8": (underground, ranges_at_rest),
        "figure-9": (underground, trajectories),
        "figure-10": (underground, errors),
        "figure-12": (underground, biases),
        "figure-13": (underground, attitude),
    }
    with rc_context(_STYLE):
        for name, (found, picture) in pictures.items():
            if found:
                made[name] = _save(picture(found[0]), folder / f"{name}.png")
        if underground:
            made["figure-11"] = _save(statistics(results), folder / "figure-11.png")
    return made


def _shown(one: Found) -> list[tuple[str, Course, str, float]]:
    """Courses that succeeded with their lines."""
    known = [(name, one.courses.get(name), *line) for name, line in _LINES.items()]
    return [(name, course, colour, width) for name, course, colour, width in known if isinstance(course, Course)]


def _moving(one: Found, *axes: Any) -> None:
    for at in axes:
        at.axvspan(*one.spans_s, color="#F4F4F4", zorder=0)


def _legend(figure: Any, at: Any, columns: int = 5) -> None:
    figure.legend(*at.get_legend_handles_labels(), loc="outside lower center", ncols=columns)


def _frame(at: Any, values: list[Array], of: str = "both") -> None:
    """Limits that a few wild epochs do not set."""
    low, high = (float(np.quantile(np.concatenate(values), q)) for q in (0.002, 0.998))
    margin = 0.08 * (high - low)
    at.set_ylim(0.0 if of == "above" else low - margin, high + margin)


def trajectories(one: Found) -> Any:
    """Figures 4 and 9: place of the tag over time, x, y, z."""
    figure, axes = _grid(3, 1, (8.5, 6.4), sharex=True)
    for i, (at, name) in enumerate(zip(axes[:, 0], ("x, m", "y, m", "z, m"), strict=True)):
        for case, course, colour, width in _shown(one):
            at.plot(course.t_s, course.tag_n[:, i], color=colour, lw=width, label=NAMES[case])
        case, course, *_ = _shown(one)[0]
        true = course.tag_n[:, i] - course.error_m[:, i]
        at.plot(course.t_s, true, color="black", lw=0.9, ls=(0, (4, 2)), label="truth")
        at.set_ylabel(name)
        _frame(at, [course.tag_n[:, i] for _, course, *_ in _shown(one)])
        _moving(one, at)
    axes[2, 0].set_xlabel("time, s (grey: moving)")
    _legend(figure, axes[0, 0], 6)
    return figure


def errors(one: Found) -> Any:
    """Figures 5 and 10: absolute errors over time, x and z."""
    figure, axes = _grid(2, 1, (8.5, 5.0), sharex=True)
    for at, (name, axis) in zip(axes[:, 0], AXES.items(), strict=True):
        for case, course, colour, width in _shown(one):
            at.plot(course.t_s, np.abs(course.error_m[:, axis]), color=colour, lw=width, label=NAMES[case])
        at.set_ylabel(f"|error in {name}|, m")
        _frame(at, [np.abs(course.error_m[:, axis]) for _, course, *_ in _shown(one)], "above")
        _moving(one, at)
    axes[1, 0].set_xlabel("time, s (grey: moving)")
    _legend(figure, axes[0, 0])
    return figure


def shares(one: Found) -> Any:
    """Figure 6: share of the epochs whose error is below a value."""
    figure, axes = _grid(1, 2, (8.5, 3.2), sharey=True)
    for at, (name, axis) in zip(axes[0], AXES.items(), strict=True):
        for case, course, colour, width in _shown(one):
            size = np.sort(np.abs(course.error_m[:, axis]))
            drawn = "#808080" if case == "uwb" else colour
            at.plot(size, np.arange(1, len(size) + 1) / len(size), color=drawn, lw=max(width, 1.2), label=NAMES[case])
        at.axhline(0.9, color="#808080", lw=0.6, ls=":")
        at.set_xlabel(f"|error in {name}|, m")
        at.set_xlim(left=0.0)
        at.set_ylim(0, 1)
    axes[0, 0].set_ylabel("share of epochs (CDF)")
    _legend(figure, axes[0, 0])
    return figure


def ranges_at_rest(one: Found) -> Any:
    """Figure 8: ranges less their medians, before the machine moves and after it has stopped."""
    start, end = one.spans_s
    figure, axes = _grid(4, 2, (8.5, 5.6), sharey="row")
    for column, (inside, title) in enumerate(
        ((one.range_s < start - 1, "before the machine moves"), (one.range_s > end + 1, "after it has stopped"))
    ):
        for at, anchor in zip(axes[:, column], _ANCHORS, strict=True):
            mine = inside & (one.anchor == anchor)
            if not mine.any():
                continue
            fluctuation = 100 * (one.range_m[mine] - np.median(one.range_m[mine]))
            at.plot(one.range_s[mine], fluctuation, ".", ms=2.0, color=_COLOURS[0])
            at.set_ylim(-8, 20)
            above = int((fluctuation > 20).sum())
            if above:
                text = f"{above} more above 20 cm"
                at.annotate(text, (0.99, 0.95), xycoords="axes fraction", ha="right", va="top", fontsize=7)
            at.set_ylabel(f"anchor {anchor}, cm" if column == 0 else "")
        axes[0, column].set_title(title, loc="left")
        axes[3, column].set_xlabel("time, s")
    return figure


def statistics(results: Results) -> Any:
    """Figure 11: largest, mean and standard deviation of the absolute error underground, median of the seeds."""
    figure, axes = _grid(1, 2, (8.5, 3.4), sharey=True)
    cases = [case for case in _LINES if results.courses("underground", case)]
    kinds = (("largest", largest), ("mean", mean_error), ("standard deviation", spread))
    for at, (name, axis) in zip(axes[0], AXES.items(), strict=True):
        for k, case in enumerate(cases):
            values = [results.median("underground", case, of) for _, of in kinds]
            heights = [float(value[axis]) for value in values if value is not None]
            x = np.arange(len(kinds)) + (k - (len(cases) - 1) / 2) * 0.8 / len(cases)
            at.bar(x, heights, 0.74 / len(cases), color=_LINES[case][0], label=NAMES[case])
            for left, height in zip(x, heights, strict=True):
                at.annotate(f"{height:.2f}", (left, height), xytext=(0, 1.5), textcoords="offset points", ha="center",
                            fontsize=6)  # fmt: skip
        at.set_yscale("log")
        at.grid(axis="x", visible=False)
        at.set_xticks(range(len(kinds)), [name for name, _ in kinds])
        at.set_title(name, loc="left")
    axes[0, 0].set_ylabel("absolute error, m")
    _legend(figure, axes[0, 0])
    return figure


def biases(one: Found) -> Any:
    """Figure 12: biases of accelerometer and gyro, with two sigmas, and what was drawn."""
    figure, axes = _grid(2, 3, (9.5, 4.6), sharex=True)
    for k, at in enumerate(axes.flat):
        for case in ("imu-uwb", GRAPH):
            course = one.courses.get(case)
            if not isinstance(course, Course) or course.bias is None or course.bias_s is None:
                continue
            colour = _LINES[case][0]
            at.plot(course.bias_s, course.bias[:, k], color=colour, label=NAMES[case])
            if course.bias_sigma is not None:
                band = 2 * course.bias_sigma[:, k]
                low, high = course.bias[:, k] - band, course.bias[:, k] + band
                at.fill_between(course.bias_s, low, high, color=colour, alpha=0.2, lw=0, label="two sigmas")
        at.axhline(one.true_bias[k], color="black", lw=0.9, ls=(0, (4, 2)), label="drawn")
        at.set_ylabel(f"{'accelerometer' if k < 3 else 'gyro'} {'xyz'[k % 3]}, {'mg' if k < 3 else 'deg/h'}")
        _moving(one, at)
    for at in axes[1]:
        at.set_xlabel("time, s (grey: moving)")
    _legend(figure, axes[0, 0])
    return figure


def attitude(one: Found) -> Any:
    """Figure 13: yaw, pitch and roll; the truth is zero but for the vibration."""
    figure, axes = _grid(3, 1, (8.5, 5.2), sharex=True)
    for i, (at, name) in enumerate(zip(axes[:, 0], ("yaw", "pitch", "roll"), strict=True)):
        for case in ("imu-uwb", GRAPH):
            course = one.courses.get(case)
            if isinstance(course, Course):
                at.plot(course.t_s, course.angle_deg[:, i], color=_LINES[case][0], label=NAMES[case])
        at.axhline(0.0, color="black", lw=0.9, ls=(0, (4, 2)), label="truth but for the vibration")
        at.set_ylabel(f"{name}, deg")
        _moving(one, at)
    axes[2, 0].set_xlabel("time, s (grey: moving)")
    _legend(figure, axes[0, 0])
    return figure
