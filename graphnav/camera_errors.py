"""The stereo camera's own errors, its mounting on the machine among them: what is declared, and what is unknown."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from factors.carried import CAMERA_ERRORS
from factors.noise import diagonal
from factors.so3 import Array
from graphnav.log import Stereo
from graphnav.problem import E
from graphnav.run import CAMERA_NAMES

if TYPE_CHECKING:
    import gtsam

#: What stands for a error that is declared to be none, rad, m, px and s: too small to show.
_HELD = 1e-9


def camera_sigmas(stereo: Stereo) -> Array:
    """Sigmas (8,): of angles about c's axes (rad) and place in b (m), of disparities (px), and of its clock (s)."""
    angles = np.radians(stereo.mounting_sigma_deg)
    return np.concatenate([angles, stereo.T_bc_pos_sigma_m, [stereo.disparity_sigma_px, stereo.time_sigma_s]])


def camera_unknown(stereo: Stereo | None) -> bool:
    """Whether anything of it is to be estimated; zero sigma: known."""
    return stereo is not None and bool((camera_sigmas(stereo) > 0).any())


def camera_known(stereo: Stereo) -> list[str]:
    """What is declared to be without error, by the names of the calibration."""
    return [name for (name, _, _), sigma in zip(CAMERA_NAMES, camera_sigmas(stereo), strict=True) if not sigma]


def camera_prior(stereo: Stereo) -> gtsam.NonlinearFactor:
    """What the log declares of it."""
    import gtsam

    return gtsam.PriorFactorVector(E(0), np.zeros(CAMERA_ERRORS), diagonal(np.maximum(camera_sigmas(stereo), _HELD)))
