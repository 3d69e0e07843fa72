"""AER1513 dataset 3: what a stereo camera's tracked points add to rates, the points' places unknown."""

from __future__ import annotations

import dataclasses
import time

import numpy as np

import graphnav as gn
from benchmarks._report import Row, Target, row, say
from benchmarks._starloc import data_folder
from graphnav.config import Config
from graphnav.evaluation import evaluate
from graphnav.log import SensorLog
from graphnav.readers import aer1513

STEREO = Target(high=0.05)


def rows() -> list[Row]:
    """Rates alone, tracks beside them, and the same with a mounting that is not declared exact."""
    source = data_folder() / "aer1513_utias"
    if not (source / "dataset3.mat").is_file():
        say(f"no recording at {source}: set GRAPHNAV_DATA")
        return [row("aer1513 dataset 3, batch, tracks: position error", None, "m rms", target=STEREO)]
    log = aer1513.convert(source, dataset=3)
    assert log.stereo is not None
    unsure = dataclasses.replace(log, stereo=log.stereo.replace(mounting_sigma_deg=np.full(3, 0.5)))
    return [
        *judged("aer1513 dataset 3, batch, rates alone", log, "off"),
        *judged("aer1513 dataset 3, batch, tracks", log, target=STEREO),
        *judged("aer1513 dataset 3, batch, tracks, mounting to 0.5 deg", unsure),
    ]


def judged(name: str, log: SensorLog, form: str = "tight", target: Target | None = None) -> list[Row]:
    """Error at the keyframes against the motion capture, in three dimensions."""
    began = time.perf_counter()
    run = gn.smooth(dataclasses.replace(log, truth=None), Config.from_dict({"stereo": {"form": form}}))
    seconds = time.perf_counter() - began
    found = evaluate(run.trajectory, log)
    size = np.linalg.norm(found.error_n_m, axis=1)
    rms = float(np.sqrt((size**2).mean()))
    say(f"{name}: {rms:.4f} m")
    return [
        row(f"{name}: position error", rms, "m rms", target=target),
        row(f"{name}: position error, largest", float(size.max()), "m"),
        row(f"{name}: NEES", found.nees_position, "1"),
        row(f"{name}: share of readings left out", left_out(run, log), "1"),
        row(f"{name}: seconds", seconds, "s"),
    ]


def left_out(run: gn.Run, log: SensorLog) -> float:
    """Readings that disagree with the rest, of all."""
    assert log.stereo_tracks is not None
    return run.diagnostics.rejected.get("stereo_tracks", 0) / len(log.stereo_tracks)
