"""Speed, memory and growth on full-shift's plain chain (IMU, 10 Hz odometer, closed path), beside two peers.

Peer a: GTSAM as its examples write it, with a Python odometer factor, at growing sizes until one run takes longer than
--limit-s. Peer b: native factors only, on the same keyframes, at the longest log. Every run has a process of its own;
logs are simulated before, and not counted. Takes about 10 minutes with the defaults.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks._measure import measured
from benchmarks._report import Before, Row, parser, publish, say, sources_id
from benchmarks._shift_rows import Timed, all_rows

SEED = 1
PEER_A_SIZES = "250,500,1000,2000,4000,8000"


class Logs:
    """Simulated logs, one per length, kept in a folder; a log made by other simulator code is not taken."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.made_by = folder, sources_id("graphnav/simulation", "graphnav/readers")
        folder.mkdir(parents=True, exist_ok=True)

    def of(self, hours: float) -> str:
        folder = self.folder / f"full-shift_{hours:.6g}h_seed{SEED}_{self.made_by}"
        if not folder.is_dir():
            say(f"simulating {hours:.4g} h")
            made = measured("benchmarks._tasks:simulate", {"folder": str(folder), "hours": hours, "seed": SEED})
            if made.failed:
                raise SystemExit(f"benchmarks.shift: cannot simulate {hours:g} h: {made.error}")
        return str(folder)


@dataclass(frozen=True)
class Job:
    """One thing to be measured."""

    task: str
    hours: float
    arguments: dict[str, Any]


def fastest(jobs: list[Job], repeats: int, limit_s: float | None = None) -> list[Timed]:
    """The fastest of `repeats` runs of each job, with its own stages; one failure makes all of that job fail.

    The jobs take turns, so that what else the machine does meets all of them alike.
    """
    best: list[Timed | None] = [None] * len(jobs)
    for _ in range(repeats):
        for k, job in enumerate(jobs):
            before = best[k]
            if before is None or not before.failed:
                best[k] = quicker(before, once(job, limit_s))
    return [timed for timed in best if timed is not None]


def once(job: Job, limit_s: float | None) -> Timed:
    """One measured run."""
    timed = Timed(job.hours, measured(f"benchmarks._tasks:{job.task}", job.arguments, limit_s))
    outcome = timed.outcome.error or f"{timed.total_s:.2f} s"
    say(f"{job.task} {job.arguments.get('method', '')} {job.hours:.4g} h: {outcome}")
    return timed


def quicker(before: Timed | None, now: Timed) -> Timed:
    """The faster one; a failure counts."""
    if before is None or now.total_s is None:
        return now
    return min(before, now, key=lambda timed: timed.total_s or 0.0)


def run_peer_a(logs: Logs, sizes: list[int], limit_s: float) -> list[tuple[Timed, Timed]]:
    """Growing sizes until one fails or takes too long, with graphnav's batch run of the same log."""
    pairs = []
    for size in sizes:
        hours, folder = size / 3600, logs.of(size / 3600)
        jobs = [Job("per_sample_peer", hours, {"folder": folder}), smoothing(logs, hours, "batch")]
        peer, ours = fastest(jobs, 1, limit_s)
        pairs.append((peer, ours))
        if peer.failed:
            break
    return pairs


def smoothing(logs: Logs, hours: float, method: str) -> Job:
    """Graphnav on one log."""
    return Job("smooth", hours, {"folder": logs.of(hours), "method": method})


def run(arguments: argparse.Namespace, cache: Path) -> list[Row]:
    """Measure everything asked for."""
    logs, hours = Logs(cache), sorted(arguments.hours)
    longest = hours[-1]
    for length in hours:
        logs.of(length)
    runs: dict[str, list[Timed]] = {}
    native = None
    for method in arguments.methods:
        repeats = arguments.repeats if method == "batch" else 1
        runs[method] = [t for h in hours[:-1] for t in fastest([smoothing(logs, h, method)], repeats)]
        jobs = [smoothing(logs, longest, method)]
        if method == "batch" and "b" in arguments.peers:
            jobs.append(native_job(logs, longest))
        ours, *peers = fastest(jobs, repeats)
        runs[method].append(ours)
        native = peers[0] if peers else native
    if native is None and "b" in arguments.peers:
        native = fastest([native_job(logs, longest)], arguments.repeats)[0]
    pairs = run_peer_a(logs, arguments.peer_a_sizes, arguments.limit_s) if "a" in arguments.peers else []
    return all_rows(runs, native, pairs, arguments.limit_s)


def native_job(logs: Logs, hours: float) -> Job:
    """Peer (b) on one log."""
    return Job("native_peer", hours, {"folder": logs.of(hours)})


def listed(kind: type, known: str | None = None) -> Any:
    """Parser of comma-separated values."""

    def parse(text: str) -> list[Any]:
        values = [kind(part) for part in text.split(",") if part.strip()]
        if known is not None and not set(values) <= set(known.split(",")):
            raise argparse.ArgumentTypeError(f"{text}: choose from {known}")
        return values

    return parse


def main(argv: list[str] | None = None) -> None:
    """Parse, measure, print."""
    args = parser(__doc__)
    args.add_argument("--hours", type=listed(float), default="0.5,1,2,4,7.1", help="lengths of the log")
    args.add_argument("--methods", type=listed(str, "batch,isam2"), default="batch,isam2", help="what of ours to run")
    args.add_argument("--peers", type=listed(str, "a,b"), default="a,b", help="which peers; empty for none")
    args.add_argument("--peer-a-sizes", type=listed(int), default=PEER_A_SIZES, help="keyframes of peer a's runs")
    args.add_argument("--limit-s", type=float, default=120.0, help="longest run of peer a")
    args.add_argument("--repeats", type=int, default=2, help="runs of batch and of peer b; the fastest counts")
    args.add_argument("--cache", type=Path, help="folder to keep the simulated logs in; default a temporary one")
    arguments, before = args.parse_args(argv), Before.now()
    if arguments.repeats < 1 or not arguments.hours:
        args.error("--repeats and --hours need at least 1")
    if arguments.cache is not None:
        rows = run(arguments, arguments.cache.resolve())
    else:
        with tempfile.TemporaryDirectory(prefix="graphnav_benchmark_") as folder:
            rows = run(arguments, Path(folder))
    publish(rows, arguments.json, before)


if __name__ == "__main__":
    main()
