"""STAR-loc: what ranges, filters and the graph make of an IMU and raw ranges, and how much of it hangs on a choice."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

import numpy as np

import graphnav as gn
from benchmarks._report import ROOT, Row, Target, row, say
from factors.so3 import from_quaternion
from graphnav._metrics import truth_at
from graphnav.evaluation import evaluate
from graphnav.log import SensorLog
from graphnav.readers import starloc

DATA = "starloc_uwb_imu_stereo"
RECORDINGS = ("loop-2d-fast_s1", "loop-3d_s5")
GRAPH = Target(high=0.12)
#: Filters linearize along the way, and need a heading to begin with.
FILTER_HEADING_DEG = 10.0


def data_folder() -> Path:
    """Where recordings are looked for."""
    return Path(os.environ.get("GRAPHNAV_DATA") or ROOT.parent / "shared" / "data")


def folder() -> Path:
    """And those of this file."""
    return data_folder() / DATA


def rows() -> list[Row]:
    """Every recording at hand."""
    found = []
    for name in RECORDINGS:
        source = folder() / name
        if source.is_dir():
            found += recording_rows(source)
        else:
            say(f"no recording at {source}: set GRAPHNAV_DATA")
            found.append(row(f"starloc {name}, batch: position error", None, "m rms", target=GRAPH))
    return found


def recording_rows(source: Path) -> list[Row]:
    """One recording by the methods, then by the graph with other declarations."""
    log, headed = starloc.convert(source), starloc.convert(source, heading_sigma_deg=FILTER_HEADING_DEG)
    name = f"starloc {source.name}"
    found = []
    for method in ("uwb", "uwb-vbukf", "imu-uwb", "imu-uwb-vbukf"):
        found += judged(f"{name}, {method}", headed, method)
    without = judged(f"{name}, batch", log, target=GRAPH)
    found += without
    bound = None if without[0].value is None else Target(high=without[0].value)
    found += judged(f"{name}, batch, stereo", starloc.convert(source, stereo=True), target=bound)
    for what, other in others(log).items():
        found += judged(f"{name}, batch, {what}", other)[:1]
    return found + error_rows(name, log)


def others(log: SensorLog) -> dict[str, SensorLog]:
    """The log with one declaration changed at a time."""
    assert log.uwb is not None
    changed = {
        "white 0.03 m": log.uwb.replace(sigma_m=0.03),
        "white 0.10 m": log.uwb.replace(sigma_m=0.10),
        "Markov 0.05 m": log.uwb.replace(markov_sigma_m=0.05),
        "Markov 0.20 m": log.uwb.replace(markov_sigma_m=0.20),
        "Markov 2 s": log.uwb.replace(markov_time_s=2.0),
        "constant 0.1 m": log.uwb.replace(bias_sigma_m=0.1),
    }
    found = {what: dataclasses.replace(log, uwb=uwb) for what, uwb in changed.items()}
    if len(log.uwb.tag) > 1:
        found["one constant for both tags"] = dataclasses.replace(log, uwb=shared_constants(log))
    return found


def shared_constants(log: SensorLog) -> gn.log.Uwb:
    """Pairs of tag and anchor taken together again: an anchor has one constant, whatever tag it answers."""
    assert log.uwb is not None
    names = np.array([name.split("-")[0] for name in log.uwb.anchor_id], dtype=object)
    anchors = {a.id.split("-")[0]: a for a in log.uwb.anchor}
    return log.uwb.replace(anchor_id=names, anchor=tuple(a.replace(id=name) for name, a in anchors.items()))


def judged(name: str, log: SensorLog, method: str = "batch", target: Target | None = None) -> list[Row]:
    """Error at the keyframes, and consistency where there are covariances."""
    try:
        run = gn.smooth(dataclasses.replace(log, truth=None), method=method)
    except gn.errors.GraphnavError as error:
        say(f"{name}: {error}")
        return [row(f"{name}: position error", None, "m rms", target=target)]
    found = evaluate(run.trajectory, log)
    size = np.linalg.norm(found.error_n_m, axis=1)
    rms = float(np.sqrt((size**2).mean()))
    say(f"{name}: {rms:.3f} m")
    return [
        row(f"{name}: position error", rms, "m rms", target=target),
        row(f"{name}: position error, median", float(np.median(size)), "m"),
        row(f"{name}: position error, largest", float(size.max()), "m"),
        row(f"{name}: NEES", found.nees_position, "1"),
    ]


def error_rows(name: str, log: SensorLog) -> list[Row]:
    """What is wrong with the ranges, by the reference: constant of each pair, spread about it, what is far off."""
    uwb, truth = log.uwb, log.truth
    assert uwb is not None and truth is not None
    known, pos, quat = truth_at(truth, uwb.t_s)
    levers, places = (
        {i.id: getattr(i, v) for i in g} for g, v in ((uwb.tag, "lever_arm_b_m"), (uwb.anchor, "pos_n_m"))
    )
    tag = pos + np.einsum("kij,kj->ki", from_quaternion(quat), np.array([levers[i] for i in uwb.tag_id[known]]))
    anchor = uwb.anchor_id[known]
    error = uwb.range_m[known] - np.linalg.norm(tag - np.array([places[i] for i in anchor]), axis=1)
    constant = {i: float(np.median(error[anchor == i])) for i in sorted(places)}
    rest = error - np.array([constant[i] for i in anchor])
    return [
        *(row(f"{name}, ranges: constant of {i}", value, "m") for i, value in constant.items()),
        row(f"{name}, ranges: spread about it (1.48 x median)", float(1.48 * np.median(np.abs(rest))), "m"),
        row(f"{name}, ranges: share over 0.3 m too long", float((rest > 0.3).mean()), "1"),
        row(f"{name}, ranges: share over 0.3 m too short", float((rest < -0.3).mean()), "1"),
    ]
