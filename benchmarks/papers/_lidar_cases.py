"""What is run of the INS/LiDAR reproduction, and what is kept of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from benchmarks._report import sources_id
from benchmarks.papers import _lidar_published as published
from benchmarks.papers._judged import Array

GRAPH, FILTER, AS_PUBLISHED = "graph", "filter", "filter as published"
UNCORRECTED, CORRECTED = "filter without correction", "filter with correction"
TRADITIONAL, IMPROVED, IMPROVED_TOLD = "traditional DR", "improved DR", "improved DR told of creep"
#: The paper's legs are points. A lean that a smooth track cannot show, left open, keeps the graph from converging.
_UPRIGHT = {"lidar": {"lean_sigma_deg": 0.01}}
_NOTHING_TAKEN_OUT = {"dead_reckoning": {"compensation": "none"}}
#: Keyframes of a course that are kept for drawing.
_DRAWN = 800


@dataclass(frozen=True, eq=False)
class Course:
    """One trajectory against truth.

    Attributes
    ----------
    largest_m : (C, 3) the error of the largest size in every cut, with its sign, east, north, up.
    stop_m : (C, 3) error at the end of every cut.
    creep_m : creep between successive stops at the near end, from the positions.
    t_s, error_m, heading_min : (N,), (N, 3), (N,) some of the keyframes; heading in minutes of arc.
    nees_position : mean of ``e' P^-1 e / 3``, or None; seconds : of the run.
    told : what the filter chose.
    """

    largest_m: Array
    stop_m: Array
    creep_m: Array
    t_s: Array
    error_m: Array
    heading_min: Array
    nees_position: float | None
    seconds: float
    told: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Found:
    """All courses on one log, by name; cuts : (start, end) s; creep_m : true; icp_m : by registration, or None.

    sources : hash of the code that ran; of several, joined with a plus.
    """

    world: str
    seed: int
    courses: dict[str, Course]
    cuts: tuple[tuple[float, float], ...]
    creep_m: Array
    icp_m: Array | None = None
    sources: str = ""

    def joined(self, other: Found) -> Found:
        """With the courses of another part of the same log."""
        return replace(
            self,
            courses=self.courses | other.courses,
            icp_m=self.icp_m if other.icp_m is None else other.icp_m,
            sources="+".join(sorted({self.sources, other.sources})),
        )


@dataclass(frozen=True)
class Job:
    """Part of what is run on one log.

    Attributes
    ----------
    world : "scenario" and "paper" with all methods of table 3; "quiet", the paper's without white noise of the gyro;
        "modes", "numbers", "distances", "correction" of sections 5.1 and 5.2.
    part : "filters", or "graph", which takes longest and is run apart.
    """

    world: str
    seed: int
    part: str = "filters"


def jobs(seeds: int, first_seed: int) -> Iterator[Job]:
    """All jobs; the selections of section 5 with the first seed, the graph in the other worlds with every seed."""
    several = range(first_seed, first_seed + seeds)
    yield from (Job(world, first_seed) for world in ("correction", "modes", "distances", "numbers"))
    yield from (Job(world, seed) for seed in several for world in ("paper", "quiet", "scenario"))
    yield Job("correction", first_seed, GRAPH)
    yield from (Job(world, seed, GRAPH) for seed in several for world in ("scenario", "paper"))


def run_job(job: Job) -> Found | str:
    """Simulate and run; the error's text when a run fails."""
    from graphnav.errors import GraphnavError

    try:
        return _graph(job) if job.part == GRAPH else _filters(job)
    except GraphnavError as error:
        return f"{job.world}, seed {job.seed}, {job.part}: {error}"


def chosen(count: int, mode: int, distance_m: float, picm: bool = False) -> dict[str, Any]:
    """Configuration of the filter with a choice of legs."""
    return {"lidar_filter": {"features": count, "mode": mode, "distance_m": distance_m, "picm": picm}}


def label(selection: tuple[int, int, float]) -> str:
    """Name of a selection."""
    count, mode, distance_m = selection
    return f"N {count}, mode {mode}, d {distance_m:g} m"


def _filters(job: Job) -> Found:
    """Dead reckoning and the paper's filter."""
    log = log_of(job)
    runs = runs_on(job.world, log)
    return _found(job, log, {name: course_of(*run) for name, run in runs.items()}, None)


def log_of(job: Job) -> Any:
    """The job's log, with truth; with scans for the graph where creep is found in them."""
    from benchmarks.papers import _lidar_worlds as worlds

    if job.world == "scenario":
        return worlds.scenario(job.seed, scans=job.part == GRAPH and creep_of_scans() is not None)
    made = {"paper": worlds.comparison_world, "quiet": worlds.quiet_world}
    return made.get(job.world, worlds.selection_world)(job.seed)


