"""The command line: parses, calls, prints. JSON goes to standard output, all else to standard error."""

from __future__ import annotations

import argparse
import os
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from graphnav import __version__, commands, log_commands
from graphnav.errors import GraphnavError
from graphnav.methods import METHODS


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; return the exit status: 0 done, 2 an error with a fix, 1 any other, 130 interrupted."""
    _one_thread_each()
    words = list(sys.argv[1:] if argv is None else argv)
    try:
        arguments = _parser().parse_args(words)
        arguments.run(arguments)
        return 0
    except GraphnavError as error:
        _show_trace(words)
        print(f"graphnav: error: {_one_line(error)}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("graphnav: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:
        # Whoever read standard output has gone; keep Python from complaining about it at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as error:
        _show_trace(words)
        advice = "" if "--traceback" in words else "; rerun with --traceback to see where"
        print(f"graphnav: unexpected {type(error).__name__}: {_one_line(error)}{advice}", file=sys.stderr)
        return 1


def _one_thread_each() -> None:
    """One thread for BLAS, before numpy is imported: more of them make small matrices slower."""
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


def _show_trace(words: Sequence[str]) -> None:
    if "--traceback" in words:
        traceback.print_exc()


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, like all others."""

    def error(self, message: str) -> NoReturn:
        raise GraphnavError(f"{message}; see {self.prog} --help")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="graphnav", description="Offline factor-graph smoothing of recorded navigation logs.")
    parser.add_argument("--version", action="version", version=f"graphnav {__version__}")
    group = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    everything = (
        _add_demo, _add_info, _add_import, _add_simulate, _add_smooth, _add_evaluate, _add_compare, _add_bound,
        _add_creep, _add_observability,
    )  # fmt: skip
    for add in everything:
        add(group)
    return parser


def _command(group: Any, name: str, run: Any, text: str, example: str) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = group.add_parser(
        name,
        help=text[0].lower() + text[1:].split(".")[0],
        description=text,
        epilog=f"example:\n  {example}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.set_defaults(run=run)
    parser.add_argument("--traceback", action="store_true", help="on an error, show where it arose")
    return parser


def _add_demo(group: Any) -> None:
    text = "Simulate a shearer and take a recorded drive, smooth both, judge and draw them."
    parser = _command(group, "demo", commands.demo, text, "graphnav demo -o demo")
    parser.add_argument("-o", "--output", type=Path, default=Path("graphnav-demo"), metavar="DIR", help="%(default)s")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")


def _add_info(group: Any) -> None:
    text = "Describe a log: sensors, rates, gaps, spans at rest, units that look wrong."
    parser = _command(group, "info", log_commands.info, text, "graphnav info shift_042/")
    parser.add_argument("log", type=Path, metavar="LOG", help="log folder")
    parser.add_argument("--json", action="store_true", help="print JSON")


def _add_import(group: Any) -> None:
    text = "Convert recorded data of another format to a log folder."
    example = "graphnav import kitti-gtsam -o kitti/"
    parser = _command(group, "import", log_commands.import_log, text, example)
    parser.add_argument(
        "format",
        metavar="FORMAT",
        choices=sorted(log_commands.IMPORTERS),
        help=", ".join(sorted(log_commands.IMPORTERS)),
    )
    parser.add_argument(
        "source",
        type=Path,
        metavar="SRC",
        nargs="?",
        help="folder of the data; kitti-gtsam, kitti-tracks and plaza come with gtsam",
    )
    _add_log_output(parser)
    parser.add_argument("--wheel-scale", type=float, help="comma2k19: known scale-factor error of the wheels")
    parser.add_argument("--position-rate-hz", type=float, help="euroc: rate of the positions given")
    parser.add_argument("--dataset", type=int, choices=(1, 2, 3), help="aer1513: line, floor (default), stereo")
    places = "aer1513: whether the tubes are surveyed (default known)"
    parser.add_argument("--landmarks", choices=("known", "unknown"), help=places)
    parser.add_argument("--interval-s", type=float, help="aer1513: least time between laser scans (default 1)")
    heading = "starloc: take the heading at the start from the reference, to this sigma"
    parser.add_argument("--heading-sigma-deg", type=float, help=heading)
    tags = "starloc: with the stereo camera, and what it sees of AprilTags"
    parser.add_argument("--stereo", action="store_const", const=True, help=tags)


def _add_simulate(group: Any) -> None:
    text = (
        "Simulate a reference scenario, truth included: shearer-mems, full-shift, shearer-lidar, face-end-uwb,"
        " roadheader-stereo."
    )
    example = "graphnav simulate shearer-mems --seed 11 -o shift/"
    parser = _command(group, "simulate", log_commands.simulate, text, example)
    parser.add_argument("scenario", metavar="SCENARIO")
    parser.add_argument("--seed", type=int, default=0, help="of the random errors (default %(default)s)")
    _add_log_output(parser)
    spacing = "shearer-mems: spacing of the closed-path points, 2, 6 or 10 m"
    parser.add_argument("--interval", dest="interval_m", type=float, metavar="M", help=spacing)
    added = "shearer-mems: error setting 1-12 of the paper's Table 2, added on top"
    parser.add_argument("--par", type=int, metavar="N", help=added)
    parser.add_argument("--hours", type=float, metavar="H", help="full-shift: length of the log")
    parser.add_argument("--sensors", metavar="A,B,C", help="shearer-mems, full-shift: of imu,odometer,closed-path,uwb")
    parser.add_argument("--cycles", type=int, metavar="N", help="shearer-lidar: number of cutting cycles, 1 to 6")
    scans = "shearer-lidar: raw scans around the stops at the ends of the face (default: with them)"
    parser.add_argument("--scans", action=argparse.BooleanOptionalAction, help=scans)
    drawn = "shearer-lidar: draw the errors that are the paper's fixed values by default"
    parser.add_argument("--draw", action="store_const", const=True, help=drawn)
    parser.add_argument("--site", metavar="SITE", help="face-end-uwb: surface or underground (default)")
    delayed = "face-end-uwb: share of ranges that come late, 0 to 1"
    parser.add_argument("--nlos-share", type=float, metavar="X", help=delayed)
    most = "face-end-uwb: they are late by up to so much (default 3)"
    parser.add_argument("--nlos-max", "--nlos-max-m", dest="nlos_max_m", type=float, metavar="M", help=most)
    frames = "roadheader-stereo: frames per second, 1 to 30 (default 5)"
    parser.add_argument("--rate", "--rate-hz", dest="rate_hz", type=float, metavar="HZ", help=frames)
    pairs = "roadheader-stereo: rendered image pairs (default: with them)"
    parser.add_argument("--images", action=argparse.BooleanOptionalAction, help=pairs)
    tracks = "roadheader-stereo: tracks of features drawn without images"
    parser.add_argument("--tracks", action="store_const", const=True, help=tracks)
    wrong = "roadheader-stereo: share of wrong matches among the tracks, 0 to less than 1"
    parser.add_argument("--outlier-share", type=float, metavar="X", help=wrong)


def _add_smooth(group: Any) -> None:
    text = "Smooth a log: states with covariances at keyframes, written to a run folder."
    parser = _command(group, "smooth", commands.smooth, text, "graphnav smooth shift/ -o run/")
    parser.add_argument("log", type=Path, metavar="LOG", help="log folder")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="RUN", help="run folder to write")
    parser.add_argument("--method", choices=tuple(METHODS), default="batch", help="default %(default)s")
    parser.add_argument("--config", type=Path, metavar="FILE", help="configuration (TOML) in place of defaults")
    parser.add_argument("--overwrite", action="store_true", help="replace RUN whatever it holds")


