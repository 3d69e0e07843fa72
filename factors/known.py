"""A linear factor on any number of variables: the wheel's own takes three at most."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from factors.so3 import Array

if TYPE_CHECKING:
    import gtsam


def known_factor(keys: list[int], blocks: list[Array], error: Array) -> gtsam.CustomFactor:
    """A factor whose whitened error (R,) and Jacobians (R, size) are known; linearized, it is these at any values."""
    import gtsam

    def told(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        if jacobians is not None:
            for k, block in enumerate(blocks):
                jacobians[k] = block
        return error

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(len(np.atleast_1d(error))), keys, told)
