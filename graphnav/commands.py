"""The commands that make something of a log, one function each; they take the parsed arguments.

Each tries its outputs first, before it imports what takes a second to.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from graphnav._outputs import check_file
from graphnav.errors import GraphnavError
from graphnav.log_commands import print_json, read_log

if TYPE_CHECKING:
    from graphnav.config import Config
    from graphnav.evaluation import Evaluation
    from graphnav.log import SensorLog
    from graphnav.run import Run


def demo(arguments: argparse.Namespace) -> None:
    """Run the demonstration and show its figures."""
    from graphnav.demo import run_demo, show
    from graphnav.report.terminal import ProgressBar

    with ProgressBar() as progress:
        result = run_demo(arguments.output, progress)
    show(result)
    if arguments.json:
        print_json(result.to_dict())


def smooth(arguments: argparse.Namespace) -> None:
    """Smooth a log to a run folder."""
    from graphnav.report import results
    from graphnav.report.terminal import ProgressBar, run_summary

    results.check_folder(arguments.output, overwrite=arguments.overwrite)
    results.check_writable(arguments.output)
    from graphnav.smooth import smooth as smooth_log

    config = _config(arguments)
    begun = time.perf_counter()
    log = read_log(arguments.log)
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
        return judge(run.trajectory, log, innovations=run.innovations)
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
    _check_picture(arguments.plot)
    from graphnav.evaluation import evaluate as judge
    from graphnav.report.plots import plot_run
    from graphnav.report.results import load, log_of
    from graphnav.report.terminal import evaluation_tables

    trajectory = load(arguments.folder)
    log = read_log(arguments.log)
    run_of = log_of(arguments.folder)
    evaluation = judge(trajectory, log, run_of=run_of)
    if run_of not in (None, log.name):
        print(f"graphnav: warning: {evaluation.notes[0]}", file=sys.stderr)
    if arguments.plot is not None:
        plot_run(trajectory, log, arguments.plot, evaluation)
    if arguments.json:
        print_json(evaluation.to_dict())
    else:
        evaluation_tables(evaluation)


def compare(arguments: argparse.Namespace) -> None:
    """Compare methods; what a method that failed leaves of the others is shown before its failure is told."""
    _check_picture(arguments.plot)
    _check_text(arguments.markdown)
    from graphnav.compare import compare as compare_methods
    from graphnav.report.comparison import plot, show
    from graphnav.report.terminal import ProgressBar

    config = _config(arguments)
    with ProgressBar() as progress:
        found = compare_methods(arguments.log, arguments.methods, config, arguments.seeds, progress)
    if arguments.json:
        print_json(found.to_dict())
    else:
        show(found)
    if arguments.markdown is not None:
        _write_text(arguments.markdown, found.to_markdown())
    if arguments.plot is not None and len(found.failed) < len(found.rows):
        plot(found, arguments.plot)
    if found.failed:
        row, others = found.failed[0], len(found.failed) - 1
        more = f" (and {others} more method{'s' * (others > 1)})" if others else ""
        raise GraphnavError(f"{row.method} failed: {row.error}{more}")


def bound(arguments: argparse.Namespace) -> None:
    """Show the Cramer-Rao bound of a log."""
    _check_picture(arguments.plot)
    from graphnav.bound import bound as bound_of
    from graphnav.report.limits import plot, show
    from graphnav.report.terminal import ProgressBar

    config = _config(arguments)
    log = read_log(arguments.log)
    with ProgressBar() as progress:
        found = bound_of(log, config, progress)
    if arguments.plot is not None:
        plot(found, arguments.plot)
    if arguments.json:
        print_json(found.to_dict())
    else:
        show(found)


def creep(arguments: argparse.Namespace) -> None:
    """Show the creep of a face; where the log has truth, its errors too."""
    from graphnav.creep import creep as creep_of
    from graphnav.creep import with_truth
    from graphnav.report.creep import show
    from graphnav.report.terminal import ProgressBar

    log, config = read_log(arguments.log), _config(arguments)
    with ProgressBar() as progress:
        found = creep_of(log, end=arguments.end, config=config, progress=progress)
    if log.truth is not None:
        try:
            found = with_truth(found, log)
        except GraphnavError as error:
            print(f"graphnav: warning: not judged by truth: {error}", file=sys.stderr)
    if arguments.json:
        print_json(found.to_dict())
    else:
        show(found)


def observability(arguments: argparse.Namespace) -> None:
    """Show which states a log makes observable."""
    _check_picture(arguments.plot)
    from graphnav.analysis import observe
    from graphnav.report.observability import plot, render
    from graphnav.report.terminal import ProgressBar

    source: Any = "filter" if arguments.filter else "graph"
    kind: Any = "smoothed" if arguments.smoothed else "causal"
    log, config = read_log(arguments.log), _config(arguments)
    with ProgressBar() as progress:
        found = observe(log, config, source=source, kind=kind, progress=progress)
    if arguments.plot is not None:
        plot(found, arguments.plot)
    if arguments.json:
        print_json(found.to_dict())
    else:
        render(found)


def _check_picture(path: Path | None) -> None:
    """Refuse a picture's name before the work, not after it."""
    from graphnav.report.plots import check_picture

    if path is not None:
        check_picture(path)


def _check_text(path: Path | None) -> None:
    """Refuse a text file's place before the work, not after it."""
    try:
        if path is not None:
            check_file(path)
    except OSError as error:
        raise _unwritable(path, error) from error


def _unwritable(path: Path | None, error: OSError) -> GraphnavError:
    return GraphnavError(f"{path}: cannot be written ({error.strerror or error})")


def _config(arguments: argparse.Namespace) -> Config | None:
    from graphnav.config import Config

    return None if arguments.config is None else Config.from_toml(arguments.config)


def _write_text(path: Path, text: str) -> None:
    """Write a text file, whole or not at all."""
    beside = path.with_name(f".{path.name}.writing-{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        beside.write_text(text, encoding="utf-8")
        beside.replace(path)
    except OSError as error:
        raise _unwritable(path, error) from error
    finally:
        beside.unlink(missing_ok=True)
