"""Columns of a parquet file as numpy arrays, with errors that name the row."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
from pyarrow import parquet

from graphnav.errors import LogError
from graphnav.readers.integers import whole_numbers
from graphnav.readers.sections import shown

_EXPECTED = {"float": "numbers", "int": "whole numbers", "str": "text", "list": "lists of numbers"}


class ParquetFile:
    """A parquet table, read one column at a time.

    Parameters
    ----------
    path : the file.
    where : its name in error texts.

    Raises
    ------
    LogError
        The file is damaged or no parquet file.
    """

    def __init__(self, path: Path, where: str) -> None:
        self._where = where
        with self._reading():
            self._file = parquet.ParquetFile(path)
            self._schema = self._file.schema_arrow
            self.names: list[str] = list(self._schema.names)

    def load(self, kinds: Mapping[str, str]) -> int:
        """Check the type of every column before any is read; return the number of rows."""
        for name in self.names:
            self._check_type(name, kinds[name])
        return int(self._file.metadata.num_rows)

    def column(self, name: str, kind: str) -> Iterator[npt.NDArray[Any]]:
        """Consecutive parts of a column: float64 or int64 numbers, str objects, or arrays of numbers."""
        with self._reading():
            data = self._file.read(columns=[name]).column(0)
        row = 0
        for chunk in data.chunks:
            if chunk.null_count:
                row += int(np.argmax(chunk.is_null().to_numpy(zero_copy_only=False)))
                problem = f"value missing, expected {_EXPECTED[kind]}"
                raise LogError(problem, where=self._where, row=row, column=name, fix="fill or drop the row")
            with self._reading():
                values = self._values(chunk, name, kind, row)
            yield values
            row += len(chunk)

    def _values(self, chunk: Any, name: str, kind: str, row: int) -> npt.NDArray[Any]:
        if kind == "str":
            return np.asarray(chunk.cast(pa.string()).to_numpy(zero_copy_only=False))
        if kind == "list":
            return self._lists(chunk, name, row)
        values = chunk.to_numpy(zero_copy_only=False)
        return whole_numbers(values, self._where, name, row) if kind == "int" else values

    def _lists(self, chunk: Any, name: str, row: int) -> npt.NDArray[Any]:
        out = np.empty(len(chunk), dtype=object)
        for i, scan in enumerate(chunk):
            values = np.array(scan.values.to_numpy(zero_copy_only=False), dtype=float)
            if not np.isfinite(values).all():
                bad = values[np.argmax(~np.isfinite(values))]
                problem = f"value {bad} in the list, expected finite numbers"
                raise LogError(problem, where=self._where, row=row + i, column=name)
            out[i] = values
        return out

    def _check_type(self, name: str, kind: str) -> None:
        stored = self._schema.field(name).type
        if not _fits(stored, kind):
            problem = f"{self._first(name)}stored as {stored}, expected {_EXPECTED[kind]}"
            place = {"where": self._where, "column": name}
            raise LogError(problem, row=0, fix="convert the column and save it again", **place)
        # A float32 clock resolves a shift of 7 h to 2 ms only: rows would collide or jitter.
        if name.startswith("t_") and pa.types.is_floating(stored) and stored != pa.float64():
            raise LogError(f"time stored as {stored}, expected float64 seconds", where=self._where, column=name)

    def _first(self, name: str) -> str:
        """The first value, so that the user sees what is stored there."""
        if not self._file.metadata.num_rows:
            return ""
        with self._reading():
            batch = next(self._file.iter_batches(batch_size=1, columns=[name]))
            return f'value "{shown(batch.column(0)[0].as_py())}" '

    @contextmanager
    def _reading(self) -> Iterator[None]:
        """Say of a damaged file which one it is; damage shows as any of these errors."""
        try:
            yield
        except (pa.ArrowException, OSError, ValueError, OverflowError, MemoryError, KeyError) as error:
            reason = shown(str(error).partition("\n")[0] or type(error).__name__)
            fix = "copy or export it again"
            raise LogError(f"unreadable as parquet ({reason})", where=self._where, fix=fix) from None


def _fits(stored: Any, kind: str) -> bool:
    if pa.types.is_dictionary(stored):
        stored = stored.value_type
    if kind == "str":
        return bool(pa.types.is_string(stored) or pa.types.is_large_string(stored))
    if kind == "list":
        lists = pa.types.is_list(stored) or pa.types.is_large_list(stored) or pa.types.is_fixed_size_list(stored)
        return bool(lists and _is_number(stored.value_type))
    return _is_number(stored)


def _is_number(stored: Any) -> bool:
    return bool(pa.types.is_floating(stored) or pa.types.is_integer(stored))
