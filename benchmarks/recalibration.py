"""What UWB anchors at one end of the face give to a shift: position and heading over the cutting cycles.

Scenario shearer-mems with IMU and odometer, and no point surveyed but the anchors: ranges within 10 m of the near end,
from a carrier that moves with the push between cycles. Each seed with its ranges and without. About 10 s a seed.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace

import numpy as np

from benchmarks._report import Before, Row, parser, publish, row, say

CYCLES = 4


@dataclass(frozen=True)
class Shift:
    """Mean squares per cycle (4,) of the 3-D position error, m^2, and of the heading's, rad^2; NEES."""

    position: np.ndarray
    heading: np.ndarray
    nees_position: float
    nees_attitude: float


def measured(seed: int, use: bool) -> Shift:
    """Simulate, smooth and judge."""
    from graphnav.evaluation import evaluate
    from graphnav.simulation import simulate
    from graphnav.smooth import smooth

    log = replace(simulate("shearer-mems", seed, sensors="imu,odometer,uwb"), surveyed=())
    log = log if use else replace(log, uwb=None)
    found = evaluate(smooth(replace(log, truth=None)).trajectory, log)
    assert found.nees_position is not None and found.nees_attitude is not None
    inside = [(found.t_s >= c.start_s) & (found.t_s <= c.end_s) for c in found.per_cycle]
    return Shift(
        np.array([np.square(found.error_n_m[rows]).sum(axis=1).mean() for rows in inside]),
        np.array([np.square(found.att_error_b_rad[rows, 2]).mean() for rows in inside]),
        found.nees_position,
        found.nees_attitude,
    )


def all_rows(with_ranges: list[Shift], without: list[Shift]) -> list[Row]:
    """Rms over the seeds, cycle by cycle; the peer is the shift without ranges."""

    def rms(shifts: list[Shift], name: str, cycle: int) -> float:
        return float(np.sqrt(np.mean([getattr(shift, name)[cycle] for shift in shifts])))

    rows = []
    for name, unit, size in (("position", "m", 1.0), ("heading", "deg", float(np.degrees(1)))):
        for cycle in range(CYCLES):
            ours, theirs = (size * rms(shifts, name, cycle) for shifts in (with_ranges, without))
            rows.append(
                row(f"cycle {cycle + 1}: rms error of the {name}, without ranges beside", ours, unit, peer=theirs)
            )
    for name in ("nees_position", "nees_attitude"):
        ours, theirs = (float(np.mean([getattr(s, name) for s in shifts])) for shifts in (with_ranges, without))
        rows.append(row(f"mean {name}", ours, "1", peer=theirs))
    return rows


def main(argv: list[str] | None = None) -> None:
    """Parse, measure, print."""
    args = parser(__doc__)
    args.add_argument("--seeds", type=int, default=8, help="number of seeds")
    arguments, before = args.parse_args(argv), Before.now()
    os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1", MKL_NUM_THREADS="1")
    found: tuple[list[Shift], list[Shift]] = ([], [])
    for seed in range(arguments.seeds):
        for shifts, use in zip(found, (True, False), strict=True):
            shifts.append(measured(seed, use))
        ours, theirs = (float(np.sqrt(shifts[-1].position.mean())) for shifts in found)
        say(f"seed {seed}: {ours:.3f} m, without ranges {theirs:.3f} m")
    publish(all_rows(*found), arguments.json, before)


if __name__ == "__main__":
    main()
