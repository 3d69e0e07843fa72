"""A declared stereo camera that its tracked features contradict: refused before anything is estimated.

Seen from a rectified pair every point lies farther left in the right image: its disparity ``u_left - u_right`` is above
zero, but for errors. What all rows say against that is a fault of the recording and not of a feature.
"""

from __future__ import annotations

import numpy as np

from graphnav._schema import Array
from graphnav.errors import LogError
from graphnav.log import SensorLog, Stereo, StereoTracks

#: Share of rows with negative disparities, beyond this many sigmas, from which on the sides are swapped.
_SWAPPED, _SIGMAS = 0.5, 3.0
_SIDES = "u_left_px, u_right_px"


def refuse_wrong_camera(log: SensorLog) -> None:
    """Raise the first of `camera_findings`.

    Raises
    ------
    LogError
        Camera and tracked features contradict each other.
    """
    for error in camera_findings(log):
        raise error


def camera_findings(log: SensorLog) -> list[LogError]:
    """What the tracked features show to be wrong with the camera or with themselves; empty for a sound log."""
    stereo, tracks = log.stereo, log.stereo_tracks
    if stereo is None or tracks is None:
        return []
    disparity = tracks.u_left_px - tracks.u_right_px
    return [*_swapped(stereo, tracks, disparity), *_flat(tracks, disparity), *_centre(stereo, tracks)]


def _swapped(stereo: Stereo, tracks: StereoTracks, disparity: Array) -> list[LogError]:
    negative = disparity < -_SIGMAS * np.hypot(np.sqrt(2.0) * stereo.sigma_px, stereo.disparity_sigma_px)
    if negative.mean() <= _SWAPPED:
        return []
    row = int(np.argmax(negative))
    problem = (
        f"disparity {disparity[row]:.2f} px, as in {negative.mean():.0%} of the rows negative, expected above zero:"
        " the cameras are swapped"
    )
    return [tracks.error(problem, row=row, column=_SIDES, fix="exchange these columns")]


def _flat(tracks: StereoTracks, disparity: Array) -> list[LogError]:
    if disparity.any():
        return []
    problem = f"{tracks.u_left_px[0]:g} px in both, and so in all rows, expected a disparity that tells the depth"
    return [tracks.error(problem, row=0, column=_SIDES, fix="write the column of each image in its own")]


def _centre(stereo: Stereo, tracks: StereoTracks) -> list[LogError]:
    """The principal point is inside the image (of which features show that it begins at zero)."""
    for name, value in (("cx_px", stereo.cx_px), ("cy_px", stereo.cy_px)):
        if value <= 0:
            return [stereo.error(f"{value:g}, expected a place inside the image", column=name, fix=_CALIBRATE)]
    return []


_CALIBRATE = "give [stereo] the calibration of the rectified images in which features were tracked"
