"""Smooth a shift and look at the result.

    python examples/smooth_a_shift.py [LOG] [RUN]

LOG is a log folder; without one, a shearer cutting four cycles of a 44.6 m face is simulated. RUN is the
folder the result is written to, by default ./smoothed.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import graphnav as gn


def main(source: str | None = None, folder: str = "smoothed") -> None:
    """Read or simulate, smooth, show, save."""
    log = gn.read(source) if source else gn.simulate("shearer-mems", seed=11)
    run = gn.smooth(log)

    path, diagnostics = run.trajectory, run.diagnostics
    print(f"{log.name}: {len(path)} keyframes over {path.t_s[-1] - path.t_s[0]:.0f} s")
    print(f"{diagnostics.method}: {diagnostics.iterations} iterations, {diagnostics.seconds['total']:.1f} s")
    for line in diagnostics.warnings:
        print("warning:", line)

    print("\ncalibration")
    for name, found in run.calibration.items():
        print(f"  {name:26s}{found.value:10.4f} +- {found.sigma:.4f} {found.unit}")

    sigma_n = np.sqrt(np.diagonal(path.cov[:, 3:6, 3:6], axis1=1, axis2=2))
    print("\nlargest position sigma, m (east, north, up):", sigma_n.max(axis=0).round(3))
    halfway = path.at(np.array([(path.t_s[0] + path.t_s[-1]) / 2]))
    print("position halfway, m (east, north, up):      ", halfway.pos_n[0].round(3))

    if log.truth is not None:
        result = gn.evaluate(path, log).to_dict()
        print("rms error against truth, m:                 ", np.round(result["rms_m"], 3))
        print("consistency of positions (1 is honest):     ", round(result["nees_position"], 2))
    run.save(Path(folder))
    print(f"\nwritten to {folder}/")


if __name__ == "__main__":
    main(*sys.argv[1:])
