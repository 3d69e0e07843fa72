"""Panels over time: errors with their 3-sigma bands, sigmas, cutting cycles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from graphnav._schema import Array
from graphnav.report.plan import BLACK, BLUE, GREEN, ORANGE, SHADE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import SubFigure

    from graphnav._cycles import CycleError
    from graphnav.evaluation import Evaluation
    from graphnav.log import Position
    from graphnav.trajectory import Trajectory

_LINES = ((BLUE, "-"), (ORANGE, "--"), (GREEN, "-."))
_ENU, _RFU = ("East", "North", "Up"), ("Right", "Forward", "Up")


class Clock:
    """Time axis in the unit that suits the length of the run."""

    def __init__(self, t_s: Array) -> None:
        span = float(t_s[-1] - t_s[0])
        self.start_s, self.end_s = float(t_s[0]), float(t_s[-1])
        self.unit, self.scale = ("s", 1.0) if span < 300 else ("min", 60.0) if span < 3 * 3600 else ("h", 3600.0)

    def __call__(self, t_s: Any) -> Any:
        """Times in the axis' unit."""
        return np.asarray(t_s) / self.scale

    def label(self, axes: Axes) -> None:
        """Label the axis and set its limits to the run's."""
        axes.set_xlabel(f"Time ({self.unit})")
        axes.set_xlim(self.start_s / self.scale, self.end_s / self.scale)


def truth_errors(
    left: SubFigure,
    right: SubFigure,
    trajectory: Trajectory,
    evaluation: Evaluation,
    clock: Clock,
    band: str = "3 sigma",
) -> None:
    """Position and attitude errors against truth, cutting cycles shaded; `band` says whose sigmas are drawn."""
    t_s = evaluation.t_s
    sigma = _sigma_rows(trajectory)[:, np.searchsorted(trajectory.t_s, t_s)]
    att_deg, att_sigma_deg = np.rad2deg(evaluation.att_error_b_rad), np.rad2deg(sigma[0:3])
    _errors(left, "Position error", _ENU, clock, t_s, evaluation.error_n_m, sigma[3:6], "m", band)
    _errors(right, "Attitude error", _RFU, clock, t_s, att_deg, att_sigma_deg, "deg", band)
    shade([*left.get_axes(), *right.get_axes()], evaluation.per_cycle, clock)


def _errors(
    figure: SubFigure,
    title: str,
    names: tuple[str, ...],
    clock: Clock,
    t_s: Array,
    error: Array,
    sigma: Array,
    unit: str,
    band_label: str = "3 sigma",
) -> None:
    """One panel per axis: error, and three sigmas to either side where they are known."""
    panels = figure.subplots(3, 1, sharex=True)
    for axis, (axes, name) in enumerate(zip(panels, names, strict=True)):
        band = 3 * sigma[axis]
        if np.isfinite(band).any():
            axes.fill_between(clock(t_s), -band, band, color=BLUE, alpha=0.22, lw=0, label=band_label)
        axes.axhline(0, color=BLACK, lw=0.6)
        marker = "." if len(t_s) < 500 else ""
        axes.plot(clock(t_s), error[:, axis], marker=marker, ms=3, color=ORANGE, lw=0.9, label="error")
        axes.set_ylabel(f"{name} ({unit})")
        _limit(axes, error[:, axis], band)
    panels[0].set_title(title)
    panels[0].legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=2, borderaxespad=0.0)
    clock.label(panels[-1])


def _limit(axes: Axes, error: Array, band: Array) -> None:
    """Show every error, and the band but for a start that would dwarf the rest."""
    usual = float(np.nanpercentile(band, 98)) if np.isfinite(band).any() else 0.0
    reach = 1.15 * max(float(np.abs(error).max()), usual)
    if reach > 0:
        axes.set_ylim(-reach, reach)


