"""Images of a converted recording, copied into its log folder: ``left/`` and ``right/``."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path, PurePosixPath

from graphnav.errors import LogError
from graphnav.log import SensorLog


def gathered(log: SensorLog) -> tuple[SensorLog, Callable[[Path], None] | None]:
    """The log with its images in ``left`` and ``right``, and what copies them there.

    Parameters
    ----------
    log : as converted; its image paths are relative to `stereo_pairs.folder`.

    Returns
    -------
    SensorLog, and a function that takes the log's folder; None for a log without images.
    """
    from dataclasses import replace

    pairs = log.stereo_pairs
    if pairs is None or pairs.folder is None:
        return log, None
    source = Path(pairs.folder)
    ways: dict[str, Path] = {}
    for side in ("left", "right"):
        for number, name in enumerate(getattr(pairs, side)):
            ways[f"{side}/{number:06d}{PurePosixPath(name).suffix}"] = source / name
    names = list(ways)
    half = len(names) // 2
    renamed = pairs.replace(left=names[:half], right=names[half:], folder=None)

    def copy(folder: Path) -> None:
        for name, path in ways.items():
            target = folder / name
            target.parent.mkdir(exist_ok=True)
            _copy(path, target)

    return replace(log, stereo_pairs=renamed), copy


def _copy(path: Path, target: Path) -> None:
    try:
        shutil.copyfile(path, target)
    except FileNotFoundError:
        raise LogError("no such image", where=str(path), fix="restore it") from None
