"""The commands that make and describe logs, one function each; they take the parsed arguments."""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from graphnav.errors import GraphnavError

if TYPE_CHECKING:
    from graphnav.log import SensorLog

#: Format -> (module with `convert`, the options it takes).
IMPORTERS = {
    "aer1513": ("graphnav.readers.aer1513", ("dataset", "landmarks", "interval_s")),
    "comma2k19": ("graphnav.readers.comma2k19", ("wheel_scale",)),
    "euroc": ("graphnav.readers.euroc", ("position_rate_hz",)),
    "kitti-gtsam": ("graphnav.readers.kitti_gtsam", ()),
    "kitti-stereo": ("graphnav.readers.kitti_stereo", ()),
    "kitti-tracks": ("graphnav.readers.kitti_tracks", ()),
    "lego": ("graphnav.readers.lego", ()),
    "plaza": ("graphnav.readers.plaza", ()),
    "starloc": ("graphnav.readers.starloc", ("heading_sigma_deg", "stereo")),
}
#: Formats whose data come with the gtsam package.
_WITH_GTSAM = ("kitti-gtsam", "kitti-tracks", "plaza")


def info(arguments: argparse.Namespace) -> None:
    """Describe a log."""
    from graphnav.report.info import describe, render

    known = describe(read_log(arguments.log))
    if arguments.json:
        print_json(known)
    else:
        render(known)


def import_log(arguments: argparse.Namespace) -> None:
    """Convert recorded data to a log folder."""
    from graphnav.readers.image_files import gathered
    from graphnav.readers.writer import check_output
    from graphnav.report.terminal import working

    module, options = IMPORTERS[arguments.format]
    every = sorted({name for _, names in IMPORTERS.values() for name in names})
    given = {name: getattr(arguments, name) for name in every}
    chosen = {name: value for name, value in given.items() if value is not None}
    foreign = sorted(set(chosen) - set(options))
    if foreign:
        raise GraphnavError(f"{arguments.format} takes no --{foreign[0].replace('_', '-')}; leave it out")
    if arguments.source is None and arguments.format not in _WITH_GTSAM:
        raise GraphnavError(f"{arguments.format} needs SRC, the folder of its data")
    check_output(arguments.output, overwrite=arguments.overwrite)
    with working("converting"):
        log, images = gathered(importlib.import_module(module).convert(arguments.source, **chosen))
        _write(log, arguments, images)


def simulate(arguments: argparse.Namespace) -> None:
    """Simulate a scenario to a log folder."""
    from graphnav.readers.writer import check_output

    check_output(arguments.output, overwrite=arguments.overwrite)
    from graphnav.report.terminal import ProgressBar, working
    from graphnav.simulation import simulate as simulate_log
    from graphnav.simulation.stereo_images import render_into

    names = (
        "interval_m", "par", "hours", "sensors", "cycles", "scans", "draw", "site", "nlos_share", "nlos_max_m",
        "rate_hz", "images", "tracks", "outlier_share",
    )  # fmt: skip
    given = {name: getattr(arguments, name) for name in names}
    options = {name: value for name, value in given.items() if value is not None}
    if "sensors" in options:
        options["sensors"] = tuple(name.strip() for name in options["sensors"].split(","))
    _check_options(arguments.scenario, options)
    with working("simulating"):
        log = simulate_log(arguments.scenario, seed=arguments.seed, **options)
    if log.stereo_pairs is None:
        _write(log, arguments)
        return
    with ProgressBar() as progress:
        _write(log, arguments, partial(render_into, arguments.scenario, arguments.seed, options, progress=progress))


def _check_options(scenario: str, options: dict[str, Any]) -> None:
    """Refuse what a scenario does not take, by the names that the command line has for it."""
    from graphnav.simulation import SCENARIOS

    taken = SCENARIOS.get(scenario, {"options": options})["options"]
    flags = {name: f"--{name.removesuffix('_m').replace('_', '-')}" for name in (*options, *taken)}
    for name in options:
        if name not in taken:
            raise GraphnavError(
                f"{scenario} takes no {flags[name]}; it takes {', '.join(flags[each] for each in taken)}"
            )


def _write(log: SensorLog, arguments: argparse.Namespace, images: Callable[[Path], None] | None = None) -> None:
    from graphnav.readers import write

    write(log, arguments.output, tables=arguments.tables, overwrite=arguments.overwrite, images=images)
    rows = ", ".join(f"{name} {len(table):,}" for name, table in log.tables().items())
    print(f"wrote {arguments.output}: {rows}", file=sys.stderr)


def read_log(path: Path) -> SensorLog:
    """Read a log, with a word of it on a terminal."""
    from graphnav.readers import read
    from graphnav.report.terminal import working

    with working(f"reading {path}"):
        return read(path)


def print_json(value: Any) -> None:
    """Print figures on standard output."""
    from graphnav.report.text import to_json

    print(to_json(value), flush=True)
