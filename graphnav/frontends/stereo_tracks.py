"""Image pairs of a log -> the table `stereo_tracks`: features that are followed from frame to frame (paper, 4.2).

Worker processes find features in both images of each pair (`stereo_sides`); this process follows them from pair to pair
(`stereo_linking`). The result is the same for any number of workers.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from graphnav._pool import in_order, leave_if_starting
from graphnav._stages import ProgressHook
from graphnav.errors import LogError
from graphnav.frontends.image_pairs import PairFiles, pair_files
from graphnav.frontends.image_size import image_size
from graphnav.frontends.skipped_pairs import none_of_use
from graphnav.frontends.stereo_cache import cache_file, keep, kept
from graphnav.frontends.stereo_calibration_check import check_calibration
from graphnav.frontends.stereo_linking import Linker, Sight
from graphnav.frontends.stereo_result import Tracked
from graphnav.frontends.stereo_sides import PairWork, Skipped
from graphnav.log import SensorLog, StereoTracks

if TYPE_CHECKING:
    from graphnav.config import StereoTracksConfig

__all__ = ["Tracked", "tracked"]


def tracked(
    log: SensorLog,
    settings: StereoTracksConfig | None = None,
    workers: int | None = None,
    progress: ProgressHook | None = None,
    cache: bool = True,
) -> Tracked:
    """Follow features through the image pairs of a log.

    Parameters
    ----------
    log : with `stereo_pairs` that were read from a folder, and `stereo`.
    settings : None takes the defaults.
    workers : processes that find features; None takes one per core.
    progress : called as ``progress("images", done, total)``.
    cache : take the tracks that an earlier call has kept in the log's folder, or keep them there.

    Raises
    ------
    LogError
        The log has no images, none is of use, an image is of another size than the rest, or the pairs do not look like
        the declared camera's: sides swapped, not rectified.
    """
    from graphnav.config import StereoTracksConfig

    leave_if_starting()
    settings = settings or StereoTracksConfig()
    files = pair_files(log)
    path = cache_file(log, files, settings) if cache else None
    found = None if path is None else kept(path)
    if found is None:
        found = _tracked(log, files, settings, workers, progress)
        if path is not None:
            keep(found, path)
    return found


def _tracked(
    log: SensorLog,
    files: Sequence[PairFiles],
    settings: StereoTracksConfig,
    workers: int | None,
    progress: ProgressHook | None,
) -> Tracked:
    began = time.perf_counter()
    sights, skipped = _followed(log, files, settings, workers, progress)
    if not sights:
        assert log.stereo_pairs is not None
        raise none_of_use(log.stereo_pairs, skipped)
    counts = np.array([len(sight.track) for sight in sights])
    times = np.array([sight.t_s for sight in sights])
    return Tracked(_table(sights, counts), times, counts, tuple(skipped), time.perf_counter() - began)


def _followed(
    log: SensorLog,
    files: Sequence[PairFiles],
    settings: StereoTracksConfig,
    workers: int | None,
    progress: ProgressHook | None,
) -> tuple[list[Sight], list[Skipped]]:
    """What is seen in the frames of use, and the other frames."""
    camera = log.stereo
    assert camera is not None
    work = PairWork(settings, image_size(files, camera), camera.fx_px * camera.baseline_m)
    check_calibration(files, work)
    linker, sights, skipped = Linker(work, camera), list[Sight](), list[Skipped]()
    for done, found in enumerate(in_order(work, files, workers), start=1):
        if isinstance(found, LogError):
            raise found
        if isinstance(found, Skipped):
            skipped.append(found)
        else:
            sights.append(linker(found))
        if progress is not None:
            progress("images", done, len(files))
    return sights, skipped


def _table(sights: Sequence[Sight], counts: npt.NDArray[np.int64]) -> StereoTracks:
    uv = np.concatenate([sight.uv_px for sight in sights])
    return StereoTracks(
        t_s=np.repeat([sight.t_s for sight in sights], counts),
        track=np.concatenate([sight.track for sight in sights]),
        u_left_px=uv[:, 0],
        u_right_px=np.concatenate([sight.u_right_px for sight in sights]),
        v_px=uv[:, 1],
    )
