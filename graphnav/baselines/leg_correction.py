"""What the first arrival at the far end tells the paper's filter: its automatic choice of legs and the correction of
the scanner's mounting (Zheng et al., INS/LiDAR, section 5.2, steps 1-4 and equations 30-32).

The first cut should lead straight along the face, over its known length. Where the filter arrives beside the face's
line, the mounting about up is turned until it would not (the posterior information correction model, PICM); of modes 2
and 7 the one that arrives at the length best is taken. The log is then filtered again from its start.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from factors import so3
from factors.so3 import Array, from_quaternion
from graphnav.baselines.inputs import Inputs
from graphnav.baselines.leg_choice import Selection, largest_distance
from graphnav.baselines.leg_filter import LegFilter, Scanner
from graphnav.errors import LogError
from graphnav.frontends.cutting_cycles import Cycle

#: The paper's step 3 chooses between these.
AUTOMATIC_MODES = (2, 7)
Progress = Callable[[float, float], None]


@dataclass(frozen=True)
class Wanted:
    """What the user fixes: count of legs; mode and distance_m, None for the paper's automatic choice; picm or not."""

    count: int = 1
    mode: int | None = None
    distance_m: float | None = None
    picm: bool = True


@dataclass(frozen=True)
class Fitted:
    """What the filter runs with.

    Attributes
    ----------
    selection, scanner : legs and mounting, after correction.
    eta_rad : (3,) the correction angle of equation 31, zero without.
    arrival_m : mode -> (3,) where the filter first arrived at the far end in m(t0) (equation 30), m.
    """

    selection: Selection
    scanner: Scanner
    eta_rad: Array
    arrival_m: dict[int, Array]


def fit(inputs: Inputs, scanner: Scanner, wanted: Wanted) -> Fitted:
    """The paper's steps 1 to 4, as far as the user leaves them open.

    Raises
    ------
    LogError : nothing open can be told, since no cut reaches the far end or the face's length is not declared.
    """
    points, lidar = inputs.log.lidar_points, inputs.log.lidar
    assert points is not None and lidar is not None
    if wanted.mode is not None and wanted.distance_m is not None and not wanted.picm:
        return Fitted(Selection(wanted.count, wanted.mode, wanted.distance_m), scanner, np.zeros(3), {})
    cut = _first_cut(inputs)
    distance_m = wanted.distance_m
    if distance_m is None:
        distance_m = largest_distance(points, cut, wanted.count, lidar.feature_spacing_m)
    modes = AUTOMATIC_MODES if wanted.mode is None else (wanted.mode,)
    if len(modes) == 1 and not wanted.picm:
        return Fitted(Selection(wanted.count, modes[0], distance_m), scanner, np.zeros(3), {})
    length_m = _length_m(inputs)
    arrival_m = {mode: arrival(inputs, scanner, Selection(wanted.count, mode, distance_m), cut) for mode in modes}
    best = min(modes, key=lambda mode: abs(arrival_m[mode][1] - length_m))
    selection, eta = Selection(wanted.count, best, distance_m), np.zeros(3)
    if wanted.picm:
        eta = correction(arrival_m[best], length_m)
        scanner = replace(scanner, rotation_bs=turned(scanner.rotation_bs, eta))
    return Fitted(selection, scanner, eta, arrival_m)


def arrival(inputs: Inputs, scanner: Scanner, selection: Selection, cut: Cycle) -> Array:
    """Where the filter is when it first arrives at the far end, (3,) in m(t0), from the start (equation 30)."""
    assert cut.end_s is not None
    last = inputs.index(cut.end_s)
    forward = LegFilter(inputs, scanner, selection)
    forward.run(last)
    return np.asarray(face_axes(inputs).T @ (forward.estimates.pos_n[last] - inputs.initial.pos_n_m))


def correction(arrival_m: Array, length_m: float) -> Array:
    """The correction angle ``eta = [0, 0, p_x / S_max]``, rad (equation 31)."""
    return np.array([0.0, 0.0, arrival_m[0] / length_m])


def turned(rotation_bs: Array, eta_rad: Array) -> Array:
    """The mounting after ``alpha_c = alpha - eta`` (equation 32).

    The paper's alpha makes ``C_s^b = I - alpha x`` (equation 6), so less eta is a turn by plus eta about up: a filter
    that came out to the right of the line turns its legs, and with them its way, to the left.
    """
    return np.asarray(so3.exp(eta_rad) @ rotation_bs)


def face_axes(inputs: Inputs) -> Array:
    """Level axes of m(t0), (3, 3) in n: right, forward along the face, up.

    Equation 30 takes the true direction of the face at the start. Here that is the line from the declared start to the
    surveyed far end; a log without one has the declared attitude, whose error then stays in the position.
    """
    start = inputs.initial.pos_n_m
    far = [point for point in inputs.log.surveyed if point.end == "far"]
    along = far[0].pos_n_m - start if far else from_quaternion(inputs.initial.quat_nb_wxyz)[:, 1]
    east, north = along[:2] / np.linalg.norm(along[:2])
    return np.array([[north, east, 0.0], [-east, north, 0.0], [0.0, 0.0, 1.0]])


def _first_cut(inputs: Inputs) -> Cycle:
    for cut in inputs.cycles:
        if cut.forward and cut.end_s is not None:
            return cut
    raise LogError(
        "no cut arrives at the far end",
        where=f"log {inputs.log.name}",
        fix="set lidar_filter.mode and lidar_filter.distance_m, and lidar_filter.picm = false",
    )


def _length_m(inputs: Inputs) -> float:
    if inputs.log.face is None:
        raise LogError(
            "no [face] section",
            where=f"log {inputs.log.name}",
            fix="declare face.length_m, or set lidar_filter.mode and lidar_filter.picm = false",
        )
    return inputs.log.face.length_m
