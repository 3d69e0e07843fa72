"""Accuracy and consistency on shearer-mems over many seeds.

Errors against truth, which no estimator sees, beside the Cramer-Rao bound at the truth; iSAM2 beside batch; the closed
path as relative factors beside the papers' absolute form, which counts the same information twice. Takes about 2
minutes with 20 seeds.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import statistics
from dataclasses import dataclass
from typing import Any

from benchmarks._report import Before, Row, Target, parser, publish, row, say
from graphnav._consistency import OverRuns, false_alarm

SCENARIO = "shearer-mems"

# The figures that the scenario and the issues name.
SEP_M = Target(high=0.07)
WORST_SEP_M = Target(high=0.15)
NEES = Target(low=0.7, high=1.4)
ISAM2_MM = Target(high=5.0)
OVER_BOUND = Target(high=1.1)
NO_FAILURE = Target(high=0.0)


@dataclass(frozen=True)
class Judged:
    """One run against truth.

    Attributes
    ----------
    sep_m : median 3-D error per cycle; mean_square_m2 : of the 3-D error.
    nees_position, nees_attitude : mean of ``e' P^-1 e / 3``.
    """

    sep_m: list[float]
    mean_square_m2: float
    nees_position: float
    nees_attitude: float


@dataclass(frozen=True)
class Seed:
    """All runs of one seed: by method with relative factors, the absolute form with batch, iSAM2 less batch.

    Attributes
    ----------
    bound_m2 : Cramer-Rao bound of the mean square 3-D error, from the graph linearised at the truth.
    """

    seed: int
    batch: Judged
    isam2: Judged
    absolute: Judged
    isam2_off_m: float
    bound_m2: float


def run_seed(seed: int) -> Seed | str:
    """Simulate and run everything for one seed; the error's text when a run fails."""
    from dataclasses import replace

    import numpy as np

    from graphnav.bound import bound
    from graphnav.config import Config
    from graphnav.errors import GraphnavError
    from graphnav.simulation import simulate
    from graphnav.smooth import smooth

    log = simulate(SCENARIO, seed=seed)
    blind = replace(log, truth=None)
    absolute = Config.from_dict({"closed_path": {"form": "absolute"}})
    try:
        batch, isam2, papers = smooth(blind), smooth(blind, method="isam2"), smooth(blind, config=absolute)
        limit = bound(log).overall.bound_3d_m
    except GraphnavError as error:
        return f"seed {seed}: {error}"
    off = batch.trajectory.pos_n - isam2.trajectory.pos_n
    rms_off = float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
    judged = [judge(run.trajectory, log) for run in (batch, isam2, papers)]
    return Seed(seed, judged[0], judged[1], judged[2], rms_off, limit**2)


def judge(trajectory: Any, log: Any) -> Judged:
    """Error and consistency of one trajectory."""
    from graphnav.evaluation import evaluate

    found = evaluate(trajectory, log)
    assert found.nees_position is not None and found.nees_attitude is not None
    return Judged(
        sep_m=[cycle.sep_m for cycle in found.per_cycle],
        mean_square_m2=found.ate_unaligned_m**2,
        nees_position=found.nees_position,
        nees_attitude=found.nees_attitude,
    )


# Rows -------------------------------------------------------------------------------------------------------


def accuracy_rows(method: str, seeds: list[Seed]) -> list[Row]:
    """SEP per cycle and error over the bound of one method, the other's beside it."""
    other = "isam2" if method == "batch" else "batch"
    runs, beside = [getattr(s, method) for s in seeds], [getattr(s, other) for s in seeds]
    rows = []
    for c in range(len(runs[0].sep_m)):
        sep, peer = (statistics.median(r.sep_m[c] for r in group) for group in (runs, beside))
        rows.append(row(f"{method}: median SEP of cycle {c + 1}, {other} beside", sep, "m", peer=peer, target=SEP_M))
    worst, peer = (max(max(r.sep_m) for r in group) for group in (runs, beside))
    name = f"{method}: largest SEP of any cycle and run, {other} beside"
    rows.append(row(name, worst, "m", peer=peer, target=WORST_SEP_M))
    rms = math.sqrt(statistics.fmean(r.mean_square_m2 for r in runs))
    bound = math.sqrt(statistics.fmean(s.bound_m2 for s in seeds))
    rows.append(row(f"{method}: rms error", rms, "m", peer=bound))
    rows.append(row(f"{method}: rms error by the bound", rms / bound, "1", target=OVER_BOUND))
    return rows


