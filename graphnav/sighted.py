"""A log with a stereo camera: features are followed through its images, and motions found, before smoothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from graphnav.config import Config
from graphnav.errors import LogError
from graphnav.frontends.camera_check import centre_note, refuse_wrong_camera
from graphnav.frontends.gyro_turns import gyro_turns
from graphnav.frontends.motion_failures import failure_note, refuse_contradiction
from graphnav.frontends.rest import rest_spans
from graphnav.log import RelativePose, SensorLog

Progress = Callable[[float, float], None]


@dataclass(frozen=True)
class Sighted:
    """A log as it is smoothed.

    Attributes
    ----------
    log : with tracked features in place of images, or with the motions found from them (`stereo.form` says which).
    guide : motions of the camera that are no measurement of their own, but lead to initial values; or None.
    notes : what the user should know of it, one line each.
    """

    log: SensorLog
    guide: RelativePose | None = None
    notes: tuple[str, ...] = ()


def with_stereo(log: SensorLog, config: Config, progress: Progress | None = None, *, alone: bool = False) -> Sighted:
    """The log with what its camera saw; as it is where it has no camera, or where that is not to be used.

    Parameters
    ----------
    alone : whether its motions are all that the method goes by, though there may be an IMU.

    Raises
    ------
    LogError : images that cannot be read; images, features or turns that are not those of the declared camera.
    """
    if config.stereo.form == "off" or (log.stereo_pairs is None and log.stereo_tracks is None):
        return Sighted(log)
    if log.stereo is None:
        table = "stereo_tracks" if log.stereo_tracks is not None else "stereo"
        return Sighted(log, None, (f"the table {table} is not used: declare the camera in a section [stereo]",))
    if log.stereo_tracks is None and log.relative_pose is not None:
        return Sighted(log, None, ("the images are not used: the log has relative poses already",))
    refuse_wrong_camera(log)
    log, notes = _tracked(log, config, progress)
    if log.imu is None and log.stereo is not None and log.stereo.time_sigma_s:
        log = replace(log, stereo=log.stereo.replace(time_sigma_s=0.0))
        notes += ("time_sigma_s of [stereo] is not used: nothing but an IMU tells a camera's clock",)
    if log.imu is None and log.relative_pose is not None:
        return Sighted(log, None, notes)
    return _moved(log, config, notes, progress, evenly=alone or log.imu is None)


def _tracked(log: SensorLog, config: Config, progress: Progress | None) -> tuple[SensorLog, tuple[str, ...]]:
    """The log with its features followed."""
    if log.stereo_tracks is not None and log.stereo is not None:
        note = centre_note(log.stereo, log.stereo_tracks)
        return log, (note,) if note else ()
    from graphnav.frontends.image_pairs import pair_files
    from graphnav.frontends.image_size import size_note
    from graphnav.frontends.skipped_pairs import skipped_notes
    from graphnav.frontends.stereo_tracks import tracked

    hook = None if progress is None else (lambda _, done, total: progress(done, total))
    found = tracked(log, config.stereo_tracks, progress=hook)
    assert log.stereo is not None and log.stereo_pairs is not None
    notes = skipped_notes(log.stereo_pairs, found.skipped)
    size = size_note(pair_files(log), log.stereo)
    notes += (size,) if size else ()
    # what the front end adds to what the pair's calibration leaves
    disparity = float(np.hypot(log.stereo.disparity_sigma_px, config.stereo_tracks.bias_px))
    stereo = log.stereo.replace(disparity_sigma_px=disparity)
    return replace(log, stereo_tracks=found.tracks, stereo=stereo), notes


def _moved(
    log: SensorLog, config: Config, notes: tuple[str, ...], progress: Progress | None, *, evenly: bool
) -> Sighted:
    """The log with motions from its tracked features, as measurements or as a guide."""
    from graphnav.frontends.stereo_odometry import stereo_motions

    turns = None if log.imu is None or log.stereo is None else gyro_turns(log.imu, log.stereo, rest_spans(log))
    found = stereo_motions(log, config.stereo_motions, rotation_prior=turns, progress=progress, evenly=evenly)
    refuse_contradiction(found, log.name)
    note = failure_note(found)
    notes += (note,) if note else ()
    if found.poses is None:
        if log.imu is None:
            raise LogError(
                f"the camera tells no motion at all ({found.failures[0].reason if found.failures else 'one frame'})",
                where=f"log {log.name}", fix="check [stereo] and the images",
            )  # fmt: skip
        return _motionless(log, config, notes)
    if config.stereo.form == "tight":
        return Sighted(log, found.poses, notes)
    if log.relative_pose is not None:
        return Sighted(
            replace(log, stereo_tracks=None), None,
            (*notes, "the tracked features are not used: with stereo.form = \"loose\" the relative poses given count"),
        )  # fmt: skip
    return Sighted(replace(log, relative_pose=found.poses, stereo_tracks=None), None, notes)


def _motionless(log: SensorLog, config: Config, notes: tuple[str, ...]) -> Sighted:
    """The log where features are too few for a motion: beside an IMU each of them still says something of its own."""
    if config.stereo.form == "tight":
        return Sighted(log, None, (*notes, "the camera alone tells no motion: its features are points of the graph"))
    return Sighted(replace(log, stereo_tracks=None), None, (*notes, "the camera tells no motion, and is not used"))
