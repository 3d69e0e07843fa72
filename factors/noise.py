"""Noise models as GTSAM takes them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from factors.so3 import Array

if TYPE_CHECKING:
    import gtsam


def diagonal(sigmas: Array | list[float]) -> gtsam.noiseModel.Diagonal:
    """Independent Gaussian noise; every sigma above zero.

    GTSAM's own default is "smart": it silently makes a hard constraint of any sigma below 1e-8, as small as the bias
    walk of a good gyro is (docs/decisions/0004).
    """
    import gtsam

    return gtsam.noiseModel.Diagonal.Sigmas(np.asarray(sigmas, float), False)
