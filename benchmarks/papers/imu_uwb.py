"""Reproduction of the IMU/UWB face-end paper (Cao et al. 2023): table 4 and figures 4-6 and 8-13, on simulated logs.

UWB alone, the paper's filter and its VB-UKF on both, and the factor graph beside them, at both sites of face-end-uwb.
With --page a page is written, with its pictures. A method that fails has a row that says why.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks._report import Before, parser, publish, say
from benchmarks.papers._uwb_cases import Job, jobs, run_job
from benchmarks.papers._uwb_rows import Results, all_rows


def measure(todo: Sequence[Job]) -> Results:
    """Run all jobs, one after the other: the seconds are those of one process."""
    found, began = [], time.monotonic()
    for job in todo:
        found.append(run_job(job))
        failed = [name for name, one in found[-1].courses.items() if isinstance(one, str)]
        said = f"; failed: {', '.join(failed)}" if failed else ""
        say(f"{len(found)} of {len(todo)}, {time.monotonic() - began:.0f} s: {job.site}, seed {job.seed}{said}")
    return Results(tuple(found))


def main(argv: list[str] | None = None) -> None:
    """Parse, measure, print, and write the page."""
    args = parser(__doc__)
    args.add_argument("--seeds", type=int, default=20, help="number of seeds of each site")
    args.add_argument("--first-seed", type=int, default=0)
    args.add_argument("--no-graph", action="store_true", help="leave the graph's runs out")
    args.add_argument("--page", type=Path, help="write the page, such as docs/papers/imu-uwb.md")
    args.add_argument("--figures", type=Path, help="folder of the pictures (default: beside the page, named as it is)")
    arguments, before = args.parse_args(argv), Before.now()
    if arguments.seeds < 1:
        args.error("--seeds needs at least 1")
    results = measure(list(jobs(arguments.seeds, arguments.first_seed, not arguments.no_graph)))
    pictures: dict[str, Path] = {}
    if arguments.figures is not None or arguments.page is not None:
        from benchmarks.papers._uwb_figures import draw

        pictures = draw(results, arguments.figures or arguments.page.with_suffix(""))
    if arguments.page is not None:
        from benchmarks.papers._uwb_page import write

        write(arguments.page, results, pictures, _command(arguments), before)
    publish(all_rows(results), arguments.json, before)


def _command(arguments: object) -> str:
    """What made the page."""
    made = f"python -m benchmarks.papers.imu_uwb --seeds {arguments.seeds}"  # type: ignore[attr-defined]
    return f"{made}{' --no-graph' if arguments.no_graph else ''} --page docs/papers/imu-uwb.md"  # type: ignore[attr-defined]


if __name__ == "__main__":
    main()
