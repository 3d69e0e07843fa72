"""The logs that the reproduction is made of, and what is run on each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.papers import _published as published
from benchmarks.papers._judged import Array, Found, Judged, calibrated, judge

SCENARIO = "shearer-mems"
PRESETS = ("paper", "matched")
FILTERS = ("ekf", "rts-online", "rts")
GRAPH = "graph"
#: Estimators on every log: a filter's name is its method and its preset.
ESTIMATORS: dict[str, tuple[str, dict[str, Any]]] = {
    **{f"{method} {preset}": (method, {"filter": {"preset": preset}}) for method in FILTERS for preset in PRESETS},
    GRAPH: ("batch", {}),
}
#: Of those, where the offline smoother adds nothing: figures 14-15.
SWEPT = tuple(name for name in ESTIMATORS if not name.startswith("rts "))
RECKONED = ("dead-reckoning", "dead-reckoning-cpoem")
COMPENSATIONS = ("none", "rest", "rts")
#: The closed path left out, or in the papers' form.
WITHOUT: dict[str, Any] = {"closed_path": {"form": "off"}}
ABSOLUTE: dict[str, Any] = {"closed_path": {"form": "absolute"}}
#: What the paper's preset changes in the matched one, one at a time.
PRESET_STEPS: dict[str, dict[str, Any]] = {
    "P0 x 3": {"prior_scale": 3.0},
    "Q x 5": {"noise_scale": 5.0},
    "constraint at every sample": {"constraint_every_s": 0.0},
    "first pass taken as exact": {"first_pass_covariance": False},
    "closed path along the face everywhere": {"along_everywhere": True},
}
#: The log whose errors are all in the linear range.
SMALL = "errors a tenth"
HALF_SECOND = "rts off, constraint twice a second"
#: Estimators whose calibration is followed (figures 9-13).
FOLLOWED = ("ekf matched", "rts-online matched", GRAPH, "ekf paper", "rts-online paper")


@dataclass(frozen=True)
class Job:
    """One log to simulate and run everything on.

    Attributes
    ----------
    kind : "base", "interval", "par" or "small"; option : the interval or the setting's number.
    keep : keep the course of the errors, for drawing.
    """

    kind: str
    seed: int
    option: int = 0
    keep: bool = False

    @property
    def log(self) -> str:
        """Name of the case, the same for all seeds."""
        return {"base": "interval 2", "small": SMALL}.get(self.kind, f"{self.kind} {self.option}")


def jobs(seeds: int, swept_seeds: int, first_seed: int = 0) -> Iterator[Job]:
    """All jobs, the long ones first; courses are kept of the first seed."""
    order = range(first_seed, first_seed + seeds)
    for seed in order:
        yield Job("base", seed, keep=seed == first_seed)
    for seed in order:
        for interval in published.INTERVALS_M[1:]:
            yield Job("interval", seed, interval, keep=seed == first_seed)
    yield from (Job("par", seed, par) for seed in order[:swept_seeds] for par in published.PARS)
    yield from (Job("small", seed) for seed in order)


def run_job(job: Job) -> Found | str:
    """Simulate and run; the error's text when a run fails."""
    from graphnav.errors import GraphnavError

    try:
        return {"base": _base, "interval": _interval, "par": _par, "small": _small}[job.kind](job)
    except GraphnavError as error:
        return f"{job.log}, seed {job.seed}: {error}"


def _interval(job: Job) -> Found:
    log, blind = _simulated(job, interval_m=job.option)
    judged = {name: judge(_smoothed(blind, name).trajectory, log, job.keep) for name in ESTIMATORS}
    return _found(job, log, judged)


def _par(job: Job) -> Found:
    from benchmarks.papers._drawn import drawn

    log, blind = _simulated(job, par=job.option)
    runs = {name: _smoothed(blind, name) for name in SWEPT}
    found = _found(job, log, {name: judge(run.trajectory, log, False) for name, run in runs.items()})
    names = runs[GRAPH].history.names
    known, first_cut = drawn(SCENARIO, job.seed, names, par=job.option), found.cycles[0][0]
    followed = {name: calibrated(run.history, known, first_cut, False) for name, run in runs.items()}
    return replace(found, calibrated=followed, names=names, units=runs[GRAPH].history.units)


def _small(job: Job) -> Found:
    """Initial, mounting, scale and bias errors a tenth of the scenario's: everything linear, the noise as it was."""
    from graphnav.simulation.scenarios import MEMS, ImuGrade
    from graphnav.simulation.shearer import simulate_shearer

    grade = MEMS.imu
    tenth = ImuGrade(
        grade.gyro_bias_deg_h / 10, grade.gyro_random_walk_deg_sqrt_h,
        grade.accel_bias_mg / 10, grade.accel_random_walk_mg_sqrt_hz,
    )  # fmt: skip
    (a0, a1, a2), (m0, m1, m2) = MEMS.att_sigma_deg, MEMS.mounting_sigma_deg
    spec = replace(
        MEMS, imu=tenth, att_sigma_deg=(a0 / 10, a1 / 10, a2 / 10), mounting_sigma_deg=(m0 / 10, m1 / 10, m2 / 10),
        scale_sigma=MEMS.scale_sigma / 10,
    )  # fmt: skip
    log = simulate_shearer(f"{SCENARIO}-tenth", spec, job.seed)
    return _found(job, log, _without_closed_path(log, replace(log, truth=None)))


