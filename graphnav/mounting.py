"""How the stereo camera is fixed to the machine: what the log declares of it, and what is unknown."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from factors.noise import diagonal
from factors.so3 import Array
from graphnav.log import Stereo
from graphnav.problem import E

if TYPE_CHECKING:
    import gtsam

#: What stands for a mounting error that is declared to be none, rad and m: too small to show.
_HELD = 1e-9


def mounting_sigmas(stereo: Stereo) -> Array:
    """Sigmas (6,) of the mounting's errors: angles about c's axes (rad), place in b (m); zero: known."""
    return np.concatenate([np.radians(stereo.mounting_sigma_deg), stereo.T_bc_pos_sigma_m])


def mounting_unknown(stereo: Stereo | None) -> bool:
    """Whether anything of the mounting is to be estimated."""
    return stereo is not None and bool((mounting_sigmas(stereo) > 0).any())


def mounting_prior(stereo: Stereo) -> gtsam.NonlinearFactor:
    """What the log declares of the mounting."""
    import gtsam

    return gtsam.PriorFactorVector(E(0), np.zeros(6), diagonal(np.maximum(mounting_sigmas(stereo), _HELD)))