def _add_evaluate(group: Any) -> None:
    text = "Judge a run by the truth in its log."
    parser = _command(group, "evaluate", commands.evaluate, text, "graphnav evaluate run/ shift/ --plot run.png")
    parser.add_argument("folder", type=Path, metavar="RUN", help="run folder")
    parser.add_argument("log", type=Path, metavar="LOG", help="log folder with truth")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw it (.png, .pdf or .svg)")


def _add_compare(group: Any) -> None:
    text = "Compare methods on a log, or on many seeds of a scenario."
    example = "graphnav compare shift/ --methods batch,rts,ekf --plot compare.png"
    parser = _command(group, "compare", commands.compare, text, example)
    parser.add_argument("log", metavar="LOG", help="log folder, or the name of a scenario")
    names = ",".join(METHODS)
    parser.add_argument("--methods", type=_names, metavar="A,B,C", help=f"default all: {names}")
    parser.add_argument(
        "--seeds", type=int, default=0, metavar="N", help="simulate the log's scenario again with seeds 0 to N-1"
    )
    parser.add_argument("--config", type=Path, metavar="FILE", help="configuration (TOML) in place of defaults")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the table")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw it (.png, .pdf or .svg)")


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _add_bound(group: Any) -> None:
    text = "The Cramer-Rao bound of a log with truth, beside what the batch smoother achieves."
    parser = _command(group, "bound", commands.bound, text, "graphnav bound shift/ --plot bound.png")
    parser.add_argument("log", type=Path, metavar="LOG", help="log folder with truth")
    parser.add_argument("--config", type=Path, metavar="FILE", help="configuration (TOML) in place of defaults")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw it (.png, .pdf or .svg)")


def _add_creep(group: Any) -> None:
    text = (
        "Creep of a longwall face after every cycle, from LiDAR scans of the roadway and from the smoothed positions."
    )
    parser = _command(group, "creep", commands.creep, text, "graphnav creep shift/ --end far")
    parser.add_argument("log", type=Path, metavar="LOG", help="log folder with raw scans at the ends of the face")
    parser.add_argument("--end", choices=("near", "far"), default="near", help="of the face (default %(default)s)")
    parser.add_argument("--config", type=Path, metavar="FILE", help="configuration (TOML) in place of defaults")
    parser.add_argument("--json", action="store_true", help="print JSON")


def _add_observability(group: Any) -> None:
    text = "Say which states a log makes observable, over time, and what it leaves confused with what."
    example = "graphnav observability shift/ --plot observability.png"
    parser = _command(group, "observability", commands.observability, text, example)
    parser.add_argument("log", type=Path, metavar="LOG", help="log folder")
    parser.add_argument("--smoothed", action="store_true", help="each time from the whole log, not the log up to it")
    parser.add_argument("--filter", action="store_true", help="from the Kalman filter's covariances, not the graph's")
    parser.add_argument("--config", type=Path, metavar="FILE", help="configuration (TOML) in place of defaults")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw it (.png, .pdf or .svg)")


def _add_log_output(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="LOG", help="log folder to write")
    parser.add_argument("--tables", choices=("parquet", "csv"), default="parquet", help="default %(default)s")
    parser.add_argument("--overwrite", action="store_true", help="replace LOG whatever it holds")
