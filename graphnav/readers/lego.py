"""LEGO robot among six cylinders (C. Brenner's SLAM course, Hannover): planar scans, wheel ticks, overhead reference.

- **Scans** (``robot4_scan.txt``, 660 beams): angle (i - 330) * 0.006135923151543 - 0.06981317 rad, counter-clockwise
  from the robot's forward axis. The scanner reads short (`RANGE_BIAS_M`), and sweeps from right to left in `SWEEP_S`.
- **Wheels** (``robot4_motors.txt``): ticks of both. Rows repeated by the robot's own log (same stamp) are dropped.
  Their mean becomes the odometer's speed; both together become `relative_pose`, planar motion of the robot. The two
  tables say the same: an estimator uses one of them.
- **Truth** (``robot4_reference.txt``): positions of a mark on the robot, seen from above. They are `REFERENCE_SCALE`
  too far apart beside the landmark file, as the mark stands higher than the floor on which the landmarks were measured.
  Its heading is not recorded: it is what leads the ticks through the positions (`headings`).
- **Clocks**: scans have the log's. Wheels and reference are stamped earlier by `WHEEL_DELAY_S` and `REFERENCE_DELAY_S`.

Axes: n is the arena's (x east, y north); b is at the reference's mark, right-forward-up, s is parallel to it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from graphnav._schema import Array
from graphnav.errors import LogError
from graphnav.log import Frames, InitialState, Lidar, LidarScans, Odometer, RelativePose, SensorLog, Truth
from graphnav.readers.wheels import upright, wheel_motions

_BEAM_RAD, _MIDDLE_BEAM, _TURNED_RAD = 0.006135923151543, 330, -0.06981317
#: The scanner turns once in 0.1 s, 232 deg of it are recorded.
SWEEP_S = 0.064
#: What the course gives for this robot: metres per tick, distance of its tracks.
_M_PER_TICK, _TRACKS_M = 0.349e-3, 0.173
#: The landmark file's 55 mm read as a radius: the cylinders fill 96 mm of the beams, their grazing edges are lost.
_DIAMETER_M = 0.11
#: Fitted once by least squares, centres of all cylinders found against the landmark file (docs/legs.md): where the
#: scanner is, seen from the mark; what its ranges lack; delays of the clocks; the reference's scale and its centre.
SCANNER_B_M = (0.007, -0.025, 0.0)
RANGE_BIAS_M = 0.067
REFERENCE_DELAY_S = 0.10
WHEEL_DELAY_S = 0.49
REFERENCE_SCALE, REFERENCE_CENTRE_M = 1 / 0.912, (1.194, 1.226)
#: The tracks' middle is this far behind the mark (from wheels and reference alone).
_AXLE_B_M = (0.0, -0.05, 0.0)
#: On the shiny cylinders the range is wrong by some cm in a pattern of its own: nearer than 0.7 m their middle reads
#: 2 to 4 cm farther than their sides (from the scans).
_RANGE_SIGMA_M, _ANGLE_SIGMA_DEG = 0.03, 0.3
#: What reads longer is no return; in the log it is a range of zero.
_LONGEST_M = 2.3


def convert(source: str | Path | None, *, raw_reference: bool = False) -> SensorLog:
    """Convert the recording.

    Parameters
    ----------
    source : folder with ``robot4_scan.txt``, ``robot4_motors.txt`` and ``robot4_reference.txt``.
    raw_reference : keep the reference's positions as recorded, without the correction of its scale.

    Returns
    -------
    SensorLog
        Scans, odometer, relative poses, truth; initial pose the reference's, to 3 cm and 3 deg.

    Raises
    ------
    LogError
        A file is missing or damaged.
    """
    if source is None:
        raise LogError("lego needs a source folder", fix="pass the folder that holds robot4_scan.txt")
    folder = Path(source)
    wheels_t_s, ticks = _wheels(folder)
    reference = _rows(folder / "robot4_reference.txt", "P", 3, least=2)
    t_s, seen_m = _later(folder / "robot4_reference.txt", reference[:, 0]) + REFERENCE_DELAY_S, reference[:, 1:] / 1e3
    centre = np.array(REFERENCE_CENTRE_M)
    place = seen_m if raw_reference else centre + (seen_m - centre) / REFERENCE_SCALE
    heading = headings(t_s, place, wheels_t_s, ticks)
    truth = Truth(t_s=t_s, pos_n_m=np.column_stack([place, np.zeros(len(t_s))]), quat_nb=upright(heading - np.pi / 2))
    return SensorLog(
        name="lego",
        frames=Frames(latitude_deg=52.4),  # Hannover; not stated, and of no effect without an IMU
        initial=_initial(truth),
        odometer=_odometer(wheels_t_s, ticks),
        relative_pose=_motion(wheels_t_s, ticks),
        lidar=Lidar(
            range_sigma_m=_RANGE_SIGMA_M,
            angle_sigma_deg=_ANGLE_SIGMA_DEG,
            T_bs_pos_m=np.array(SCANNER_B_M),
            mounting_sigma_deg=np.array([0.5, 0.5, 0.5]),
            range_bias_sigma_m=0.02,
            leg_diameter_m=_DIAMETER_M,
        ),
        lidar_scans=_scans(folder),
        truth=truth,
    )


def landmarks(source: str | Path) -> Array:
    """Centres (6, 2) of the cylinders in n, m, from ``robot_arena_landmarks.txt``; for judging alone."""
    return _rows(Path(source) / "robot_arena_landmarks.txt", "L", 3, skip=2)[:, :2] / 1e3


def headings(t_s: Array, pos_m: Array, wheels_t_s: Array, ticks: Array) -> Array:
    """Directions of travel (N,), counter-clockwise from x, that lead the wheels' ticks through known positions.

    The wheels' difference gives the turns, a correction that wanders slowly (nodes 5 s apart) what they miss; scale,
    track width and the axle's place are fitted along. Scans and landmarks have no part in it.

    Parameters
    ----------
    t_s, pos_m : (N,), (N, 2) positions.
    wheels_t_s, ticks : (M,), (M, 2) left and right, counted from anywhere.
    """
    from scipy.optimize import least_squares

    fine = np.arange(t_s[0] - 0.5, t_s[-1] + 0.5, 0.02)
    nodes = np.arange(t_s[0] - 1.0, t_s[-1] + 6.0, 5.0)
    mean, difference = ticks.mean(axis=1), ticks[:, 1] - ticks[:, 0]
    mean, difference = mean - mean[0], difference - difference[0]

    def path(p: Array) -> tuple[Array, Array]:
        gone = np.interp(fine, wheels_t_s, mean) * p[0] * 1e-3
        turn = np.interp(fine, wheels_t_s, difference) * p[1] * 1e-3 + np.interp(fine, nodes, p[5:])
        middle = (turn[1:] + turn[:-1]) / 2
        step = np.diff(gone)[:, None] * np.column_stack([np.cos(middle), np.sin(middle)])
        axle = p[3:5] + np.concatenate([np.zeros((1, 2)), np.cumsum(step, axis=0)])
        heading = np.interp(t_s, fine, turn)
        at = np.column_stack([np.interp(t_s, fine, axis) for axis in axle.T])
        return at + p[2] * np.column_stack([np.cos(heading), np.sin(heading)]), heading

    def residual(p: Array) -> Array:
        return np.concatenate([((path(p)[0] - pos_m) / 0.003).ravel(), np.diff(p[5:]) / 0.02])

    moving = int(np.argmax(np.linalg.norm(pos_m - pos_m[0], axis=1) > 0.3))
    first = np.arctan2(*(pos_m[moving] - pos_m[0])[::-1])
    lever = -_AXLE_B_M[1]
    start = np.concatenate([
        [_M_PER_TICK * 1e3, _M_PER_TICK / _TRACKS_M * 1e3, lever],
        pos_m[0] - lever * np.array([np.cos(first), np.sin(first)]), np.full(len(nodes), first),
    ])  # fmt: skip
    found = least_squares(residual, start, loss="soft_l1")
    return path(found.x)[1]


def _scans(folder: Path) -> LidarScans:
    path = folder / "robot4_scan.txt"
    rows = _rows(path, "S", None)
    if rows.shape[1] < 3 or (rows[:, 1] != rows.shape[1] - 2).any():
        raise LogError("the number of beams differs from what the rows hold", where=str(path), fix="fetch it again")
    ranges = rows[:, 2:] / 1e3
    ranges = np.where((ranges > 0.02) & (ranges < _LONGEST_M), ranges + RANGE_BIAS_M, 0.0)
    count = len(rows)
    return LidarScans(
        t_s=_later(path, rows[:, 0]),
        angle_min_rad=np.full(count, -_MIDDLE_BEAM * _BEAM_RAD + _TURNED_RAD),
        angle_step_rad=np.full(count, _BEAM_RAD),
        ranges_m=list(ranges),
    )


def _wheels(folder: Path) -> tuple[Array, Array]:
    """Times on the log's clock, ticks left and right; repeated rows dropped."""
    rows = _rows(folder / "robot4_motors.txt", "M", None, least=3)
    if rows.shape[1] < 6:
        raise LogError(f"{rows.shape[1] + 1} fields, expected 14", where=str(folder / "robot4_motors.txt"))
    keep = np.concatenate([[True], np.diff(rows[:, 0]) > 0])
    return rows[keep, 0] / 1e3 + WHEEL_DELAY_S, rows[keep][:, [1, 5]]


