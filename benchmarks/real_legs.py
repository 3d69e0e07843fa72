"""Robots without an IMU in the graph: wheels and laser landmarks, on three recordings.

AER1513 dataset 2 (a floor among 17 tubes, 10.5 min), dataset 1 (a line with one cylinder, 21 min) and the LEGO robot
(six cylinders, detected in raw scans). Errors are those of the position in the plane (on the line: along it) at the
keyframes, against the reference, nothing aligned; NEES is the mean of e' P^-1 e by the number of these axes. Needs the
recordings (GRAPHNAV_DATA or ../shared/data); a row without its recording has no value, and its target is not met. Takes
about a minute, compilation of the leg finder apart.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import graphnav as gn
from benchmarks._planar import Judged, judge, repeated, residuals, seen_places
from benchmarks._report import ROOT, Before, Row, Target, parser, publish, row, say
from benchmarks._wheel_fit import FITTED_S, best_corrections
from factors.so3 import Array
from graphnav.config import Config
from graphnav.frontends.legs import legs, with_legs
from graphnav.log import Landmark, SensorLog
from graphnav.readers import aer1513, lego
from graphnav.readers.aer1513 import AS_RECORDED, CORRECTIONS
from graphnav.run import Run

FLOOR = Target(high=0.06)
LINE = Target(high=0.03)
LEGO_MM = Target(high=30.0)
#: A cylinder of the landmark file this close to where a number's readings put it is that number's.
MATCH_M = 0.15
#: What the landmark file is off the scans (docs/legs.md).
PLACE_SIGMA_M = 0.02
LAGS_S, LEGO_LAGS_S = (0.1, 1.0, 5.0), (0.2, 1.0, 2.0)
SELDOM_S = 2.0


def smoothed(log: SensorLog, use_legs: bool = True) -> Run:
    """The run, which never sees the truth."""
    config = Config.from_dict({"lidar": {"use": use_legs}})
    return gn.smooth(dataclasses.replace(log, truth=None), config)


def surveyed(log: SensorLog, run: Run, marks: Array) -> SensorLog:
    """The log with every leg number surveyed that the run puts on a place of the landmark file (J, 2)."""
    found = []
    for number, place in seen_places(run, log).items():
        distance = np.linalg.norm(marks - place, axis=1)
        if distance.min() < MATCH_M:
            there = np.r_[marks[distance.argmin()], 0.0]
            found.append(Landmark(feature=number, pos_n_m=there, sigma_m=PLACE_SIGMA_M))
    assert log.lidar is not None
    return dataclasses.replace(log, lidar=log.lidar.replace(landmark=tuple(found)))


def floor_rows(folder: Path) -> list[Row]:
    """AER1513 dataset 2."""

    def case(name: str, use_legs: bool = True, target: Target | None = None, **options: Any) -> list[Row]:
        log = aer1513.convert(folder, **options)
        return _rows(f"floor, {name}", judge(smoothed(log, use_legs), log), "m", target)

    log = aer1513.convert(folder)
    late = judge(smoothed(log), log, after_s=FITTED_S)
    return [
        *case("wheels alone", use_legs=False),
        *case("tubes known", target=FLOOR),
        *_rows(f"floor, tubes known, after {FITTED_S:g} s", late, "m", FLOOR),
        *case("tubes unknown", landmarks="unknown"),
        *case("wheels alone, as recorded", use_legs=False, corrections=AS_RECORDED),
        *case("tubes known, as recorded", corrections=AS_RECORDED, target=FLOOR),
        *case("tubes unknown, as recorded", landmarks="unknown", corrections=AS_RECORDED),
        *every_scan_rows(folder),
        *fit_rows(folder),
    ]


def every_scan_rows(folder: Path) -> list[Row]:
    """All scans, ten a second: their errors repeat each other, so that they count for too much."""
    log = aer1513.convert(folder, interval_s=0.1)
    run = smoothed(log)
    found = _rows("floor, tubes known, every scan", judge(run, log), "m", FLOOR)
    return found + _repeated_rows("floor, every scan", run, log, LAGS_S)


def fit_rows(folder: Path) -> list[Row]:
    """The importer's corrections found again, by wheels and laser alone."""
    found = []
    for name, (value, sigma) in best_corrections(folder).items():
        found.append(row(f"floor, first {FITTED_S:g} s: {name}", value, "SI", peer=getattr(CORRECTIONS[2], name)))
        found.append(row(f"floor, first {FITTED_S:g} s: sigma of {name}", sigma, "SI"))
    return found


