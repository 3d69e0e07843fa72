"""What was drawn for a simulated log and no log tells: used for scoring and drawing, never by an estimator."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.papers._judged import Array


def drawn(scenario: str, seed: int, names: tuple[str, ...], **options: Any) -> Array:
    """True biases, scale and mounting angles (K,) in the order and units of a run's calibration history."""
    from graphnav.run import ACCEL_NAMES, GYRO_NAMES, ODOMETER_NAMES
    from graphnav.simulation.scenarios import resolve
    from graphnav.simulation.world import build_world, draw_errors

    spec, streams = resolve(scenario, options), np.random.default_rng(seed).spawn(5)
    errors, world = draw_errors(spec, streams[2], 1.0), build_world(spec, streams[0], streams[1])
    groups = (
        (ACCEL_NAMES, errors.accel_bias_m_s2),
        (GYRO_NAMES, errors.gyro_bias_rad_s),
        (ODOMETER_NAMES, np.r_[errors.odometer_scale, world.mounting_rad]),
    )
    known = {
        name: value / size for group, values in groups for (name, size, _), value in zip(group, values, strict=True)
    }
    return np.array([known[name] for name in names])
