"""Columns of a csv file as numpy arrays; a bad value is found again by row and column."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
from pyarrow import csv as arrow_csv

from graphnav.errors import LogError
from graphnav.readers.integers import whole_numbers
from graphnav.readers.sections import shown


class CsvFile:
    """A csv table with a header row, commas and decimal points.

    Parameters
    ----------
    path : the file.
    where : its name in error texts.

    Raises
    ------
    LogError
        No header row, or not UTF-8 text.
    """

    def __init__(self, path: Path, where: str) -> None:
        self._path, self._where = path, where
        self._data: dict[str, list[npt.NDArray[Any]]] = {}
        self.names: list[str] = next(self._rows(), [])
        if not self.names:
            raise LogError("empty file, expected a header row", where=where, fix="remove it or record again")

    def load(self, kinds: Mapping[str, str]) -> int:
        """Parse the whole file; return the number of rows."""
        types = {"float": pa.float64(), "int": pa.int64(), "str": pa.string()}
        convert = arrow_csv.ConvertOptions(
            column_types={name: types[kinds[name]] for name in self.names},
            null_values=[""],
            strings_can_be_null=False,
        )
        try:
            table = arrow_csv.read_csv(self._path, convert_options=convert)
        except (pa.ArrowException, OSError):
            table = None
        if table is None or any(table.column(name).null_count for name in self.names):
            self._data = {name: [values] for name, values in self._parse_slowly(kinds).items()}
        else:
            self._data = {name: _arrays(table.column(name).chunks) for name in self.names}
        return sum(map(len, self._data[self.names[0]]))

    def column(self, name: str, kind: str) -> Iterator[npt.NDArray[Any]]:
        """Consecutive parts of a column, given up once read."""
        yield from self._data.pop(name)

    def _rows(self) -> Iterator[list[str]]:
        """The rows that are not blank, the header first."""
        try:
            with self._path.open(encoding="utf-8-sig", newline="") as file:
                yield from (row for row in csv.reader(file) if row)
        except (UnicodeDecodeError, csv.Error, OSError) as error:
            raise LogError(f"unreadable as csv ({error})", where=self._where, fix="save it as UTF-8 csv") from None

    def _parse_slowly(self, kinds: Mapping[str, str]) -> dict[str, npt.NDArray[Any]]:
        """Parse value by value, to name the first bad one or to accept whole numbers written as 3.0."""
        values: dict[str, list[Any]] = {name: [] for name in self.names}
        rows = self._rows()
        next(rows)
        for row, texts in enumerate(rows):
            if len(texts) != len(self.names):
                problem = f"{len(texts)} values, expected {len(self.names)} as in the header row"
                raise LogError(problem, where=self._where, row=row, fix="repair the row")
            for name, text in zip(self.names, texts, strict=True):
                values[name].append(text if kinds[name] == "str" else self._number(text, row, name))
        arrays = {name: np.array(v, object if kinds[name] == "str" else float) for name, v in values.items()}
        for name in self.names:
            if kinds[name] == "int":
                arrays[name] = whole_numbers(arrays[name], self._where, name)
        return arrays

    def _number(self, text: str, row: int, name: str) -> float:
        try:
            value = math.nan if "_" in text else float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            found = f'value "{shown(text)}"' if text.strip() else "value missing"
            fix = "drop the row or repair the recording"
            raise LogError(f"{found}, expected a finite number", where=self._where, row=row, column=name, fix=fix)
        return value


def _arrays(chunks: list[Any]) -> list[npt.NDArray[Any]]:
    return [chunk.to_numpy(zero_copy_only=False) for chunk in chunks]
