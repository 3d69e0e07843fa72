"""Tracks kept beside the log, so that a second smoothing does not follow the features again.

They lie in the hidden folder ``.graphnav`` of the log, one file for each choice of settings, named by a hash of all
that the result depends on: settings, camera, names, sizes and times of change of the images, versions. A file that is
damaged is made anew; where nothing can be written, nothing is kept. Images outside a log's folder leave no file there.
"""

from __future__ import annotations

import hashlib
import json
import os
import uuid
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from graphnav.frontends._opencv import opencv
from graphnav.frontends.image_pairs import PairFiles
from graphnav.frontends.stereo_result import Tracked
from graphnav.frontends.stereo_sides import Skipped
from graphnav.log import SensorLog, StereoTracks
from graphnav.readers.sections import CACHE_FOLDER, LOG_FILE

if TYPE_CHECKING:
    from graphnav.config import StereoTracksConfig

#: Raised with every change of what comes out of the same images.
VERSION = 3
_META = b"graphnav"
_COLUMNS = ("t_s", "track", "u_left_px", "u_right_px", "v_px")


def cache_file(log: SensorLog, files: Sequence[PairFiles], settings: StereoTracksConfig) -> Path | None:
    """Where the tracks of these images with these settings are kept; None for images outside a log folder."""
    folder = log.stereo_pairs.folder if log.stereo_pairs is not None else None
    if folder is None or not (Path(folder) / LOG_FILE).is_file():
        return None
    camera = log.stereo
    assert camera is not None
    figures = [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, camera.baseline_m]
    known: dict[str, Any] = {
        "versions": [VERSION, opencv().__version__],
        "settings": settings.model_dump(exclude={"bias_px"}),  # a figure about the tracks, not for them
        "camera": [float(value).hex() for value in figures],
        **({} if camera.size_px is None else {"size": camera.size_px}),
        "pairs": [[pair.t_s.hex(), _state(pair.left), _state(pair.right)] for pair in files],
    }
    digest = hashlib.sha256(json.dumps(known, sort_keys=True).encode()).hexdigest()
    return Path(folder) / CACHE_FOLDER / f"tracks-{digest[:32]}.parquet"


def _state(path: Path) -> list[Any]:
    try:
        found = path.stat()
    except OSError:
        return [str(path), None]
    return [str(path), found.st_size, found.st_mtime_ns]


def kept(path: Path) -> Tracked | None:
    """The tracks of a file; None if there is none, or it cannot be read."""
    import pyarrow as pa
    from pyarrow import parquet

    try:
        table = parquet.read_table(path)
        meta = json.loads(table.schema.metadata[_META])
        columns = {name: table[name].to_numpy() for name in _COLUMNS}
        skipped = tuple(Skipped(float(t_s), str(reason)) for t_s, reason in meta["skipped"])
        times, counts = np.array(meta["t_s"], float), np.array(meta["counts"], np.int64)
        if counts.sum() != len(table):
            return None
        return Tracked(StereoTracks(**columns), times, counts, skipped, float(meta["seconds"]))
    except (OSError, pa.ArrowException, ValueError, KeyError, TypeError):
        return None


def keep(found: Tracked, path: Path) -> None:
    """Write the tracks beside their place, then rename; where that is not possible, leave it."""
    import pyarrow as pa
    from pyarrow import parquet

    meta = {
        "t_s": found.t_s.tolist(),
        "counts": found.counts.tolist(),
        "skipped": [[frame.t_s, frame.reason] for frame in found.skipped],
        "seconds": found.seconds,
    }
    table = pa.table({name: getattr(found.tracks, name) for name in _COLUMNS})
    table = table.replace_schema_metadata({_META: json.dumps(meta).encode()})
    draft = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}")
    try:
        path.parent.mkdir(exist_ok=True)
        parquet.write_table(table, draft, compression="zstd")
        os.replace(draft, path)
    except OSError:
        with suppress(OSError):
            draft.unlink()
