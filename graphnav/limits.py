"""`Bound`: the posterior Cramer-Rao bound of a log beside what an estimator achieves on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from graphnav import _metrics as metrics
from graphnav._cycles import sep
from graphnav._schema import Array
from graphnav.evaluation import ATT, POS, Evaluation
from graphnav.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Share:
    """The bound and the error achieved, over all keyframes or those of one cycle.

    Attributes
    ----------
    bound_m, rms_m : (3,) root mean square over the keyframes of the bound's sigma and of the error, east, north, up.
    sep_m : median of the 3-D error's norm; max_m : (3,) largest absolute error.
    """

    bound_m: Array
    rms_m: Array
    sep_m: float
    max_m: Array

    @classmethod
    def of(cls, sigma: Array, error: Array) -> Share:
        """From the bound's sigmas (N, 3) and the errors (N, 3)."""
        return cls(metrics.rms(sigma), metrics.rms(error), sep(error), metrics.largest(error))

    @property
    def bound_3d_m(self) -> float:
        """Root mean square of the bound in three dimensions."""
        return float(np.linalg.norm(self.bound_m))

    @property
    def rms_3d_m(self) -> float:
        """Root mean square of the error in three dimensions."""
        return float(np.linalg.norm(self.rms_m))

    @property
    def efficiency(self) -> float:
        """Achieved rms by the bound's, both in three dimensions; near 1 over many logs for the best estimator."""
        return self.rms_3d_m / self.bound_3d_m

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and lists."""
        return {
            "bound_m": self.bound_m.tolist(),
            "rms_m": self.rms_m.tolist(),
            "bound_3d_m": self.bound_3d_m,
            "rms_3d_m": self.rms_3d_m,
            "efficiency": self.efficiency,
            "sep_m": self.sep_m,
            "max_m": self.max_m.tolist(),
        }


@dataclass(frozen=True, eq=False)
class Bound:
    """The bound over time beside the errors of the batch run on the same log.

    Attributes
    ----------
    name : of the log.
    limit : true states at the keyframes; its covariance is the bound.
    achieved : the batch run against truth, at the same keyframes.
    """

    name: str
    limit: Trajectory
    achieved: Evaluation

    @property
    def t_s(self) -> Array:
        """(N,) keyframe times."""
        return self.limit.t_s

    @property
    def sigma_n_m(self) -> Array:
        """(N, 3) bound of the position's sigma, east, north, up."""
        return _sigmas(self.limit, POS)

    @property
    def att_sigma_b_rad(self) -> Array:
        """(N, 3) bound of the attitude's sigma about the body's right, forward, up."""
        return _sigmas(self.limit, ATT)

    @property
    def overall(self) -> Share:
        """Over all keyframes."""
        return Share.of(self.sigma_n_m, self.achieved.error_n_m)

    @property
    def per_cycle(self) -> dict[int, Share]:
        """Over the keyframes of each cutting cycle, by its number."""
        found = {}
        for cycle in self.achieved.per_cycle:
            inside = (self.t_s >= cycle.start_s) & (self.t_s <= cycle.end_s)
            found[cycle.cycle] = Share.of(self.sigma_n_m[inside], self.achieved.error_n_m[inside])
        return found

    def to_dict(self) -> dict[str, Any]:
        """The object that ``graphnav bound --json`` prints."""
        return {
            "log": self.name,
            "keyframes": len(self.t_s),
            **self.overall.to_dict(),
            "att_bound_deg": np.rad2deg(metrics.rms(self.att_sigma_b_rad)).tolist(),
            "att_rms_deg": self.achieved.rms_deg.tolist(),
            "per_cycle": [{"cycle": cycle, **share.to_dict()} for cycle, share in self.per_cycle.items()],
            "over_time": {"t_s": self.t_s.tolist(), "sigma_m": self.sigma_n_m.tolist()},
        }


def _sigmas(trajectory: Trajectory, block: slice) -> Array:
    if trajectory.cov is None:
        return np.full((len(trajectory), 3), np.nan)
    return np.asarray(np.sqrt(np.diagonal(trajectory.cov[:, block, block], axis1=1, axis2=2)))
