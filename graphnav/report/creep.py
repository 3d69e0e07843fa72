"""Creep for people: the terminal's table."""

from __future__ import annotations

from graphnav.creep_rows import Creep, CreepRow
from graphnav.report.terminal import say, table


def show(found: Creep) -> None:
    """Print the creep after every cycle, on standard error."""
    judged = any(row.true_m is not None for row in found.rows)
    columns = ["cycle", "ICP (m)", "sigma (mm)", "graph (m)", "sigma (mm)", "beams", "fit"]
    if judged:
        columns += ["true (m)", "ICP error (mm)", "graph error (mm)"]
    rows = [(*_cells(row), *(_errors(row) if judged else ())) for row in found.rows]
    table(f"{found.name}: creep after each cycle towards the far end, at the {found.end} end", columns, rows)
    say("ICP: by registration of the roadway's wall; graph: from the smoothed positions of the stops")
    say("fit: rms distance of the beams from the wall seen before, in sigmas of their noise; 1 is as expected")
    for note in found.notes:
        say(f"note: {note}")


def _cells(row: CreepRow) -> tuple[str, ...]:
    return (
        f"{row.cycle}",
        f"{row.icp_m:.4f}",
        f"{1e3 * row.icp_sigma_m:.2f}",
        f"{row.graph_m:.4f}",
        f"{1e3 * row.graph_sigma_m:.2f}",
        f"{row.beams}",
        f"{row.residual:.2f}",
    )


def _errors(row: CreepRow) -> tuple[str, ...]:
    if row.true_m is None or row.icp_error_m is None or row.graph_error_m is None:
        return ("-",) * 3
    return (f"{row.true_m:.4f}", f"{1e3 * row.icp_error_m:+.2f}", f"{1e3 * row.graph_error_m:+.2f}")
