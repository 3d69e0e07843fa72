"""Writing a graphnav log folder: beside its place, then renamed, so that it is there whole or not at all."""

from __future__ import annotations

import os
import shutil
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Literal

from graphnav._outputs import check_makable
from graphnav.errors import LogError
from graphnav.log import TABLES, SensorLog
from graphnav.readers import sections
from graphnav.readers.folder import check_pairs
from graphnav.readers.sections import CACHE_FOLDER, LOG_FILE
from graphnav.readers.tables import SUFFIXES, write_table

_OVERWRITE = "choose another folder, or replace all of it with --overwrite (in Python overwrite=True)"


def write(
    log: SensorLog,
    path: str | os.PathLike[str],
    tables: Literal["parquet", "csv"] = "parquet",
    overwrite: bool = False,
    images: Callable[[Path], None] | None = None,
) -> None:
    """Write a log folder that `read` gives back number for number.

    Images named by a stereo table are no part of the `SensorLog` and are not copied; `images` may make them.

    Parameters
    ----------
    log : the log.
    path : the folder. One that is empty or holds a log and nothing else is replaced; images are something else.
    tables : file type of the tables; scans, which have a list column, are parquet in either case.
    overwrite : replace a folder that holds anything else, too.
    images : called with the folder before it is put in its place, to write the images there.

    Raises
    ------
    LogError
        The path is a file or a folder with other content, it cannot be written, or the log lacks a part that
        its format requires.
    """
    if f".{tables}" not in SUFFIXES:
        raise LogError(f'tables="{tables}", expected "parquet" or "csv"', where=str(path))
    target = Path(path).resolve()
    _check_target(target, overwrite)
    present = [name for name in sections.ALL_SECTIONS if getattr(log, name)]
    check_pairs(present, log.tables(), target.name)
    draft = _beside(target, "draft")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        _write_into(draft, log, f".{tables}")
        if images is not None:
            images(draft)
        _put_in_place(draft, target)
    except OSError as error:
        raise _unwritable(path, error) from None
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def check_output(path: str | os.PathLike[str], overwrite: bool = False) -> None:
    """Whether `write` would be able to make a folder, told before there is a log to be written.

    Raises
    ------
    LogError : it is a file, holds what is no part of a log, or cannot be made.
    """
    try:
        target = Path(path).resolve()
        _check_target(target, overwrite)
        check_makable(target)
    except OSError as error:
        raise _unwritable(path, error) from None


def _unwritable(path: str | os.PathLike[str], error: OSError) -> LogError:
    problem = f"cannot be written ({error.strerror or error})"
    return LogError(problem, where=str(path), fix="choose a folder that can be written to")


def _check_target(target: Path, overwrite: bool) -> None:
    if target.exists() and not target.is_dir():
        raise LogError("a file, expected a folder to write the log to", where=str(target), fix="choose another path")
    if overwrite or not target.exists():
        return
    others = sorted(p.name for p in target.iterdir() if not _is_log_file(p))
    if others:
        problem = f"the folder holds {others[0]}, which is no part of a log"
        raise LogError(problem, where=str(target), fix=_OVERWRITE)


def _is_log_file(path: Path) -> bool:
    if path.name == CACHE_FOLDER:
        return path.is_dir()
    return path.is_file() and (path.name == LOG_FILE or (path.stem in TABLES and path.suffix in SUFFIXES))


def _beside(target: Path, what: str) -> Path:
    """A hidden name in the same folder, hence on the same file system, that nobody else uses."""
    return target.with_name(f".{target.name}.{uuid.uuid4().hex[:8]}.{what}")


def _write_into(folder: Path, log: SensorLog, ending: str) -> None:
    folder.mkdir()
    (folder / LOG_FILE).write_text(sections.dump(log), encoding="utf-8")
    for record in log.tables().values():
        write_table(record, folder, ending)


def _put_in_place(draft: Path, target: Path) -> None:
    """Rename the draft to the target; what stood there is put aside first and comes back on failure."""
    if not target.exists():
        draft.rename(target)
        return
    old = _beside(target, "old")
    target.rename(old)
    try:
        draft.rename(target)
    except OSError:
        old.rename(target)
        raise
    shutil.rmtree(old)
