"""Figures of a run: plan view, errors with their 3-sigma bands, sigmas alone where truth is unknown."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from graphnav._outputs import check_file
from graphnav.errors import GraphnavError
from graphnav.report import panels
from graphnav.report.plan import draw_plan

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure

    from graphnav.evaluation import Evaluation
    from graphnav.log import Position, SensorLog
    from graphnav.trajectory import Trajectory

_STYLE: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#D9D9D9",
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    "axes.titlesize": 10.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "legend.frameon": False,
    "legend.fontsize": 8.0,
}


def plot_run(
    trajectory: Trajectory,
    log: SensorLog,
    path_png: str | Path,
    evaluation: Evaluation | None = None,
    withheld: Position | None = None,
) -> Path:
    """Draw a run: plan view above; below, errors over time where there is something to judge by.

    Beside the plan, with truth, the distribution of the 3-D error.

    Parameters
    ----------
    trajectory : the estimate at its keyframes.
    log : its log; name, truth, given positions and cycles are taken from it.
    path_png : the picture's file; its ending (.png, .pdf, .svg) is the format.
    evaluation : errors against truth; computed when the log has truth and this is not given.
    withheld : positions that the estimator was not given; without truth, errors are drawn against them.

    Returns
    -------
    Path
        The file written.
    """
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    if evaluation is None and log.truth is not None:
        from graphnav.evaluation import evaluate

        evaluation = evaluate(trajectory, log)
    with rc_context(_STYLE):
        figure = Figure(figsize=(11.0, 10.5), layout="constrained")
        plan, below = _split(figure, 2, 1, height_ratios=(1.0, 1.25))
        if evaluation is not None:
            plan, beside = _split(plan, 1, 2, width_ratios=(3.0, 1.0))
            panels.distribution(beside, evaluation)
        draw_plan(plan, trajectory, log, withheld)
        clock = panels.Clock(trajectory.t_s)
        if evaluation is not None:
            left, right = _split(below, 1, 2)
            panels.truth_errors(left, right, trajectory, evaluation, clock)
        elif withheld is not None:
            left, right = _split(below, 1, 2)
            panels.withheld_errors(left, trajectory, withheld, clock)
            panels.sigmas(right, trajectory, clock)
        else:
            panels.sigmas(below, trajectory, clock)
        figure.suptitle(_headline(log, trajectory, evaluation, withheld), fontsize=11, x=0.01, ha="left")
        return _save(figure, Path(path_png))


def _split(figure: Figure | SubFigure, rows: int, columns: int, **options: Any) -> list[SubFigure]:
    """Parts of a figure, row by row."""
    return list(np.ravel(np.asarray(figure.subfigures(rows, columns, **options), dtype=object)))


def _headline(log: SensorLog, trajectory: Trajectory, evaluation: Evaluation | None, withheld: Position | None) -> str:
    span = trajectory.t_s[-1] - trajectory.t_s[0]
    title = f"{log.name}: {len(trajectory)} keyframes over {span:,.0f} s"
    if evaluation is None and withheld is None:
        return title
    if evaluation is not None:
        what, rms_m, nees = "Position error", evaluation.rms_m, evaluation.nees_position
    else:
        from graphnav.evaluation import withheld_error

        found = withheld_error(trajectory, withheld)  # type: ignore[arg-type]
        what, rms_m, nees = f"At {found.count} withheld positions", np.array(found.rms_m), found.nees_position
    title += f". {what}: rms {' / '.join(f'{value:.3f}' for value in rms_m)} m east / north / up"
    if nees is not None:
        title += f", NEES {nees:.3g}"
    if evaluation is not None and evaluation.per_cycle:
        title += "\nSEP per cycle " + " / ".join(f"{cycle.sep_m:.3f}" for cycle in evaluation.per_cycle) + " m"
    return title


def _save(figure: Figure, path: Path) -> Path:
    """Write a picture, whole or not at all; `GraphnavError` if its name or place will not do."""
    check_picture(path)
    beside = path.with_name(f".{path.stem}.writing-{os.getpid()}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(beside, dpi=150)
        beside.replace(path)
    except OSError as error:
        raise GraphnavError(f"{path}: cannot write the picture ({error.strerror or error})") from error
    finally:
        beside.unlink(missing_ok=True)
    return path


def check_picture(path: Path) -> None:
    """Refuse a name whose ending is no format that is drawn, and a place that takes no file."""
    if path.suffix.lower() not in (".png", ".pdf", ".svg"):
        raise GraphnavError(f"{path}: a picture's name ends in .png, .pdf or .svg")
    try:
        check_file(path)
    except OSError as error:
        raise GraphnavError(f"{path}: cannot be written ({error.strerror or error})") from error
