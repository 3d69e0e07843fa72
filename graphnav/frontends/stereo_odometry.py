"""Stereo odometry: motions of the camera between keyframes, from features tracked in its image pairs.

Motions follow each other from keyframe to keyframe. Between two frames that give none there is a gap, which the IMU has
to bridge, and a failure that says why. Two motions in a row share the readings of the keyframe between them; their
errors are taken for independent, which is on the safe side (docs/stereo-odometry.md).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from factors import so3
from factors.stereo import StereoCamera
from graphnav._schema import Array
from graphnav.config import StereoMotionsConfig
from graphnav.errors import LogError
from graphnav.frontends.stereo_bundle import RotationPrior
from graphnav.frontends.stereo_frames import TrackedFrames
from graphnav.frontends.stereo_keyframes import Link, Linker
from graphnav.frontends.stereo_motion import MotionFailure, StereoMotion, stereo_motion
from graphnav.log import RelativePose, SensorLog, Stereo, StereoTracks

#: ``R_c_from_c_to`` between two times (s), with its covariance; None where it is not known.
RotationBetween = Callable[[float, float], RotationPrior | None]
_UPPER = np.triu_indices(6)


@dataclass(frozen=True)
class FailedMotion:
    """No motion between two frames, and why."""

    t_from_s: float
    t_to_s: float
    reason: str


@dataclass(frozen=True)
class StereoMotions:
    """What stereo odometry gives.

    Attributes
    ----------
    poses : motions of the camera from keyframe to keyframe, with full covariances; None when there is none.
    inliers, matched : (K,) features that agree with each motion, and features that both keyframes see.
    scale : (K,) error of their readings as a multiple of the declared one.
    failures : frames between which there is no motion.
    seconds : spent.
    """

    poses: RelativePose | None
    inliers: Array
    matched: Array
    scale: Array
    failures: tuple[FailedMotion, ...]
    seconds: float


def stereo_motions(
    log: SensorLog,
    settings: StereoMotionsConfig,
    tracks: StereoTracks | None = None,
    rotation_prior: RotationBetween | None = None,
    progress: Callable[[float, float], None] | None = None,
    *,
    evenly: bool = True,
) -> StereoMotions:
    """Motions of the camera between keyframes.

    Parameters
    ----------
    log : its section [stereo] describes the camera.
    tracks : tracked features; None: those of the log.
    rotation_prior : rotations that the IMU tells, for the use that `settings` names.
    progress : called with the frames done and all.
    evenly : a motion ends where the camera stops going evenly, as a chain of motions takes it to between keyframes;
        beside an IMU, which knows better, that costs keyframes for nothing.

    Raises
    ------
    LogError : no camera or no tracks; a feature that a frame holds twice.
    """
    began = time.perf_counter()
    tracks = log.stereo_tracks if tracks is None else tracks
    if log.stereo is None or tracks is None:
        missing = "section [stereo]" if log.stereo is None else "table stereo_tracks"
        raise LogError(f"no {missing}", where=f"log {log.name}", fix="stereo odometry needs both")
    frames = TrackedFrames.of(tracks)
    links = []
    between = _between(frames, log.stereo, settings, rotation_prior)
    for link in Linker(frames, settings, between, evenly).links():
        links.append(link)
        if progress is not None:
            progress(link.second, len(frames) - 1)
    return _collected(frames, links, time.perf_counter() - began)


def camera_of(stereo: Stereo) -> StereoCamera:
    """The camera that a log declares."""
    return StereoCamera(stereo.fx_px, stereo.fy_px, stereo.cx_px, stereo.cy_px, stereo.baseline_m)


def _between(
    frames: TrackedFrames, stereo: Stereo, settings: StereoMotionsConfig, rotation_prior: RotationBetween | None
) -> Callable[[int, int], StereoMotion | MotionFailure]:
    camera = camera_of(stereo)

    def motion(i: int, j: int) -> StereoMotion | MotionFailure:
        prior = None if rotation_prior is None else rotation_prior(float(frames.t_s[i]), float(frames.t_s[j]))
        return stereo_motion(camera, frames.matches(i, j, stereo.sigma_px), settings, prior)

    return motion


def _collected(frames: TrackedFrames, links: list[Link], seconds: float) -> StereoMotions:
    good = [(link, link.motion) for link in links if isinstance(link.motion, StereoMotion)]
    failures = tuple(
        FailedMotion(float(frames.t_s[link.first]), float(frames.t_s[link.second]), link.motion.reason)
        for link in links
        if isinstance(link.motion, MotionFailure)
    )
    return StereoMotions(
        _poses(frames, good),
        np.array([motion.inlier.sum() for _, motion in good], float),
        np.array([len(motion.inlier) for _, motion in good], float),
        np.array([motion.scale for _, motion in good]),
        failures,
        seconds,
    )


def _poses(frames: TrackedFrames, good: list[tuple[Link, StereoMotion]]) -> RelativePose | None:
    if not good:
        return None
    return RelativePose(
        t_from_s=frames.t_s[[link.first for link, _ in good]],
        t_to_s=frames.t_s[[link.second for link, _ in good]],
        pos_m=np.array([motion.pos_m for _, motion in good]),
        quat=so3.to_quaternion(np.array([motion.rotation for _, motion in good])),
        cov_upper=np.array([motion.cov[_UPPER] for _, motion in good]),
    )
