"""What is run of the roadheader's reproduction, and what is kept of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from benchmarks.papers._judged import Array
from benchmarks.papers._uwb_cases import angles_deg

RELATIVE, LOOSE, GRAPH = "vio-kf, relative", "batch, loose", "batch"
ENHANCED_FILTER, ENHANCED_LOOSE, RAW, ENHANCED = (
    "vio-kf, enhanced",
    "batch, loose, enhanced",
    "batch, raw images",
    "batch, enhanced",
)
_ENHANCE: dict[str, Any] = {"stereo_tracks": {"enhance": "retinex-dust"}}
#: Name -> method and its configuration.
CASES: Mapping[str, tuple[str, dict[str, Any]]] = {
    "sins": ("sins", {}),
    "stereo": ("stereo", {}),
    "vio-kf": ("vio-kf", {}),
    ENHANCED_FILTER: ("vio-kf", _ENHANCE),
    RELATIVE: ("vio-kf", {"vio_filter": {"relative": True}}),
    LOOSE: ("batch", {"stereo": {"form": "loose"}}),
    ENHANCED_LOOSE: ("batch", {"stereo": {"form": "loose"}, **_ENHANCE}),
    GRAPH: ("batch", {}),
    RAW: ("batch", {"stereo_tracks": {"enhance": "none"}}),
    ENHANCED: ("batch", _ENHANCE),
}
#: Columns of the attitude's covariance (right, forward, up) that belong to roll, yaw and pitch.
_ROLL_YAW_PITCH = [1, 2, 0]
_ON_ROW_S = 1e-3


@dataclass(frozen=True, eq=False)
class Course:
    """One trajectory against truth while the machine drives.

    Attributes
    ----------
    t_s : (N,); pose, error : (N, 6) x, y, z (m), roll, yaw, pitch (deg).
    sigma : (N, 6) that the method states, None where it states none.
    nees : of position and attitude, None without covariances; seconds : of the run, without the front end.
    notes : warnings of the run.
    """

    t_s: Array
    pose: Array
    error: Array
    sigma: Array | None
    nees: tuple[float | None, float | None]
    seconds: float
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Bounded:
    """The bound while the machine drives: sigma (N, 6) of position and angles."""

    t_s: Array
    sigma: Array


@dataclass(frozen=True, eq=False)
class FrontEnd:
    """Features followed with one enhancement: pairs a second, features of a pair, frames of a track, both means."""

    pairs_per_s: float
    features: float
    length: float


@dataclass(frozen=True, eq=False)
class Found:
    """All that one log gave.

    Attributes
    ----------
    courses : by case; what failed is its error's text.
    bound : None where it failed.
    front : by enhancement; empty for a log without images.
    matched, confirmed : by enhancement (K,) matches that RANSAC keeps in K pairs of frames, and those that are true.
    """

    seed: int
    courses: dict[str, Course | str]
    bound: Bounded | None
    front: dict[str, FrontEnd] = field(default_factory=dict)
    matched: dict[str, Array] = field(default_factory=dict)
    confirmed: dict[str, Array] = field(default_factory=dict)


def run_cases(seed: int, log: Any, said: Callable[[str], None] = lambda _: None) -> Found:
    """All cases on a log, and its bound."""
    courses: dict[str, Course | str] = {}
    for name in CASES:
        courses[name] = course(name, log)
        said(name)
    return Found(seed, courses, bound_of(log) if isinstance(courses[GRAPH], Course) else None)


def course(name: str, log: Any) -> Course | str:
    """One case on a log; the error's text where it fails."""
    from graphnav.config import Config
    from graphnav.errors import GraphnavError
    from graphnav.evaluation import evaluate
    from graphnav.smooth import smooth

    method, chosen = CASES[name]
    try:
        run = smooth(replace(log, truth=None), Config.from_dict(chosen), method)
    except GraphnavError as error:
        return str(error)
    found, states, spent = evaluate(run.trajectory, log), run.trajectory, run.diagnostics.seconds
    rows, true_rows = _compared(states.t_s, log)
    pose = _six(states.pos_n[rows], states.quat_nb[rows])
    true = _six(log.truth.pos_n_m[true_rows], log.truth.quat_nb[true_rows])
    return Course(
        states.t_s[rows], pose, difference(pose, true), sigmas(states, rows),
        (found.nees_position, found.nees_attitude), spent["total"] - spent.get("frontend", 0.0),
        tuple(run.diagnostics.warnings),
    )  # fmt: skip


def _compared(t_s: Array, log: Any) -> tuple[Any, Any]:
    """Keyframes of the drive that fall on rows of truth, and these rows: the machine shakes between them."""
    true_s, start_s = log.truth.t_s, log.initial.static_until_s or 0.0
    nearest = np.clip(np.searchsorted(true_s, t_s - _ON_ROW_S), 0, len(true_s) - 1)
    rows = np.flatnonzero((np.abs(true_s[nearest] - t_s) < _ON_ROW_S) & (t_s >= start_s))
    return rows, nearest[rows]


def _six(pos_n: Array, quat_nb: Array) -> Array:
    """Position (m) and roll, yaw, pitch (deg), (N, 6)."""
    from factors.so3 import from_quaternion

    return np.column_stack([pos_n, angles_deg(from_quaternion(quat_nb))[:, [2, 0, 1]]])


def difference(pose: Array, true: Array) -> Array:
    """Errors (N, 6), angles within half a turn."""
    error = pose - true
    error[:, 3:] = (error[:, 3:] + 180.0) % 360.0 - 180.0
    return error


def sigmas(states: Any, rows: Any) -> Array | None:
    """Sigmas (N, 6) of position and angles; for these the machine is near enough to level."""
    if states.cov is None:
        return None
    sigma = np.sqrt(np.diagonal(states.cov[rows], axis1=1, axis2=2))
    return np.column_stack([sigma[:, 3:6], np.degrees(sigma[:, _ROLL_YAW_PITCH])])


def bound_of(log: Any) -> Bounded | None:
    """The bound of the graph with the features as points, where there is one."""
    from graphnav.bound import bound
    from graphnav.errors import GraphnavError

    try:
        limit = bound(log).limit
    except GraphnavError:
        return None
    rows, _ = _compared(limit.t_s, log)
    sigma = sigmas(limit, rows)
    return None if sigma is None else Bounded(limit.t_s[rows], sigma)
