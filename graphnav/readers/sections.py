"""log.toml: the sections of a log and their parameters, read and written by the classes' own field lists."""

from __future__ import annotations

import dataclasses
import datetime
import json
import math
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from graphnav._hints import hint
from graphnav._schema import Record
from graphnav.errors import LogError
from graphnav.log import SECTIONS, TABLES, SensorLog, SurveyedPoint

LOG_FILE = "log.toml"
#: Folder in a log where results are kept that can be made again; no part of the log.
CACHE_FOLDER = ".graphnav"
FORMAT = "graphnav-log/1"

#: Section name -> class, for every section of log.toml.
ALL_SECTIONS: dict[str, type[Record]] = {
    **SECTIONS,
    **{cls.SECTION: cls for cls in TABLES.values() if cls.SECTION},
    SurveyedPoint.SECTION: SurveyedPoint,
}
_HEADER = ("format", "name", "epoch")


def _elsewhere(cls: type[Record], key: str) -> str:
    """Advice for a choice of method in a section of the log that the configuration has by the same name."""
    from graphnav.config import Config

    section = Config.model_fields.get(cls.SECTION)
    if section is None or key not in getattr(section.annotation, "model_fields", {}):
        return ""
    return f"{cls.SECTION}.{key} is a choice of method: give it in the configuration (--config FILE), not in the log"


def load(folder: Path) -> dict[str, Any]:
    """Parse log.toml and check its format, header and section names.

    Raises
    ------
    LogError
        Unreadable or unknown format, unknown or missing header key, section of the wrong form.
    """
    where = f"{folder.name}/{LOG_FILE}"
    try:
        document = tomllib.loads((folder / LOG_FILE).read_text(encoding="utf-8-sig"))
    except UnicodeDecodeError as error:
        raise LogError(f"not UTF-8 text ({error.reason})", where=where, fix="save it as UTF-8") from None
    except OSError as error:
        raise LogError(f"unreadable ({error.strerror})", where=where, fix="check the file's rights") from None
    except (
        ValueError,
        RecursionError,
    ) as error:  # TOML syntax, a number of thousands of digits, deep nesting
        raise LogError(f"TOML syntax error: {error}", where=where, fix="repair that line") from None
    if document.get("format") != FORMAT:
        found = _show(document["format"]) if "format" in document else "missing"
        raise LogError(f'{found}, expected "{FORMAT}"', where=where, column="format", fix=f'set format = "{FORMAT}"')
    for key, value in document.items():
        _check_top_level(key, value, where)
    if "name" not in document:
        raise LogError("missing key", where=where, column="name", fix=f'add name = "{folder.name}"')
    return document


def _check_top_level(key: str, value: Any, where: str) -> None:
    if key not in ALL_SECTIONS and key not in _HEADER:
        what = "section" if isinstance(value, (dict, list)) else "key"
        raise LogError(f'unknown {what} "{key}"', where=where, fix=hint(key, [*ALL_SECTIONS, *_HEADER]))
    if key in _HEADER:
        if not isinstance(value, str):
            fix = "put it in quotes" if not isinstance(value, (dict, list)) else ""
            raise LogError(f"{_show(value)}, expected text", where=where, column=key, fix=fix)
        if key == "epoch":
            _check_epoch(value, where)
        return
    wants_list = key == SurveyedPoint.SECTION
    if not _is_section(value, wants_list):
        form = f"[[{key}]]" if wants_list else f"[{key}]"
        raise LogError(f'"{key}" is no {form} section', where=where, fix=f"write its keys under {form}")


def _is_section(value: Any, wants_list: bool) -> bool:
    if wants_list:
        return isinstance(value, list) and all(isinstance(item, dict) for item in value)
    return isinstance(value, dict)


def _check_epoch(text: str, where: str) -> None:
    try:
        datetime.datetime.fromisoformat(text)
    except ValueError:
        fix = 'write it like "2026-03-01T06:00:00Z"'
        raise LogError(f'"{text}", expected an ISO 8601 time', where=where, column="epoch", fix=fix) from None


