"""The plan view of a run."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from graphnav._schema import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import SubFigure

    from graphnav.log import Position, SensorLog
    from graphnav.trajectory import Trajectory

# Okabe and Ito's palette, which the usual kinds of colour blindness tell apart.
BLUE, ORANGE, GREEN, BLACK, SHADE = "#0072B2", "#D55E00", "#009E73", "#222222", "#EDEFF2"


def draw_plan(
    figure: SubFigure,
    trajectory: Trajectory,
    log: SensorLog,
    withheld: Position | None,
) -> None:
    """Estimate, truth, given and withheld positions and surveyed points, seen from above."""
    axes = figure.subplots()
    view = _View(trajectory.pos_n)
    if log.truth is not None:
        inside = (log.truth.t_s >= trajectory.t_s[0]) & (log.truth.t_s <= trajectory.t_s[-1])
        axes.plot(*view(log.truth.pos_n_m[inside][:: 1 + len(log.truth) // 20_000]), color=BLACK, lw=2.2, alpha=0.35)
        axes.plot([], [], color=BLACK, lw=2.2, alpha=0.35, label="truth")
    axes.plot(*view(trajectory.pos_n), color=BLUE, lw=1.0, label="estimate")
    for position, label, colour, marker in (
        (log.position, "positions given", GREEN, "o"),
        (withheld, "positions withheld", ORANGE, "x"),
    ):
        if position is not None:
            axes.plot(*view(position.pos_n_m), marker, ms=2.5, mew=0.7, color=colour, ls="", label=label)
    if log.surveyed:
        surveyed = np.array([point.pos_n_m for point in log.surveyed])
        axes.plot(*view(surveyed), "^", ms=8, color=ORANGE, mec="white", ls="", label="surveyed point")
    axes.plot(*view(trajectory.pos_n[:1]), "o", ms=7, color="white", mec=BLACK, mew=1.4, label="start")
    axes.plot(*view(trajectory.pos_n[-1:]), "s", ms=6, color=BLACK, mec="white", label="end")
    view.label(axes)
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))


class _View:
    """The plan's axes: east and north to scale, or along and across a long narrow track, across stretched."""

    def __init__(self, pos_n: Array) -> None:
        self.origin = pos_n[0, :2]
        moved = pos_n[:, :2] - pos_n[:, :2].mean(axis=0)
        direction = np.linalg.svd(moved, full_matrices=False)[2][0]
        ahead = np.asarray(pos_n[np.argmax(np.linalg.norm(pos_n[:, :2] - self.origin, axis=1)), :2] - self.origin)
        direction = direction if direction @ ahead >= 0 else -direction
        self.axes_n = np.array([direction, [-direction[1], direction[0]]])  # along, and to the left of it
        extent = np.ptp(moved @ self.axes_n.T, axis=0)
        self.narrow = bool(extent[1] < extent[0] / 8)
        self.bearing_deg = float(np.rad2deg(np.arctan2(direction[0], direction[1])) % 360)

    def __call__(self, pos_n: Array) -> tuple[Array, Array]:
        seen = (pos_n[:, :2] - self.origin) @ self.axes_n.T if self.narrow else pos_n[:, :2]
        return seen[:, 0], seen[:, 1]

    def label(self, axes: Axes) -> None:
        if self.narrow:
            axes.set_xlabel(f"Along the track, bearing {self.bearing_deg:.0f} deg (m)")
            axes.set_ylabel("Across it, left positive (m)")
            axes.margins(x=0.03, y=0.12)
            box, (x, y) = axes.get_window_extent(), (np.ptp(axes.get_xlim()), np.ptp(axes.get_ylim()))
            axes.set_title(f"Plan, stretched about {(box.height / y) / (box.width / x):.0f} times across the track")
        else:
            axes.set_xlabel("East (m)")
            axes.set_ylabel("North (m)")
            axes.set_aspect("equal", adjustable="datalim")
            axes.set_title("Plan, to scale")
