"""What the measured processes of `benchmarks.rts` do."""

from __future__ import annotations

import time
from typing import Any

from benchmarks._measure import peak_gb

#: Epochs of the mechanisation at a time: bounds its memory.
_BLOCK = 20_000


def run(folder: str, short: str, method: str) -> dict[str, Any]:
    """Graphnav from a log's folder to all covariances; then, uncounted, its error against truth.

    A short log goes before, so that packages and compiled code are loaded. For the peak memory that one run takes, as
    any user's does, ask `once`.
    """
    from graphnav.evaluation import evaluate
    from graphnav.readers import read
    from graphnav.smooth import smooth

    first, again = (_seconds(short, method) for _ in range(2))
    began = time.process_time()
    done = smooth(folder, method=method)
    cpu_s = time.process_time() - began
    return {
        "seconds": done.diagnostics.seconds,
        "cpu_s": cpu_s,
        "loading_s": first - again,
        "keyframes": done.diagnostics.keyframes,
        "rms_m": evaluate(done.trajectory, read(folder)).ate_unaligned_m,
    }


def once(folder: str, method: str) -> dict[str, Any]:
    """One run in a fresh process: its peak memory."""
    from graphnav.smooth import smooth

    smooth(folder, method=method)
    return {"peak_gb": peak_gb()}


def _seconds(folder: str, method: str) -> float:
    from graphnav.smooth import smooth

    began = time.perf_counter()
    smooth(folder, method=method)
    return time.perf_counter() - began


def mechanise(folder: str, short: str) -> dict[str, Any]:
    """Strapdown navigation alone, with its error transition at the odometer's rate: what no filter can do without."""
    _mechanised(short)
    return {"seconds": {"total": _mechanised(folder)}}


def _mechanised(folder: str) -> float:
    import numpy as np

    from factors.so3 import from_quaternion
    from graphnav._stages import Stages
    from graphnav.baselines import strapdown
    from graphnav.config import Config
    from graphnav.smooth import posed

    problem = posed(folder, Config(), Stages(None))
    samples, initial, odometer = problem.imu.samples, problem.log.initial, problem.log.odometer
    assert initial is not None and odometer is not None
    inside = (odometer.t_s > problem.keyframe_s[0]) & (odometer.t_s <= samples.edge_s[-1])
    rotation, vel, pos = from_quaternion(initial.quat_nb_wxyz), initial.vel_n_m_s, initial.pos_n_m
    now, elapsed = float(problem.keyframe_s[0]), 0.0
    for epoch_s in np.array_split(odometer.t_s[inside], max(int(inside.sum()) // _BLOCK, 1)):
        count, zero = len(epoch_s), np.zeros(3)
        rotations, velocities, positions = np.empty((count, 3, 3)), np.empty((count, 3)), np.empty((count, 3))
        blocks, force = np.empty((count, strapdown.BLOCKS, 3, 3)), np.empty((count, 3))
        began = time.perf_counter()
        strapdown.advance(
            samples.edge_s, samples.gyro_b, samples.accel_b, now, epoch_s, rotation, vel, pos, zero, zero,
            problem.gravity_m_s2, problem.earth_rate_n, False, rotations, velocities, positions, blocks, force,
        )  # fmt: skip
        elapsed += time.perf_counter() - began
        rotation, vel, pos, now = rotations[-1], velocities[-1], positions[-1], float(epoch_s[-1])
    return elapsed
