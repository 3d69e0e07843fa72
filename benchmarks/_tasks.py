"""What a measured process does: simulate a log, smooth one, or run a peer on one."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from benchmarks._measure import Stopwatch, peak_gb
from benchmarks._report import say


def simulate(folder: str, hours: float, seed: int) -> dict[str, Any]:
    """Write the plain chain of `full-shift`: IMU, 10 Hz odometer, closed path."""
    from graphnav.readers import write
    from graphnav.simulation import simulate as simulated

    log = simulated("full-shift", seed=seed, hours=hours, sensors="imu,odometer,closed-path")
    partial = Path(f"{folder}.part")
    write(log, partial, overwrite=True)
    partial.rename(folder)
    return {"imu_rows": len(log.imu) if log.imu is not None else 0}


def smooth(folder: str, method: str) -> dict[str, Any]:
    """Graphnav from the log's folder to all covariances; then, uncounted, its error against truth."""
    import numpy as np

    from graphnav.evaluation import evaluate
    from graphnav.readers import read
    from graphnav.smooth import smooth as smoothed

    _load_packages()
    began = time.process_time()
    run = smoothed(folder, method=method, progress=_Progress(f"{method}, {Path(folder).name}"))
    cpu_s, peak = time.process_time() - began, peak_gb()
    cov = run.trajectory.cov
    error = evaluate(run.trajectory, read(folder))
    return {
        "seconds": run.diagnostics.seconds,
        "cpu_s": cpu_s,
        "peak_gb": peak,
        "keyframes": run.diagnostics.keyframes,
        "iterations": run.diagnostics.iterations,
        "covariances": 0 if cov is None else int(np.isfinite(cov).all(axis=(1, 2)).sum()),
        "rms_m": error.ate_unaligned_m,
    }


def native_peer(folder: str) -> dict[str, Any]:
    """Peer (b)."""
    from benchmarks.peers import native

    return _peer(folder, native.build)


def per_sample_peer(folder: str) -> dict[str, Any]:
    """Peer (a)."""
    from benchmarks.peers import per_sample

    return _peer(folder, per_sample.build)


def _peer(folder: str, build: Any) -> dict[str, Any]:
    from benchmarks.peers.chain import Chain
    from benchmarks.peers.native import marginals, optimise
    from graphnav.config import Config
    from graphnav.keyframes import run_frontend
    from graphnav.readers import read

    _load_packages()
    watch = Stopwatch()
    log = read(folder)
    watch.lap("read")
    assert log.initial is not None
    chain = Chain(log, run_frontend(log, Config()), log.initial)
    watch.restart()  # the keyframes are given to the peer
    graph, values = build(chain)
    watch.lap("assemble")
    estimate, iterations, _ = optimise(graph, values)
    watch.lap("solve")
    found, refused = marginals(graph, estimate, len(chain.keyframe_s))
    watch.lap("covariance")
    return {
        "seconds": watch.total(),
        "cpu_s": watch.cpu_s,
        "keyframes": len(chain.keyframe_s),
        "iterations": iterations,
        "covariances": len(found),
        "refused": refused,
    }


def _load_packages() -> None:
    """Imports are not part of anybody's time."""
    import gtsam  # noqa: F401
    import pyarrow.parquet  # noqa: F401
    import scipy.interpolate
    import scipy.spatial.transform  # noqa: F401


class _Progress:
    """A line to standard error every 20 s."""

    def __init__(self, name: str) -> None:
        self.name, self.last = name, time.perf_counter()

    def __call__(self, stage: str, done: float, total: float) -> None:
        now = time.perf_counter()
        if now - self.last >= 20:
            self.last = now
            say(f"  {self.name}: {stage} {100 * done / max(total, 1):.0f} %")
