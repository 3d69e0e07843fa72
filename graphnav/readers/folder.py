"""Reading a graphnav log folder: log.toml and one table per sensor, every rule of the format enforced."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

import numpy as np
import numpy.typing as npt

from graphnav._schema import Record
from graphnav.errors import LogError
from graphnav.log import SECTIONS, TABLES, Lidar, SensorLog, Stereo, StereoPairs, SurveyedPoint
from graphnav.readers import sections, tables
from graphnav.readers.sections import LOG_FILE

_BLOCK_ROWS = 1 << 16
#: Sections that several tables share, and these tables; those of the second list can do without the section.
_SHARED: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    Lidar.SECTION: (("lidar_points", "lidar_scans"), ()),
    Stereo.SECTION: (("stereo", "stereo_tracks"), ("relative_pose",)),
}


def read_folder(folder: Path) -> SensorLog:
    """Read a log folder.

    Each sensor's `time_offset_s` is added to its times, and `gyro_matrix` and `accel_matrix` are applied to
    the samples; in the log returned these parameters stand at their defaults, so that nothing is applied
    twice and a log written again means the same.

    Parameters
    ----------
    folder : a folder that holds log.toml.

    Returns
    -------
    SensorLog

    Raises
    ------
    LogError
        The log breaks a rule of its format; the text names file, row, column, value and fix.
    """
    folder = folder.resolve()
    document, files = sections.load(folder), tables.find(folder)
    check_pairs(document, files, folder.name)
    file = f"{folder.name}/{LOG_FILE}"
    records: dict[str, Any] = {
        name: _build(cls, sections.params(cls, document[name], f"{file} [{name}]"), file)
        for name, cls in SECTIONS.items()
        if name in document
    }
    records["surveyed"] = sections.build_items(SurveyedPoint, document.get("surveyed", []), file)
    offsets_s = {table: records[section].time_offset_s for section, table in _shared_clocks() if section in records}
    for name, path in files.items():
        cls = TABLES[name]
        records[cls.field_name()] = _read_table(cls, document, path, file, offsets_s.get(name, 0.0))
    for section in _SHARED:
        if section in records:
            records[section] = records[section].replace(time_offset_s=0.0)
    try:
        return SensorLog(name=document["name"], epoch=document.get("epoch"), **records)
    except LogError as error:
        raise error.at(folder.name) from None


def check_pairs(present: Collection[str], files: Collection[str], folder: str) -> None:
    """Refuse a section without its table, a table without its section, and a log without frames.

    Parameters
    ----------
    present : names of the sections.
    files : names of the tables.
    folder : the log's name in error texts.
    """
    file = f"{folder}/{LOG_FILE}"
    if "frames" not in present:
        raise LogError("missing section [frames]", where=file, fix="add [frames] with latitude_deg of the origin")
    for section in sections.ALL_SECTIONS:
        wanted, served = _tables_of(section)
        if section in present and wanted and not any(t in files for t in wanted + served):
            names = " or ".join(f"{t}.parquet or .csv" for t in wanted + served)
            raise LogError("section without its table", where=f"{file} [{section}]", fix=f"add {names}, or remove it")
        needed_by = [t for t in wanted if t in files]
        if section not in present and needed_by:
            fix = f"add [{section}] with {', '.join(_needed_keys(sections.ALL_SECTIONS[section]))}"
            raise LogError(f"missing section [{section}], needed by the table {needed_by[0]}", where=file, fix=fix)


def _needed_keys(cls: type[Record]) -> list[str]:
    """Keys without a default, or the lists of sub-sections where there are none."""
    keys = [f.name for f in cls.param_fields() if f.default is dataclasses.MISSING]
    return keys or [f.name for f in cls.param_fields() if f.metadata["items"] is not None]


def _tables_of(section: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Tables that need this section, and those that can do without."""
    return _SHARED.get(section, ((section,) if section in TABLES else (), ()))


def _shared_clocks() -> Iterator[tuple[str, str]]:
    """Each shared section with each of its tables."""
    return ((section, table) for section, (wanted, served) in _SHARED.items() for table in wanted + served)


