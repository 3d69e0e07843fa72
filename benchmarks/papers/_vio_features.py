"""The front end of the roadheader's reproduction: matched features, pairs a second, milliseconds of enhancement."""

from __future__ import annotations

import statistics
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks._rendered_roadway import scenes
from benchmarks.papers._judged import Array
from benchmarks.papers._vio_cases import FrontEnd
from graphnav.simulation.roadheader_figures import ROADHEADER

#: Configuration's name -> what the page calls it.
ENHANCERS = {"none": "raw", "clahe": "CLAHE", "retinex-dust": "enhanced"}
WORKERS = 2
_TIMED = 50


@dataclass(frozen=True, eq=False)
class Shown:
    """A pair of frames with its matches that RANSAC keeps, for figure 9: columns (K, 2) in px, and depths (K,)."""

    first: Any
    second: Any
    first_px: Array
    second_px: Array
    depth_m: Array


def followed(log: Any) -> dict[str, FrontEnd]:
    """Follow the features of a log's images with each enhancement, with two workers."""
    from graphnav.config import StereoTracksConfig
    from graphnav.frontends.stereo_tracks import tracked

    front = {}
    for name in ENHANCERS:
        found = tracked(log, StereoTracksConfig(enhance=name), workers=WORKERS)  # type: ignore[arg-type]
        pairs = len(found.t_s) + len(found.skipped)
        front[name] = FrontEnd(pairs / found.seconds, float(found.counts.mean()), found.mean_length)
    return front


def matches(seed: int, count: int) -> tuple[dict[str, Array], dict[str, Array]]:
    """SIFT matches (K,) kept by RANSAC and those that the true motion confirms, in frames a second apart."""
    from graphnav.frontends.enhancement import ENHANCERS as MADE
    from graphnav.frontends.image_quality import matched

    kept: dict[str, list[int]] = {name: [] for name in ENHANCERS}
    true: dict[str, list[int]] = {name: [] for name in ENHANCERS}
    for scene in scenes(count, seed):
        for name in ENHANCERS:
            found = matched(MADE[name](scene.first), MADE[name](scene.second))
            kept[name].append(found.count)
            true[name].append(int((found.kept & scene.confirmed(found)).sum()))
    return tuple({name: np.array(values, float) for name, values in one.items()} for one in (kept, true))  # type: ignore[return-value]


def shown(seed: int, count: int) -> dict[str, Shown]:
    """The middle one of the pairs, raw and enhanced."""
    from graphnav.frontends.enhancement import ENHANCERS as MADE
    from graphnav.frontends.image_quality import matched

    scene, camera, made = scenes(count, seed)[count // 2], ROADHEADER.camera, {}
    for name in ("none", "retinex-dust"):
        first, second = MADE[name](scene.first), MADE[name](scene.second)
        found = matched(first, second)
        px = found.first_px[found.kept]
        depth_m = camera.focal_px * camera.baseline_m / scene.disparity_px(px)
        made[name] = Shown(first, second, px, found.second_px[found.kept], depth_m)
    return made


def enhancement_ms(seed: int) -> dict[str, float]:
    """Median milliseconds of a frame by enhancement, in one thread, frames drawn from the drive in turn."""
    from graphnav.frontends._opencv import opencv
    from graphnav.frontends.enhancement import ENHANCERS as MADE

    threads, images = opencv().getNumThreads(), [scene.first for scene in scenes(4, seed)]
    opencv().setNumThreads(1)
    try:
        return {name: _median_ms(MADE[name], images) for name in ENHANCERS if name != "none"}
    finally:
        opencv().setNumThreads(threads)


def _median_ms(work: Any, images: list[Any]) -> float:
    spent = []
    for k in range(_TIMED + len(images)):
        began = time.perf_counter()
        work(images[k % len(images)])
        spent.append(1e3 * (time.perf_counter() - began))
    return statistics.median(spent[len(images) :])
