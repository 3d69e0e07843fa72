"""Baselines on the same log: dead reckoning, the error-state Kalman filter and its RTS smoother.

Source: J. Zheng et al., "Research on the Shearer Positioning Method Based on the MEMS Inertial Sensors/Odometer
Integrated Navigation System and RTS Smoother", Micromachines 12 (2021) 1527. The filter's measurements are the
residual functions of `factors`, the very ones that the graph is made of.
"""

from __future__ import annotations


def warm_up() -> None:
    """Compile the loops, or load them compiled, so that a first run is not timed with it."""
    import numpy as np

    from graphnav.baselines import kalman, strapdown
    from graphnav.baselines.states import SIZE

    count = 3
    edge, gyro, accel = np.arange(count + 1) / 100.0, np.zeros((count, 3)), np.tile([0.0, 0.0, 9.8], (count, 1))
    zero, earth = np.zeros(3), np.array([0.0, 6e-5, 4e-5])
    epoch = np.array([0.02])
    rotations, velocities, positions = np.empty((1, 3, 3)), np.empty((1, 3)), np.empty((1, 3))
    blocks, force, noise = np.empty((1, strapdown.BLOCKS, 3, 3)), np.empty((1, 3)), np.empty((1, SIZE, SIZE))
    for locked in (True, False):
        # a log's arrays are read-only, those with bridged holes are not: two compilations
        for array in (gyro, accel):
            array.flags.writeable = not locked
        strapdown.advance(
            edge, gyro, accel, 0.0, epoch, np.eye(3), zero, zero, zero, zero, 9.8, earth, False,
            rotations, velocities, positions, blocks, force,
        )  # fmt: skip
    density = np.array([1e-3])
    kalman.process_noise(force, epoch, density, density, np.zeros(SIZE), False, noise)
    rows, index, z = np.eye(1, SIZE), np.zeros(1, np.int64), np.zeros(1)
    x, p, a = np.zeros(SIZE), np.eye(SIZE), np.empty((SIZE, SIZE))
    c, big_c = np.empty(SIZE), np.empty((SIZE, SIZE))
    kalman.interval(blocks, noise, rows, index, z, x, p, np.empty(1), np.empty(1), True, a, c, big_c)
    kalman.backward(a, c, big_c, p, np.zeros(SIZE), np.zeros((SIZE, SIZE)))
