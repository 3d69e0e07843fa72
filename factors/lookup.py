"""Values of many keys as arrays: every different key is asked for once."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from factors.increments import npt_int
from factors.so3 import Array

if TYPE_CHECKING:
    import gtsam


def poses(values: gtsam.Values, keys: npt_int) -> Array:
    """(K, 4, 4) of Pose3 values."""
    different, which = np.unique(keys, return_inverse=True)
    return np.array([values.atPose3(key).matrix() for key in different.tolist()])[which]


def vectors(values: gtsam.Values, keys: npt_int) -> Array:
    """(K, size) of vector values of one size."""
    different, which = np.unique(keys, return_inverse=True)
    return np.array([values.atVector(key) for key in different.tolist()])[which]


def biases(values: gtsam.Values, keys: npt_int) -> Array:
    """(K, 6) of IMU biases, accelerometer first."""
    different, which = np.unique(keys, return_inverse=True)
    return np.array([values.atConstantBias(key).vector() for key in different.tolist()])[which]
