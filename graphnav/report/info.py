"""What a log holds, told to a person or a script: `describe` and `render`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from graphnav._schema import Array, Record
from graphnav.errors import LogError
from graphnav.frontends.rest import rest_spans
from graphnav.frontends.units import check_units
from graphnav.log import SensorLog

if TYPE_CHECKING:
    from rich.console import Console

#: A step this many times the usual one is a gap.
_GAP_RATIO = 2.5
#: Tables that are lists of happenings, without a rate.
_UNSAMPLED = ("events", "push")
_SECTIONS = ("frames", "initial", "imu", "odometer", "face", "lidar", "uwb", "stereo")


def describe(log: SensorLog) -> dict[str, Any]:
    """What the log holds, as plain numbers, text, lists and dictionaries.

    Parameters
    ----------
    log : the log.

    Returns
    -------
    dict
        `name`, `epoch`, `start_s`, `end_s`, `duration_s`;
        `tables`: name -> `rows, start_s, end_s, rate_hz, gaps`; a gap is `{start_s, length_s}` from the last
        sample before it to the first one after, and the rate is None for a table that is not sampled;
        `rest`: list of `{start_s, end_s}`; `suspicious`: lines about wrong units and contradictions;
        `declared`: section -> key -> value, from log.toml or default; `surveyed`: list of points.
    """
    tables = {name: _table(name, record) for name, record in log.tables().items()}
    start_s = min(table["start_s"] for table in tables.values())
    end_s = max(table["end_s"] for table in tables.values())
    rest, suspicious = _rest_and_suspicions(log)
    return {
        "name": log.name,
        "epoch": log.epoch,
        "start_s": start_s,
        "end_s": end_s,
        "duration_s": end_s - start_s,
        "tables": tables,
        "rest": [{"start_s": float(start), "end_s": float(end)} for start, end in rest],
        "suspicious": suspicious,
        "declared": {name: _params(getattr(log, name)) for name in _SECTIONS if getattr(log, name) is not None},
        "surveyed": [_params(point) for point in log.surveyed],
    }


def _rest_and_suspicions(log: SensorLog) -> tuple[Array, list[str]]:
    try:
        rest = rest_spans(log)
    except LogError as error:
        return np.zeros((0, 2)), [str(error), *check_units(log, np.zeros((0, 2)))]
    return rest, check_units(log, rest)


def _table(name: str, record: Record) -> dict[str, Any]:
    times = getattr(record, record.TIME)
    steps = np.diff(times)
    moves = steps > 0
    sampled = name not in _UNSAMPLED and bool(moves.any())
    return {
        "rows": len(times),
        "start_s": float(times[0]),
        "end_s": float(times[-1]),
        "rate_hz": round(1 / float(np.median(steps[moves])), 6) if sampled else None,
        "gaps": _gaps(times, steps, moves) if sampled else [],
    }


def _gaps(times: Array, steps: Array, moves: npt.NDArray[np.bool_]) -> list[dict[str, float]]:
    """Steps well above the usual ones; the 90th percentile allows for sensors that sample in bursts."""
    usual = max(float(np.median(steps[moves])), float(np.percentile(steps[moves], 90)))
    rows = np.flatnonzero(steps > _GAP_RATIO * usual)
    return [{"start_s": float(times[row]), "length_s": float(steps[row])} for row in rows]


def _params(record: Record) -> dict[str, Any]:
    return {f.name: _plain(getattr(record, f.name)) for f in record.param_fields()}


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_params(item) for item in value]
    return value.tolist() if isinstance(value, np.ndarray) else value


def render(info: dict[str, Any], console: Console | None = None) -> None:
    """Print what `describe` found as tables for the terminal.

    Parameters
    ----------
    info : result of `describe`.
    console : where to; standard error by default, as standard output is kept for JSON.
    """
    from rich.console import Console

    console = console or Console(stderr=True)
    epoch = f", epoch {info['epoch']}" if info["epoch"] else ""
    span = f"{info['start_s']:.3f} to {info['end_s']:.3f} s ({_duration(info['duration_s'])})"
    console.print(f"{info['name']}: {span}{epoch}", style="bold", markup=False, highlight=False)
    console.print(_tables_table(info["tables"]))
    console.print(_declared_table(info["declared"], info["surveyed"]))
    _print_rest(console, info["rest"])
    for line in info["suspicious"]:
        console.print(f"suspicious: {line}", style="red", markup=False, highlight=False)
    if not info["suspicious"]:
        console.print("units: nothing suspicious", highlight=False)


def _tables_table(tables: dict[str, Any]) -> Any:
    from rich.table import Table

    view = Table("table", *(_right(name) for name in ("rows", "rate Hz", "start s", "end s", "gaps", "longest s")))
    for name, table in tables.items():
        gaps = table["gaps"]
        view.add_row(
            name,
            f"{table['rows']:,}",
            "" if table["rate_hz"] is None else f"{table['rate_hz']:.4g}",
            f"{table['start_s']:.3f}",
            f"{table['end_s']:.3f}",
            str(len(gaps)) if gaps else "",
            f"{max(gap['length_s'] for gap in gaps):.3f}" if gaps else "",
        )
    return view


def _declared_table(declared: dict[str, Any], surveyed: list[dict[str, Any]]) -> Any:
    from rich.table import Table
    from rich.text import Text

    view = Table("section", "declared")
    sections = {**declared, **{f"surveyed {i}": point for i, point in enumerate(surveyed, start=1)}}
    for name, keys in sections.items():
        lines = [f"{key} = {_short(value)}" for key, value in keys.items() if value is not None]
        view.add_row(name, Text("\n".join(lines)), end_section=True)
    return view


def _print_rest(console: Console, rest: list[dict[str, float]]) -> None:
    total = sum(span["end_s"] - span["start_s"] for span in rest)
    shown = ", ".join(f"{span['start_s']:.1f}-{span['end_s']:.1f}" for span in rest[:8])
    more = f" and {len(rest) - 8} more" if len(rest) > 8 else ""
    text = f"at rest: {_duration(total)} in {len(rest)} spans: {shown} s{more}" if rest else "at rest: never found"
    console.print(text, markup=False, highlight=False)


def _right(name: str) -> Any:
    from rich.table import Column

    return Column(name, justify="right")


def _short(value: Any) -> str:
    if isinstance(value, list):
        return (
            f"{len(value)} declared" if value and isinstance(value[0], dict) else f"[{', '.join(map(_short, value))}]"
        )
    return f"{value:g}" if isinstance(value, float) else str(value)


def _duration(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.1f} s"
    return f"{seconds / 60:.1f} min" if seconds < 7200 else f"{seconds / 3600:.2f} h"
