"""Ranges of a log taken together into epochs, a position for each, and where the machine stood at the start.

Anchors answer in turn, so the ranges of an epoch are up to `span_s` apart and the machine has moved meanwhile: 7 mm at
4 m/min. What knows the motion in between takes each range at its own time; here they are one moment.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np

from factors.so3 import Array
from graphnav.errors import LogError
from graphnav.frontends.trilateration import Fix, coplanar, fix, fixes, usable
from graphnav.log import InitialState, SensorLog, Uwb

#: A declared position less sure than this means unknown (docs/log-format.md).
UNKNOWN_M = 100.0
#: The fewest seconds in which an epoch's ranges may lie, and the seconds over which the side of the plane is voted.
_SPAN_S, _VOTE_S = 0.1, 20.0
#: Without a rest at the start, the seconds of ranges that give the first position.
_FIRST_S = 1.0
#: Seconds of ranges of which initial values take medians.
_MEDIAN_S = 0.5
#: What serves where anchors are too few.
_WITH_IMU = "declare pos_n_m and pos_sigma_m in [initial] and use imu-uwb, batch or isam2"


Rows = np.ndarray[tuple[int, ...], np.dtype[np.int64]]


@dataclass(frozen=True, eq=False)
class RangeEpochs:
    """Ranges of one tag to several anchors, epoch by epoch (E), in order of time.

    Attributes
    ----------
    anchor_ids : A of them; anchors_n : (A, 3); sigma_m : (A,) of a range with all its errors.
    t_s : (E,) mean time of an epoch's ranges; ranges_m : (E, A), NaN where there is none.
    lever_arm_b : (E, 3) of the tag.
    """

    anchor_ids: tuple[str, ...]
    anchors_n: Array
    sigma_m: Array
    t_s: Array
    ranges_m: Array
    lever_arm_b: Array

    def only(self, rows: Rows) -> RangeEpochs:
        """Some of them."""
        return replace(self, t_s=self.t_s[rows], ranges_m=self.ranges_m[rows], lever_arm_b=self.lever_arm_b[rows])

    def medians(self, span_s: float = _MEDIAN_S) -> RangeEpochs:
        """One epoch for every `span_s` and tag, of the median range to each anchor: reflections drop out."""
        _, tag = np.unique(self.lever_arm_b, axis=0, return_inverse=True)
        number = np.floor((self.t_s - self.t_s[0]) / span_s).astype(np.int64) * (int(tag.max()) + 1) + tag.ravel()
        order = np.argsort(number, kind="stable")
        parts = np.split(order, np.flatnonzero(np.diff(number[order])) + 1)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # an anchor without a range has none
            ranges = np.array([np.nanmedian(self.ranges_m[part], axis=0) for part in parts])
        t_s = np.array([self.t_s[part].mean() for part in parts])
        lever = np.array([self.lever_arm_b[part[0]] for part in parts])
        return replace(self, t_s=t_s, ranges_m=ranges, lever_arm_b=lever)


def total_sigma(uwb: Uwb) -> Array:
    """Sigma (A,) of a single range: white, Markov and constant error, and that of its anchor's survey."""
    parts = [uwb.sigma_m, uwb.markov_sigma_m or 0.0]
    survey = np.array([anchor.sigma_m for anchor in uwb.anchor])
    return np.asarray(np.sqrt(np.sum(np.square(parts)) + uwb.constant_sigma_m**2 + survey**2))


