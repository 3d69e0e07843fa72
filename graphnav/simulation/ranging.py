"""UWB ranges to anchors in turn, and the parts of their errors.

A range at its own time, between IMU samples too, is the distance of the tag's true place from the anchor's true place
plus white noise, a first-order Markov process of the anchor, a constant of the anchor and what delays the signal.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

from graphnav.log import Uwb, UwbAnchor, UwbTag
from graphnav.simulation.motion import Motion
from graphnav.simulation.uwb_figures import RangingSpec

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Booleans = npt.NDArray[np.bool_]

_TAG = "1"
_STANDS_M_S = 1e-9  # at a stop the speed is zero but for rounding


@dataclass(frozen=True)
class Anchors:
    """A row of anchors in its places: those that measure from `from_s` of their place on, until the next place.

    Attributes
    ----------
    pos_n_m : ``(P, A, 3)`` true positions of A anchors in P places.
    declared : P times A sections of the log.
    from_s : ``(P,)`` ascending, the first minus infinity.
    """

    pos_n_m: Array
    declared: tuple[UwbAnchor, ...]
    from_s: Array

    @property
    def turn(self) -> int:
        """Number of anchors that measure in turn."""
        return int(self.pos_n_m.shape[1])


@dataclass(frozen=True)
class RangeErrors:
    """True distances and the parts of each range's error (m), row by row of the log's table; for scoring alone.

    Attributes
    ----------
    t_s : ``(N,)`` times.
    anchor_id : ``(N,)`` text.
    distance_m : ``(N,)`` between tag and anchor, without error.
    constant_m, markov_m, white_m : ``(N,)`` the errors that the log declares sigmas of.
    multipath_m, nlos_m : ``(N,)`` delays, zero for most ranges; of these the log tells nothing.
    """

    t_s: Array
    anchor_id: npt.NDArray[Any]
    distance_m: Array
    constant_m: Array
    markov_m: Array
    white_m: Array
    multipath_m: Array
    nlos_m: Array

    @property
    def total_m(self) -> Array:
        """Measured less true distance."""
        return self.constant_m + self.markov_m + self.white_m + self.multipath_m + self.nlos_m

    @property
    def delayed(self) -> Booleans:
        """The ranges that are no draws of the declared errors."""
        late: Booleans = self.multipath_m + self.nlos_m > 0
        return late


def surveyed(spec: RangingSpec, rng: np.random.Generator, on: float) -> Anchors:
    """Anchors in one place, declared where the scenario has them and truly off by the survey's error."""
    declared_n = np.array(spec.anchors_m)
    sections = tuple(UwbAnchor(str(i), pos, spec.survey_m) for i, pos in enumerate(declared_n, start=1))
    true_n = declared_n + on * spec.survey_m * rng.standard_normal(declared_n.shape)
    return Anchors(true_n[None], sections, np.array([-np.inf]))


