"""Plaza1 (J. Djugash): a lawn mower with wheel and gyro odometry and ranges to four radios, in GTSAM's example data.

32 minutes and 1.9 km in a plane of 70 m, 5 steps of the odometry and 2 ranges a second; read where GTSAM finds it.

- *Steps of odometry* (``Plaza1_DR.txt``: way and turn since the step before) become the table `relative_pose`.
- *Ranges* (``Plaza1_TD.txt``) are as recorded: nothing is taken off. Two blocks of them (rows after the stamps go back,
  by 64 and 50 s) are in the file behind later ones; rows are sorted by time.
- *Radios*: the surveyed places in ``Plaza1_.mat`` (`TL`), 0.2 m. All of them, and the machine, at height zero.
- *Start*: **heading from the reference**, within `heading_sigma_deg`; place unknown; height zero.
- *Truth* (`GT`): satellite positions, for judging alone. **Its heading is not independent**: its steps are the
  odometry's turns to rounding.

Ranges are too long, by 2.8 m in the median and 6.6 % of the range: the error grows with the distance (none at zero), so
that a radio's constant bias leaves +-1.3 m which change as slowly as the distance. `bias_sigma_m` 3 m is the constant,
and the Markov error of 1.5 m and 20 s (the time in which the machine passes a radio) the rest; white 0.5 m.

Odometry, chosen: 1 % of each step's way as white noise would be nothing after 9,657 of them. Its errors are declared
as random walks, of 0.05 m along, 0.05 m across and 1 deg in a second.
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
_ALONG_M, _ACROSS_M, _TURN_RAD = 0.05, 0.05, float(np.radians(1.0))
_RANGES: dict[str, Any] = {"sigma_m": 0.5, "bias_sigma_m": 3.0, "markov_sigma_m": 1.5, "markov_time_s": 20.0}
_RADIO_SIGMA_M = 0.2
_TAG = "2"


def convert(source: str | Path | None = None, *, heading_sigma_deg: float = 10.0) -> SensorLog:
    """Convert the drive.

    Parameters
    ----------
    source : folder with the three files; None finds them with ``gtsam.findExampleDataFile``.
    heading_sigma_deg : declared sigma of the heading at the start, which is the reference's.

    Returns
    -------
    SensorLog
        Relative poses of the odometry, ranges, truth; planar.

    Raises
    ------
    LogError
        A file is missing or not as expected.
    """
    if not heading_sigma_deg > 0:
        raise LogError(f"heading_sigma_deg {heading_sigma_deg}, expected above zero")
    steps, ranges = _table(_find(source, ODOMETRY_FILE), 3), _table(_find(source, RANGE_FILE), 4)
    mat = MatFile(_find(source, MAT_FILE))
    reference, places = mat.array("GT", (len(steps) + 1, 4)), mat.array("TL", (None, 3))
    zero = reference[0, 0]
    t_s = np.append(reference[0, 0], steps[:, 0]) - zero
    walk = np.sqrt(np.diff(t_s))
    truth = _truth(reference)
    return SensorLog(
        name="plaza1",
        frames=Frames(latitude_deg=40.4, longitude_deg=-80.0),  # Pittsburgh; of no effect without an IMU
        initial=_initial(truth, heading_sigma_deg),
        relative_pose=wheel_motions(
            t_s,
            steps[:, 1],
            steps[:, 2],
            sigma_forward_m=_ALONG_M * walk,
            sigma_side_m=_ACROSS_M * walk,
            sigma_turn_rad=_TURN_RAD * walk,
        ),
        uwb=_ranges(ranges, places, zero),
        truth=truth,
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


def _initial(truth: Truth, heading_sigma_deg: float) -> InitialState:
    """Upright on the plane, at rest, heading of the reference."""
    return InitialState(
        pos_n_m=np.zeros(3),
        pos_sigma_m=np.array([1000.0, 1000.0, 1e-3]),
        quat_nb_wxyz=truth.quat_nb[0],
        att_sigma_deg=np.array([0.05, 0.05, heading_sigma_deg]),
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
