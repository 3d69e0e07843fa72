"""What a solution leaves of UWB ranges: a table, and a picture with a panel for each anchor."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol

import numpy as np

from graphnav._schema import Array
from graphnav.report.plots import _STYLE, _save

#: Panels shown, of the anchors with the most ranges; and points of each, so that the picture stays small.
_PANELS, _POINTS = 12, 20_000
#: Residuals beyond this many times the usual are drawn at the panel's edge.
_WIDE = 8.0


class Residuals(Protocol):
    """What is written and drawn: a `graphnav.run.RangeResiduals`."""

    @property
    def t_s(self) -> Array:
        """(K,) ascending."""

    @property
    def anchor(self) -> Any:
        """(K,) ids."""

    @property
    def residual_m(self) -> Array:
        """(K,) what is left."""

    @property
    def used(self) -> Any:
        """(K,) or left out."""


def write(residuals: Residuals, path: Path) -> None:
    """Columns ``t_s, anchor, residual_m, used``."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = {
        "t_s": residuals.t_s,
        "anchor": [str(name) for name in residuals.anchor],
        "residual_m": residuals.residual_m,
        "used": residuals.used,
    }
    pq.write_table(pa.table(columns), path, compression="zstd")


def plot(residuals: Residuals, path: Path) -> Path:
    """Residuals over time, anchor by anchor: those used as points, those left out as crosses."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    names, count = np.unique(residuals.anchor.astype(str), return_counts=True)
    shown = names[np.sort(np.argsort(-count, kind="stable")[:_PANELS])]
    columns = 1 if len(shown) < 3 else 2
    rows = -(-len(shown) // columns)
    with rc_context(_STYLE):
        figure = Figure(figsize=(11.0, 1.2 + 1.9 * rows), layout="constrained")
        axes = np.ravel(figure.subplots(rows, columns, sharex=True, squeeze=False))
        for axis, name in zip(axes, shown, strict=False):
            _panel(axis, residuals, name)
        for axis in axes[len(shown) :]:
            axis.set_visible(False)
        for axis in axes[max(len(shown) - columns, 0) : len(shown)]:
            axis.set_xlabel("time, s")
        more = "" if len(shown) == len(names) else f" ({len(shown)} of {len(names)} anchors)"
        title = f"Ranges less what the solution makes of them{more}"
        figure.suptitle(title, fontsize=11, x=0.01, ha="left")
        return _save(figure, path)


def _panel(axis: Any, residuals: Residuals, name: str) -> None:
    mine = residuals.anchor.astype(str) == name
    used, out = np.flatnonzero(mine & residuals.used), np.flatnonzero(mine & ~residuals.used)
    usual = 1.4826 * float(np.median(np.abs(residuals.residual_m[used if len(used) else out])))
    edge = _WIDE * max(usual, 1e-3)
    for rows, style in (
        (used, {"marker": ".", "ms": 1.5, "color": "#0072B2"}),
        (out, {"marker": "x", "ms": 4, "color": "#D55E00"}),
    ):
        some = rows[:: max(1, len(rows) // _POINTS)]
        axis.plot(residuals.t_s[some], np.clip(residuals.residual_m[some], -edge, edge), ls="none", **style)
    axis.set_ylim(-1.05 * edge, 1.05 * edge)
    axis.set_ylabel("m")
    axis.set_title(f"anchor {name}: {len(used):,} used, {len(out):,} left out (crosses)")
