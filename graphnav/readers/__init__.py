"""Reading and writing recorded logs: `read` any supported format, `write` the graphnav log folder."""

from __future__ import annotations

import os
from pathlib import Path

from graphnav.errors import LogError
from graphnav.log import SensorLog
from graphnav.readers.folder import read_folder
from graphnav.readers.sections import LOG_FILE
from graphnav.readers.writer import write

__all__ = ["read", "write"]


def read(path: str | os.PathLike[str]) -> SensorLog:
    """Read a recorded log.

    Parameters
    ----------
    path : log folder (``log.toml`` and one table per sensor). The format is recognised by its files.

    Returns
    -------
    SensorLog
        All times on the common clock; declared matrices applied to the inertial samples.

    Raises
    ------
    LogError
        The path is no log, or the log breaks a rule of its format; the text names file, row, column,
        value and fix.
    """
    path = Path(path)
    if (path / LOG_FILE).is_file():
        return read_folder(path)
    raise _no_log(path)


def _no_log(path: Path) -> LogError:
    """Say why `path` cannot be read, and what would be."""
    if not path.exists():
        return LogError("no such folder", where=str(path), fix="check the path")
    if path.is_file():
        fix = f"pass the log folder {path.parent}" if path.name == LOG_FILE else f"pass a folder with {LOG_FILE}"
        return LogError("a file, expected a log folder", where=str(path), fix=fix)
    if (path / "trajectory.parquet").is_file():
        return LogError("the results of a run, expected a log", where=str(path), fix="pass the log that was smoothed")
    near = sorted(p.name for p in path.iterdir() if p.name.lower() == LOG_FILE)
    fix = f"rename {near[0]} to {LOG_FILE}" if near else f'add {LOG_FILE} with format = "graphnav-log/1"'
    return LogError(f"no {LOG_FILE} in the folder, so it is no graphnav log", where=str(path), fix=fix)
