"""Reproduction of J. Zheng et al., Micromachines 12 (2021) 1527: figures 7-16 and table 3, on simulated logs.

Everything is measured in the run that prints it, on shearer-mems: the paper's filter and RTS smoother with its own
tuning and with the log's, dead reckoning with and without compensation, and the factor graph beside them. With --page
a page is written, with its pictures. Takes about 5 minutes with 10 seeds on two cores.
"""

from __future__ import annotations

import multiprocessing
import os
import time
from pathlib import Path

from benchmarks._report import Before, parser, publish, say
from benchmarks.papers._cases import Job, jobs, run_job
from benchmarks.papers._judged import Found
from benchmarks.papers._results import Results
from benchmarks.papers._rows import all_rows


def measure(todo: list[Job], workers: int) -> Results:
    """Run all jobs in processes of their own."""
    # inherited by the workers: more BLAS threads than one slow the small matrices down
    os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1", MKL_NUM_THREADS="1")
    began, outcomes = time.monotonic(), list[Found | str]()
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        for outcome in pool.imap(run_job, todo):
            outcomes.append(outcome)
            job = todo[len(outcomes) - 1]
            text = outcome if isinstance(outcome, str) else f"{job.log}, seed {job.seed}"
            say(f"{len(outcomes)} of {len(todo)}, {time.monotonic() - began:.0f} s: {text}")
    return Results.of(outcomes)


def main(argv: list[str] | None = None) -> None:
    """Parse, measure, print, and write the page."""
    args = parser(__doc__)
    args.add_argument("--seeds", type=int, default=10, help="number of seeds (default 10)")
    args.add_argument("--par-seeds", type=int, help="of these for the twelve error settings (default half of them)")
    args.add_argument("--first-seed", type=int, default=0)
    args.add_argument("--workers", type=int, default=2, help="processes (default 2)")
    args.add_argument("--page", type=Path, help="write the page, such as docs/papers/mems-odometer.md")
    args.add_argument("--figures", type=Path, help="folder of the pictures (default: beside the page, named as it is)")
    arguments, before = args.parse_args(argv), Before.now()
    if arguments.seeds < 1 or arguments.workers < 1:
        args.error("--seeds and --workers need at least 1")
    swept = arguments.par_seeds if arguments.par_seeds is not None else (arguments.seeds + 1) // 2
    results = measure(list(jobs(arguments.seeds, swept, arguments.first_seed)), arguments.workers)
    rows = all_rows(results)
    pictures = _draw(results, arguments.figures, arguments.page)
    if arguments.page is not None:
        from benchmarks.papers._page import write

        write(arguments.page, results, pictures, before)
    publish(rows, arguments.json, before)


def _draw(results: Results, folder: Path | None, page: Path | None) -> dict[str, Path]:
    """Pictures by name, where a folder or a page is asked for."""
    if folder is None and page is None:
        return {}
    from benchmarks.papers._figures import draw

    return draw(results, folder or (page or Path()).with_suffix(""))


if __name__ == "__main__":
    main()