def nees_rows(name: str, values: list[float], target: Target | None, peer: float | None = None) -> list[Row]:
    """Mean NEES over the runs with what is known of its scatter.

    Errors of one run are all of a piece, so a run counts as one draw: its mean NEES is taken for a chi-square of `d`
    degrees of freedom over d, with d from the runs' scatter (``d = 2 mean^2 / variance``). The false-alarm rate is the
    chance that the mean over as many runs of an estimator with NEES 1 falls outside the target's band.
    """
    found = OverRuns.of(values)
    assert found is not None
    rows = [row(f"{name}: mean NEES", found.mean, "1", peer=peer, target=target)]
    if found.freedom is not None:
        rows.append(row(f"{name}: standard error of the mean NEES", found.standard_error, "1"))
        rows.append(row(f"{name}: degrees of freedom of one run", found.freedom, "1"))
        if target is not None:
            alarm = false_alarm(found.runs * found.freedom, target.low, target.high)
            rows.append(row(f"{name}: false-alarm rate of the band with {found.runs} runs", alarm, "1"))
    return rows


def all_rows(method: str, found: list[Seed | str]) -> list[Row]:
    """Everything, from the runs that succeeded; failures are a row of their own."""
    seeds = [s for s in found if isinstance(s, Seed)]
    rows = [row("runs of all seeds that failed", float(len(found) - len(seeds)), "1", target=NO_FAILURE)]
    if not seeds:
        return rows
    rows += accuracy_rows(method, seeds)
    runs = [getattr(s, method) for s in seeds]
    rows += nees_rows(f"{method}, position", [r.nees_position for r in runs], NEES)
    rows += nees_rows(f"{method}, attitude", [r.nees_attitude for r in runs], None)
    absolute = [s.absolute.nees_position for s in seeds]
    relative = [s.batch.nees_position for s in seeds]
    beside = statistics.fmean(relative)
    rows += nees_rows("batch, absolute closed path (relative beside), position", absolute, None, peer=beside)
    lifted = sum(a > r for a, r in zip(absolute, relative, strict=True)) / len(seeds)
    rows.append(row("absolute closed path: share of runs with the higher NEES", lifted, "1"))
    rms, beside = (
        math.sqrt(statistics.fmean(getattr(s, form).mean_square_m2 for s in seeds)) for form in ("absolute", "batch")
    )
    rows.append(row("batch, absolute closed path (relative beside): rms error", rms, "m", peer=beside))
    off = [s.isam2_off_m * 1e3 for s in seeds]
    rows.append(row("isam2 less batch: rms position, median run", statistics.median(off), "mm"))
    rows.append(row("isam2 less batch: rms position, worst run", max(off), "mm", target=ISAM2_MM))
    return rows


def _listed(values: list[float]) -> str:
    return ", ".join(f"{x:.3f}" for x in values)


def main(argv: list[str] | None = None) -> None:
    """Parse, measure, print."""
    args = parser(__doc__)
    args.add_argument("--seeds", type=int, default=20, help="number of seeds")
    args.add_argument("--first-seed", type=int, default=0)
    args.add_argument("--method", choices=("batch", "isam2"), default="batch", help="method that is judged")
    args.add_argument("--workers", type=int, default=2, help="processes")
    arguments, before = args.parse_args(argv), Before.now()
    # inherited by the workers: more BLAS threads than one slow the small matrices down
    os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1", MKL_NUM_THREADS="1")
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    found: list[Seed | str] = []
    with multiprocessing.get_context("spawn").Pool(arguments.workers) as pool:
        for done in pool.imap(run_seed, seeds):
            found.append(done)
            say(done if isinstance(done, str) else f"seed {done.seed}: SEP per cycle {_listed(done.batch.sep_m)} m")
    publish(all_rows(arguments.method, found), arguments.json, before)


if __name__ == "__main__":
    main()