def _base(job: Job) -> Found:
    """The scenario as it is, with everything that the paper shows of one log."""
    from graphnav._stages import Stages
    from graphnav.config import Config
    from graphnav.smooth import posed

    log, blind = _simulated(job)
    runs = {name: _smoothed(blind, name) for name in ESTIMATORS}
    judged = {name: judge(run.trajectory, log, job.keep) for name, run in runs.items()}
    judged |= _reckoned(log, blind, job.keep)
    judged |= _without_closed_path(log, blind)
    judged["graph absolute"] = _run(log, blind, "batch", ABSOLUTE)
    problem = posed(blind, Config(), Stages(None))
    judged |= _preset_steps(log, problem)
    found = _found(job, log, judged)
    return _with_calibration(found, job, log, runs, problem)


def _reckoned(log: Any, blind: Any, keep: bool) -> dict[str, Judged]:
    """Table 3's traditional methods, with and without compensation."""
    return {
        f"{method} {known}": _run(log, blind, method, {"dead_reckoning": {"compensation": known}}, keep)
        for method in RECKONED
        for known in COMPENSATIONS
    }


def _without_closed_path(log: Any, blind: Any) -> dict[str, Judged]:
    """Where filter, smoother and graph should agree: the odometer, rest and the surveyed end alone."""
    from benchmarks.papers._navigation import smoothed_whole
    from graphnav._stages import Stages
    from graphnav.config import Config
    from graphnav.smooth import posed

    judged = {
        "ekf off": _run(log, blind, "ekf", WITHOUT),
        "rts off": _run(log, blind, "rts", WITHOUT),
        "graph off": _run(log, blind, "batch", WITHOUT),
    }
    problem = posed(blind, Config.from_dict(WITHOUT), Stages(None))
    judged[HALF_SECOND] = judge(smoothed_whole(problem, constraint_every_s=0.5), log, False)
    return judged


def _preset_steps(log: Any, problem: Any) -> dict[str, Judged]:
    """The online smoother with one of the paper's settings at a time."""
    from benchmarks.papers._navigation import smoothed

    return {name: judge(smoothed(problem, **changes), log, False) for name, changes in PRESET_STEPS.items()}


def _with_calibration(found: Found, job: Job, log: Any, runs: dict[str, Any], problem: Any) -> Found:
    """Figures 9-13: estimates against what was drawn, and what navigation is worth with them."""
    from benchmarks.papers._drawn import drawn
    from benchmarks.papers._navigation import pure_inertial, reckoned

    history = runs[GRAPH].history
    known = drawn(SCENARIO, job.seed, history.names)
    first_cut = found.cycles[0][0]
    followed = {name: calibrated(runs[name].history, known, first_cut, job.keep) for name in FOLLOWED}
    told = {name: runs[name].history.value[-1] for name in FOLLOWED} | {"true": known}
    inertial = {"nothing": pure_inertial(problem, log, np.zeros(3), np.zeros(3), published.PURE_INERTIAL_S)}
    judged = dict(found.judged)
    for name, value in told.items():
        accel, gyro, odometer = in_si(value, history.names)
        inertial[name] = pure_inertial(problem, log, gyro, accel, published.PURE_INERTIAL_S)
        judged[f"dr by {name}"] = judge(reckoned(problem, gyro, odometer), log, job.keep)
    return replace(
        found, judged=judged, calibrated=followed, inertial=inertial, known=known, names=history.names,
        units=history.units,
    )  # fmt: skip


def in_si(value: Array, names: tuple[str, ...]) -> tuple[Array, Array, Array]:
    """Accelerometer bias (3,), gyro bias (3,), odometer calibration (4,) of values in datasheet units."""
    from graphnav.run import ACCEL_NAMES, GYRO_NAMES, ODOMETER_NAMES

    by_name = dict(zip(names, value.tolist(), strict=True))
    accel, gyro, odometer = (
        np.array([by_name[name] * size for name, size, _ in group])
        for group in (ACCEL_NAMES, GYRO_NAMES, ODOMETER_NAMES)
    )
    return accel, gyro, odometer


def _simulated(job: Job, **options: Any) -> tuple[Any, Any]:
    """The log, and what estimators get of it: no truth."""
    from graphnav.simulation import simulate

    log = simulate(SCENARIO, seed=job.seed, **options)
    return log, replace(log, truth=None)


def _smoothed(blind: Any, name: str) -> Any:
    from graphnav.config import Config
    from graphnav.smooth import smooth

    method, config = ESTIMATORS[name]
    return smooth(blind, Config.from_dict(config), method)


def _run(log: Any, blind: Any, method: str, config: dict[str, Any], keep: bool = False) -> Judged:
    from graphnav.config import Config
    from graphnav.smooth import smooth

    return judge(smooth(blind, Config.from_dict(config), method).trajectory, log, keep)


def _found(job: Job, log: Any, judged: dict[str, Judged]) -> Found:
    from graphnav._cycles import cycle_spans

    return Found(job.log, job.seed, judged, tuple((start, end) for _, start, end in cycle_spans(log)))
