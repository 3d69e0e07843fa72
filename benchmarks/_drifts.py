"""KITTI: stereo odometry of an excerpt with images, and of a drive whose features come with gtsam."""

from __future__ import annotations

import dataclasses
import time

import numpy as np

import graphnav as gn
from benchmarks._report import Row, Target, row, say
from benchmarks._starloc import data_folder
from factors import so3
from factors.so3 import Array
from graphnav._drift import kitti_drift
from graphnav.config import Config
from graphnav.evaluation import evaluate
from graphnav.log import SensorLog
from graphnav.readers import kitti_stereo, kitti_tracks
from graphnav.run import Run

#: Segments of the excerpt, which is 60 m long, m.
SEGMENTS_M = (10.0, 20.0, 30.0, 40.0, 50.0)
TRANSLATION, ROTATION = Target(high=1.5), Target(high=0.01)
#: Name -> method and form of `stereo.form`.
METHODS = {"stereo": ("stereo", "loose"), "batch, loose": ("batch", "loose"), "batch, tight": ("batch", "tight")}
#: Camera axes (right, down, forward) -> right, forward, up.
_RFU_FROM_CAMERA = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def smoothed(log: SensorLog, name: str, features: str = "orb") -> tuple[Run, float]:
    """The run, which never sees the truth, and its seconds."""
    method, form = METHODS[name]
    config = Config.from_dict({"stereo": {"form": form}, "stereo_tracks": {"features": features}})
    began = time.perf_counter()
    run = gn.smooth(dataclasses.replace(log, truth=None), config, method=method)
    return run, time.perf_counter() - began


def stereo_rows() -> list[Row]:
    """The excerpt with images, by features and methods."""
    source = data_folder() / "kitti_stereo"
    if not source.is_dir():
        say(f"no recording at {source}: set GRAPHNAV_DATA")
        name = "kitti_stereo, orb, batch, tight"
        return [
            row(f"{name}: translational drift", None, "%", target=TRANSLATION),
            row(f"{name}: rotational drift", None, "deg/m", target=ROTATION),
        ]
    log, found = kitti_stereo.convert(source), []
    for features in ("orb", "sift"):
        for method in METHODS:
            run, seconds = smoothed(log, method, features)
            found += judged(f"kitti_stereo, {features}, {method}", run, log, seconds)
    return found + reference_rows(log)


def poses(run: Run, t_s: Array) -> tuple[Array, Array]:
    """Rotations (N, 3, 3) and positions (N, 3) at times (N,)."""
    states = run.trajectory.at(t_s)
    return states.rotation_nb, states.pos_n


def judged(name: str, run: Run, log: SensorLog, seconds: float) -> list[Row]:
    """Drift by the KITTI measure, over all of the reference and over the part that is measured; and the rest."""
    truth = log.truth
    assert truth is not None
    (rotation, pos), true_rotation = poses(run, truth.t_s), so3.from_quaternion(truth.quat_nb)
    error = evaluate(run.trajectory, log)
    found = []
    for what, first in (("", 0), (", from 1.2 s on", kitti_stereo.MEASURED_FROM)):
        drift = kitti_drift((rotation[first:], pos[first:]), (true_rotation[first:], truth.pos_n_m[first:]), SEGMENTS_M)
        say(f"{name}{what}: {drift.translation_percent:.2f} %, {drift.rotation_deg_m:.4f} deg/m")
        targets = (TRANSLATION, ROTATION) if not first else (None, None)
        found += [
            row(f"{name}: translational drift{what}", drift.translation_percent, "%", target=targets[0]),
            row(f"{name}: rotational drift{what}", drift.rotation_deg_m, "deg/m", target=targets[1]),
        ]
    turned = np.degrees(np.linalg.norm(so3.log(so3.transpose(true_rotation) @ rotation), axis=1))
    found += [
        row(f"{name}: position error", float(np.sqrt((np.array(error.rms_m) ** 2).sum())), "m rms"),
        row(f"{name}: attitude error", float(np.sqrt((turned**2).mean())), "deg rms"),
        row(f"{name}: NEES", error.nees_position, "1"),
        row(f"{name}: seconds", seconds, "s"),
    ]
    for what, item in run.calibration.items():
        found += [row(f"{name}: {what}", item.value, item.unit), row(f"{name}: sigma of {what}", item.sigma, item.unit)]
    return found


def reference_rows(log: SensorLog) -> list[Row]:
    """How much the reference's steps differ among each other in its first 1.1 s, and afterwards."""
    spread = step_spread(log)
    first = kitti_stereo.MEASURED_FROM - 1
    return [
        row("kitti_stereo, reference: spread of its turns up to 1.1 s", float(spread[:first].max()), "deg"),
        row("kitti_stereo, reference: spread of its turns afterwards", float(np.median(spread[first:])), "deg"),
    ]


def step_spread(log: SensorLog) -> Array:
    """(N-1,) how far each turn of the reference from pose to pose is from the median one of its first second, deg."""
    assert log.truth is not None
    rotation = so3.from_quaternion(log.truth.quat_nb)
    turn = np.degrees(so3.log(so3.transpose(rotation[:-1]) @ rotation[1:]))
    return np.asarray(np.linalg.norm(turn - np.median(turn[:10], axis=0), axis=1))


def tracks_rows() -> list[Row]:
    """The drive whose features are given, against the visual odometry that comes with them: agreement, no error."""
    log = kitti_tracks.convert()
    t_s, rotation_c, pos_c = kitti_tracks.estimated_poses()
    given = (_RFU_FROM_CAMERA @ rotation_c @ _RFU_FROM_CAMERA.T, pos_c @ _RFU_FROM_CAMERA.T)
    found = []
    for method in METHODS:
        run, seconds = smoothed(log, method)
        states = run.trajectory.at(t_s)
        drift = kitti_drift((states.rotation_nb, states.pos_n), given, SEGMENTS_M)
        apart, name = states.pos_n - given[1], f"kitti_tracks, {method}"
        assert states.cov is not None
        squared = np.einsum("ki,kij,kj->k", apart[1:], np.linalg.inv(states.cov[1:, 3:6, 3:6]), apart[1:])
        say(f"{name}: {drift.translation_percent:.2f} %, {drift.rotation_deg_m:.4f} deg/m from the poses given")
        found += [
            row(f"{name}: translation from the poses given", drift.translation_percent, "%"),
            row(f"{name}: rotation from the poses given", drift.rotation_deg_m, "deg/m"),
            row(f"{name}: squared distance from the poses given, in sigmas, by axis", float(squared.mean() / 3), "1"),
            row(f"{name}: seconds", seconds, "s"),
        ]
    return found
