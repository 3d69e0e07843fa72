"""Methods side by side: each smooths the same log, each is judged by the same truth, which none of them is shown.

Over seeds the scenario is simulated again for every seed, and the seeds are shared out over the processor's cores.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import TYPE_CHECKING

from graphnav._seeds import in_workers, over_seeds
from graphnav._stages import ProgressHook
from graphnav.comparison import TRUTH, Comparison, Curve, MethodRow, NisBand
from graphnav.errors import ConfigError, GraphnavError
from graphnav.log import SensorLog, Truth
from graphnav.methods import LEG_METHODS, METHODS, SIGHTED_METHODS, STEREO_METHODS, UWB_METHODS

if TYPE_CHECKING:
    from graphnav.config import Config
    from graphnav.run import Run
    from graphnav.simulation.naming import Simulated

#: Stages of a run that report progress.
_STAGES = ("frontend", "assemble", "solve", "covariance")


def compare(
    log: SensorLog | str | Path,
    methods: Sequence[str] | None = None,
    config: Config | None = None,
    seeds: int = 0,
    progress: ProgressHook | None = None,
) -> Comparison:
    """Run several methods on one log, or on many seeds of one scenario.

    Parameters
    ----------
    log : a `SensorLog`, the folder of one, or the name of a scenario ("shearer-mems", "shearer-mems_interval_m=6").
        Without truth in it the first method that succeeds is what the others are compared with.
    methods : of `graphnav.methods.METHODS`; by default all that the log has the sensors for.
    config : choices of method, the same for all; None for the defaults.
    seeds : above zero, the scenario of the log is simulated again with the seeds 0, 1, ... seeds - 1, in worker
        processes; call it then under ``if __name__ == "__main__":``.
    progress : called as ``progress(method, "seeds" or "images", done, total)``, "images" while those of a simulated log
        are rendered.

    Returns
    -------
    Comparison. A method that fails has a row that says why; the others are not lost.

    Raises
    ------
    ConfigError : an unknown method, or seeds for a log whose name tells no scenario.
    LogError : a log that cannot be read.
    """
    from graphnav.config import Config

    chosen = None if methods is None else _checked(methods)
    config = Config.given(config)
    if seeds < 0:
        raise ConfigError(f"seeds = {seeds}, expected zero or more")
    if seeds:
        task = _Task(_scenario(log), chosen, config)
        return over_seeds(task.name, in_workers(task.run, seeds, progress), seeds)
    with _opened(log, chosen, progress) as opened:
        return Comparison(opened.name, *_compared(opened, chosen, config, progress))


def _checked(methods: Sequence[str]) -> tuple[str, ...]:
    """The methods, each once."""
    chosen = tuple(dict.fromkeys(methods))
    unknown = [method for method in chosen if method not in METHODS]
    if unknown or not chosen:
        what = f'unknown method "{unknown[0]}"' if unknown else "no method given"
        raise ConfigError(f"{what}; known: {', '.join(METHODS)}")
    return chosen


def _every(log: SensorLog) -> tuple[str, ...]:
    """All methods that a log has the sensors for."""
    seen = (log.relative_pose, log.stereo_pairs, log.stereo_tracks)
    missing = (LEG_METHODS if log.lidar_points is None else ()) + (UWB_METHODS if log.uwb is None else ())
    missing += STEREO_METHODS if all(table is None for table in seen) else ()
    return tuple(method for method in METHODS if method not in missing)


@contextmanager
def _opened(
    log: SensorLog | str | Path, methods: Sequence[str] | None, progress: ProgressHook | None
) -> Iterator[SensorLog]:
    """The log itself, from its folder, or simulated from its name."""
    found = None if isinstance(log, SensorLog) or Path(log).exists() else _parsed(str(log))
    if found is not None:
        with _simulated(found, found.seed or 0, methods, progress) as simulated:
            yield simulated
        return
    yield log if isinstance(log, SensorLog) else _read(log)


def _read(folder: str | Path) -> SensorLog:
    from graphnav.readers import read

    return read(folder)


@contextmanager
def _simulated(
    found: Simulated, seed: int, methods: Sequence[str] | None, progress: ProgressHook | None = None
) -> Iterator[SensorLog]:
    """A simulated log, with its images in a folder that is removed in the end; without them where none is looked at."""
    from graphnav.simulation import simulate

    log = simulate(found.scenario, seed, **found.options)
    looked_at = methods is None or not set(methods).isdisjoint(SIGHTED_METHODS)
    if not looked_at or log.stereo_pairs is None or log.stereo_tracks is not None:
        yield log
        return
    from graphnav.simulation.stereo_images import render_into

    with TemporaryDirectory(prefix="graphnav-images-") as folder:
        render_into(found.scenario, seed, found.options, Path(folder), progress=progress)
        yield replace(log, stereo_pairs=log.stereo_pairs.replace(folder=Path(folder)))


def _scenario(log: SensorLog | str | Path) -> Simulated:
    """The scenario that a log was simulated from, or that a name tells."""
    named = None if isinstance(log, SensorLog) or Path(log).exists() else _parsed(str(log))
    name = str(log) if named is not None else log.name if isinstance(log, SensorLog) else _read(log).name
    found = named or _parsed(name)
    if found is None:
        raise ConfigError(
            f'log "{name}" was not simulated from a scenario, and seeds mean to simulate it again; leave out the seeds,'
            " or give the name of a scenario"
        )
    return found


def _parsed(name: str) -> Simulated | None:
    from graphnav.simulation.naming import parse_name

    return parse_name(name)


# One log ----------------------------------------------------------------------------------------------------


def _compared(
    log: SensorLog, methods: Sequence[str] | None, config: Config, progress: ProgressHook | None
) -> tuple[str, int, tuple[MethodRow, ...]]:
    """What the errors are against, no seeds, and a row per method."""
    _warm_up()
    blind = replace(log, truth=None)
    reference, judge, rows = TRUTH, log, []
    for method in _every(log) if methods is None else methods:
        run = _tried(blind, config, method, progress)
        if isinstance(run, MethodRow):
            rows.append(run)
            continue
        if judge.truth is None:
            states = run.trajectory
            reference = method
            judge = replace(log, truth=Truth(states.t_s, states.pos_n, states.quat_nb, states.vel_n))
        rows.append(_judged(method, run, judge, reference))
    return reference, 0, tuple(rows)


def _warm_up() -> None:
    """Load what the methods compute with and compile it, so that no method's seconds hold what others then have."""
    importlib.import_module("gtsam")
    warm_up = getattr(importlib.import_module("graphnav.baselines"), "warm_up", None)
    if warm_up is not None:
        warm_up()


