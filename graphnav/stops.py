"""The stops of a run, for what compares them: found by time, moved by small errors, made up where there are none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from factors.so3 import Array, exp
from graphnav.errors import GraphnavError
from graphnav.keyframes import SAME_S
from graphnav.leg_priors import lidar_sigmas
from graphnav.log import Lidar
from graphnav.run import LIDAR_NAMES, Calibration, Stops
from graphnav.trajectory import Trajectory

#: Numbers that say where a stop is: attitude and position.
POSE = 6


def at_times(stops: Stops, t_s: Sequence[float]) -> list[int]:
    """Rows of the stops at some times.

    Raises
    ------
    GraphnavError
        There is no stop at one of them.
    """
    apart = np.abs(np.asarray(t_s)[:, None] - stops.t_s)
    rows = np.argmin(apart, axis=1)
    missing = apart[np.arange(len(rows)), rows] > SAME_S * (1 + 1e-6)
    if missing.any():
        time_s = np.asarray(t_s)[missing][0]
        raise GraphnavError(
            f"the run has no keyframe at {time_s:.3f} s, where a cut of the log begins or ends; smooth this log with"
            " keyframes.events = true"
        )
    return [int(row) for row in rows]


def independent_stops(trajectory: Trajectory, calibration: dict[str, Calibration], t_s: Array) -> Stops:
    """Stops of a trajectory, each with its own covariance and none in common; the scanner where it was estimated.

    Raises
    ------
    GraphnavError
        A trajectory without covariances, or one that does not reach a stop.
    """
    states = trajectory.at(t_s)
    if states.cov is None:
        raise GraphnavError("the run has no covariances, so creep would have no sigma; smooth with covariance = true")
    known = [calibration[name] for name, _, _ in LIDAR_NAMES if name in calibration]
    size = np.array([unit for _, unit, _ in LIDAR_NAMES[: len(known)]])
    scanner = np.array([item.value for item in known]) * size
    sigma = np.array([item.sigma or 0.0 for item in known]) * size
    cov = _block_diagonal([*states.cov[:, :POSE, :POSE], np.diag(sigma**2)])
    return Stops(states.t_s, states.pos_n, states.rotation_nb, scanner, cov)


def declared_scanner(stops: Stops, lidar: Lidar) -> Stops:
    """The stops with the scanner's declared sigmas, where the run has not estimated its calibration."""
    if len(stops.scanner):
        return stops
    sigmas = lidar_sigmas(lidar)
    return replace(stops, scanner=np.zeros(len(sigmas)), cov=_block_diagonal([stops.cov, np.diag(sigmas**2)]))


def moved(stops: Stops, error: Array) -> Stops:
    """The stops moved by small errors in the order of their covariance; that itself is left as it is."""
    poses = error[: POSE * len(stops.t_s)].reshape(-1, POSE)
    return replace(
        stops,
        rot_nb=stops.rot_nb @ exp(poses[:, :3]),
        pos_n=stops.pos_n + poses[:, 3:],
        scanner=stops.scanner + error[poses.size :],
    )


def _block_diagonal(blocks: list[Array]) -> Array:
    from scipy.linalg import block_diag

    return np.asarray(block_diag(*blocks))