def _odometer(t_s: Array, ticks: Array) -> Odometer:
    """Speed at the middle of every interval between rows."""
    return Odometer(
        t_s=(t_s[1:] + t_s[:-1]) / 2,
        speed_m_s=np.diff(ticks.mean(axis=1)) * _M_PER_TICK / np.diff(t_s),
        sigma_m_s=0.02,  # stamps jitter by some 20 ms of 200 at 0.2 m/s
        slip_sigma_m_s=0.005,
        scale_sigma=0.05,  # rubber tracks
        mounting_sigma_deg=np.array([1.0, 1.0, 1.0]),
        lever_arm_b_m=np.array(_AXLE_B_M),
    )


def _motion(t_s: Array, ticks: Array) -> RelativePose:
    """Motion of b between rows, on the arc that both tracks say."""
    step = np.diff(ticks, axis=0) * _M_PER_TICK
    turn, gone = (step[:, 1] - step[:, 0]) / _TRACKS_M, step.mean(axis=1)
    sigma_m = 0.002 + 0.1 * np.abs(gone)
    return wheel_motions(
        t_s,
        gone,
        turn,
        sigma_forward_m=sigma_m,
        sigma_side_m=sigma_m,
        sigma_turn_rad=0.002 + 0.1 * np.abs(turn),
        axle_b_m=_AXLE_B_M,
    )