class Ranger:
    """Takes ranges while a machine's motion is worked through in blocks; errors are drawn at the end.

    Parameters
    ----------
    spec : the tag and its errors.
    anchors : where they are.
    rng : of the errors.
    on : factor on all of them.
    """

    def __init__(self, spec: RangingSpec, anchors: Anchors, rng: np.random.Generator, on: float) -> None:
        self._spec, self._anchors, self._rng, self._on = spec, anchors, rng, on
        self._blocks: list[tuple[Array, Integers, Array, Booleans]] = []

    def add(self, t_s: Array, motion: Motion, rot_nb: Rotation) -> None:
        """Range at the instants after the first and up to the last of N consecutive IMU instants.

        Between them the IMU turns at a constant rate, as its sample has it, and moves along a cubic.
        """
        rate_hz = self._spec.rate_hz
        ticks = np.arange(_ticks(t_s[0], rate_hz) + 1, _ticks(t_s[-1], rate_hz) + 1)
        ticks = ticks[self._may_reach(ticks / rate_hz, t_s, motion.pos_n)]
        if len(ticks) == 0:
            return
        times = ticks / rate_hz
        pos_n = CubicHermiteSpline(t_s, motion.pos_n, motion.vel_n)(times)
        tag_n = pos_n + Slerp(t_s, rot_nb)(times).apply(self._spec.lever_arm_b_m)
        place = np.searchsorted(self._anchors.from_s, times, side="right") - 1
        turn = (ticks - 1) % self._anchors.turn
        distance = np.linalg.norm(tag_n - self._anchors.pos_n_m[place, turn], axis=1)
        rests = np.interp(times, t_s, np.abs(motion.speed_m_s)) < _STANDS_M_S
        near = distance <= self._spec.reach_m
        self._blocks.append((times[near], (place * self._anchors.turn + turn)[near], distance[near], rests[near]))

    def _may_reach(self, times: Array, t_s: Array, pos_n: Array) -> Booleans:
        """Spare a shift the exact distances while the machine is far from all places of the anchors."""
        middle, spec = self._anchors.pos_n_m.mean(axis=(0, 1)), self._spec
        spread = np.linalg.norm(self._anchors.pos_n_m - middle, axis=-1).max() + np.linalg.norm(spec.lever_arm_b_m)
        away = np.interp(times, t_s, np.linalg.norm(pos_n - middle, axis=1))
        may: Booleans = away <= spec.reach_m + spread + 0.1
        return may

    def errors(self) -> RangeErrors:
        """Draw the errors of all ranges so far; to be called once."""
        spec, on = self._spec, self._on
        t_s, anchor, distance, rests = (np.concatenate(part) for part in zip(*self._blocks, strict=True))
        constant_rng, white_rng, markov_rng, multipath_rng, nlos_rng = self._rng.spawn(5)
        calm = np.where(rests, spec.rest_factor, 1.0)
        constant = spec.constant_m * constant_rng.standard_normal(len(self._anchors.declared))
        ids = np.array([section.id for section in self._anchors.declared], dtype=object)
        return RangeErrors(
            t_s=t_s,
            anchor_id=ids[anchor],
            distance_m=distance,
            constant_m=on * constant[anchor],
            markov_m=on * spec.markov_m * calm * unit_markov(t_s, anchor, spec.markov_time_s, markov_rng),
            white_m=on * spec.white_m * calm * white_rng.standard_normal(len(t_s)),
            multipath_m=on * _multipath(spec, anchor % self._anchors.turn, multipath_rng),
            nlos_m=on * _nlos(spec, len(t_s), nlos_rng),
        )

    def table(self, errors: RangeErrors) -> Uwb:
        """The log's part: measured ranges, and the sigmas that their errors are drawn with."""
        spec, groups = self._spec, any(section.group is not None for section in self._anchors.declared)
        return Uwb(
            t_s=errors.t_s,
            tag_id=np.full(len(errors.t_s), _TAG, dtype=object),
            anchor_id=errors.anchor_id,
            range_m=errors.distance_m + errors.total_m,
            sigma_m=spec.white_m,
            bias_sigma_m=spec.constant_m,
            markov_sigma_m=spec.markov_m,
            markov_time_s=spec.markov_time_s,
            rest_factor=spec.rest_factor,
            group_sigma_m=spec.group_m if groups else None,
            group_turn_sigma_deg=spec.group_turn_deg if groups else None,
            tag=(UwbTag(_TAG, np.array(spec.lever_arm_b_m)),),
            anchor=self._anchors.declared,
        )


def unit_markov(t_s: Array, anchor: Integers, time_s: float, rng: np.random.Generator) -> Array:
    """Stationary first-order Gauss-Markov processes of unit variance, one for each anchor, at ascending times.

    Discretised exactly over whatever time lies between two ranges of an anchor: ``x+ = a x + sqrt(1 - a^2) n`` with
    ``a = exp(-dt / time_s)``.
    """
    values: Array = rng.standard_normal(len(t_s))
    for number in np.unique(anchor):
        rows = np.flatnonzero(anchor == number)
        decay = np.exp(-np.diff(t_s[rows]) / time_s)
        state = float(values[rows[0]])
        steps = zip(decay.tolist(), (np.sqrt(1 - decay**2) * values[rows[1:]]).tolist(), strict=True)
        values[rows[1:]] = [state := a * state + drive for a, drive in steps]
    return values


def _ticks(t_s: float, rate_hz: float) -> int:
    """Number of range instants up to and including a time."""
    return int(np.floor(t_s * rate_hz + 1e-6))


def _multipath(spec: RangingSpec, turn: Integers, rng: np.random.Generator) -> Array:
    if spec.multipath is None:
        return np.zeros(len(turn))
    late = (rng.random(len(turn)) < spec.multipath.share) & (turn == spec.multipath.anchor)
    return np.where(late, rng.exponential(spec.multipath.mean_m, len(turn)), 0.0)


def _nlos(spec: RangingSpec, count: int, rng: np.random.Generator) -> Array:
    late = rng.random(count) < spec.nlos_share
    return np.where(late, rng.uniform(0.0, spec.nlos_max_m, count), 0.0)
