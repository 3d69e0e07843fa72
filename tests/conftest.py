"""What every test shares: reproducible settings and the place of recorded data."""

from __future__ import annotations

import os
from pathlib import Path

import hypothesis
import pytest
from tree import ROOT

# Before numpy is first imported: more BLAS threads than one slow the small matrices down.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
os.environ.setdefault("MPLBACKEND", "Agg")

# The same examples in every run, and no time limit on any of them.
hypothesis.settings.register_profile("graphnav", derandomize=True, deadline=None, database=None)
hypothesis.settings.load_profile("graphnav")


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of recorded data: $GRAPHNAV_DATA or ../shared/data; skips where there is none."""
    folder = Path(os.environ.get("GRAPHNAV_DATA") or ROOT.parent / "shared" / "data")
    if not folder.is_dir():
        pytest.skip(f"no recorded data: {folder} is no folder (set GRAPHNAV_DATA)")
    return folder
