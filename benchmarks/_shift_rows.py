"""The rows of `benchmarks.shift`: stages, memory, growth, and the targets that issues name for them."""

from __future__ import annotations

from dataclasses import dataclass

from benchmarks._measure import Outcome
from benchmarks._report import Row, Target, exponent, row

FULL_HOURS, FULL_FROM_HOURS = 7.1, 0.5
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


def all_rows(
    runs: dict[str, list[Timed]], native: Timed | None, pairs: list[tuple[Timed, Timed]], limit_s: float
) -> list[Row]:
    """Every row, and how many of graphnav's runs failed."""
    a_rows, a_growth = peer_a_rows(pairs, limit_s) if pairs else ([], None)
    rows: list[Row] = []
    for method, timed in runs.items():
        rows += our_rows(method, timed, native, a_growth)
    rows += peer_b_rows(native) if native else []
    ours = [t for timed in runs.values() for t in timed] + [ours for _, ours in pairs]
    failures = float(sum(t.failed for t in ours))
    return [*rows, *a_rows, row("graphnav: runs that failed, indeterminate or else", failures, "1", target=NO_FAILURE)]
