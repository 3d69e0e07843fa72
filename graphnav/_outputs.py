"""Whether a place takes what is to be written there: told before the work, not after an hour of it."""

from __future__ import annotations

import errno
import os
import tempfile
from pathlib import Path


def check_makable(path: Path) -> None:
    """Try whether something new can be made at a path, by making and removing a folder beside it.

    It has the path's whole name and some more, as what is written beside its place before it is moved there.

    Raises
    ------
    OSError : the nearest folder above it that exists takes nothing new.
    """
    target = path.resolve()
    above = next(place for place in target.parents if place.exists())
    Path(tempfile.mkdtemp(prefix=f".{target.name}.trying-", dir=above)).rmdir()


def check_file(path: Path) -> None:
    """Try whether a file can be made, or replaced, at a path.

    Raises
    ------
    OSError : it is a folder, or nothing new can be made there.
    """
    if path.is_dir():
        raise OSError(errno.EISDIR, os.strerror(errno.EISDIR))
    check_makable(path)
