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
#: Share of rows that may be anywhere, and by how many sigmas a feature at the edge may be read outside.
_FEW, _EDGE_SIGMAS = 0.01, 5.0
_SIDES = "u_left_px, u_right_px"
_CALIBRATE = "give [stereo] the calibration of the rectified images in which features were tracked"


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
    findings = [*_swapped(stereo, tracks, disparity), *_flat(tracks, disparity)]
    return [*findings, *_centre(stereo), *_outside(stereo, tracks)]


def centre_note(stereo: Stereo, tracks: StereoTracks) -> str:
    """Where all but a few features lie on one side of the principal point; empty where they surround it."""
    for name, centre, places in (("cx_px", stereo.cx_px, tracks.u_left_px), ("cy_px", stereo.cy_px, tracks.v_px)):
        low, high = np.quantile(places, [_FEW, 1 - _FEW])
        if not low <= centre <= high:
            return (
                f"{name} of [stereo] is {centre:g}, but features lie from {low:.0f} to {high:.0f} px: if the"
                " calibration is for images of another size, positions are wrong"
            )
    return ""


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


def _centre(stereo: Stereo) -> list[LogError]:
    """Features show that the image begins at zero, and the principal point is inside."""
    for name, value in (("cx_px", stereo.cx_px), ("cy_px", stereo.cy_px)):
        if value <= 0:
            return [stereo.error(f"{value:g}, expected a place inside the image", column=name, fix=_CALIBRATE)]
    return []


def _outside(stereo: Stereo, tracks: StereoTracks) -> list[LogError]:
    """More features than a few outside images of the declared size."""
    if stereo.size_px is None:
        return []
    edge = _EDGE_SIGMAS * stereo.sigma_px
    for name, size in zip(("u_left_px", "v_px"), stereo.size_px, strict=True):
        places = getattr(tracks, name)
        outside = (places < -edge) | (places > size - 1 + edge)
        if outside.mean() > _FEW:
            row = int(np.argmax(outside))
            problem = f"{places[row]:.1f} px, as {outside.mean():.0%} of the rows outside 0 to {size - 1} px"
            return [tracks.error(problem, row=row, column=name, fix=_CALIBRATE)]
    return []