def range_epochs(log: SensorLog, span_s: float | None = None) -> RangeEpochs:
    """Epochs in which every anchor has one range at most, and that determine a position.

    Parameters
    ----------
    span_s : longest time between the first and the last range; by default the time in which all anchors answer once,
        0.1 s at least.

    Raises
    ------
    LogError : no ranges, or anchors that determine no position.
    """
    uwb = ranges_of(log)
    anchors = np.array([anchor.pos_n_m for anchor in uwb.anchor])
    _refuse_geometry(uwb, anchors)
    ids = [anchor.id for anchor in uwb.anchor]
    column = np.array([ids.index(name) for name in uwb.anchor_id])
    times, rows, levers = [], [], []
    for tag in uwb.tag:
        mine = np.flatnonzero(uwb.tag_id == tag.id)
        if not len(mine):
            continue
        t_s, ranges = _grouped(uwb.t_s[mine], column[mine], uwb.range_m[mine], len(ids), span_s)
        times.append(t_s)
        rows.append(ranges)
        levers.append(np.tile(tag.lever_arm_b_m, (len(t_s), 1)))
    t_s, ranges, lever = np.concatenate(times), np.concatenate(rows), np.concatenate(levers)
    good = usable(anchors, np.isfinite(ranges))
    if not good.any():
        raise uwb.error("no three anchors answer together, as a position from ranges alone needs", fix=_WITH_IMU)
    order = np.flatnonzero(good)[np.argsort(t_s[good], kind="stable")]
    return RangeEpochs(tuple(ids), anchors, total_sigma(uwb), t_s[order], ranges[order], lever[order])


def ranges_of(log: SensorLog) -> Uwb:
    """The log's ranges.

    Raises
    ------
    LogError : no table uwb.
    """
    if log.uwb is None or not len(log.uwb):
        raise LogError("no uwb table, which this method needs", where=f"log {log.name}", fix="use another method")
    return log.uwb


def _refuse_geometry(uwb: Uwb, anchors: Array) -> None:
    if len(anchors) < 3:
        raise uwb.error(
            f"{len(anchors)} anchors, a position from ranges alone needs 3, and 4 to be unique",
            column="anchor",
            fix=f"add anchors, or {_WITH_IMU}",
        )
    if not usable(anchors, np.ones((1, len(anchors)), bool))[0]:
        raise uwb.error(
            "the anchors lie on one line: their ranges leave a circle of positions", column="anchor",
            fix=f"add an anchor beside the line, or {_WITH_IMU}",
        )  # fmt: skip


def _grouped(t_s: Array, column: Array, range_m: Array, count: int, span_s: float | None) -> tuple[Array, Array]:
    """Mean times (E,) and ranges (E, A) of one tag's rows: an epoch ends where an anchor answers again."""
    usual = float(np.median(np.diff(t_s))) if len(t_s) > 1 else 0.0
    longest = max(_SPAN_S, count * usual) if span_s is None else span_s
    epoch, began, seen, now = np.empty(len(t_s), int), -np.inf, set[int](), -1
    for k, (t, a) in enumerate(zip(t_s.tolist(), column.tolist(), strict=True)):
        if a in seen or t - began > longest:
            now, began, seen = now + 1, t, set()
        seen.add(a)
        epoch[k] = now
    ranges = np.full((now + 1, count), np.nan)
    ranges[epoch, column] = range_m
    return np.bincount(epoch, t_s) / np.bincount(epoch), ranges


# A position per epoch ---------------------------------------------------------------------------------------


def positions(epochs: RangeEpochs, near_n: Array | None = None) -> Fix:
    """A position of the tag in every epoch, all of them on the side of the anchors' plane that the ranges vote for.

    Noise alone puts many an epoch on the wrong side of anchors that are nearly in a plane; the costs of both sides,
    summed over some seconds, tell where the machine is unless it moves through the plane, where it matters little.

    Parameters
    ----------
    near_n : (3,) a place on the machine's side, for anchors that lie in one plane.

    Raises
    ------
    LogError : anchors in one plane and nothing that tells the side.
    """
    found = fixes(epochs.anchors_n, epochs.ranges_m, epochs.sigma_m, near_n)
    middle = epochs.anchors_n.mean(axis=0)
    normal = np.linalg.svd(epochs.anchors_n - middle)[2][2]
    if coplanar(epochs.anchors_n):
        if near_n is None:
            raise LogError(
                "the anchors lie in one plane: two mirrored positions have the same ranges",
                where="log.toml, [[uwb.anchor]]",
                fix="give pos_n_m in [initial], or an anchor off the plane",
            )
        return found
    above = (found.pos_n - middle) @ normal > (found.mirror_n - middle) @ normal
    favour = np.where(above, 1.0, -1.0) * (found.mirror_cost - found.cost)
    wrong = above != (_windowed(epochs.t_s, favour) > 0)
    near = np.where(wrong[:, None], found.mirror_n, found.pos_n)
    return fixes(epochs.anchors_n, epochs.ranges_m, epochs.sigma_m, near, nearest=True)


