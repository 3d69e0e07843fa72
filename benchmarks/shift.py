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

from benchmarks._measure import Outcome, measured, sources_id
from benchmarks._report import Row, Target, exponent, machine, parser, publish, row, say

SEED = 1
FULL_HOURS, FULL_FROM_HOURS = 7.1, 0.5
PEER_A_SIZES = "250,500,1000,2000,4000,8000"
STAGES = ("read", "frontend", "assemble", "solve", "covariance")

# The figures that issues name; all at 7.1 h, exponents over 0.5 to 7.1 h.
BATCH_BY_PEER = Target(high=1.0, of_ratio=True)
BATCH_PEAK_GB = Target(high=1.0)
BATCH_GROWTH = Target(high=1.1)
ISAM2_REAL_TIME = Target(low=50.0)
ISAM2_GROWTH = Target(high=1.3)
NO_FAILURE = Target(high=0.0)


@dataclass(frozen=True)
class Timed:
    """The fastest of a few runs of one thing."""

    hours: float
    outcome: Outcome

    @property
    def failed(self) -> bool:
        return self.outcome.failed

    @property
    def total_s(self) -> float | None:
        return self.get("total")

    def get(self, name: str) -> float | None:
        """A stage's seconds, or another figure of the task; None when the run failed."""
        if self.failed:
            return None
        result = self.outcome.result
        found = result["seconds"].get(name, result.get(name))
        return None if found is None else float(found)


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


def fastest(task: str, hours: float, arguments: dict[str, Any], repeats: int, limit_s: float | None = None) -> Timed:
    """Run `repeats` times; the fastest counts, with its own stages; one failure makes all fail."""
    best: Timed | None = None
    for _ in range(repeats):
        timed = Timed(hours, measured(f"benchmarks._tasks:{task}", arguments, limit_s))
        say(f"{task} {arguments.get('method', '')} {hours:.4g} h: {timed.outcome.error or f'{timed.total_s:.2f} s'}")
        if timed.failed:
            return timed
        if best is None or (timed.total_s or 0) < (best.total_s or 0):
            best = timed
    assert best is not None
    return best


# Rows -------------------------------------------------------------------------------------------------------


def stage_rows(name: str, timed: Timed, beside: Timed | None = None) -> list[Row]:
    """Seconds per stage, keyframes and iterations of one run, with the peer's beside them."""
    rows = []
    for stage in (*STAGES, "cpu_s"):
        if stage == "frontend" and timed.get(stage) is None and not timed.failed:
            continue
        label = "processor time" if stage == "cpu_s" else stage
        rows.append(row(f"{name}: {label}", timed.get(stage), "s", peer=beside.get(stage) if beside else None))
    rows += [row(f"{name}: {figure}", timed.get(figure), "1") for figure in ("keyframes", "iterations", "covariances")]
    return rows


def growth_row(name: str, runs: list[Timed], target: Target, peer: float | None) -> Row:
    """Exponent over the lengths; the target is for the whole range."""
    hours = [r.hours for r in runs]
    known = [r for r in runs if r.total_s is not None]
    slope = exponent([r.hours for r in known], [r.total_s or 0 for r in known]) if len(known) == len(runs) else None
    whole = min(hours) <= FULL_FROM_HOURS and max(hours) >= FULL_HOURS
    return row(f"{name}: growth exponent", slope, "1", peer=peer, target=target if whole else None)


def our_rows(method: str, runs: list[Timed], native: Timed | None, peer_growth: float | None) -> list[Row]:
    """All rows of one method."""
    rows: list[Row] = []
    for timed in runs:
        name, full = f"{method} {timed.hours:g} h", timed.hours >= FULL_HOURS
        beside = native if native is not None and native.hours == timed.hours else None
        rows += stage_rows(name, timed, beside)
        peer_s, peer_gb = (beside.total_s, beside.outcome.peak_gb) if beside else (None, None)
        by_peer = BATCH_BY_PEER if method == "batch" and full else None
        rows.append(row(f"{name}: whole run", timed.total_s, "s", peer=peer_s, target=by_peer))
        peak = BATCH_PEAK_GB if method == "batch" and full else None
        rows.append(row(f"{name}: peak memory", timed.outcome.peak_gb, "GB", peer=peer_gb, target=peak))
        rows.append(row(f"{name}: rms position error", timed.get("rms_m"), "m"))
        if method == "isam2":
            faster = timed.hours * 3600 / timed.total_s if timed.total_s else None
            target = ISAM2_REAL_TIME if full else None
            rows.append(row(f"{name}: times faster than real time", faster, "1", target=target))
    rows.append(growth_row(method, runs, BATCH_GROWTH if method == "batch" else ISAM2_GROWTH, peer_growth))
    return rows


