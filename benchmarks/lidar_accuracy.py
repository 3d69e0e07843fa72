"""Accuracy and consistency of LiDAR legs on shearer-lidar over many seeds, beside the Cramer-Rao bound.

Every error drawn anew for each seed. Errors against truth, which no estimator sees, with legs and without, beside the
bound at the truth; the scanner's calibration against what was drawn. Takes about 1 minute a seed and process.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import statistics
from dataclasses import dataclass
from typing import Any

from benchmarks._report import Before, Row, Target, parser, publish, row, say
from benchmarks.accuracy import NO_FAILURE, nees_rows

SCENARIO = "shearer-lidar"
OVER_BOUND = Target(high=1.15)
#: In the order of the calibration's eight numbers; last, what the data know of the third and eighth.
NUMBERS = (
    "range scale", "range bias", "angle bias", "angle scale", "angle quadratic", "mounting about right",
    "mounting about forward", "mounting about up", "angle bias and mounting about up together",
)  # fmt: skip


@dataclass(frozen=True)
class Seed:
    """One seed.

    Attributes
    ----------
    squares_m2, bound_m2 : mean square of the 3-D error and its bound, with legs and without.
    nees_position, nees_attitude : mean of ``e' P^-1 e / 3`` with legs.
    sigmas : errors of the calibration (`NUMBERS`) by their sigmas; learnt : their sigmas by those declared.
    nees_calibration : ``e' P^-1 e / 8`` of the eight numbers.
    """

    seed: int
    squares_m2: tuple[float, float]
    bound_m2: tuple[float, float]
    nees_position: float
    nees_attitude: float
    sigmas: list[float]
    learnt: list[float]
    nees_calibration: float


def run_seed(work: tuple[int, int]) -> Seed | str:
    """Simulate, smooth and bound for one (seed, number of cycles); the error's text on failure."""
    from dataclasses import replace

    from graphnav.bound import bound
    from graphnav.config import Config
    from graphnav.errors import GraphnavError
    from graphnav.evaluation import evaluate
    from graphnav.simulation import simulate
    from graphnav.smooth import smooth

    seed, cycles = work
    log = simulate(SCENARIO, seed=seed, cycles=cycles, scans=False, draw=True)
    try:
        run = smooth(replace(log, truth=None))
        limits = [bound(log, Config.from_dict({"lidar": {"use": use}})).overall for use in (True, False)]
    except GraphnavError as error:
        return f"seed {seed}: {error}"
    judged = evaluate(run.trajectory, log)
    assert judged.nees_position is not None and judged.nees_attitude is not None
    with_legs, without = limits
    return Seed(
        seed,
        (with_legs.rms_3d_m**2, without.rms_3d_m**2),
        (with_legs.bound_3d_m**2, without.bound_3d_m**2),
        judged.nees_position,
        judged.nees_attitude,
        *calibration(run, log, seed, cycles),
    )


def calibration(run: Any, log: Any, seed: int, cycles: int) -> tuple[list[float], list[float], float]:
    """Errors by sigma and sigma by declared sigma (9 each, see `NUMBERS`), and the NEES of the eight numbers."""
    import numpy as np

    from graphnav.leg_priors import lidar_sigmas
    from graphnav.simulation.lidar import draw_lidar_errors
    from graphnav.simulation.scenarios import shearer_lidar
    from graphnav.simulation.world import streams

    spec = shearer_lidar(cycles, False, True).lidar
    assert spec is not None
    drawn = draw_lidar_errors(spec, streams(seed).lidar, 1.0)
    # the quadratic term is drawn per degree; in radians it is larger by the degrees of one
    angle = [np.radians(drawn.angle_bias_deg), drawn.angle_scale, np.degrees(drawn.angle_quadratic_per_deg)]
    error = run.stops.scanner - np.r_[drawn.range_scale, drawn.range_bias_m, angle, drawn.mounting_rad]
    cov = run.stops.cov[-8:, -8:]
    rows = np.vstack([np.eye(8), np.eye(8)[2] + np.eye(8)[7]])
    sigma = np.sqrt(np.diag(rows @ cov @ rows.T))
    declared = np.sqrt(np.diag(rows @ np.diag(lidar_sigmas(log.lidar) ** 2) @ rows.T))
    whole = float(error @ np.linalg.solve(cov, error)) / 8
    return (rows @ error / sigma).tolist(), (sigma / declared).tolist(), whole


def all_rows(done: list[Seed | str]) -> list[Row]:
    """Everything, from the runs that succeeded; failures are a row of their own."""
    seeds = [s for s in done if isinstance(s, Seed)]
    rows = [row("runs of all seeds that failed", float(len(done) - len(seeds)), "1", target=NO_FAILURE)]
    if not seeds:
        return rows
    rms, limit = (
        [math.sqrt(statistics.fmean(getattr(s, name)[k] for s in seeds)) for k in (0, 1)]
        for name in ("squares_m2", "bound_m2")
    )
    rows.append(row("bound with legs, without beside", limit[0], "m", peer=limit[1]))
    rows.append(row("rms error with legs, without beside", rms[0], "m", peer=rms[1]))
    over, bare = (rms[k] / limit[k] for k in (0, 1))
    rows.append(row("rms error by the bound, without legs beside", over, "1", peer=bare, target=OVER_BOUND))
    rows += nees_rows("position", [s.nees_position for s in seeds], None)
    rows += nees_rows("attitude", [s.nees_attitude for s in seeds], None)
    rows += nees_rows("calibration of the scanner", [s.nees_calibration for s in seeds], None)
    for k, name in enumerate(NUMBERS):
        off = math.sqrt(statistics.fmean(s.sigmas[k] ** 2 for s in seeds))
        rows.append(row(f"{name}: rms error by its sigma", off, "1"))
        rows.append(row(f"{name}: sigma by that declared", statistics.fmean(s.learnt[k] for s in seeds), "1"))
    return rows


def main(argv: list[str] | None = None) -> None:
    """Parse, measure, print."""
    args = parser(__doc__)
    args.add_argument("--seeds", type=int, default=8, help="number of seeds")
    args.add_argument("--first-seed", type=int, default=0)
    args.add_argument("--cycles", type=int, default=2, help="cutting cycles of a shift")
    args.add_argument("--workers", type=int, default=1, help="processes")
    arguments, before = args.parse_args(argv), Before.now()
    # inherited by the workers: more BLAS threads than one slow the small matrices down
    os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1", MKL_NUM_THREADS="1")
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    done: list[Seed | str] = []
    # one seed a process: what a shift took is given back
    with multiprocessing.get_context("spawn").Pool(arguments.workers, maxtasksperchild=1) as pool:
        for found in pool.imap(run_seed, [(seed, arguments.cycles) for seed in seeds], chunksize=1):
            done.append(found)
            say(found if isinstance(found, str) else f"seed {found.seed}: {_listed(found)}")
    publish(all_rows(done), arguments.json, before)


def _listed(seed: Seed) -> str:
    rms, limit = math.sqrt(seed.squares_m2[0]), math.sqrt(seed.bound_m2[0])
    return f"rms {1e3 * rms:.1f} mm, bound {1e3 * limit:.1f} mm, NEES of the position {seed.nees_position:.2f}"


if __name__ == "__main__":
    main()
