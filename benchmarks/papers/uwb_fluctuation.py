"""Figure 8 of the IMU/UWB paper from the simulator: how the ranges fluctuate before and after the drive.

python -m benchmarks.papers.uwb_fluctuation -o docs/papers/imu-uwb
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

SPANS_S = ((0.0, 45.0), (45.0, 153.0), (153.0, 166.0))


def main() -> None:
    """Draw ranges less true distances, anchor by anchor, and print their standard deviations."""
    parser = argparse.ArgumentParser(description="Draw the fluctuation of simulated ranges underground.")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR")
    parser.add_argument("--seed", type=int, default=5)
    arguments = parser.parse_args()
    from graphnav.simulation.uwb_truth import uwb_truth

    truth = uwb_truth("face-end-uwb", arguments.seed, site="underground")
    draw(truth, arguments.output / "range-fluctuation.png")
    for start_s, end_s in SPANS_S:
        within = (truth.t_s > start_s) & (truth.t_s <= end_s)
        spread = [np.std(truth.total_m[within & (truth.anchor_id == name)]) for name in "1234"]
        print(f"{start_s:.0f} to {end_s:.0f} s:", ", ".join(f"{value:.3f} m" for value in spread))


def draw(truth: Any, path: Path) -> None:
    """One panel for each anchor; spans at rest are shaded."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, panels = pyplot.subplots(4, 1, figsize=(8, 8), sharex=True, sharey=True, layout="constrained")
    for name, panel in zip("1234", panels, strict=True):
        rows = truth.anchor_id == name
        panel.plot(truth.t_s[rows], truth.total_m[rows], ".", markersize=2)
        for start_s, end_s in (SPANS_S[0], SPANS_S[2]):
            panel.axvspan(start_s, end_s, color="0.9", zorder=0)
        panel.set_ylabel(f"anchor {name}, m")
        panel.grid(linewidth=0.5)
    panels[0].set_title("Measured less true range, underground; grey: the machine stands")
    panels[-1].set_xlabel("time, s")
    panels[-1].set_ylim(-0.4, 1.2)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
