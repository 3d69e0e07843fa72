"""Plaza1: what odometry alone, ranges with a constant alone, and ranges with a scale error make of the drive."""

from __future__ import annotations

import dataclasses

import numpy as np

import graphnav as gn
from benchmarks._planar import Judged, judge
from benchmarks._report import Row, Target, row, say
from graphnav.log import SensorLog
from graphnav.readers import plaza
from graphnav.run import Run

GRAPH = Target(high=0.5)


def smoothed(log: SensorLog, method: str = "batch") -> Run:
    """The run, which never sees the truth."""
    return gn.smooth(dataclasses.replace(log, truth=None), method=method)


def rows() -> list[Row]:
    """The drive as declared, then with one declaration changed at a time."""
    log = plaza.convert()
    assert log.uwb is not None
    run = smoothed(log)
    found = [
        *_rows("plaza1, odometry alone, laid where ranges fit it", judge(smoothed(log, "dead-reckoning"), log), None),
        *_rows("plaza1, batch", judge(run, log), GRAPH),
        *_calibration(run),
    ]
    changed = {
        "constants only": log.uwb.replace(scale_sigma=None),
        "constants only, Markov 1.5 m, 20 s": log.uwb.replace(scale_sigma=None, markov_sigma_m=1.5, markov_time_s=20.0),
        "white 0.3 m": log.uwb.replace(sigma_m=0.3),
        "Markov 1 m, 20 s": log.uwb.replace(markov_sigma_m=1.0, markov_time_s=20.0),
        "no Markov error": log.uwb.replace(markov_sigma_m=None, markov_time_s=None),
    }
    for what, uwb in changed.items():
        other = smoothed(dataclasses.replace(log, uwb=uwb))
        found += _rows(f"plaza1, batch, {what}", judge(other, log), GRAPH if what == "constants only" else None)
    return found + error_rows(log)


def _rows(name: str, found: Judged, target: Target | None) -> list[Row]:
    say(f"{name}: {found.rms_m:.3f} m")
    return [
        row(f"{name}: position error in the plane", found.rms_m, "m rms", target=target),
        row(f"{name}: largest error", found.max_m, "m"),
        row(f"{name}: NEES", found.nees, "1"),
    ]


def _calibration(run: Run) -> list[Row]:
    found = []
    for name, item in run.calibration.items():
        found += [row(f"plaza1, batch: {name}", item.value, item.unit)]
        found += [row(f"plaza1, batch: sigma of {name}", item.sigma, item.unit)]
    return found


def error_rows(log: SensorLog) -> list[Row]:
    """What is wrong with the ranges, by the reference: median, and the line of the error over the distance."""
    uwb, truth = log.uwb, log.truth
    assert uwb is not None and truth is not None
    pos = np.column_stack([np.interp(uwb.t_s, truth.t_s, truth.pos_n_m[:, axis]) for axis in range(3)])
    places = {a.id: a.pos_n_m for a in uwb.anchor}
    distance = np.linalg.norm(pos - np.array([places[i] for i in uwb.anchor_id]), axis=1)
    error = uwb.range_m - distance
    slope, offset = np.polyfit(distance, error, 1)
    return [
        row("plaza1, ranges: median error", float(np.median(error)), "m"),
        row("plaza1, ranges: error by distance", float(slope), "1"),
        row("plaza1, ranges: error at no distance", float(offset), "m"),
        row("plaza1, ranges: spread about this line", float((error - slope * distance - offset).std()), "m"),
    ]