def _windowed(t_s: Array, value: Array) -> Array:
    """Sums over a window about each time."""
    total = np.concatenate([[0.0], np.cumsum(value)])
    low, high = (np.searchsorted(t_s, t_s + side * _VOTE_S / 2) for side in (-1, 1))
    return np.asarray(total[high] - total[low])


# Where the log starts ---------------------------------------------------------------------------------------


def is_unknown(initial: InitialState) -> bool:
    """Whether a log declares no position at its start."""
    return bool((initial.pos_sigma_m >= UNKNOWN_M).any())


def start_position(log: SensorLog, rotation_nb: Array, start_s: float, rest_s: Array) -> tuple[Array, Array]:
    """Position of the body at the start (3,) and its covariance (3, 3), from the ranges of the first rest.

    The medians of an anchor's ranges hold off multipath, and averaging before the position is found keeps its
    non-linearity small. Constants and the survey do not average, the Markov part does over its own time.

    Parameters
    ----------
    rotation_nb : (3, 3) attitude then; rest_s : (K, 2) spans at rest; without one the first second serves.

    Raises
    ------
    LogError : no ranges, or ranges that determine no position.
    """
    epochs, uwb = range_epochs(log), ranges_of(log)
    resting = bool(len(rest_s)) and rest_s[0, 0] - start_s < 2.0
    first = epochs.t_s[0] if not resting or epochs.t_s[0] > rest_s[0, 1] else start_s
    until = float(rest_s[0, 1]) if resting and first == start_s else first + _FIRST_S
    now = (epochs.t_s <= until) & (epochs.lever_arm_b == epochs.lever_arm_b[0]).all(axis=1)
    answers = [column[np.isfinite(column)] for column in epochs.ranges_m[now].T]
    ranges = np.array([np.median(column) if len(column) else np.nan for column in answers])
    early = epochs.only(np.flatnonzero(epochs.t_s <= until + _VOTE_S / 2)).medians()
    near = np.median(positions(early).pos_n[early.t_s <= until], axis=0)
    calm = uwb.rest_factor if resting else 1.0
    span = max(until - first, 1e-3)
    shared = min(1.0, 2 * (uwb.markov_time_s or 0.0) / span) * (uwb.markov_sigma_m or 0.0) ** 2
    # a median is worth two thirds of a mean
    white = uwb.sigma_m**2 * np.pi / 2 / np.maximum([len(column) for column in answers], 1)
    constant = total_sigma(uwb) ** 2 - uwb.sigma_m**2 - (uwb.markov_sigma_m or 0.0) ** 2
    found = fix(epochs.anchors_n, ranges, np.sqrt(calm**2 * (white + shared) + constant), near)
    return found.pos_n - rotation_nb @ epochs.lever_arm_b[0], found.cov


def fixes_by_ranges(log: SensorLog, rotation_nb: Array) -> tuple[tuple[float, Array, Array], ...]:
    """Positions of the body, one a second, for initial values alone: (time, position (3,), sigma (3,)).

    None where the anchors determine no position. `rotation_nb` (3, 3) stands for the attitude throughout, which leaves
    positions wrong by the lever arm where the machine turns.
    """
    try:
        epochs = range_epochs(log).medians()
        found = positions(epochs).pos_n - epochs.lever_arm_b @ rotation_nb.T
    except LogError:
        return ()
    second = np.floor((epochs.t_s - epochs.t_s[0]) / _FIRST_S).astype(int)
    parts = [np.flatnonzero(second == k) for k in np.unique(second)]
    return tuple((float(epochs.t_s[p].mean()), np.median(found[p], axis=0), np.ones(3)) for p in parts)
