"""Image enhancement on dark photographs and the rendered roadway: matched features, quality measures, time a frame.

The photographs (DICM, LIME; GRAPHNAV_DATA or ../shared/data) are taken as they are, made grey and 424 x 240. Each is
seen twice under small random homographies, with shot and read noise of its own in both frames, so that what matches
truly is known; the simulated roadheader's camera (roadheader-stereo) sees its roadway a second apart. A set that is not
at hand has rows without a value. Processor time, on one thread. Takes about 3 minutes a seed.
"""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from benchmarks._dark_images import NOISES, SETS, VARIANTS, pairs, photographs, scores
from benchmarks._image_rows import SHOWN, Judged, Quality, Results, all_rows
from benchmarks._report import Before, parser, publish, say
from graphnav.frontends._opencv import Image

ROADWAY, SCENES = "rendered roadway", 12


def measure(seeds: int, groups: tuple[str, ...] = SETS, scenes: int = SCENES) -> tuple[Results, list[str]]:
    """Everything, and the sets that are not at hand."""
    judged: list[Judged] = []
    at_hand = {name: photographs(name) for name in groups}
    frames = [image for images in at_hand.values() for _, image in images]
    for name, images in at_hand.items():
        judged += judged_photographs(name, images, seeds)
    for seed in range(seeds):
        judged += judged_roadway(scenes, seed)
    return Results(tuple(judged), timed(frames)), [name for name, images in at_hand.items() if not images]


def judged_photographs(group: str, images: list[tuple[str, Image]], seeds: int) -> Iterator[Judged]:
    """Pairs of every photograph, noise and seed; the quality of each photograph once."""
    from graphnav.frontends.enhancement import resized

    measured = {name: qualities(resized(image)) for name, image in images}
    for noise in NOISES:
        for seed in range(seeds):
            for pair in pairs(images, NOISES[noise], seed):
                first = seed == 0 and noise == next(iter(NOISES))
                found = scores(pair.first, pair.second, "homography", lambda m, pair=pair: m.true_to(pair.warp))
                yield Judged(group, noise, pair.name, found, measured[pair.name] if first else {}, {})
            say(f"{group}, {noise}, seed {seed}: {len(images)} photographs")


def judged_roadway(count: int, seed: int) -> Iterator[Judged]:
    """Rendered frames with the camera's own noise, which is the usual one here."""
    from benchmarks._rendered_roadway import scenes
    from graphnav.frontends.image_quality import depth_spread

    for number, scene in enumerate(scenes(count, seed)):
        found = scores(scene.first, scene.second, "auto", scene.confirmed)
        depth = {case: depth_spread(scene.disparity_px(one.true_px)) for case, one in found.items()}
        name = f"seed {seed}, scene {number}"
        yield Judged(ROADWAY, next(iter(NOISES)), name, found, qualities(scene.first), depth)
    say(f"{ROADWAY}, seed {seed}: {count} scenes")


def qualities(image: Image) -> dict[str, Quality]:
    """Of one image: variant -> measures."""
    from graphnav.frontends import image_quality as quality

    made = {name: VARIANTS[name](image) for name in SHOWN}
    return {
        name: Quality(
            float(one.mean()), quality.rms_contrast(one), quality.local_contrast(one), quality.entropy(one), _niqe(one)
        )
        for name, one in made.items()
    }


def _niqe(image: Image) -> float | None:
    """None where the parameters are not installed."""
    from graphnav.errors import GraphnavError
    from graphnav.frontends.niqe import natural, niqe

    try:
        natural()
    except GraphnavError:
        return None
    return niqe(image)


def timed(images: list[Image]) -> dict[str, float]:
    """Milliseconds a frame of processor time: median over the frames of the least of five."""
    from graphnav.frontends.enhancement import resized

    small = [resized(image) for image in images]
    if not small:
        from benchmarks._rendered_roadway import scenes

        small = [scene.first for scene in scenes(2)]
    found = {name: statistics.median(_least_ms(VARIANTS[name], image) for image in small) for name in SHOWN[1:]}
    found["resizing"] = statistics.median(_least_ms(resized, image) for image in images) if images else 0.0
    return found


def _least_ms(change: Callable[[Image], Image], image: Image) -> float:
    found = []
    for _ in range(5):
        began = time.thread_time()
        change(image)
        found.append(1e3 * (time.thread_time() - began))
    return min(found)


def main(argv: list[str] | None = None) -> None:
    """Parse, measure, print, and write the page."""
    args = parser(__doc__)
    args.add_argument("--seeds", type=int, default=1, help="pairs of each photograph")
    args.add_argument("--page", type=Path, help="write the page, such as docs/enhancement.md, with its pictures")
    args.add_argument("--photographs", type=Path, help="folder outside the repository for pictures of photographs")
    arguments, before = args.parse_args(argv), Before.now()
    os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1", MKL_NUM_THREADS="1")
    from graphnav.frontends._opencv import opencv

    opencv().setNumThreads(1)
    if arguments.seeds < 1:
        args.error("--seeds needs at least 1")
    results, missing = measure(arguments.seeds)
    if arguments.photographs is not None:
        from benchmarks.papers._enhancement_figures import draw_photographs

        draw_photographs(arguments.photographs)
    if arguments.page is not None:
        from benchmarks.papers._enhancement_page import write

        write(arguments.page, results, arguments.seeds, before)
    publish(all_rows(results, missing), arguments.json, before)


if __name__ == "__main__":
    main()
