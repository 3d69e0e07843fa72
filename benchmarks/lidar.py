"""What the legs of the roof supports give to a shearer's shift, and what they cost: scenario shearer-lidar over seeds.

Every error is drawn. Each smoothing is a process of its own on one thread: processor seconds and peak memory are its
alone, without reading the log. Takes about 4 minutes a seed.
"""

from __future__ import annotations

import statistics
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._measure import measured
from benchmarks._report import Before, Row, Target, parser, publish, row, say
from benchmarks.accuracy import NO_FAILURE, nees_rows

AXES = ("east", "north", "height")
#: Figures of the scenario: largest error of any cycle with a surveyed far end, m; and of issue 4.
LARGEST_M = (0.10, 0.10, 0.05)
TWICE, MEMORY_GB, WITHIN_SIGMAS, BELOW_PRIOR = Target(high=2.0, of_ratio=True), Target(high=2.0), Target(high=3.0), 5.0
CASES: dict[str, dict[str, Any]] = {
    "legs": {},
    "no legs": {"lidar": {"use": False}},
    "legs, advances not tied": {"lidar": {"advances": False}},
    "no closed path": {"closed_path": {"form": "off"}},
    "no closed path, advances not tied": {"closed_path": {"form": "off"}, "lidar": {"advances": False}},
}


def simulate(folder: str, seed: int, cycles: int) -> dict[str, Any]:
    """Write the log of a seed; returns the scanner's true errors and their declared sigmas, as `Run` names them."""
    from graphnav.leg_priors import lidar_sigmas
    from graphnav.readers import write
    from graphnav.run import LIDAR_NAMES
    from graphnav.simulation import simulate as simulated
    from graphnav.simulation.lidar import draw_lidar_errors
    from graphnav.simulation.scenarios import shearer_lidar
    from graphnav.simulation.world import streams

    log = simulated("shearer-lidar", seed=seed, cycles=cycles, draw=True)
    write(log, folder)
    spec = shearer_lidar(cycles=cycles, draw=True).lidar
    assert spec is not None and log.lidar is not None
    true = draw_lidar_errors(spec, streams(seed).lidar, 1.0)
    values = [
        true.range_scale, true.range_bias_m, true.angle_bias_deg, true.angle_scale, true.angle_quadratic_per_deg,
        *np.degrees(true.mounting_rad),
    ]  # fmt: skip
    sigmas = lidar_sigmas(log.lidar) / [unit for _, unit, _ in LIDAR_NAMES]
    return {
        name: pair for (name, _, _), pair in zip(LIDAR_NAMES, zip(values, sigmas.tolist(), strict=True), strict=True)
    }


def one_seed(seed: int, cycles: int, folder: Path) -> dict[str, Any] | str:
    """All cases of a seed by name, and the truth of the scanner; the error's text on failure."""
    log = str(folder / f"seed{seed}")
    made = measured("benchmarks.lidar:simulate", {"folder": log, "seed": seed, "cycles": cycles})
    if made.error is not None:
        return f"seed {seed}: {made.error}"
    found: dict[str, Any] = {"true": made.result}
    for case, config in CASES.items():
        done = measured("benchmarks._lidar_tasks:smooth_shift", {"folder": log, "config": config})
        if done.error is not None:
            return f"seed {seed}, {case}: {done.error}"
        found[case] = {**done.result, "peak_gb": done.peak_gb}
        largest = ", ".join(f"{1e3 * value:.0f}" for value in done.result["largest_m"])
        say(
            f"seed {seed}, {case}: {done.result['seconds']:.1f} s, largest {largest} mm, NEES {done.result['nees']:.2f}"
        )
    return found


def all_rows(done: list[dict[str, Any] | str]) -> list[Row]:
    """Everything, from the seeds that succeeded; failures are a row of their own."""
    seeds = [s for s in done if not isinstance(s, str)]
    rows = [row("seeds that failed", float(len(done) - len(seeds)), "1", target=NO_FAILURE)]
    if not seeds:
        return rows
    seconds = {case: statistics.median(s[case]["seconds"] for s in seeds) for case in CASES}
    rows.append(row("processor time with legs", seconds["legs"], "s", peer=seconds["no legs"], target=TWICE))
    rows.append(row("peak memory with legs", max(s["legs"]["peak_gb"] for s in seeds), "GB", target=MEMORY_GB))
    for case in CASES:
        for k, axis in enumerate(AXES):
            target = Target(high=LARGEST_M[k]) if case == "legs" else None
            worst = max(s[case]["largest_m"][k] for s in seeds)
            rows.append(row(f"{case}: largest error of any cycle, {axis}", worst, "m", target=target))
            sigma = statistics.fmean(s[case]["sigma_m"][k] for s in seeds)
            rows.append(row(f"{case}: largest sigma, {axis}", sigma, "m"))
        rows += nees_rows(case, [s[case]["nees"] for s in seeds], None)
    return rows + _scanner_rows(seeds)


def _scanner_rows(seeds: list[dict[str, Any]]) -> list[Row]:
    """The scanner's errors found: how far off in sigmas, and how much better known than before."""
    rows = []
    for name in seeds[0]["true"]:
        off, gain = [], []
        for s in seeds:
            (true, declared), (value, sigma) = s["true"][name], s["legs"]["scanner"][name]
            off.append(abs(value - true) / sigma)
            gain.append(declared / sigma)
        rows.append(row(f"{name}: furthest off, in sigmas", max(off), "1", target=WITHIN_SIGMAS))
        rows.append(row(f"{name}: declared sigma by the one found", min(gain), "1", target=Target(low=BELOW_PRIOR)))
    return rows


def main(argv: list[str] | None = None) -> None:
    """Parse, measure, print."""
    args = parser(__doc__)
    args.add_argument("--seeds", type=int, default=6, help="number of seeds")
    args.add_argument("--first-seed", type=int, default=0)
    args.add_argument("--cycles", type=int, default=6, help="cutting cycles of a shift")
    arguments, before = args.parse_args(argv), Before.now()
    done = []
    for seed in range(arguments.first_seed, arguments.first_seed + arguments.seeds):
        with tempfile.TemporaryDirectory() as folder:
            done.append(one_seed(seed, arguments.cycles, Path(folder)))
        if isinstance(done[-1], str):
            say(done[-1])
    publish(all_rows(done), arguments.json, before)


if __name__ == "__main__":
    main()