def line_rows(folder: Path) -> list[Row]:
    """AER1513 dataset 1."""

    def case(name: str, use_legs: bool = True, target: Target | None = None, **options: Any) -> list[Row]:
        log = aer1513.convert(folder, dataset=1, **options)
        return _rows(f"line, {name}", judge(smoothed(log, use_legs), log, axes=1), "m", target)

    return [
        *case("wheels alone", use_legs=False),
        *case("range once a second", target=LINE),
        *case("range once a second, as recorded", corrections=AS_RECORDED, target=LINE),
    ]


def lego_rows(folder: Path) -> list[Row]:
    """The LEGO robot, cylinders by the leg finder."""
    log = lego.convert(folder)
    log = with_legs(log, legs(log, side=None, sweep_s=lego.SWEEP_S))
    free = smoothed(log)
    known_log = surveyed(log, free, lego.landmarks(folder))
    known, seldom = smoothed(known_log), smoothed(seldom_seen(known_log, SELDOM_S))
    return [
        *_rows("lego, tracks alone", judge(smoothed(log, use_legs=False), log), "mm", None),
        *_rows("lego, cylinders known", judge(known, log), "mm", LEGO_MM),
        *_rows("lego, cylinders unknown", judge(free, log), "mm", LEGO_MM),
        *_rows(f"lego, cylinders known, a scan each {SELDOM_S:g} s", judge(seldom, log), "mm", LEGO_MM),
        *_repeated_rows("lego", known, known_log, LEGO_LAGS_S, near_s=0.05),
    ]


def seldom_seen(log: SensorLog, interval_s: float) -> SensorLog:
    """The log with detections of scans at least an interval apart."""
    points = log.lidar_points
    assert points is not None
    kept: list[float] = []
    for t in np.unique(points.t_s).tolist():
        if not kept or t - kept[-1] >= interval_s:
            kept.append(t)
    rows = np.isin(points.t_s, kept)
    columns = {name: getattr(points, name)[rows] for name in ("t_s", "feature", "range_m", "angle_rad")}
    return dataclasses.replace(log, lidar_points=points.replace(**columns))


def _rows(name: str, found: Judged, unit: str, target: Target | None) -> list[Row]:
    say(f"{name}: {found.rms_m:.4f} m")
    size = 1e3 if unit == "mm" else 1.0
    return [
        row(f"{name}: position error", size * found.rms_m, f"{unit} rms", target=target),
        row(f"{name}: largest error", size * found.max_m, unit),
        row(f"{name}: NEES", found.nees, "1"),
    ]


def _repeated_rows(name: str, run: Run, log: SensorLog, lags_s: tuple[float, ...], near_s: float = 2e-3) -> list[Row]:
    """How far what known legs leave of a reading is that of the reading before."""
    t_s, feature, left = residuals(run, log)
    found = []
    for column, what in enumerate(("range", "bearing")):
        for lag in lags_s:
            value = repeated(t_s, feature, left[:, column], lag, near_s)
            found.append(row(f"{name}: correlation of {what} residuals {lag:g} s apart", value, "1"))
    return found


def recorded(name: str, measure: Callable[[Path], list[Row]], missing: list[Row]) -> list[Row]:
    """The rows of a recording, or those that say it is not at hand."""
    folder = Path(os.environ.get("GRAPHNAV_DATA") or ROOT.parent / "shared" / "data") / name
    if folder.is_dir():
        return measure(folder)
    say(f"no recording at {folder}: set GRAPHNAV_DATA")
    return missing


def main() -> None:
    """Measure and print."""
    options = parser(__doc__).parse_args()
    before = Before.now()
    rows = recorded(
        "aer1513_utias",
        lambda folder: floor_rows(folder) + line_rows(folder),
        [
            row("floor, tubes known: position error", None, "m rms", target=FLOOR),
            row("line, range once a second: position error", None, "m rms", target=LINE),
        ],
    )
    rows += recorded(
        "lego_lidar_cylinders",
        lego_rows,
        [row("lego, cylinders known: position error", None, "mm rms", target=LEGO_MM)],
    )
    publish(rows, options.json, before)


if __name__ == "__main__":
    main()
