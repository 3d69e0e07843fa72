"""Declarative fields for sensor records: what a column or a log.toml key holds, and its validation.

A record class lists its columns and parameters once; construction, the folder reader and the writer
all follow that list, so a rule of the log format is written in one place.
"""

from __future__ import annotations

import dataclasses
from dataclasses import MISSING, dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from graphnav.errors import LogError

Array = npt.NDArray[np.float64]
Kind = Literal["float", "int", "str", "list"]


def column(*names: str, kind: Kind = "float", positive: bool = False, optional: bool = False) -> Any:
    """A table column, or several that form the rows of an ``(N, k)`` array."""
    meta = {"columns": names, "kind": kind, "positive": positive, "optional": optional}
    return field(default=None if optional else MISSING, metadata=meta)


def param(
    default: Any = MISSING,
    *,
    positive: bool = False,
    nonnegative: bool = False,
    shape: tuple[int, ...] = (),
    kind: Literal["float", "int", "str"] = "float",
    items: type | None = None,
) -> Any:
    """A key of a log.toml section: a number, an array of `shape`, a whole number, a string or a list of `items`."""
    meta = {
        "param": True,
        "positive": positive,
        "nonnegative": nonnegative,
        "shape": shape,
        "kind": kind,
        "items": items,
    }
    return field(default=default, metadata=meta)


@dataclass(frozen=True, eq=False)
class Record:
    """Base of everything a log is made of: frozen, validated on construction, arrays read-only.

    `SECTION` is the log.toml section of its parameters, `TABLE` the table of its columns (either may be
    empty), `FIELD` its place in the `SensorLog` where that is not the table's name, `STRICT` whether two rows may share
    a time.
    """

    SECTION: ClassVar[str] = ""
    TABLE: ClassVar[str] = ""
    FIELD: ClassVar[str] = ""
    STRICT: ClassVar[bool] = True
    TIME: ClassVar[str] = "t_s"

    def __post_init__(self) -> None:
        for f in dataclasses.fields(self):
            value = getattr(self, f.name)
            if "columns" in f.metadata:
                if not (value is None and f.metadata["optional"]):
                    object.__setattr__(self, f.name, _check_column(self, f, value))
            elif f.metadata.get("param") and value is not None:
                object.__setattr__(self, f.name, _check_param(self, f, value))
        if self.TABLE:
            _check_table(self)

    def __len__(self) -> int:
        return len(getattr(self, self.TIME)) if self.TABLE else 1

    @classmethod
    def field_name(cls) -> str:
        """Name of this table in the `SensorLog`."""
        return cls.FIELD or cls.TABLE

    @classmethod
    def column_fields(cls) -> list[dataclasses.Field[Any]]:
        """Fields that come from the table."""
        return [f for f in dataclasses.fields(cls) if "columns" in f.metadata]

    @classmethod
    def param_fields(cls) -> list[dataclasses.Field[Any]]:
        """Fields that come from the log.toml section."""
        return [f for f in dataclasses.fields(cls) if f.metadata.get("param")]

    def error(self, problem: str, **place: Any) -> LogError:
        """A `LogError` placed in this record's table or section."""
        where = f"table {self.TABLE}" if self.TABLE else f"[{self.SECTION}]"
        return LogError(problem, where=where, **place)

    def replace(self, **changes: Any) -> Any:
        """A copy with some fields changed, validated anew."""
        return dataclasses.replace(self, **changes)


def _check_column(record: Record, f: dataclasses.Field[Any], value: Any) -> npt.NDArray[Any]:
    names, kind = f.metadata["columns"], f.metadata["kind"]
    if kind == "str":
        return np.asarray(value, dtype=object)
    if kind == "list":
        rows = np.empty(len(value), dtype=object)
        rows[:] = [np.asarray(v, float) for v in value]
        return rows
    dtype = np.int64 if kind == "int" else np.float64
    try:
        array = np.ascontiguousarray(value, dtype=dtype)
    except (TypeError, ValueError) as error:
        raise record.error(f"not numeric ({error})", column=names[0]) from None
    if array is value and array.flags.writeable:
        array = array.view()
    wanted = 1 if len(names) == 1 else 2
    if array.ndim != wanted or (wanted == 2 and array.shape[1] != len(names)):
        raise record.error(f"shape {array.shape}, expected (N,{len(names) if wanted == 2 else ''})", column=f.name)
    bad = ~np.isfinite(array)
    if bad.any():
        index = np.argwhere(bad)[0]
        raise record.error(
            f"value {array[tuple(index)]}, expected a finite number",
            row=int(index[0]),
            column=names[int(index[1]) if wanted == 2 else 0],
            fix="drop the row or repair the recording",
        )
    if f.metadata["positive"] and (array <= 0).any():
        index = np.argwhere(array <= 0)[0]
        raise record.error(
            f"value {array[tuple(index)]}, expected a number above zero",
            row=int(index[0]),
            column=names[int(index[1]) if wanted == 2 else 0],
            fix="drop the row or repair the recording",
        )
    array.flags.writeable = False
    return array


def _check_table(record: Record) -> None:
    lengths = {
        f.name: len(getattr(record, f.name)) for f in record.column_fields() if getattr(record, f.name) is not None
    }
    if len(set(lengths.values())) > 1:
        raise record.error(f"columns of different lengths: {lengths}")
    times = getattr(record, record.TIME)
    if len(times) == 0:
        raise record.error("no rows", fix="remove the empty table or record again")
    steps = np.diff(times)
    wrong = steps <= 0 if record.STRICT else steps < 0
    if wrong.any():
        row = int(np.argmax(wrong)) + 1
        what = "twice" if steps[row - 1] == 0 else "runs backwards"
        raise record.error(
            f"time {what}: {times[row]:.6f} s after {times[row - 1]:.6f} s",
            row=row,
            column=record.TIME,
            fix="sort the rows by time and remove duplicates",
        )


def _check_param(record: Record, f: dataclasses.Field[Any], value: Any) -> Any:
    meta = f.metadata
    if meta["items"] is not None:
        return tuple(value)
    if meta["kind"] == "str":
        if not isinstance(value, str):
            raise record.error(f"{value!r}, expected text", column=f.name)
        return value
    if meta["kind"] == "int":
        if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
            raise record.error(f"{value!r}, expected a whole number", column=f.name)
        return int(value)
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise record.error(f"{value!r}, expected a number", column=f.name) from None
    if isinstance(value, bool) or array.shape != meta["shape"]:
        what = "a number" if meta["shape"] == () else f"numbers of shape {meta['shape']}"
        raise record.error(f"{value!r}, expected {what}", column=f.name)
    if not np.isfinite(array).all():
        raise record.error(f"{value!r}, expected finite numbers", column=f.name)
    if (meta["positive"] and (array <= 0).any()) or (meta["nonnegative"] and (array < 0).any()):
        bound = "above zero" if meta["positive"] else "of zero or more"
        fix = "declare the sensor's 1-sigma error" if "sigma" in f.name else ""
        raise record.error(f"{value!r}, expected a value {bound}", column=f.name, fix=fix)
    if meta["shape"] == ():
        return float(array)
    array.flags.writeable = False
    return array
