"""What a child process does for `benchmarks.lidar`: read a shift, smooth it, judge it."""

from __future__ import annotations

from typing import Any

from benchmarks._measure import Stopwatch, peak_gb


def smooth_shift(folder: str, config: dict[str, Any]) -> dict[str, Any]:
    """Smooth the log in a folder: processor seconds and peak of it alone, errors, consistency, the scanner's state."""
    from dataclasses import replace

    import numpy as np

    from graphnav.config import Config
    from graphnav.evaluation import evaluate
    from graphnav.readers import read
    from graphnav.smooth import smooth

    log = read(folder)
    blind = replace(log, truth=None)
    watch = Stopwatch()
    run = smooth(blind, Config.from_dict(config))
    watch.lap("smooth")
    peak = peak_gb()
    found = evaluate(run.trajectory, log)
    cov = run.trajectory.cov
    assert cov is not None
    return {
        "peak_gb": peak,
        "seconds": watch.cpu_s,
        "largest_m": np.max([cycle.max_m for cycle in found.per_cycle], axis=0).tolist(),
        "nees": found.nees_position,
        "sigma_m": np.sqrt(np.diagonal(cov, axis1=1, axis2=2)[:, 3:6].max(axis=0)).tolist(),
        "scanner": {name: (c.value, c.sigma) for name, c in run.calibration.items() if name.startswith("lidar_")},
    }
