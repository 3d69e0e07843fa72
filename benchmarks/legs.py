"""The leg finder: speed, what it finds and how well, on simulated rows of supports and on the LEGO recording.

Speed: scans to numbered landmarks, compiled code loaded before, the fastest of a few runs on one thread. Simulated rows
hold legs that lean by 10 deg, dust, lost beams and supports that advance; a leg counts as visible when at least 70 % of
its width is in sight and it spans 6 beams. The LEGO rows need the recording (GRAPHNAV_DATA or ../shared/data); without
it they have no values, and their targets are not met. Takes about 10 s, compilation apart.
"""

from __future__ import annotations

import os
import time
from pathlib import Path

import numpy as np

from benchmarks._leg_scans import Push, Row, Scanned, scanned
from benchmarks._lego_legs import Judged, judge, rms
from benchmarks._report import ROOT, Before, Target, parser, publish, row, say
from benchmarks._report import Row as Figure
from graphnav.frontends.legs import detect, legs

SECONDS, SEED = 120.0, 4
FEWEST_BEAMS, SHARE = 6, 0.7
PUSHES = (Push(10, 20.0), Push(11, 45.0), Push(12, 70.0))
RATE = Target(low=2000.0)
RECALL = Target(low=0.95)
CENTRE_MM = Target(high=25.0)


def speed(case: Scanned, repeats: int) -> tuple[float, float]:
    """Scans per second of detection alone, and of all steps."""
    scans, lidar = case.log.lidar_scans, case.log.lidar
    assert scans is not None and lidar is not None
    legs(case.log)
    best_detect, best = np.inf, np.inf
    for _ in range(repeats):
        start = time.perf_counter()
        detect(scans, lidar)
        middle = time.perf_counter()
        legs(case.log)
        best_detect = min(best_detect, middle - start)
        best = min(best, time.perf_counter() - middle)
    return len(scans) / best_detect, len(scans) / best


def simulated_rows(case: Scanned, look: Row, name: str) -> list[Figure]:
    """Recall, centre error and consistency on a simulated row."""
    assert case.log.lidar_scans is not None and case.log.lidar is not None
    found = detect(case.log.lidar_scans, case.log.lidar)
    error = found.pos_s_m[:, None] - case.legs_m[found.scan]
    distance = np.linalg.norm(error, axis=-1)
    nearest = distance.argmin(axis=1)
    right = distance.min(axis=1) < look.diameter_m / 2
    e = error[np.arange(len(found)), nearest][right]
    step = np.radians(look.fov_deg) / (look.beams - 1)
    far = np.linalg.norm(case.legs_m, axis=-1)
    visible = (case.share > SHARE) & (case.share * look.diameter_m / far > FEWEST_BEAMS * step)
    hit = np.zeros(visible.shape, bool)
    hit[found.scan[right], nearest[right]] = True
    nees = np.einsum("ki,kij,kj->k", e, np.linalg.inv(found.cov_s_m2[right]), e).mean() / 2
    return [
        row(f"{name}: share of visible legs found", float(hit[visible].mean()), "1", target=RECALL),
        row(f"{name}: detections that are no leg", float((~right).mean()), "1"),
        row(f"{name}: centre error", 1e3 * rms(e), "mm rms"),
        row(f"{name}: NEES of a centre", float(nees), "1"),
    ]


def number_rows(case: Scanned) -> list[Figure]:
    """Numbers given to legs at rest: one each, a new one after a push, none while it moves."""
    scans = case.log.lidar_scans
    points = legs(case.log).points
    assert scans is not None and points is not None
    at = np.searchsorted(scans.t_s, points.t_s)
    place = points.range_m[:, None] * np.column_stack([-np.sin(points.angle_rad), np.cos(points.angle_rad)])
    leg = np.linalg.norm(case.legs_m[at] - place[:, None], axis=-1).argmin(axis=1)
    moved = case.legs_m[at, leg, 0]
    mixed, travelled = 0, 0.0
    for number in np.unique(points.feature):
        own = points.feature == number
        mixed += len(np.unique(leg[own])) > 1
        travelled = max(travelled, float(np.ptp(moved[own])))
    landmarks = {(int(k), round(float(m), 3)) for k, m in zip(leg, moved, strict=True)}
    return [
        row("row: numbers given per landmark", len(np.unique(points.feature)) / len(landmarks), "1"),
        row("row: numbers that mix two legs", mixed, "1"),
        row("row: largest motion within one number", 1e3 * travelled, "mm"),
    ]


def lego_rows(judged: Judged | None) -> list[Figure]:
    """The recording; None where it is not at hand."""

    def figure(name: str, value: float | None, unit: str, target: Target | None = None) -> Figure:
        return row(f"lego: {name}", value, unit, target=target)

    j = judged
    return [
        figure("share of visible cylinders found", j.recall if j else None, "1", RECALL),
        figure("visible cylinders", j.visible if j else None, "1"),
        figure("centres that match no cylinder", j.other if j else None, "1"),
        figure("centre error, reference pose", 1e3 * rms(j.error_m) if j else None, "mm rms", CENTRE_MM),
        figure("centre error, reference place, heading free", 1e3 * j.own_heading_rms_m if j else None, "mm rms"),
        figure("centre error, pose free", 1e3 * j.own_pose_rms_m if j else None, "mm rms"),
        figure("centre error, pose and landmarks free", 1e3 * j.own_map_rms_m if j else None, "mm rms"),
    ]


def recording() -> Judged | None:
    """Judge the recording where there is one."""
    folder = Path(os.environ.get("GRAPHNAV_DATA") or ROOT.parent / "shared" / "data") / "lego_lidar_cylinders"
    if not folder.is_dir():
        say(f"no recording at {folder}: set GRAPHNAV_DATA")
        return None
    return judge(folder)


def main() -> None:
    """Measure and print."""
    arguments = parser(__doc__)
    arguments.add_argument("--repeats", type=int, default=3, help="runs of which the fastest counts")
    options = arguments.parse_args()
    before = Before.now()
    rows: list[Figure] = []
    for beams in (360, 720):
        look = Row(beams=beams)
        case = scanned(look, SECONDS, SEED, PUSHES)
        alone, whole = speed(case, options.repeats)
        say(f"{beams} beams: {whole:.0f} scans/s")
        rows.append(row(f"{beams} beams: scans to landmarks", whole, "scans/s", target=RATE))
        rows.append(row(f"{beams} beams: detection alone", alone, "scans/s"))
        rows += simulated_rows(case, look, f"{beams} beams")
    rows += number_rows(case)
    publish(rows + lego_rows(recording()), options.json, before)


if __name__ == "__main__":
    main()
