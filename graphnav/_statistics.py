"""What a sample of errors looks like: statistics per axis, absolute pose errors, quantiles of the 3-D error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from graphnav import _metrics as metrics
from graphnav._schema import Array

#: Shares of the keyframes, per cent, at which the distribution of the 3-D error is given.
PERCENT = tuple(range(10, 101, 10))


@dataclass(frozen=True, eq=False)
class AxisStatistics:
    """Errors of three axes, each (3,) in the unit of the errors.

    Attributes
    ----------
    mean, std : mean, and deviation from it (all N keyframes divide, so that ``rms^2 = mean^2 + std^2``).
    rms, max : root mean square; largest absolute value.
    """

    mean: Array
    std: Array
    rms: Array
    max: Array

    @classmethod
    def of(cls, errors: Array) -> AxisStatistics:
        """From errors (N, 3)."""
        return cls(errors.mean(axis=0), errors.std(axis=0), metrics.rms(errors), metrics.largest(errors))

    def to_dict(self) -> dict[str, Any]:
        """Plain lists, one number per axis."""
        return {name: value.tolist() for name, value in vars(self).items()}


@dataclass(frozen=True)
class AbsolutePoseError:
    """Root mean square over the keyframes of the pose errors ``T_true^-1 T_estimate``.

    Attributes
    ----------
    translation_rms_m : of the norm of the translation.
    rotation_rms_deg : of the angle of the rotation; None after an alignment that is left open about a straight path.
    """

    translation_rms_m: float
    rotation_rms_deg: float | None

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers."""
        return dict(vars(self))


def absolute_error(pos: Array, quat: Array, pos_true: Array, quat_true: Array, *, aligned: bool) -> AbsolutePoseError:
    """Absolute pose error of positions (N, 3) and quaternions (N, 4).

    With `aligned` the estimate is first moved as one rigid body, positions and attitudes together, so that its
    positions fit those of truth best. Along a straight line they do not say how it is turned about that line, and the
    attitudes' error is then unknown.
    """
    from scipy.spatial.transform import Rotation

    if aligned:
        rotation, shift = metrics.alignment(pos, pos_true)
        pos = pos @ rotation.T + shift
        quat = (Rotation.from_matrix(rotation) * Rotation.from_quat(quat, scalar_first=True)).as_quat(scalar_first=True)
        if not metrics.turns_about_line(pos, pos_true):
            return AbsolutePoseError(metrics.rms_norm(pos - pos_true), None)
    angle = metrics.rms_norm(metrics.attitude_error(quat, quat_true))
    return AbsolutePoseError(metrics.rms_norm(pos - pos_true), float(np.rad2deg(angle)))


def quantiles(errors: Array) -> tuple[float, ...]:
    """Norms of errors (N, 3) that `PERCENT` of the keyframes do not exceed: points of their distribution function.

    The smallest norm of which that holds, so each is an error that occurred.
    """
    norms = np.linalg.norm(errors, axis=1)
    return tuple(np.quantile(norms, np.array(PERCENT) / 100, method="inverted_cdf").tolist())
