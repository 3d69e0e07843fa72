"""UWB ranges in the graph: what reflected ranges cost, which are left out, and how fast an hour of 40 Hz is.

Scenario face-end-uwb. Each seed is smoothed as it is and with a share of its ranges too long by up to 3 m; truth and
the errors drawn are for judging alone. The hour is the underground site's drive with a long stop after it. Processor
time, on one thread. Takes about 20 s a seed, and 2 minutes for the hour.
"""

from __future__ import annotations

import math
import os
import statistics
import time
from dataclasses import dataclass, replace

from benchmarks._report import Before, Row, Target, parser, publish, row, say

SHARE = 0.2
GROWTH, REAL_TIME = Target(high=1.5, of_ratio=True), Target(low=50)
OVER_BOUND = Target(high=1.15)


@dataclass(frozen=True)
class Case:
    """One seed: mean squares of the 3-D error and its bound, NEES, and the same with reflected ranges.

    Attributes
    ----------
    precision, recall : share of the ranges left out that are reflected, and of the reflected ones that are left out.
    """

    square_m2: float
    bound_m2: float
    nees_position: float
    nees_attitude: float
    reflected_m2: float
    precision: float
    recall: float


def measured(site: str, seed: int) -> Case:
    """Simulate, smooth and judge."""
    import numpy as np

    from graphnav._stages import Stages
    from graphnav.bound import bound
    from graphnav.config import Config
    from graphnav.evaluation import evaluate
    from graphnav.outcome import smoothed_trajectory
    from graphnav.simulation import simulate
    from graphnav.simulation.uwb_truth import uwb_truth
    from graphnav.smooth import posed, smooth
    from graphnav.solution import solve_batch

    log = simulate("face-end-uwb", seed=seed, site=site)
    limit = bound(log).overall
    plain = evaluate(smooth(replace(log, truth=None)).trajectory, log)
    late = simulate("face-end-uwb", seed=seed, site=site, nlos_share=SHARE)
    problem = posed(replace(late, truth=None), Config(), Stages(None))
    solved = solve_batch(problem, Stages(None))
    off = evaluate(smoothed_trajectory(problem, solved.result.values, None), late)
    reflected = uwb_truth("face-end-uwb", seed, site=site, nlos_share=SHARE).delayed
    left_out = np.zeros(len(reflected), bool)
    if solved.ranges_left_out is not None:
        left_out[solved.ranges_left_out.row] = True
    both = float((left_out & reflected).sum())
    assert plain.nees_position is not None and plain.nees_attitude is not None
    return Case(
        limit.rms_3d_m**2, limit.bound_3d_m**2, plain.nees_position, plain.nees_attitude,
        float(np.square(off.rms_m).sum()), both / max(left_out.sum(), 1), both / max(reflected.sum(), 1),
    )  # fmt: skip


def rows_of(site: str, cases: list[Case]) -> list[Row]:
    """A site's figures."""

    def mean(name: str) -> float:
        return statistics.fmean(getattr(case, name) for case in cases)

    rms, limit, reflected = (math.sqrt(mean(name)) for name in ("square_m2", "bound_m2", "reflected_m2"))
    return [
        row(f"{site}: rms error by the bound", rms / limit, "1", target=OVER_BOUND),
        row(f"{site}: mean position NEES", mean("nees_position"), "1"),
        row(f"{site}: mean attitude NEES", mean("nees_attitude"), "1"),
        row(f"{site}: rms error with a fifth of the ranges up to 3 m long", reflected, "m", peer=rms, target=GROWTH),
        row(f"{site}: share of the ranges left out that are too long", mean("precision"), "1"),
        row(f"{site}: share of those too long that are left out", mean("recall"), "1"),
    ]


def hour_rows() -> list[Row]:
    """Speed on an hour of ranges at 40 Hz and IMU at 100 Hz."""
    from graphnav.simulation.face_end import simulate_face_end
    from graphnav.simulation.uwb_figures import UNDERGROUND
    from graphnav.smooth import smooth

    end_s = UNDERGROUND.tail_s + 3600 - simulate_face_end("short", UNDERGROUND, 1).imu.t_s[-1]  # type: ignore[union-attr]
    log = simulate_face_end("hour", replace(UNDERGROUND, tail_s=float(end_s)), 1)
    blind, began = replace(log, truth=None), time.process_time()
    run = smooth(blind)
    seconds = time.process_time() - began
    assert log.uwb is not None
    return [
        row("an hour: ranges", float(len(log.uwb)), "1"),
        row("an hour: keyframes", float(run.diagnostics.keyframes), "1"),
        row("an hour: processor time of batch", seconds, "s"),
        row("an hour: times faster than real time", 3600 / seconds, "1", target=REAL_TIME),
    ]


def main(argv: list[str] | None = None) -> None:
    """Parse, measure, print."""
    args = parser(__doc__)
    args.add_argument("--seeds", type=int, default=6, help="number of seeds of each site")
    args.add_argument("--hour", action="store_true", help="measure the hour alone")
    arguments, before = args.parse_args(argv), Before.now()
    os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1", MKL_NUM_THREADS="1")
    rows: list[Row] = []
    for site in () if arguments.hour else ("surface", "underground"):
        cases = []
        for seed in range(arguments.seeds):
            cases.append(measured(site, seed))
            say(f"{site}, seed {seed}: {math.sqrt(cases[-1].square_m2):.3f} m")
        rows += rows_of(site, cases)
    publish(rows + hour_rows(), arguments.json, before)


if __name__ == "__main__":
    main()
