"""Creep of the face on shearer-lidar over many seeds, by registration of the roadway and from the smoothed positions.

Errors against truth, which no estimator sees, at both ends of the face, beside the paper's largest (Table 4, one
simulated shift, registration alone). Takes about 2 minutes and 4 GB a seed.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import statistics
from dataclasses import dataclass

from benchmarks._report import Before, Row, Target, parser, publish, row, say
from benchmarks.accuracy import NO_FAILURE, nees_rows

SCENARIO = "shearer-lidar"
ENDS = ("near", "far")
KINDS = ("registration", "positions")
# The figure that the scenario names, and the paper's.
LARGEST_MM = Target(high=2.0)
PAPER_MM = 4.0


@dataclass(frozen=True)
class Found:
    """One creep by one measurement: its error and its sigma, mm."""

    kind: str
    end: str
    error_mm: float
    sigma_mm: float


@dataclass(frozen=True)
class Shift:
    """All creeps of one seed."""

    seed: int
    found: list[Found]

    def of(self, kind: str, end: str | None = None) -> list[Found]:
        """Those by one measurement, at one end or both."""
        return [f for f in self.found if f.kind == kind and end in (None, f.end)]


def run_seed(work: tuple[int, int, bool]) -> Shift | str:
    """Simulate, smooth and look at both ends for one (seed, number of cycles, drawn); the error's text on failure."""
    from dataclasses import replace

    from graphnav.creep import creep, with_truth
    from graphnav.errors import GraphnavError
    from graphnav.simulation import simulate
    from graphnav.smooth import smooth

    seed, cycles, draw = work
    log = simulate(SCENARIO, seed=seed, cycles=cycles, draw=draw)
    blind = replace(log, truth=None)
    found = []
    try:
        run = smooth(blind)
        for end in ENDS:
            for r in with_truth(creep(blind, run, end=end), log).rows:
                assert r.icp_error_m is not None and r.graph_error_m is not None
                found.append(Found("registration", end, 1e3 * r.icp_error_m, 1e3 * r.icp_sigma_m))
                found.append(Found("positions", end, 1e3 * r.graph_error_m, 1e3 * r.graph_sigma_m))
    except GraphnavError as error:
        return f"seed {seed}: {error}"
    return Shift(seed, found)


def all_rows(done: list[Shift | str]) -> list[Row]:
    """Everything, from the runs that succeeded; failures are a row of their own."""
    shifts = [s for s in done if isinstance(s, Shift)]
    rows = [row("runs of all seeds that failed", float(len(done) - len(shifts)), "1", target=NO_FAILURE)]
    for kind in KINDS if shifts else ():
        for end in ENDS:
            found = [f for s in shifts for f in s.of(kind, end)]
            errors, name = [abs(f.error_mm) for f in found], f"{kind}, {end} end"
            peer = PAPER_MM if kind == "registration" else None
            rows.append(row(f"{name}: largest error of {len(found)}", max(errors), "mm", peer=peer, target=LARGEST_MM))
            rows.append(row(f"{name}: rms error", math.sqrt(statistics.fmean(e**2 for e in errors)), "mm"))
            rows.append(row(f"{name}: mean sigma", statistics.fmean(f.sigma_mm for f in found), "mm"))
        squares = [statistics.fmean((f.error_mm / f.sigma_mm) ** 2 for f in s.of(kind)) for s in shifts]
        rows += nees_rows(kind, squares, None)
    return rows


def main(argv: list[str] | None = None) -> None:
    """Parse, measure, print."""
    args = parser(__doc__)
    args.add_argument("--seeds", type=int, default=6, help="number of seeds")
    args.add_argument("--first-seed", type=int, default=0)
    args.add_argument("--cycles", type=int, default=6, help="cutting cycles of a shift")
    args.add_argument("--fixed", action="store_true", help="the paper's errors of scanner and mounting, not drawn ones")
    args.add_argument("--workers", type=int, default=1, help="processes")
    arguments, before = args.parse_args(argv), Before.now()
    # inherited by the workers: more BLAS threads than one slow the small matrices down
    os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1", MKL_NUM_THREADS="1")
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    work = [(seed, arguments.cycles, not arguments.fixed) for seed in seeds]
    done: list[Shift | str] = []
    # one seed a process: what a shift took is given back
    with multiprocessing.get_context("spawn").Pool(arguments.workers, maxtasksperchild=1) as pool:
        for shift in pool.imap(run_seed, work, chunksize=1):
            done.append(shift)
            say(shift if isinstance(shift, str) else f"seed {shift.seed}: {_listed(shift)} mm")
    publish(all_rows(done), arguments.json, before)


def _listed(shift: Shift) -> str:
    parts = [f"{kind} " + " ".join(f"{f.error_mm:+.2f}" for f in shift.of(kind)) for kind in KINDS]
    return ", ".join(parts)


if __name__ == "__main__":
    main()
