"""The commands behind the command line, one function each; they take the parsed arguments."""

from __future__ import annotations

import argparse
import importlib
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from graphnav.errors import GraphnavError

if TYPE_CHECKING:
    from graphnav.evaluation import Evaluation
    from graphnav.log import SensorLog
    from graphnav.run import Run

#: Format -> (module with `convert`, the options it takes).
IMPORTERS = {
    "comma2k19": ("graphnav.readers.comma2k19", ("wheel_scale",)),
    "euroc": ("graphnav.readers.euroc", ("position_rate_hz",)),
    "kitti-gtsam": ("graphnav.readers.kitti_gtsam", ()),
}


def demo(arguments: argparse.Namespace) -> None:
    """Run the demonstration and show its figures."""
    from graphnav.demo import run_demo, show
    from graphnav.report.terminal import ProgressBar

    with ProgressBar() as progress:
        result = run_demo(arguments.output, progress)
    show(result)
    if arguments.json:
        _print_json(result.to_dict())


def info(arguments: argparse.Namespace) -> None:
    """Describe a log."""
    from graphnav.report.info import describe, render

    known = describe(_read(arguments.log))
    if arguments.json:
        _print_json(known)
    else:
        render(known)


def import_log(arguments: argparse.Namespace) -> None:
    """Convert recorded data to a log folder."""
    from graphnav.report.terminal import working

    module, options = IMPORTERS[arguments.format]
    given = {name: getattr(arguments, name) for name in ("wheel_scale", "position_rate_hz")}
    chosen = {name: value for name, value in given.items() if value is not None}
    foreign = sorted(set(chosen) - set(options))
    if foreign:
        raise GraphnavError(f"{arguments.format} takes no --{foreign[0].replace('_', '-')}; leave it out")
    if arguments.source is None and arguments.format != "kitti-gtsam":
        raise GraphnavError(f"{arguments.format} needs SRC, the folder of its data")
    with working("converting"):
        log = importlib.import_module(module).convert(arguments.source, **chosen)
        _write(log, arguments)


def simulate(arguments: argparse.Namespace) -> None:
    """Simulate a scenario to a log folder."""
    from graphnav.report.terminal import working
    from graphnav.simulation import simulate as simulate_log

    given = {name: getattr(arguments, name) for name in ("interval_m", "par", "hours", "sensors")}
    options = {name: value for name, value in given.items() if value is not None}
    if "sensors" in options:
        options["sensors"] = tuple(name.strip() for name in options["sensors"].split(","))
    with working("simulating"):
        _write(simulate_log(arguments.scenario, seed=arguments.seed, **options), arguments)


def smooth(arguments: argparse.Namespace) -> None:
    """Smooth a log to a run folder."""
    from graphnav.config import Config
    from graphnav.report import results
    from graphnav.report.terminal import ProgressBar, run_summary
    from graphnav.smooth import smooth as smooth_log

    results.check_folder(arguments.output, overwrite=arguments.overwrite)
    config = None if arguments.config is None else Config.from_toml(arguments.config)
    begun = time.perf_counter()
    log = _read(arguments.log)
    read_s = time.perf_counter() - begun
    with ProgressBar() as progress:
        # Truth is for judging alone: the smoother does not even see it.
        blind = replace(log, truth=None)
        run = smooth_log(blind, config=config, method=arguments.method, progress=progress)
    run = _with_read_time(run, read_s)
    evaluation = _judged(run, log)
    results.save(run, arguments.output, evaluation=evaluation, overwrite=arguments.overwrite)
    run_summary(run, evaluation, arguments.output)


def _judged(run: Run, log: SensorLog) -> Evaluation | None:
    """Figures against truth, if the log has it; truth that cannot judge the run does not spoil it."""
    from graphnav.evaluation import evaluate as judge

    if log.truth is None:
        return None
    try:
        return judge(run.trajectory, log)
    except GraphnavError as error:
        print(f"graphnav: warning: not judged by truth: {error}", file=sys.stderr)
        return None


def _with_read_time(run: Run, read_s: float) -> Run:
    """Add the time of reading, which the smoother could not see, to the run's seconds."""
    seconds = dict(run.diagnostics.seconds)
    seconds["read"] += read_s
    seconds["total"] += read_s
    return replace(run, diagnostics=replace(run.diagnostics, seconds=seconds))


def evaluate(arguments: argparse.Namespace) -> None:
    """Judge a run by the truth in its log."""
    from graphnav.evaluation import evaluate as judge
    from graphnav.report.plots import plot_run
    from graphnav.report.results import load
    from graphnav.report.terminal import evaluation_tables

    trajectory = load(arguments.folder)
    log = _read(arguments.log)
    evaluation = judge(trajectory, log)
    if arguments.plot is not None:
        plot_run(trajectory, log, arguments.plot, evaluation)
    if arguments.json:
        _print_json(evaluation.to_dict())
    else:
        evaluation_tables(evaluation)


def _read(path: Path) -> SensorLog:
    from graphnav.readers import read
    from graphnav.report.terminal import working

    with working(f"reading {path}"):
        return read(path)


def _write(log: SensorLog, arguments: argparse.Namespace) -> None:
    from graphnav.readers import write

    write(log, arguments.output, tables=arguments.tables, overwrite=arguments.overwrite)
    rows = ", ".join(f"{name} {len(table):,}" for name, table in log.tables().items())
    print(f"wrote {arguments.output}: {rows}", file=sys.stderr)


def _print_json(value: Any) -> None:
    from graphnav.report.text import to_json

    print(to_json(value), flush=True)
