"""Comma-separated tables with names in the first row: columns checked as they are taken."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np

from graphnav._schema import Array
from graphnav.errors import LogError


class NamedCsv:
    """The columns of a file by name; rows may end in a comma that the header lacks."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            with path.open(newline="", encoding="utf-8") as file:
                header, *rows = csv.reader(file)
        except FileNotFoundError:
            raise LogError("no such file", where=str(path), fix="pass the folder of the recording") from None
        except (OSError, UnicodeDecodeError, ValueError) as error:
            raise LogError(f"no table ({error})", where=str(path), fix="fetch it again") from None
        short = [row for row, cells in enumerate(rows) if len(cells) < len(header)]
        if short:
            raise self._error(f"{len(rows[short[0]])} cells, expected {len(header)}", row=short[0])
        self._columns = {name: [row[place] for row in rows] for place, name in enumerate(header)}

    def names(self, name: str) -> Any:
        """A column (N,) as text."""
        if name not in self._columns:
            raise self._error("missing column", column=name)
        return np.array(self._columns[name], dtype=object)

    def column(self, name: str) -> Array:
        """A column (N,) of finite numbers."""
        cells = self.names(name)
        try:
            values = np.array(cells, float)
        except ValueError as error:
            raise self._error(f"no number ({error})", column=name) from None
        bad = ~np.isfinite(values)
        if bad.any():
            raise self._error("expected a finite number", row=int(np.argmax(bad)), column=name)
        return values

    def columns(self, *names: str) -> Array:
        """Columns (N, K) of finite numbers."""
        return np.column_stack([self.column(name) for name in names])

    def times(self, name: str, *, apart: bool = True) -> Array:
        """Ascending times (N,), at least two; the same one twice only where they need not be `apart`."""
        t_s = self.column(name)
        if len(t_s) < 2:
            raise self._error(f"{len(t_s)} rows, expected at least 2", column=name)
        step = np.diff(t_s)
        wrong = np.flatnonzero(step <= 0 if apart else step < 0)
        if len(wrong):
            raise self._error("time does not ascend", row=int(wrong[0]) + 1, column=name)
        return t_s

    def _error(self, problem: str, **place: Any) -> LogError:
        return LogError(problem, where=str(self.path), fix="fetch it again", **place)
