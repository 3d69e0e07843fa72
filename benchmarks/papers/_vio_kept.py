"""Outcomes of the roadheader's reproduction as files: rows, page and pictures are made of them again without a run.

They are taken only by the same graphnav that left them: its sources' hash is part of their names.
"""

from __future__ import annotations

import pickle
from pathlib import Path

from benchmarks._report import sources_id
from benchmarks.papers._vio_cases import Found


def file_of(seed: int, folder: Path) -> Path:
    """Where the outcome of a seed is kept."""
    return folder / f"found-{seed}-{sources_id('graphnav', 'factors')}.pickle"


def keep(one: Found, folder: Path) -> None:
    """Write an outcome, whole or not at all."""
    folder.mkdir(parents=True, exist_ok=True)
    beside = file_of(one.seed, folder).with_suffix(".part")
    beside.write_bytes(pickle.dumps(one))
    beside.replace(file_of(one.seed, folder))


def kept(seed: int, folder: Path) -> Found | None:
    """A kept outcome of this very graphnav, or None."""
    path = file_of(seed, folder)
    if not path.exists():
        return None
    found = pickle.loads(path.read_bytes())
    return found if isinstance(found, Found) else None
