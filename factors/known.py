"""Linear factors on any number of variables: the wheel's own takes three at most."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from factors.so3 import Array

if TYPE_CHECKING:
    import gtsam


def jacobian_factor(keys: list[int], blocks: list[Array], error: Array) -> gtsam.GaussianConditional:
    """Whitened Jacobian factor of the squares of ``error + sum of block x``, with blocks (R, size) and error (R,)."""
    return block_factor(keys, [block.shape[1] for block in blocks], np.column_stack([*blocks, -error]))


def block_factor(keys: list[int], sizes: list[int], augmented: Array) -> gtsam.GaussianConditional:
    """The same from all blocks and minus the error side by side (R, sum of sizes + 1), fastest ordered by columns.

    A conditional density is a Jacobian factor too, and the only one whose constructor takes a matrix of blocks.
    """
    import gtsam

    return gtsam.GaussianConditional(keys, 1, gtsam.VerticalBlockMatrix(sizes, augmented, True))


def linear_factor(keys: list[int], blocks: list[Array]) -> gtsam.CustomFactor:
    """A factor on vectors whose whitened error (R,) is the sum of each block (R, size) times its vector."""
    import gtsam

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        if jacobians is not None:
            for k, block in enumerate(blocks):
                jacobians[k] = block
        return np.asarray(sum(block @ values.atVector(key) for key, block in zip(keys, blocks, strict=True)))

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(len(blocks[0])), keys, error)
