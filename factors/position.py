"""Known positions: fixes (GNSS, total station) and surveyed points, as native factors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from factors.noise import diagonal
from factors.so3 import Array

if TYPE_CHECKING:
    import gtsam


def position_factor(pose_key: int, pos_n: Array, sigma_n: Array | float) -> gtsam.NonlinearFactor:
    """A measured position of the body: ``e = p_n - measured`` (native `PoseTranslationPrior3D`).

    Parameters
    ----------
    pose_key : Pose3 key.
    pos_n : (3,) measured position, m.
    sigma_n : 1-sigma along east, north, up (3,) or common, m.
    """
    import gtsam

    noise = diagonal(np.broadcast_to(sigma_n, 3))
    return gtsam.PoseTranslationPrior3D(pose_key, gtsam.Pose3(gtsam.Rot3(), np.asarray(pos_n, float)), noise)
