"""`Comparison`: methods side by side on one log, or on many seeds of one scenario."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from graphnav._consistency import OverRuns, one_run_band
from graphnav._cycles import CycleError
from graphnav._schema import Array

#: `Comparison.reference` when errors are against truth; else it is the name of a method.
TRUTH = "truth"
COLUMNS = ("method", "seconds", "rms e / n / u (m)", "max e / n / u (m)", "SEP per cycle (m)", "NEES pos / att", "NIS")


@dataclass(frozen=True, eq=False)
class Curve:
    """Position error over time.

    Attributes
    ----------
    t_s : (N,) times; error_n_m : (N, 3) east, north, up: signed for one log, rms over the runs for many.
    """

    t_s: Array
    error_n_m: Array


@dataclass(frozen=True)
class NisBand:
    """Mean normalized innovation squared of a filter with its 95 % band; rows : scalar measurements in it."""

    mean: float
    low: float
    high: float
    rows: int

    def to_dict(self) -> dict[str, Any]:
        """Mean, band, rows, and whether the mean lies in the band."""
        inside = self.low <= self.mean <= self.high
        return {"mean": self.mean, "band": [self.low, self.high], "rows": self.rows, "inside": inside}


@dataclass(frozen=True)
class OverSeeds:
    """What many runs of one method say beyond the figures that a row has for one.

    Attributes
    ----------
    runs, failed : seeds that succeeded, and that did not.
    nees_position, nees_attitude : means over the runs with standard error and band; None without covariances.
    """

    runs: int
    failed: int
    nees_position: OverRuns | None
    nees_attitude: OverRuns | None

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, None for unknown."""
        position, attitude = (None if n is None else n.to_dict() for n in (self.nees_position, self.nees_attitude))
        return {"runs": self.runs, "failed": self.failed, "nees_position": position, "nees_attitude": attitude}


@dataclass(frozen=True, eq=False)
class MethodRow:
    """One method's figures.

    On one log they are its own. Over seeds: `seconds` and the cycles' `sep_m` are medians, `rms_m` is over all runs,
    the maxima are the largest of any run, the NEES are means over the runs.

    Attributes
    ----------
    seconds : of one run, from the log in memory to the trajectory with its covariances.
    rms_m, max_m : east, north, up.
    error : why the method gave nothing (or, over seeds, why some runs failed), or None.
    """

    method: str
    seconds: float | None = None
    rms_m: tuple[float, ...] | None = None
    max_m: tuple[float, ...] | None = None
    per_cycle: tuple[CycleError, ...] = ()
    nees_position: float | None = None
    nees_attitude: float | None = None
    nis: NisBand | None = None
    converged: bool = False
    warnings: tuple[str, ...] = ()
    error: str | None = None
    curve: Curve | None = None
    over_seeds: OverSeeds | None = None

    def to_dict(self) -> dict[str, Any]:
        """One row of ``graphnav compare --json``; None for unknown."""
        found = {
            "method": self.method,
            "seconds": self.seconds,
            "rms_m": _listed(self.rms_m),
            "max_m": _listed(self.max_m),
            "per_cycle": [cycle.to_dict() for cycle in self.per_cycle],
            "nees_position": self.nees_position,
            "nees_attitude": self.nees_attitude,
            "nis": None if self.nis is None else self.nis.to_dict(),
            "converged": self.converged,
            "warnings": list(self.warnings),
            "error": self.error,
        }
        return found if self.over_seeds is None else {**found, "over_seeds": self.over_seeds.to_dict()}

    def cells(self) -> tuple[str, ...]:
        """Texts for the table's `COLUMNS`."""
        if self.rms_m is None or self.max_m is None or self.seconds is None:
            return (self.method, "failed", *["-"] * (len(COLUMNS) - 2))
        seconds = f"{self.seconds:.3g}" if self.seconds < 100 else f"{self.seconds:.0f}"
        seps = _metres(cycle.sep_m for cycle in self.per_cycle) or "-"
        nis = "-" if self.nis is None else f"{self.nis.mean:.3f}"
        return (self.method, seconds, _metres(self.rms_m), _metres(self.max_m), seps, self._nees(), nis)

    def _nees(self) -> str:
        over = self.over_seeds
        texts = []
        for mean, runs in (
            (self.nees_position, over.nees_position if over else None),
            (self.nees_attitude, over.nees_attitude if over else None),
        ):
            error = f" ± {runs.standard_error:.2g}" if runs is not None and runs.standard_error is not None else ""
            texts.append("-" if mean is None else f"{mean:.3g}{error}")
        return " / ".join(texts)


