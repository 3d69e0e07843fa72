"""The logs of the roadheader's reproduction: simulated once with their images, kept outside the repository.

Folders are named by seed and by a hash of the simulator's sources: a simulator that has changed makes them anew.
"""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks._report import say, sources_id

SCENARIO = "roadheader-stereo"


def default_folder() -> Path:
    """Where logs are kept unless told otherwise."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "graphnav" / "roadheader-vio"


def log_of(seed: int, folder: Path) -> Any:
    """The log of a seed, with its truth and its images; without tracks, which an earlier run's sources have left."""
    import graphnav as gn

    place = folder / f"seed-{seed}-{sources_id('graphnav/simulation')}"
    if not place.exists():
        _make(seed, place)
    for tracks in (place / ".graphnav").glob("tracks-*.parquet"):
        tracks.unlink()
    return gn.read(place)


def _make(seed: int, place: Path) -> None:
    """Log and images, whole or not at all."""
    import graphnav as gn
    from graphnav.simulation import simulate
    from graphnav.simulation.stereo_images import render_into

    say(f"seed {seed}: rendering the images to {place}")
    place.parent.mkdir(parents=True, exist_ok=True)
    gn.write(simulate(SCENARIO, seed), place, images=partial(render_into, SCENARIO, seed, {}))
