"""Plaza1 (J. Djugash): a lawn mower with wheel and gyro odometry and ranges to four radios, in GTSAM's example data.

32 minutes and 1.9 km in a plane of 70 m, 5 steps of the odometry and 2 ranges a second; read where GTSAM finds it.

- *Steps of odometry* (``Plaza1_DR.txt``: way and turn since the step before) become the table `relative_pose`.
- *Ranges* (``Plaza1_TD.txt``) are as recorded: nothing is taken off. Two blocks of them (rows after the stamps go back,
  by 64 and 50 s) are in the file behind later ones; rows are sorted by time.
- *Radios*: the surveyed places in ``Plaza1_.mat`` (`TL`), 0.2 m. All of them, and the machine, at height zero.
- *Start*: place and heading unknown, height zero; ranges show both.
- *Truth* (`GT`): satellite positions, for judging alone. **Its heading is not independent**: its steps are the
  odometry's turns to rounding.

Ranges are too long, by 2.8 m in the median. The error is no constant but grows from nothing by 6.6 % of the distance:
a constant for each radio leaves +-1.3 m. Declared are both, a scale error that all ranges share (`scale_sigma` 0.1) and
a constant for each radio (`bias_sigma_m` 3 m); white 0.5 m, and 0.5 m that changes within 10 s.

Odometry, chosen: random walks of 5 cm along and 2 cm across in a second at some 1 m/s, and of 0.05 deg in a second
(3 deg/sqrt(h)) for a fibre-optic gyro on a machine that shakes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from factors.so3 import Array
from graphnav.errors import LogError
from graphnav.log import Frames, InitialState, SensorLog, Truth, Uwb, UwbAnchor, UwbTag
from graphnav.readers.mat_file import MatFile
from graphnav.readers.wheels import upright, wheel_motions

ODOMETRY_FILE, RANGE_FILE, MAT_FILE = "Plaza1_DR.txt", "Plaza1_TD.txt", "Plaza1_.mat"
#: Random walks in a second: along, across, turn.
_ALONG_M, _ACROSS_M, _TURN_RAD = 0.05, 0.02, float(np.radians(0.05))
_RANGES: dict[str, Any] = {
    "sigma_m": 0.5,
    "bias_sigma_m": 3.0,
    "markov_sigma_m": 0.5,
    "markov_time_s": 10.0,
    "scale_sigma": 0.1,
}
_RADIO_SIGMA_M = 0.2
_TAG = "2"


def convert(source: str | Path | None = None) -> SensorLog:
    """Convert the drive.

    Parameters
    ----------
    source : folder with the three files; None finds them with ``gtsam.findExampleDataFile``.

    Returns
    -------
    SensorLog
        Relative poses of the odometry, ranges, truth; planar.

    Raises
    ------
    LogError
        A file is missing or not as expected.
    """
    steps, ranges = _table(_find(source, ODOMETRY_FILE), 3), _table(_find(source, RANGE_FILE), 4)
    mat = MatFile(_find(source, MAT_FILE))
    reference, places = mat.array("GT", (len(steps) + 1, 4)), mat.array("TL", (None, 3))
    zero = reference[0, 0]
    t_s = np.append(reference[0, 0], steps[:, 0]) - zero
    walk = np.sqrt(np.diff(t_s))
    return SensorLog(
        name="plaza1",
        frames=Frames(latitude_deg=40.4, longitude_deg=-80.0),  # Pittsburgh; of no effect without an IMU
        initial=_initial(),
        relative_pose=wheel_motions(
            t_s,
            steps[:, 1],
            steps[:, 2],
            sigma_forward_m=_ALONG_M * walk,
            sigma_side_m=_ACROSS_M * walk,
            sigma_turn_rad=_TURN_RAD * walk,
        ),
        uwb=_ranges(ranges, places, zero),
        truth=_truth(reference),
    )


def _find(source: str | Path | None, name: str) -> Path:
    if source is not None:
        path = Path(source) / name
        if not path.is_file():
            raise LogError("no such file", where=str(path), fix="pass the folder that holds Plaza1_.mat, or none")
        return path
    import gtsam

    return Path(gtsam.findExampleDataFile(name))  # type: ignore[no-untyped-call]


def _table(path: Path, columns: int) -> Array:
    """All numbers of a text file (N, columns)."""
    try:
        table = np.loadtxt(path, ndmin=2)
    except ValueError as error:
        raise LogError(f"no table of numbers ({error})", where=str(path), fix="fetch it again") from None
    if table.shape[1] != columns or not np.isfinite(table).all():
        raise LogError(f"expected {columns} columns of finite numbers", where=str(path), fix="fetch it again")
    return np.asarray(table, float)


def _truth(reference: Array) -> Truth:
    pos = np.column_stack([reference[:, 1:3], np.zeros(len(reference))])
    return Truth(t_s=reference[:, 0] - reference[0, 0], pos_n_m=pos, quat_nb=upright(reference[:, 3] - np.pi / 2))


def _initial() -> InitialState:
    """Upright on the plane and at rest; east, north and heading unknown."""
    return InitialState(
        pos_n_m=np.zeros(3),
        pos_sigma_m=np.array([1000.0, 1000.0, 1e-3]),
        quat_nb_wxyz=np.array([1.0, 0.0, 0.0, 0.0]),
        att_sigma_deg=np.array([0.05, 0.05, 120.0]),
        vel_n_m_s=np.zeros(3),
        vel_sigma_m_s=np.full(3, 0.1),
    )


def _ranges(table: Array, places: Array, zero_s: float) -> Uwb:
    rows = table[np.argsort(table[:, 0], kind="stable")]
    return Uwb(
        t_s=rows[:, 0] - zero_s,
        tag_id=np.full(len(rows), _TAG, dtype=object),
        anchor_id=np.array([str(int(name)) for name in rows[:, 2]], dtype=object),
        range_m=rows[:, 3],
        tag=(UwbTag(id=_TAG),),
        anchor=tuple(
            UwbAnchor(id=str(int(name)), pos_n_m=np.array([x, y, 0.0]), sigma_m=_RADIO_SIGMA_M) for name, x, y in places
        ),
        **_RANGES,
    )