def _tried(blind: SensorLog, config: Config, method: str, progress: ProgressHook | None) -> Run | MethodRow:
    """The run, or the row of a method that failed: whatever it was, the other methods go on."""
    from graphnav.smooth import smooth

    try:
        return smooth(blind, config, method, _per_method(method, progress))
    except Exception as error:
        return MethodRow(method, error=_one_line(error))


def _per_method(method: str, progress: ProgressHook | None) -> ProgressHook | None:
    """Progress of all stages as one number; a stage that is repeated does not set it back."""
    if progress is None:
        return None
    reached = 0.0

    def hook(stage: str, done: float, total: float) -> None:
        nonlocal reached
        if stage in _STAGES:
            reached = max(reached, _STAGES.index(stage) + done / max(total, 1e-9))
            progress(method, reached, len(_STAGES))

    return hook


def _one_line(error: Exception) -> str:
    text = " ".join(str(error).split())
    return text if isinstance(error, GraphnavError) else f"unexpected {type(error).__name__}: {text}".rstrip(": ")


def _judged(method: str, run: Run, log: SensorLog, reference: str) -> MethodRow:
    """A method's figures against the truth in `log`, or against a method that stands in for it."""
    from graphnav.evaluation import evaluate

    known = run.diagnostics
    try:
        found = evaluate(run.trajectory, log)
    except GraphnavError as error:
        return MethodRow(method, known.seconds["total"], warnings=tuple(known.warnings), error=_one_line(error))
    true = reference == TRUTH
    nis = None if run.innovations is None else run.innovations.nis()
    return MethodRow(
        method=method,
        seconds=known.seconds["total"],
        rms_m=tuple(found.rms_m.tolist()),
        max_m=tuple(found.max_m.tolist()),
        per_cycle=found.per_cycle,
        nees_position=found.nees_position if true else None,
        nees_attitude=found.nees_attitude if true else None,
        nis=None if nis is None else NisBand(nis.mean, nis.low, nis.high, nis.rows),
        converged=known.converged,
        warnings=(*known.warnings, *found.notes),
        curve=Curve(found.t_s, found.error_n_m),
    )


# Many seeds -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Task:
    """What a worker is told: it simulates the log itself."""

    scenario: Simulated
    methods: tuple[str, ...] | None
    config: Config

    @property
    def name(self) -> str:
        """The scenario's name with its options, without a seed."""
        from graphnav.simulation.naming import log_name

        return log_name(self.scenario.scenario, self.scenario.options, None)

    def run(self, seed: int) -> tuple[MethodRow, ...]:
        """All methods on one seed."""
        with _simulated(self.scenario, seed, self.methods) as log:
            return _compared(log, self.methods, self.config, None)[2]


class _CallableModule(ModuleType):
    """Module and function share the name ``graphnav.compare``: see `graphnav._PUBLIC`."""

    def __call__(
        self,
        log: SensorLog | str | Path,
        methods: Sequence[str] | None = None,
        config: Config | None = None,
        seeds: int = 0,
        progress: ProgressHook | None = None,
    ) -> Comparison:
        """See `compare`."""
        return compare(log, methods, config, seeds, progress)


sys.modules[__name__].__class__ = _CallableModule