def _read_table(cls: type[Record], document: Mapping[str, Any], path: Path, file: str, offset_s: float) -> Record:
    where = f"{path.parent.name}/{path.name}"
    arguments: dict[str, Any] = {}
    if cls.SECTION:
        arguments = sections.params(cls, document[cls.SECTION], f"{file} [{cls.SECTION}]")
    arguments |= tables.read_columns(cls, path, where)
    offset_s += arguments.pop("time_offset_s", 0.0)
    for column in {cls.TIME, "t_to_s"} & arguments.keys():
        arguments[column] += offset_s
    if cls is StereoPairs:
        arguments["folder"] = path.parent
    for matrix, samples in (("gyro_matrix", "gyro_b_rad_s"), ("accel_matrix", "accel_b_m_s2")):
        if matrix in arguments:
            _apply(arguments.pop(matrix), arguments[samples])
    record: Record = _build(cls, arguments, file, where)
    _refuse_repeats(record, where)
    _check_image_paths(record, where)
    return record


def _apply(matrix: npt.NDArray[np.float64], samples: npt.NDArray[np.float64]) -> None:
    """Multiply every row of `samples` (N, 3) by `matrix`, in place and in blocks to spare memory."""
    for start in range(0, len(samples), _BLOCK_ROWS):
        block = samples[start : start + _BLOCK_ROWS]
        block[:] = block @ matrix.T


def _build(cls: type[Record], arguments: Mapping[str, Any], file: str, table: str = "") -> Any:
    """Construct a record; place the errors of its own checks in the table or in the section of `file`."""
    try:
        return cls(**arguments)
    except LogError as error:
        by_name = {f.name: f.metadata["columns"] for f in cls.column_fields()}
        keys = {f.name for f in cls.param_fields()}
        columns = [name for names in by_name.values() for name in names]
        in_section = not table or (error.column in keys and (error.row is None or error.column not in columns))
        placed = error.at(f"{file} [{cls.SECTION}]" if in_section else table)
        placed.column = ", ".join(by_name.get(error.column, (error.column,)))
        placed.row = None if in_section else error.row
        raise placed from None


def _refuse_repeats(record: Record, where: str) -> None:
    """Refuse a row that repeats another in every column (a table whose rows may share times can have one)."""
    times = getattr(record, record.TIME)
    rows = _in_doubt(record)
    # In blocks, to spare memory; rows of one time stay together, as no block ends between them.
    ends = np.append(np.flatnonzero(np.diff(times[rows])) + 1, len(rows))
    start = 0
    while start < len(rows):
        end = int(ends[min(int(np.searchsorted(ends, start + _BLOCK_ROWS)), len(ends) - 1)])
        _refuse_repeats_within(record, where, rows[start:end])
        start = end


def _in_doubt(record: Record) -> npt.NDArray[np.int64]:
    """Rows that may be there twice: not those of a time of which a column rises or falls from row to row."""
    times = getattr(record, record.TIME)
    first = np.flatnonzero(np.diff(times, prepend=-np.inf))
    count = np.diff(first, append=len(times))
    doubt = count > 1
    for f in record.column_fields():
        values = getattr(record, f.name)
        if doubt.any() and values is not None and values.ndim == 1 and values.dtype != object:
            for ordered in (values[1:] > values[:-1], values[1:] < values[:-1]):
                from_row_to_row = np.concatenate([[True], ordered])
                from_row_to_row[first] = True
                doubt &= ~np.logical_and.reduceat(from_row_to_row, first)
    return np.flatnonzero(np.repeat(doubt, count))


def _refuse_repeats_within(record: Record, where: str, rows: npt.NDArray[np.int64]) -> None:
    keys = []
    for f in record.column_fields():
        values = getattr(record, f.name)
        if values is not None:
            values = values[rows]
            keys += list(values.T) if values.ndim == 2 else [_ranks(values)]
    order = np.lexsort([np.arange(len(rows)), *reversed(keys)])
    same = np.logical_and.reduce([key[order][1:] == key[order][:-1] for key in keys])
    if same.any():
        row = int(rows[order[1:][same].min()])
        problem = f"the row at {getattr(record, record.TIME)[row]:.6f} s is there twice"
        raise LogError(problem, where=where, row=row, column=record.TIME, fix="remove duplicate rows")


def _ranks(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Numbers that sort and compare as the values do."""
    return np.unique(values, return_inverse=True)[1] if values.dtype == object else values


def _check_image_paths(record: Record, where: str) -> None:
    for name in ("left", "right") if isinstance(record, StereoPairs) else ():
        for row, text in enumerate(getattr(record, name)):
            if not _inside(text):
                problem = f'"{text}", expected an image path relative to the log folder, and within it'
                raise LogError(problem, where=where, row=row, column=name, fix="put the images into the log folder")


def _inside(text: str) -> bool:
    """Whether a path leads to a place in the folder that it is relative to, by the rules of any system."""
    ways = (PurePosixPath(text), PureWindowsPath(text))
    return bool(text) and not any(way.is_absolute() or ".." in way.parts for way in ways)
