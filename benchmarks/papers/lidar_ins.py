"""Reproduction of the INS/LiDAR shearer paper: figures 7, 8 and 10, tables 3 and 4, on simulated logs.

Everything is measured in the run that prints it: the paper's filter with its choices of legs, its automatic choice and
its posterior correction, dead reckoning, and the factor graph beside them, in the paper's own plain world and on
shearer-lidar. With --page a page is written, with its pictures. Takes about 15 minutes with 3 seeds on two cores.
"""

from __future__ import annotations

import multiprocessing
import os
import time
from pathlib import Path

from benchmarks._report import Before, parser, publish, say
from benchmarks.papers._lidar_cases import Found, Job, jobs, run_job
from benchmarks.papers._lidar_rows import Results, all_rows


def measure(todo: list[Job], workers: int) -> Results:
    """Run all jobs in processes of their own."""
    # inherited by the workers: more BLAS threads than one slow the small matrices down
    os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1", MKL_NUM_THREADS="1")
    began, outcomes = time.monotonic(), list[Found | str]()
    with multiprocessing.get_context("spawn").Pool(workers, maxtasksperchild=1) as pool:
        for outcome in pool.imap(run_job, todo):
            outcomes.append(outcome)
            job = todo[len(outcomes) - 1]
            text = outcome if isinstance(outcome, str) else f"{job.world}, seed {job.seed}"
            say(f"{len(outcomes)} of {len(todo)}, {time.monotonic() - began:.0f} s: {text}")
    return Results.of(outcomes)


def main(argv: list[str] | None = None) -> None:
    """Parse, measure, print, and write the page."""
    args = parser(__doc__)
    args.add_argument("--seeds", type=int, default=3, help="number of seeds of shearer-lidar (default 3)")
    args.add_argument("--first-seed", type=int, default=3)
    args.add_argument("--workers", type=int, default=2, help="processes (default 2), up to 4 GB each")
    args.add_argument("--page", type=Path, help="write the page, such as docs/papers/lidar-ins.md")
    args.add_argument("--figures", type=Path, help="folder of the pictures (default: beside the page, named as it is)")
    arguments, before = args.parse_args(argv), Before.now()
    if arguments.seeds < 1 or arguments.workers < 1:
        args.error("--seeds and --workers need at least 1")
    results = measure(list(jobs(arguments.seeds, arguments.first_seed)), arguments.workers)
    pictures = _draw(results, arguments.figures, arguments.page)
    if arguments.page is not None:
        from benchmarks.papers._lidar_page import write

        write(arguments.page, results, pictures, before)
    publish(all_rows(results), arguments.json, before)


def _draw(results: Results, folder: Path | None, page: Path | None) -> dict[str, Path]:
    """Pictures by name, where a folder or a page is asked for."""
    if folder is None and page is None:
        return {}
    from benchmarks.papers._lidar_figures import draw

    return draw(results, folder or (page or Path()).with_suffix(""))


if __name__ == "__main__":
    main()