def runs_on(world: str, log: Any) -> dict[str, tuple[str, dict[str, Any], Any]]:
    """Method, configuration and log by name."""
    # the mounting error that section 5.3 states is what its correction left
    compared = {AS_PUBLISHED: ("lidar-ekf", chosen(*published.COMPARED), log), FILTER: ("lidar-ekf", {}, log)}
    if world == "quiet":
        return {AS_PUBLISHED: compared[AS_PUBLISHED]}
    if world in ("paper", "scenario"):
        return _reckoned(log) | compared
    if world == "correction":
        return {
            UNCORRECTED: ("lidar-ekf", chosen(*published.CORRECTED), log),
            CORRECTED: ("lidar-ekf", chosen(*published.CORRECTED, picm=True), log),
            FILTER: ("lidar-ekf", {}, log),
        }
    of = {"modes": published.MODES, "numbers": published.NUMBERS, "distances": published.DISTANCES}[world]
    return {label(selection): ("lidar-ekf", chosen(*selection), log) for selection in of}


def _reckoned(log: Any) -> dict[str, tuple[str, dict[str, Any], Any]]:
    """Table 3's dead reckoning, which is told no surveyed point; with closed path not told of creep, and told."""
    unsurveyed = replace(log, surveyed=())
    creep_m = float(np.mean(published.CREEP_STANDARD))
    told = replace(unsurveyed, face=log.face.replace(creep_m=creep_m, creep_sigma_m=log.face.along_sigma_m))
    return {
        TRADITIONAL: ("dead-reckoning", _NOTHING_TAKEN_OUT, unsurveyed),
        IMPROVED: ("dead-reckoning-cpoem", _NOTHING_TAKEN_OUT, unsurveyed),
        IMPROVED_TOLD: ("dead-reckoning-cpoem", _NOTHING_TAKEN_OUT, told),
    }


def _graph(job: Job) -> Found:
    """The graph, told of upright legs where they are upright.

    With creep by registration where scans and `graphnav.creep` are there.
    """
    from graphnav._cycles import cycle_spans
    from graphnav.config import Config
    from graphnav.smooth import smooth

    log, creep = log_of(job), creep_of_scans()
    config = Config.from_dict({} if job.world == "scenario" else _UPRIGHT)
    run, icp = smooth(replace(log, truth=None), config), None
    if creep is not None and log.lidar_scans is not None:
        by_cycle = {row.cycle: row.icp_m for row in creep(replace(log, truth=None), run).rows}
        # all cycles or none: what is compared is five figures
        if set(by_cycle) == set(range(1, len(cycle_spans(log)))):
            icp = np.array([by_cycle[cycle] for cycle in sorted(by_cycle)])
    return _found(job, log, {GRAPH: judged(run, log)}, icp)


def creep_of_scans() -> Any:
    """`graphnav.creep.creep`, or None where this version has none."""
    from importlib import import_module, util

    return import_module("graphnav.creep").creep if util.find_spec("graphnav.creep") is not None else None


def course_of(method: str, config: dict[str, Any], log: Any) -> Course:
    """Run a method on a log, which is then blind, and judge it."""
    from graphnav.config import Config
    from graphnav.smooth import smooth

    return judged(smooth(replace(log, truth=None), Config.from_dict(config), method), log)


def judged(run: Any, log: Any) -> Course:
    """A run against its log's truth."""
    from graphnav._cycles import cycle_spans
    from graphnav.evaluation import evaluate

    found, cuts = evaluate(run.trajectory, log), [(start, end) for _, start, end in cycle_spans(log)]
    t_s, error = found.t_s, found.error_n_m
    inside = [error[(t_s >= start) & (t_s <= end)] for start, end in cuts]
    largest = [part[np.abs(part).argmax(axis=0), range(3)] for part in inside]
    every = max(1, len(t_s) // _DRAWN)
    told = {k: v for step in run.diagnostics.history for k, v in step.items()} if run.diagnostics.nis else {}
    stops = near_stops(cuts)
    return Course(
        np.array(largest), np.array([part[-1] for part in inside]),
        np.diff(_along(run.trajectory.t_s, run.trajectory.pos_n, stops)), t_s[::every], error[::every],
        np.degrees(found.att_error_b_rad[::every, 2]) * 60, found.nees_position, run.diagnostics.seconds["total"], told,
    )  # fmt: skip


def near_stops(cuts: list[tuple[float, float]]) -> list[float]:
    """When the machine stands at the near end in every cycle: odd cuts start there, even ones end there."""
    return [start if k % 2 == 0 else end for k, (start, end) in enumerate(cuts)]


def _along(t_s: Array, pos_n: Array, stops: list[float]) -> Array:
    """Coordinate along the face, which lies north, at some times."""
    return np.interp(stops, t_s, pos_n[:, 1])


def _found(job: Job, log: Any, courses: dict[str, Course], icp: Array | None) -> Found:
    from graphnav._cycles import cycle_spans

    cuts = tuple((start, end) for _, start, end in cycle_spans(log))
    creep = np.diff(_along(log.truth.t_s, log.truth.pos_n_m, near_stops(list(cuts))))
    return Found(job.world, job.seed, courses, cuts, creep, icp, sources_id("graphnav", "factors"))
