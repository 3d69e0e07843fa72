"""Reproduction of the INS/LiDAR shearer paper: figures 7, 8 and 10, tables 3 and 4, on simulated logs.

The paper's filter with its choices of legs, its automatic choice and its posterior correction, dead reckoning, and the
factor graph beside them, in the paper's own plain world and on shearer-lidar. With --page a page is written, with its
pictures. Takes about 50 minutes with 3 seeds, 20 of them for the graph. With --kept outcomes are
kept in a folder, and those that are there are taken as they are: remove what is to be measured again.
"""

from __future__ import annotations

import multiprocessing
import os
import time
from pathlib import Path

from benchmarks._report import Before, parser, publish, say
from benchmarks.papers._lidar_cases import GRAPH, Found, Job, jobs, run_job
from benchmarks.papers._lidar_kept import keep, kept
from benchmarks.papers._lidar_rows import Results, all_rows


def measure(todo: list[Job], workers: int, folder: Path | None) -> Results:
    """Run all jobs in processes of their own, but for those whose outcomes are kept."""
    # inherited by the workers: more BLAS threads than one slow the small matrices down
    os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1", MKL_NUM_THREADS="1")
    known = taken(todo, folder)
    open_jobs, began = [job for job in todo if job not in known], time.monotonic()
    if open_jobs:
        with multiprocessing.get_context("spawn").Pool(workers, maxtasksperchild=1) as pool:
            for job, outcome in zip(open_jobs, pool.imap(run_job, open_jobs), strict=True):
                known[job] = outcome
                if folder is not None:
                    keep(job, outcome, folder)
                text = outcome if isinstance(outcome, str) else f"{job.world}, seed {job.seed}, {job.part}"
                say(f"{len(known)} of {len(todo)}, {time.monotonic() - began:.0f} s: {text}")
    return Results.of([known[job] for job in todo])


def taken(todo: list[Job], folder: Path | None) -> dict[Job, Found | str]:
    """Kept outcomes by job."""
    if folder is None:
        return {}
    found = {job: kept(job, folder) for job in todo}
    return {job: outcome for job, outcome in found.items() if outcome is not None}


def main(argv: list[str] | None = None) -> None:
    """Parse, measure, print, and write the page."""
    args = parser(__doc__)
    args.add_argument("--seeds", type=int, default=3, help="number of seeds of the paper's world and of shearer-lidar")
    args.add_argument("--first-seed", type=int, default=3)
    args.add_argument("--no-graph", action="store_true", help="leave the graph's runs out")
    args.add_argument("--workers", type=int, default=2, help="processes (default 2), up to 4 GB each")
    args.add_argument("--kept", type=Path, help="folder of kept outcomes")
    args.add_argument("--no-runs", action="store_true", help="make do with the outcomes that are kept")
    args.add_argument("--page", type=Path, help="write the page, such as docs/papers/lidar-ins.md")
    args.add_argument("--figures", type=Path, help="folder of the pictures (default: beside the page, named as it is)")
    arguments, before = args.parse_args(argv), Before.now()
    if arguments.seeds < 1 or arguments.workers < 1:
        args.error("--seeds and --workers need at least 1")
    if arguments.no_runs and arguments.kept is None:
        args.error("--no-runs needs --kept")
    todo = list(jobs(arguments.seeds, arguments.first_seed))
    todo = [job for job in todo if job.part != GRAPH] if arguments.no_graph else todo
    if arguments.no_runs:
        todo = list(taken(todo, arguments.kept))
    results = measure(todo, arguments.workers, arguments.kept)
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
