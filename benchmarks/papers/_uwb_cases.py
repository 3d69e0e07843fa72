"""What is run of the IMU/UWB reproduction, and what is kept of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.papers._judged import Array

SITES = ("surface", "underground")
INFLATED, GRAPH = "imu-uwb, Markov counted", "batch"
#: Name -> method and its configuration.
CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "uwb": ("uwb", {}),
    "uwb-vbukf": ("uwb-vbukf", {}),
    "imu-uwb": ("imu-uwb", {}),
    "imu-uwb-vbukf": ("imu-uwb-vbukf", {}),
    INFLATED: ("imu-uwb", {"uwb_filter": {"inflate": True}}),
    GRAPH: ("batch", {}),
}
#: A position less sure than this is none: a method that made no use of the ranges has it.
_NONE_M = 100.0


@dataclass(frozen=True, eq=False)
class Course:
    """One trajectory against truth.

    Attributes
    ----------
    t_s, tag_n, error_m : (N,), (N, 3), (N, 3) place of the tag, and error of the body's.
    angle_deg, angle_error_deg : (N, 3) yaw, pitch, roll, and the attitude's error about right, forward, up.
    nees : of position and attitude, None without covariances; seconds : of the run.
    bias_s, bias, bias_sigma : (K,), (K, 6), (K, 6) or None: accelerometer (mg) and gyro (deg/h).
    """

    t_s: Array
    tag_n: Array
    error_m: Array
    angle_deg: Array
    angle_error_deg: Array
    nees: tuple[float | None, float | None]
    seconds: float
    bias_s: Array | None = None
    bias: Array | None = None
    bias_sigma: Array | None = None


@dataclass(frozen=True, eq=False)
class Found:
    """All that one log gave.

    Attributes
    ----------
    courses : by case; what failed is its error's text.
    range_s, range_m, anchor : (M,) ranges as they were recorded.
    true_bias : (6,) drawn biases, mg and deg/h; spans_s : when the machine moved.
    bound_m : (3,) rms of the bound on position, or None.
    """

    site: str
    seed: int
    courses: dict[str, Course | str]
    range_s: Array
    range_m: Array
    anchor: Any
    true_bias: Array
    spans_s: tuple[float, float]
    bound_m: Array | None = None


@dataclass(frozen=True)
class Job:
    """One log and the cases to run on it."""

    site: str
    seed: int
    cases: tuple[str, ...]


def jobs(seeds: int, first_seed: int, graph: bool) -> Iterator[Job]:
    """Both sites with every seed."""
    cases = tuple(name for name in CASES if graph or name != GRAPH)
    for site in SITES:
        yield from (Job(site, seed, cases) for seed in range(first_seed, first_seed + seeds))


def run_job(job: Job) -> Found:
    """Simulate, run all cases, judge them."""
    from graphnav.simulation import simulate

    log = simulate("face-end-uwb", job.seed, site=job.site)
    assert log.uwb is not None
    courses = {name: course(name, log) for name in job.cases}
    return Found(
        job.site, job.seed, courses, log.uwb.t_s, log.uwb.range_m, log.uwb.anchor_id, true_biases(job),
        moving(log), bound_of(log) if isinstance(courses.get(GRAPH), Course) else None,
    )  # fmt: skip


def course(name: str, log: Any) -> Course | str:
    """One case on a log; the error's text where it fails."""
    from factors.so3 import from_quaternion
    from graphnav.config import Config
    from graphnav.errors import GraphnavError
    from graphnav.evaluation import evaluate
    from graphnav.smooth import smooth

    method, chosen = CASES[name]
    try:
        run = smooth(replace(log, truth=None), Config.from_dict(chosen), method)
    except GraphnavError as error:
        return str(error)
    states = run.trajectory
    if states.cov is not None and np.sqrt(np.median(states.cov[:, 3, 3])) > _NONE_M:
        return f"{method} found no position: it made no use of the ranges"
    found, rotation = evaluate(states, log), from_quaternion(states.quat_nb)
    known = run.history
    return Course(
        found.t_s, states.pos_n + rotation @ log.uwb.tag[0].lever_arm_b_m, found.error_n_m, angles_deg(rotation),
        np.degrees(found.att_error_b_rad), (found.nees_position, found.nees_attitude),
        run.diagnostics.seconds["total"],
        *((None, None, None) if known is None else (known.t_s, known.value[:, :6], _six(known.sigma))),
    )  # fmt: skip


def _six(sigma: Array | None) -> Array | None:
    return None if sigma is None else sigma[:, :6]


def angles_deg(rotation: Array) -> Array:
    """Yaw about up, then pitch about right, then roll about forward (N, 3), deg."""
    yaw = np.arctan2(-rotation[:, 0, 1], rotation[:, 1, 1])
    pitch = np.arcsin(np.clip(rotation[:, 2, 1], -1, 1))
    roll = np.arctan2(-rotation[:, 2, 0], rotation[:, 2, 2])
    return np.degrees(np.column_stack([yaw, pitch, roll]))


def bound_of(log: Any) -> Array | None:
    """Rms of the bound on position (3,), where there is one."""
    from graphnav.bound import bound
    from graphnav.errors import GraphnavError

    try:
        return np.asarray(np.sqrt(np.mean(bound(log).sigma_n_m ** 2, axis=0)))
    except GraphnavError:
        return None


def true_biases(job: Job) -> Array:
    """Drawn biases (6,): accelerometer in mg, gyro in deg/h."""
    from graphnav.run import DEG_H, MG
    from graphnav.simulation.imu import draw_biases
    from graphnav.simulation.scenarios import resolve
    from graphnav.simulation.world import streams

    spec: Any = resolve("face-end-uwb", {"site": job.site})
    gyro, accel = draw_biases(spec.imu, streams(job.seed).errors, 1.0)
    return np.concatenate([accel / MG, gyro / DEG_H])


def moving(log: Any) -> tuple[float, float]:
    """From when to when the machine moves, by the truth."""
    speed = np.linalg.norm(log.truth.vel_n_m_s, axis=1)
    rows = np.flatnonzero(speed > 0.02)
    return float(log.truth.t_s[rows[0]]), float(log.truth.t_s[rows[-1]])