@dataclass(frozen=True, eq=False)
class Comparison:
    """Methods side by side.

    Attributes
    ----------
    log : name of the log, or of the scenario.
    reference : what the errors are against: "truth", or the method whose trajectory stands in for it.
    seeds : how many; 0 for one log.
    rows : one per method, in the order asked for.
    """

    log: str
    reference: str
    seeds: int
    rows: tuple[MethodRow, ...]

    @property
    def failed(self) -> tuple[MethodRow, ...]:
        """Rows with an error."""
        return tuple(row for row in self.rows if row.error is not None)

    @property
    def cycles(self) -> tuple[CycleError, ...]:
        """Cutting cycles with their spans, as the first row that has any knows them."""
        return next((row.per_cycle for row in self.rows if row.per_cycle), ())

    @property
    def title(self) -> str:
        """What is compared with what."""
        what = f"{self.log}, {self.seeds} seeds" if self.seeds else self.log
        against = "errors against truth" if self.reference == TRUTH else f"differences from {self.reference}"
        return f"{what}: {against}"

    def notes(self) -> list[str]:
        """What a reader of the table must know, one line each."""
        found = []
        if self.reference != TRUTH:
            found.append(f"no truth in the log: differences from {self.reference}, which is itself in error; no NEES")
        if self.seeds:
            found.append(
                "over seeds: seconds and SEP are medians, rms is over all runs, max the largest of any;"
                " NEES are means with their standard errors"
            )
        found += self._bands()
        found += [f"{row.method} failed: {row.error}" for row in self.failed]
        return found + self._warnings()

    def _warnings(self) -> list[str]:
        """Each warning once with the methods that gave it; over seeds, the first of each method."""
        given: dict[str, list[str]] = {}
        for row in self.rows:
            told = row.warnings[:1] if self.seeds else row.warnings
            others = f" (and {len(row.warnings) - 1} more warnings)" if len(row.warnings) > len(told) else ""
            for warning in told:
                given.setdefault(warning + others, []).append(row.method)
        return [f"{', '.join(methods)}: {warning}" for warning, methods in given.items()]

    def _bands(self) -> list[str]:
        found = []
        if any(row.nees_position is not None for row in self.rows):
            found.append(_nees_band_note(self.rows) if self.seeds else _one_run_note())
        for row in self.rows:
            if row.nis is not None:
                found.append(f"NIS of {row.method}: 95 % band {row.nis.low:.3f} to {row.nis.high:.3f}")
        return found

    def to_dict(self) -> dict[str, Any]:
        """The object that ``graphnav compare --json`` prints."""
        rows = [row.to_dict() for row in self.rows]
        return {"log": self.log, "reference": self.reference, "seeds": self.seeds, "rows": rows}

    def to_markdown(self) -> str:
        """Title, table and notes as Markdown text."""
        lines = [f"**{self.title}**", "", _line(COLUMNS), _line(["---", *["---:"] * (len(COLUMNS) - 1)])]
        lines += [_line(row.cells()) for row in self.rows]
        lines += ["", *(f"- {note}" for note in self.notes())]
        return "\n".join(lines) + "\n"


def _one_run_note() -> str:
    low, high = one_run_band(3)
    return (
        f"NEES: 1 is consistent; 95 % band {low:.2f} to {high:.2f}, the run taken for one draw of three axes, since its"
        " keyframes are correlated"
    )


def _nees_band_note(rows: Iterable[MethodRow]) -> str:
    bands = []
    for row in rows:
        over = row.over_seeds.nees_position if row.over_seeds else None
        if over is not None and over.low is not None and over.high is not None:
            bands.append(f"{row.method} {over.low:.2f} to {over.high:.2f}")
    return f"NEES of position: 1 is consistent; 95 % bands of the means: {', '.join(bands) or 'unknown'}"


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _metres(values: Iterable[float]) -> str:
    return " / ".join(f"{value:.3f}" if value == 0 or value >= 5e-4 else f"{value:.0e}" for value in values)


def _listed(values: tuple[float, ...] | None) -> list[float] | None:
    return None if values is None else list(values)
