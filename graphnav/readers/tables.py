"""Table files: the columns of a record, read from and written to NAME.parquet or NAME.csv.

A shift holds millions of inertial rows, so a table is read one column at a time into arrays that are
allocated once, and written in blocks.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from graphnav._hints import hint
from graphnav._memory import allocate, release
from graphnav._schema import Record
from graphnav.errors import LogError
from graphnav.log import TABLES
from graphnav.readers.sections import shown

SUFFIXES = (".parquet", ".csv")
_DTYPES = {"float": np.float64, "int": np.int64}
_BLOCK_ROWS = 1 << 18


class TableFile(Protocol):
    """An opened table file; `load` must come before `column`."""

    names: list[str]

    def load(self, kinds: Mapping[str, str]) -> int:
        """Prepare reading, given the kind of each known column; return the number of rows."""

    def column(self, name: str, kind: str) -> Iterator[npt.NDArray[Any]]:
        """Consecutive parts of a column: float64 or int64 numbers, str objects, or arrays of numbers."""


def find(folder: Path) -> dict[str, Path]:
    """Table name -> file, in the order of the log format.

    Raises
    ------
    LogError
        A table twice, a table of an unknown file type, a csv or parquet file that is no known table.
    """
    found: dict[str, Path] = {}
    for path in sorted(p for p in folder.iterdir() if p.is_file() and not p.name.startswith(".")):
        where, name = f"{folder.name}/{path.name}", path.name.partition(".")[0]
        if path.suffix in SUFFIXES and path.stem in TABLES:
            if path.stem in found:
                problem = f"the table is there twice, also as {found[path.stem].name}"
                raise LogError(problem, where=where, fix="remove one of the two")
            found[path.stem] = path
        elif name in TABLES:
            ending = path.name.removeprefix(name)
            problem = f'unknown file ending "{ending}", expected ".parquet" or ".csv"'
            raise LogError(problem, where=where, fix=f"save the table as {name}.parquet or {name}.csv")
        elif path.suffix.lower() in SUFFIXES:
            fix = f"{hint(path.stem, TABLES)}, or move the file away"
            raise LogError(f'unknown table "{path.stem}"', where=where, fix=fix)
    return {name: found[name] for name in TABLES if name in found}


def read_columns(cls: type[Record], path: Path, where: str) -> dict[str, npt.NDArray[Any]]:
    """Constructor arguments of `cls` from its table file.

    Parameters
    ----------
    cls : a record class with a table.
    path : the .parquet or .csv file.
    where : the file's name in error texts.

    Returns
    -------
    dict
        Field name -> ``(N,)`` array, or ``(N, k)`` for a field of k columns.

    Raises
    ------
    LogError
        Unknown, repeated or missing column, a value of the wrong type, an unreadable file.
    """
    # Imported here: pyarrow takes time that `import graphnav` should not cost.
    from graphnav.readers.csv_file import CsvFile
    from graphnav.readers.parquet_file import ParquetFile

    table: TableFile = CsvFile(path, where) if path.suffix == ".csv" else ParquetFile(path, where)
    kinds = {name: f.metadata["kind"] for f in cls.column_fields() for name in f.metadata["columns"]}
    _check_names(table.names, kinds, where)
    fields = [f for f in cls.column_fields() if _is_present(f, table.names, where)]
    if path.suffix == ".csv" and "list" in kinds.values():
        name = path.stem
        raise LogError("a table with lists, expected parquet", where=where, fix=f"save it as {name}.parquet")
    rows = table.load(kinds)
    arguments = {f.name: _field(f, table, rows) for f in fields}
    return arguments


def _check_names(names: list[str], known: Mapping[str, str], where: str) -> None:
    for index, name in enumerate(names):
        if name not in known:
            fix = "separate the columns by commas" if ";" in name or "\t" in name else hint(name, known)
            raise LogError(f'unknown column "{shown(name)}"', where=where, fix=fix)
        if name in names[:index]:
            raise LogError("the column is there twice", where=where, column=name, fix="remove one of the two")


def _is_present(f: dataclasses.Field[Any], names: list[str], where: str) -> bool:
    wanted = f.metadata["columns"]
    missing = [name for name in wanted if name not in names]
    if not missing:
        return True
    if f.metadata["optional"] and len(missing) == len(wanted):
        return False
    together = f"it comes with {', '.join(n for n in wanted if n not in missing)}" if len(wanted) > len(missing) else ""
    raise LogError("missing column", where=where, column=missing[0], fix=together or f"add {missing[0]}")


def _field(f: dataclasses.Field[Any], table: TableFile, rows: int) -> npt.NDArray[Any]:
    names, kind = f.metadata["columns"], f.metadata["kind"]
    out = allocate((rows, len(names)), _DTYPES.get(kind, object))
    for j, name in enumerate(names):
        start = 0
        for part in table.column(name, kind):
            out[start : start + len(part), j] = part
            start += len(part)
        # a column at a time: neither arrow's copies nor what is written already need stay in memory
        _release_memory()
        release(out)
    return out[:, 0] if len(names) == 1 else out


def _release_memory() -> None:
    import pyarrow

    pyarrow.default_memory_pool().release_unused()


def write_table(record: Record, folder: Path, ending: str) -> None:
    """Write the record's table as ``folder/NAME.parquet`` or ``.csv``, every digit kept.

    A table with a list column is written as parquet whatever the `ending`, as csv cannot hold it.
    """
    import pyarrow as pa
    from pyarrow import csv, parquet

    columns = dict(_columns(record))
    types = {"float": pa.float64(), "int": pa.int64(), "str": pa.string(), "list": pa.list_(pa.float64())}
    schema = pa.schema([(name, types[kind]) for name, (kind, _) in columns.items()])
    kinds = {name: kind for name, (kind, _) in columns.items()}
    if ending == ".csv" and "list" not in kinds.values():
        writer = csv.CSVWriter(folder / f"{record.TABLE}.csv", schema)
    else:
        writer = parquet.ParquetWriter(
            folder / f"{record.TABLE}.parquet",
            schema,
            compression="zstd",
            use_dictionary=[name for name, kind in kinds.items() if kind == "str"],
            use_byte_stream_split=[name for name, kind in kinds.items() if kind == "float"],
        )
    with writer:
        for start in range(0, len(record), _BLOCK_ROWS):
            block = slice(start, start + _BLOCK_ROWS)
            arrays = [pa.array(data[block], type=types[kind]) for kind, data in columns.values()]
            writer.write_batch(pa.record_batch(arrays, schema=schema))
    _release_memory()


def _columns(record: Record) -> Iterator[tuple[str, tuple[str, npt.NDArray[Any]]]]:
    """Column name -> kind and ``(N,)`` data, in the order of the fields."""
    for f in record.column_fields():
        data = getattr(record, f.name)
        for j, name in enumerate(f.metadata["columns"] if data is not None else ()):
            yield name, (f.metadata["kind"], data if data.ndim == 1 else data[:, j])
