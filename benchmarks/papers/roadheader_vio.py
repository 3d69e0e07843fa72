"""Reproduction of the roadheader's visual-inertial odometry: table 6, figures 8, 9 and 14, on simulated images.

SINS, stereo odometry, the paper's filter and the factor graph on roadheader-stereo, with raw and enhanced images. The
logs with their images (0.2 GB and some 90 s of one core each) are kept in a folder outside the repository. With --page
a page is written, with its pictures. A method that fails has a row that says why.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from benchmarks._report import Before, parser, publish, say
from benchmarks.papers._vio_cases import Found, run_cases
from benchmarks.papers._vio_features import Shown, enhancement_ms, followed, matches, shown
from benchmarks.papers._vio_kept import keep, kept
from benchmarks.papers._vio_logs import default_folder, log_of
from benchmarks.papers._vio_rows import Results, all_rows

PAIRS = 40


def measure(seeds: Sequence[int], folder: Path, pairs: int, again: bool) -> Results:
    """All seeds, one after the other: the front end has both cores, then all else is timed in this process.

    Parameters
    ----------
    folder : of the logs, where outcomes are left too.
    again : measure also what an earlier run of the same graphnav has left.
    """
    os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1", MKL_NUM_THREADS="1")
    found = []
    for seed in seeds:
        known = None if again else kept(seed, folder)
        found.append(known or _found(seed, folder, pairs))
        keep(found[-1], folder)
    return Results(tuple(found), enhancement_ms(seeds[0]))


def _found(seed: int, folder: Path, pairs: int) -> Found:
    began = time.monotonic()

    def said(what: str) -> None:
        say(f"seed {seed}, {time.monotonic() - began:.0f} s: {what}")

    log = log_of(seed, folder)
    front = followed(log)
    said("features followed")
    kept, true = matches(seed, pairs)
    said("features matched")
    return replace(run_cases(seed, log, said), front=front, matched=kept, confirmed=true)


def main(argv: list[str] | None = None) -> None:
    """Parse, measure, print, and write the page."""
    args = parser(__doc__)
    args.add_argument("--seeds", type=int, default=5, help="number of seeds")
    args.add_argument("--first-seed", type=int, default=0)
    args.add_argument(
        "--pairs", type=int, default=PAIRS, help="pairs of frames of each seed whose features are matched"
    )
    args.add_argument("--logs", type=Path, default=default_folder(), help="folder of kept logs (default %(default)s)")
    args.add_argument("--kept", action="store_true", help="take what an earlier run of the same sources has left there")
    args.add_argument("--no-runs", action="store_true", help="make do with the seeds of which there are such outcomes")
    args.add_argument("--page", type=Path, help="write the page, such as docs/papers/roadheader-vio.md")
    args.add_argument("--figures", type=Path, help="folder of the pictures (default: beside the page, named as it is)")
    arguments, before = args.parse_args(argv), Before.now()
    if arguments.seeds < 1 or arguments.pairs < 1:
        args.error("--seeds and --pairs need at least 1")
    seeds = list(range(arguments.first_seed, arguments.first_seed + arguments.seeds))
    if arguments.no_runs:
        seeds = [seed for seed in seeds if kept(seed, arguments.logs) is not None]
    if not seeds:
        args.error(f"--no-runs: no outcomes of these sources in {arguments.logs}")
    results = measure(seeds, arguments.logs, arguments.pairs, not (arguments.kept or arguments.no_runs))
    pictures = _draw(results, shown(seeds[0], arguments.pairs), arguments.figures, arguments.page)
    if arguments.page is not None:
        from benchmarks.papers._vio_page import write

        write(arguments.page, results, pictures, _command(arguments), before)
    publish(all_rows(results), arguments.json, before)


def _draw(results: Results, pair: dict[str, Shown], folder: Path | None, page: Path | None) -> dict[str, Path]:
    """Pictures by name, where a folder or a page is asked for."""
    if folder is None and page is None:
        return {}
    from benchmarks.papers._vio_figures import draw

    return draw(results, pair, folder or (page or Path()).with_suffix(""))


def _command(arguments: object) -> str:
    """What made the page."""
    known = vars(arguments)
    made = f"python -m benchmarks.papers.roadheader_vio --seeds {known['seeds']}"
    made += f" --first-seed {known['first_seed']}" if known["first_seed"] else ""
    made += f" --pairs {known['pairs']}" if known["pairs"] != PAIRS else ""
    made += "".join(f" --{name.replace('_', '-')}" for name in ("kept", "no_runs") if known[name])
    return f"{made} --page docs/papers/roadheader-vio.md"


if __name__ == "__main__":
    main()
