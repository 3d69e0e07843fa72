"""Whether a place takes what is to be written there: told before the work, not after an hour of it."""

from __future__ import annotations

import tempfile
from pathlib import Path


def check_makable(path: Path) -> None:
    """Try whether something new can be made at a path, by making and removing a folder beside it.

    Raises
    ------
    OSError : the nearest folder above it that exists takes nothing new.
    """
    target = path.resolve()
    above = next(place for place in target.parents if place.exists())
    Path(tempfile.mkdtemp(prefix=f".{target.name[:50]}.trying-", dir=above)).rmdir()
