"""What the command line shows: progress bars and tables, on standard error only."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

from graphnav._statistics import PERCENT

if TYPE_CHECKING:
    from rich.progress import TaskID

    from graphnav.evaluation import Evaluation, WithheldError
    from graphnav.report.results import RunLike

_DELAY_S = 1.0


class ProgressBar:
    """A bar per stage, shown on a terminal once the work has taken a second; called as the smoother reports.

    >>> with ProgressBar() as progress:
    ...     progress("solve", 3, 10)
    """

    def __init__(self) -> None:
        self._begun = time.monotonic()
        self._bar: Any = None
        self._tasks: dict[str, TaskID] = {}

    def __call__(self, stage: str, done: float, total: float) -> None:
        """Report that `done` of `total` of a stage is finished."""
        if not sys.stderr.isatty() or time.monotonic() - self._begun < _DELAY_S:
            return
        if self._bar is None:
            self._bar = _bar()
            self._bar.start()
        if stage not in self._tasks:
            self._tasks[stage] = self._bar.add_task(stage, total=total)
        self._bar.update(self._tasks[stage], completed=done, total=total)

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()


@contextmanager
def working(text: str) -> Iterator[None]:
    """A spinner on a terminal while something without stages runs."""
    if not sys.stderr.isatty():
        yield
        return
    from rich.console import Console

    with Console(stderr=True).status(text):
        yield


def say(text: str) -> None:
    """A line for the user."""
    print(text, file=sys.stderr)


def table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]], width: int = 120) -> None:
    """A table for the user; the first column is text, the others numbers. `width` is for a pipe: it has none."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    grid = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for index, column in enumerate(columns):
        grid.add_column(column, justify="left" if index == 0 else "right", overflow="fold")
    for row in rows:
        grid.add_row(*(str(cell) for cell in row))
    console = Console(stderr=True)
    if not console.is_terminal:
        console.width = width
    console.print(title, style="bold", highlight=False)
    console.print(grid)


def evaluation_tables(evaluation: Evaluation) -> None:
    """Show the figures against truth."""
    sigma = evaluation.nees_axes
    rows = [
        ("position rms (m)", *_metres(evaluation.rms_m)),
        ("position max (m)", *_metres(evaluation.max_m)),
        ("position e^2/sigma^2", *(("-",) * 3 if sigma is None else (f"{v:.3g}" for v in sigma))),
    ]
    table("Against truth, in n", ("", "east", "north", "up"), rows)
    rows = [
        ("attitude rms (deg)", *(f"{v:.4f}" for v in evaluation.rms_deg)),
        ("attitude max (deg)", *(f"{v:.4f}" for v in evaluation.max_deg)),
    ]
    table("Against truth, in b", ("", "right", "forward", "up"), rows)
    if evaluation.per_cycle:
        cycles = [(f"cycle {c.cycle}", f"{c.sep_m:.3f}", *_metres(c.max_m)) for c in evaluation.per_cycle]
        table("Cutting cycles", ("", "SEP (m)", "max east", "max north", "max up"), cycles)
    _consistency(evaluation)
    share = dict(zip(PERCENT, evaluation.quantiles_m, strict=True))
    say(f"3-D error: SEP (median) {evaluation.sep_m:.3f} m, 90 % {share[90]:.3f} m, all {share[100]:.3f} m")
    for name, ape in evaluation.ape.items():
        turn = "rotation unknown" if ape.rotation_rms_deg is None else f"{ape.rotation_rms_deg:.4f} deg rms"
        say(f"APE {name}: {ape.translation_rms_m:.3f} m, {turn}")
    for rpe in evaluation.rpe.values():
        if rpe.translation_rms_m is not None and rpe.rotation_rms_deg is not None:
            say(
                f"RPE over {rpe.delta:g} {rpe.unit}: {rpe.translation_rms_m:.3f} m, "
                f"{rpe.rotation_rms_deg:.4f} deg rms of {rpe.pairs} pairs"
            )
    say(f"judged {len(evaluation.t_s)} of {evaluation.keyframes_total} keyframes")
    for note in evaluation.notes:
        say(f"note: {note}")


def _consistency(evaluation: Evaluation) -> None:
    """NEES and NIS with their bands."""
    text = f"NEES: position {_number(evaluation.nees_position)}, attitude {_number(evaluation.nees_attitude)}"
    if evaluation.nees_band is not None:
        low, high = evaluation.nees_band["position"]
        text += f" (1 is consistent; 95 % band {low:.2f} to {high:.2f}, the run taken for one draw)"
    say(text)
    for kind, nis in (evaluation.nis or {}).items():
        say(f"NIS, {kind}: {nis['mean']:.3f}, 95 % band {nis['low']:.3f} to {nis['high']:.3f}, {nis['rows']} rows")


def withheld_table(name: str, error: WithheldError) -> None:
    """Show the figures at withheld positions."""
    rows = [("rms (m)", *_metres(error.rms_m)), ("max (m)", *_metres(error.max_m))]
    table(f"{name}: at {error.count} withheld positions", ("", "east", "north", "up"), rows)
    say(f"rms in three dimensions {error.rms_3d_m:.3f} m, NEES {_number(error.nees_position)}")


def run_summary(run: RunLike, evaluation: Evaluation | None, folder: Path) -> None:
    """Show what a smoothing gave and where it is."""
    known = run.diagnostics
    rows = [
        (name, f"{item.value:.5g}", "-" if item.sigma is None else f"{item.sigma:.2g}", item.unit)
        for name, item in run.calibration.items()
    ]
    if rows:
        table("Calibration", ("", "estimate", "sigma", "unit"), rows)
    parts = ", ".join(f"{stage} {seconds:.1f}" for stage, seconds in known.seconds.items())
    say(f"{known.method}: converged in {known.iterations} iterations, {known.keyframes} keyframes")
    say(f"seconds: {parts}; peak memory {known.peak_rss_mb:.0f} MB")
    if known.nis is not None:
        nis = known.nis["all"]
        say(f"NIS {nis['mean']:.3f}, 95 % band {nis['low']:.3f} to {nis['high']:.3f}: 1 is consistent")
    if evaluation is not None:
        say(f"against truth: rms {' / '.join(_metres(evaluation.rms_m))} m east / north / up")
    for sensor, count in known.rejected.items():
        say(f"rejected: {count} of {sensor}")
    for warning in known.warnings:
        say(f"graphnav: warning: {warning}")
    say(f"wrote {folder}")


def _bar() -> Any:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description:>12}"), BarColumn(), TextColumn("{task.percentage:3.0f} %"))
    return Progress(*columns, TimeElapsedColumn(), console=Console(stderr=True), transient=True)


def _metres(values: Iterable[float]) -> tuple[str, ...]:
    return tuple(f"{value:.3f}" for value in values)


def _number(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.3g}"