def _initial(truth: Truth) -> InitialState:
    return InitialState(
        pos_n_m=truth.pos_n_m[0],
        pos_sigma_m=np.array([0.03, 0.03, 0.01]),
        quat_nb_wxyz=truth.quat_nb[0],
        att_sigma_deg=np.array([0.5, 0.5, 3.0]),
        vel_n_m_s=np.zeros(3),
        vel_sigma_m_s=np.full(3, 0.02),
    )


def _rows(path: Path, letter: str, columns: int | None, skip: int = 1, least: int = 1) -> Array:
    """Numbers (N, columns) behind the letter of every line, all lines equally long."""
    try:
        text = path.read_text(encoding="ascii")
    except FileNotFoundError:
        raise LogError("no such file", where=str(path), fix="pass the folder of the recording") from None
    except (OSError, UnicodeDecodeError) as error:
        raise LogError(f"not a text file ({error})", where=str(path), fix="fetch it again") from None
    rows: list[list[float]] = []
    for number, line in enumerate(text.splitlines()):
        fields = line.split()
        if not fields or fields[0] != letter:
            raise LogError(f'"{line[:20]}", expected a line that starts with {letter}', where=str(path), row=number)
        try:
            values = [float(v) for v in fields[skip:]]
        except ValueError:
            raise LogError(f'"{line[:40]}", expected numbers', where=str(path), row=number) from None
        expected = columns if columns is not None else len(rows[0]) if rows else len(values)
        if len(values) != expected:
            raise LogError(f"{len(values)} numbers, expected {expected}", where=str(path), row=number)
        rows.append(values)
    if len(rows) < least:
        count = {0: "no rows", 1: "1 row"}.get(len(rows), f"{len(rows)} rows")
        raise LogError(f"{count}, expected at least {least}", where=str(path), fix="fetch it again")
    return np.array(rows)


def _later(path: Path, t_ms: Array) -> Array:
    """Times in s, ascending."""
    wrong = np.flatnonzero(np.diff(t_ms) <= 0)
    if len(wrong):
        raise LogError("time does not ascend", where=str(path), row=int(wrong[0]) + 1, fix="fetch it again")
    return t_ms / 1e3