def params(cls: type[Record], values: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Constructor arguments of `cls` from its section: known keys only, all required ones, right types.

    Bounds and relations between values are checked by the class itself.
    """
    fields = {f.name: f for f in cls.param_fields()}
    for key in values:
        if key not in fields:
            raise LogError(f'unknown key "{key}"', where=where, fix=_elsewhere(cls, key) or hint(key, fields))
    for name, f in fields.items():
        if name not in values and f.default is dataclasses.MISSING:
            raise LogError("missing key", where=where, column=name, fix=f"add {name} to this section")
    return {name: _param(f, values[name], where) for name, f in fields.items() if name in values}


def _param(f: dataclasses.Field[Any], value: Any, where: str) -> Any:
    if f.metadata["items"] is not None:
        return _items(f, value, where)
    if f.metadata["kind"] == "str":
        if not isinstance(value, str):
            raise LogError(f"{_show(value)}, expected text", where=where, column=f.name, fix="put it in quotes")
        return value
    if f.metadata["kind"] == "int":
        if isinstance(value, bool) or not isinstance(value, int):
            raise LogError(f"{_show(value)}, expected a whole number", where=where, column=f.name)
        return value
    shape = f.metadata["shape"]
    what = f"an array of {' x '.join(map(str, shape))} numbers" if shape else "a number"
    if not _has_shape(value, shape):
        raise LogError(f"{_show(value)}, expected {what}", where=where, column=f.name)
    try:
        array = np.array(value, dtype=float)
    except OverflowError:
        array = np.array(math.inf)
    if not np.isfinite(array).all():
        raise LogError(f"{_show(value)}, expected finite numbers", where=where, column=f.name)
    return array if shape else float(array)


def _has_shape(value: Any, shape: tuple[int, ...]) -> bool:
    """Whether `value` is numbers (no text, no true/false) nested in lists of exactly this shape."""
    if not shape:
        return isinstance(value, (int, float)) and not isinstance(value, bool)
    return isinstance(value, list) and len(value) == shape[0] and all(_has_shape(v, shape[1:]) for v in value)


def _items(f: dataclasses.Field[Any], value: Any, where: str) -> tuple[Any, ...]:
    cls = f.metadata["items"]
    if not _is_section(value, wants_list=True):
        raise LogError(f'"{f.name}" is no list of sections', where=where, fix=f"write [[{cls.SECTION}]]")
    place = where.partition(" [")[0]
    return build_items(cls, value, place)


def build_items(cls: type[Record], values: list[dict[str, Any]], file: str) -> tuple[Any, ...]:
    """The records of a ``[[section]]`` list; errors name which one, counted from 1."""
    records = []
    for number, item in enumerate(values, start=1):
        where = f"{file} [[{cls.SECTION}]] {number}"
        arguments = params(cls, item, where)
        try:
            records.append(cls(**arguments))
        except LogError as error:
            raise error.at(where) from None
    return tuple(records)


def dump(log: SensorLog) -> str:
    """The text of log.toml for this log; numbers in full precision, unset optional keys left out."""
    lines = [f"format = {_toml(FORMAT)}", f"name = {_toml(log.name)}"]
    if log.epoch is not None:
        lines.append(f"epoch = {_toml(log.epoch)}")
    for section in ALL_SECTIONS:
        record = getattr(log, section)
        if isinstance(record, tuple):
            for item in record:
                lines += ["", f"[[{section}]]", *_dump_params(item)]
        elif record is not None:
            lines += ["", f"[{section}]", *_dump_params(record)]
    return "\n".join(lines) + "\n"


def _dump_params(record: Record) -> list[str]:
    lines, nested = [], []
    for f in record.param_fields():
        value = getattr(record, f.name)
        if f.metadata["items"] is not None:
            for item in value:
                nested += ["", f"[[{f.metadata['items'].SECTION}]]", *_dump_params(item)]
        elif value is not None:
            lines.append(f"{f.name} = {_toml(value)}")
    return lines + nested


def _toml(value: Any) -> str:
    """A TOML value: text, a whole number, a number with every digit, or nested lists of numbers."""
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, (np.ndarray, tuple, list)):
        return f"[{', '.join(_toml(v) for v in value)}]"
    if isinstance(value, int):
        return str(value)
    return repr(float(value))


def _show(value: Any) -> str:
    """A value as the user wrote it, near enough to find it by."""
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{shown(value)}"' if isinstance(value, str) else shown(value)


def shown(value: Any, longest: int = 80) -> str:
    """Text of a value, cut where it would fill the screen."""
    text = str(value)
    return text if len(text) <= longest else f"{text[: longest - 3]}..."
