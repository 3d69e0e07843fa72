"""The Cramer-Rao bound for people: the terminal's table and the figure."""

from __future__ import annotations

from pathlib import Path

from graphnav.limits import Bound, Share
from graphnav.report import panels
from graphnav.report.plots import _STYLE, _save, _split
from graphnav.report.terminal import say, table


def show(bound: Bound) -> None:
    """Print the bound beside the errors achieved, on standard error."""
    rows = [(f"cycle {cycle}", *_cells(share)) for cycle, share in bound.per_cycle.items()]
    columns = ("", "bound e / n / u (m)", "rms e / n / u (m)", "bound 3-D", "rms 3-D", "rms / bound")
    table(f"{bound.name}: Cramer-Rao bound and the batch run", columns, [*rows, ("all", *_cells(bound.overall))])
    say("one log is one draw of the errors: rms / bound scatters about 1; many seeds tell (benchmarks/accuracy.py)")


def _cells(share: Share) -> tuple[str, ...]:
    three = (" / ".join(f"{value:.3f}" for value in values) for values in (share.bound_m, share.rms_m))
    return (*three, f"{share.bound_3d_m:.3f}", f"{share.rms_3d_m:.3f}", f"{share.efficiency:.2f}")


def plot(bound: Bound, path: str | Path) -> Path:
    """Draw the batch run's errors over time within three sigmas of the bound.

    Parameters
    ----------
    path : the picture's file; its ending (.png, .pdf, .svg) is the format.
    """
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(_STYLE):
        figure = Figure(figsize=(11.0, 6.5), layout="constrained")
        left, right = _split(figure, 1, 2)
        panels.truth_errors(left, right, bound.limit, bound.achieved, panels.Clock(bound.t_s), "3 sigma of the bound")
        share = bound.overall
        figure.suptitle(
            f"{bound.name}: error of the batch run, rms {share.rms_3d_m:.3f} m in three dimensions,"
            f" and the Cramer-Rao bound, {share.bound_3d_m:.3f} m",
            fontsize=11,
            x=0.01,
            ha="left",
        )
        return _save(figure, Path(path))