def withheld_errors(figure: SubFigure, trajectory: Trajectory, withheld: Position, clock: Clock) -> None:
    """Differences from positions withheld; the band holds their own sigma as well."""
    inside = (withheld.t_s >= trajectory.t_s[0]) & (withheld.t_s <= trajectory.t_s[-1])
    t_s = withheld.t_s[inside]
    estimate = trajectory.at(t_s)
    sigma = np.hypot(_sigma_rows(estimate)[3:6], withheld.sigma_n_m[inside].T)
    error = estimate.pos_n - withheld.pos_n_m[inside]
    _errors(figure, "Difference from withheld positions", _ENU, clock, t_s, error, sigma, "m")


def sigmas(figure: SubFigure, trajectory: Trajectory, clock: Clock) -> None:
    """Position and attitude sigmas on logarithmic axes; height over time where there are none."""
    sigma = _sigma_rows(trajectory)
    if not np.isfinite(sigma[:6]).any():
        axes = figure.subplots()
        axes.plot(clock(trajectory.t_s), trajectory.pos_n[:, 2], color=BLUE)
        axes.set_title("Height (no covariances, no truth)")
        axes.set_ylabel("Up (m)")
        clock.label(axes)
        return
    panels = figure.subplots(2, 1, sharex=True)
    for axes, rows, names, title in (
        (panels[0], sigma[3:6], _ENU, "Position sigma (m)"),
        (panels[1], np.rad2deg(sigma[0:3]), _RFU, "Attitude sigma (deg)"),
    ):
        for row, name, (colour, line) in zip(rows, names, _LINES, strict=True):
            axes.semilogy(clock(trajectory.t_s), row, color=colour, ls=line, lw=1.2, label=name)
        axes.set_title(title)
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=3, borderaxespad=0.0)
        _plain_log_axis(axes, rows)
    clock.label(panels[1])


def _plain_log_axis(axes: Axes, values: Array) -> None:
    """A logarithmic axis with plain numbers at 1, 2, 5, wide enough to hold two of them."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    known = values[np.isfinite(values) & (values > 0)]
    if len(known):
        axes.set_ylim(float(known.min()) / 1.6, float(known.max()) * 1.6)
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def distribution(figure: SubFigure, evaluation: Evaluation) -> None:
    """Share of the keyframes whose 3-D error is no larger than the abscissa, with its median, the SEP."""
    axes = figure.subplots()
    norms = np.sort(np.linalg.norm(evaluation.error_n_m, axis=1))
    axes.step(norms, 100 * np.arange(1, len(norms) + 1) / len(norms), where="post", color=BLUE, lw=1.4)
    axes.plot([0, evaluation.sep_m, evaluation.sep_m], [50, 50, 0], color=BLACK, lw=0.8, ls="--")
    axes.annotate(f"SEP {evaluation.sep_m:.3f} m", (evaluation.sep_m, 4), xytext=(4, 0), textcoords="offset points")
    axes.set_xlim(0, None)
    axes.set_ylim(0, 100)
    axes.set_title("3-D error")
    axes.set_xlabel("Error (m)")
    axes.set_ylabel("Keyframes below it (%)")


def shade(panels: list[Axes], cycles: Sequence[CycleError], clock: Clock) -> None:
    """Grey spans for the cutting cycles, numbered in the top panels."""
    for axes in panels:
        for cycle in cycles:
            axes.axvspan(clock(cycle.start_s), clock(cycle.end_s), color=SHADE, lw=0, zorder=0)
            if axes.get_title(loc="left"):
                middle = float(clock((cycle.start_s + cycle.end_s) / 2))
                label = f"cycle {cycle.cycle}"
                axes.annotate(
                    label,
                    (middle, 1),
                    xycoords=("data", "axes fraction"),
                    ha="center",
                    va="top",
                    fontsize=7.5,
                )


def _sigma_rows(trajectory: Trajectory) -> Array:
    """(9, N) sigmas in the order of the covariance, NaN where unknown."""
    if trajectory.cov is None:
        return np.full((9, len(trajectory)), np.nan)
    return np.asarray(np.sqrt(np.diagonal(trajectory.cov, axis1=1, axis2=2)).T)