def peer_a_rows(pairs: list[tuple[Timed, Timed]], limit_s: float) -> tuple[list[Row], float | None]:
    """Peer (a) at its sizes with ours beside it, and its growth exponent."""
    rows = []
    for peer, ours in pairs:
        size = round(peer.hours * 3600)
        rows.append(row(f"batch at {size} s, beside peer a: whole run", ours.total_s, "s", peer=peer.total_s))
        rows.append(row(f"peer a {size} s: solve", peer.get("solve"), "s"))
        rows.append(row(f"peer a {size} s: iterations", peer.get("iterations"), "1"))
        rows.append(row(f"peer a {size} s: covariances refused as indeterminate", peer.get("refused"), "1"))
    done = [p for p, _ in pairs if not p.failed]
    hours = [p.hours for p in done]
    slope = exponent(hours, [p.total_s or 0 for p in done])
    # Cholesky fails at some sizes and costs iterations there, so one iteration grows more evenly than the whole
    each = exponent(hours, [(p.get("solve") or 0) / max(p.get("iterations") or 1, 1) for p in done])
    rows.append(row(f"peer a: longest run within {limit_s:g} s", max(hours, default=None), "h"))
    rows.append(row("peer a: growth exponent", slope, "1"))
    rows.append(row("peer a: growth exponent of one iteration", each, "1"))
    return rows, slope


def peer_b_rows(native: Timed) -> list[Row]:
    """Peer (b)."""
    name = f"peer b {native.hours:g} h"
    return [
        *stage_rows(name, native),
        row(f"{name}: whole run", native.total_s, "s"),
        row(f"{name}: peak memory", native.outcome.peak_gb, "GB"),
        row(f"{name}: covariances refused as indeterminate", native.get("refused"), "1"),
    ]


# Runs -------------------------------------------------------------------------------------------------------


def run_peer_a(logs: Logs, sizes: list[int], limit_s: float) -> list[tuple[Timed, Timed]]:
    """Growing sizes until one fails or takes too long, with graphnav's batch run of the same log."""
    pairs = []
    for size in sizes:
        hours, folder = size / 3600, logs.of(size / 3600)
        peer = fastest("per_sample_peer", hours, {"folder": folder}, 1, limit_s)
        pairs.append((peer, fastest("smooth", hours, {"folder": folder, "method": "batch"}, 1)))
        if peer.failed:
            break
    return pairs


def run(arguments: argparse.Namespace, cache: Path) -> list[Row]:
    """Measure everything asked for."""
    logs, hours = Logs(cache), sorted(arguments.hours)
    longest = hours[-1]
    for length in hours:
        logs.of(length)
    native = None
    if "b" in arguments.peers:
        native = fastest("native_peer", longest, {"folder": logs.of(longest)}, arguments.repeats)
    runs = {}
    for method in arguments.methods:
        repeats = arguments.repeats if method == "batch" else 1
        runs[method] = [fastest("smooth", h, {"folder": logs.of(h), "method": method}, repeats) for h in hours]
    pairs = run_peer_a(logs, arguments.peer_a_sizes, arguments.limit_s) if "a" in arguments.peers else []

    a_rows, a_growth = peer_a_rows(pairs, arguments.limit_s) if pairs else ([], None)
    rows: list[Row] = []
    for method, timed in runs.items():
        rows += our_rows(method, timed, native, a_growth)
    rows += peer_b_rows(native) if native else []
    ours = [t for timed in runs.values() for t in timed] + [ours for _, ours in pairs]
    failures = float(sum(t.failed for t in ours))
    return [*rows, *a_rows, row("graphnav: runs that failed, indeterminate or else", failures, "1", target=NO_FAILURE)]


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
    arguments, before = args.parse_args(argv), machine()
    if arguments.cache is not None:
        rows = run(arguments, arguments.cache.resolve())
    else:
        with tempfile.TemporaryDirectory(prefix="graphnav_benchmark_") as folder:
            rows = run(arguments, Path(folder))
    publish(rows, arguments.json, before)


if __name__ == "__main__":
    main()
