"""The row of hydraulic supports beside the machine: where each leg stands, and when it is moved.

A support stands at rest until the machine has cut past it and is `lag_m` away; then it is drawn up by the push and
stands at rest again. Each such place at rest is a landmark of its own with a feature number of its own. Supports that
the machine does not leave behind in the cut itself, at the end where it stops, move while it draws back from there.
At 0.1 m/s the machine is 11.75 m away along the face when a support has come to rest, and the support itself has crept
by some 0.2 m. So a cut towards the far end shows each support at one place only; a cut towards the near end shows most
of them for a second more, at their next place at the edge of the LiDAR's reach.

Supports advance by the push, and by the creep of the face along it, each with an error of its own of the sigmas that
the log declares for the advance: to the right and up, and along the face. All advance in parallel, square to the face.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from graphnav.simulation.lidar_figures import LidarSpec, SupportSpec
from graphnav.simulation.motion import Leg
from graphnav.simulation.path import Line
from graphnav.simulation.scenarios import ShearerSpec
from graphnav.simulation.world import World, build_world, creep_of, face_frame, streams

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

_STEP_S = 0.05  # of the table of the machine's face coordinate over time: 5 mm of travel at 0.1 m/s


@dataclass(frozen=True)
class Supports:
    """Every place that a leg has stood at. A landmark is a leg at rest: one per support and advance.

    Attributes
    ----------
    spec : the row's figures.
    feature : ``(K,)`` numbers of the landmarks: 1 to K, first all supports before their first advance.
    support : ``(K,)`` number of the support, from 0 at the near end on.
    advance : ``(K,)`` number of times it has been advanced before.
    pos_n_m : ``(K, 3)`` the point of the leg's axis at the height of the track beside it.
    axis_n : ``(K, 3)`` unit vectors up along the leg.
    from_s, until_s : ``(K,)`` times between which the leg stands there; infinite where nothing moves it.
    """

    spec: SupportSpec
    feature: Integers
    support: Integers
    advance: Integers
    pos_n_m: Array
    axis_n: Array
    from_s: Array
    until_s: Array

    @property
    def count(self) -> int:
        """Number of supports."""
        return int(np.count_nonzero(self.advance == 0))

    def rows(self, feature: npt.ArrayLike) -> Integers:
        """Rows of landmarks by their feature numbers, ``(N,)``."""
        return np.asarray(feature, np.int64) - 1

    def standing(self, rows: Integers, t_s: Array) -> tuple[Array, npt.NDArray[np.bool_]]:
        """Places of K supports at N times while they stand at, or move on from, the landmarks of `rows`.

        Returns
        -------
        pos_n : ``(N, K, 3)`` m.
        there : ``(N, K)`` false before a support has come there and after it has come to the next place.
        """
        following = np.minimum(rows + self.count, len(self.feature) - 1)
        share = np.clip((t_s[:, None] - self.until_s[rows]) / self.spec.moving_s, 0.0, 1.0)
        pos_n = self.pos_n_m[rows] + share[..., None] * (self.pos_n_m[following] - self.pos_n_m[rows])
        return pos_n, (self.from_s[rows] <= t_s[:, None]) & (share < 1.0)


def build_supports(world: World, rng: np.random.Generator) -> Supports:
    """Set up the row and advance it through the shift.

    Raises
    ------
    ValueError
        The scenario has no LiDAR.
    """
    spec = _lidar(world.spec).supports
    u_m = np.arange(-spec.beyond_m, world.spec.length_m + spec.beyond_m + 1e-9, spec.spacing_m)
    count, places = len(u_m), world.spec.cycles + 1
    moves_s = _moves(world, spec, u_m)
    pos_n, axis_n = _places(world, u_m, places, rng)
    return Supports(
        spec,
        feature=np.arange(1, places * count + 1),
        support=np.tile(np.arange(count), places),
        advance=np.repeat(np.arange(places), count),
        pos_n_m=pos_n,
        axis_n=axis_n,
        from_s=np.concatenate([np.full(count, -np.inf), moves_s.ravel() + spec.moving_s]),
        until_s=np.concatenate([moves_s.ravel(), np.full(count, np.inf)]),
    )


def supports_truth(scenario: str, seed: int = 0, **options: Any) -> Supports:
    """The landmarks of a simulated log, for scoring alone: a log does not tell them.

    Parameters
    ----------
    scenario, seed, **options : as the log was simulated with.

    Raises
    ------
    ConfigError
        Unknown scenario or option, a value out of range, or a scenario without LiDAR.
    """
    from graphnav.errors import ConfigError
    from graphnav.simulation.scenarios import resolve

    spec, streams_of = resolve(scenario, options), streams(seed)
    if not isinstance(spec, ShearerSpec) or spec.lidar is None:
        raise ConfigError(f"{scenario}: no LiDAR and so no supports; use shearer-lidar")
    return build_supports(build_world(spec, streams_of.geometry, streams_of.machine), streams_of.supports)


def _lidar(spec: ShearerSpec) -> LidarSpec:
    if spec.lidar is None:
        raise ValueError("a scenario without LiDAR has no supports")
    return spec.lidar


def _places(world: World, u_m: Array, places: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Positions and axes of all supports after 0, 1, ... advances, ``(places * count, 3)`` each, in n."""
    spec, row = world.spec, _lidar(world.spec).supports
    to_n = face_frame(spec)
    step_rng, lean_rng = rng.spawn(2)
    sigma_m = np.array([spec.push_sigma_m, spec.along_sigma_m, spec.push_sigma_m])
    pos_n, axis_n = np.empty((places, len(u_m), 3)), np.empty((places, len(u_m), 3))
    before_n, step_m = _beside(world.lines[0], u_m, spec.length_m), np.array([-row.beside_m, 0.0, 0.0])
    for place in range(places):
        step_m = step_m + sigma_m * step_rng.standard_normal((len(u_m), 3))
        pos_n[place] = before_n + step_m @ to_n.T
        before_n, step_m = pos_n[place], np.array([spec.push_m, creep_of(spec, place) or 0.0, 0.0])
        axis_n[place] = _axes(row, lean_rng, len(u_m)) @ to_n.T
    return pos_n.reshape(-1, 3), axis_n.reshape(-1, 3)


def _beside(line: Line, u_m: Array, length_m: float) -> Array:
    """Points of the line, which goes on straight beyond the ends of the travel, ``(N, 3)``."""
    within = np.clip(u_m, 0.0, length_m)
    pos_n, slope, _ = line.at(within)
    return np.asarray(pos_n + (u_m - within)[:, None] * slope)


def _axes(spec: SupportSpec, rng: np.random.Generator, count: int) -> Array:
    """Directions of leaning legs in the face's axes, ``(count, 3)``."""
    lean = np.deg2rad(rng.uniform(*spec.lean_deg, count))
    azimuth = np.deg2rad(spec.lean_azimuth_deg) * rng.standard_normal(count)
    side = np.sin(lean)
    return np.column_stack([side * np.cos(azimuth), side * np.sin(azimuth), np.cos(lean)])


def _moves(world: World, spec: SupportSpec, u_m: Array) -> Array:
    """Times at which the supports start to move, ``(cycles, count)``; infinite where the shift ends before."""
    legs = world.timeline.legs
    moves = []
    for index, cut in enumerate(legs):
        if cut.cycle:
            following = legs[index + 1] if index + 1 < len(legs) else None
            moves.append(_moves_of_cut(cut, following, spec.lag_m, u_m))
    return np.array(moves)


def _moves_of_cut(cut: Leg, oblique: Leg | None, lag_m: float, u_m: Array) -> Array:
    way = cut.arc.direction
    time_s, at_m = _travel(cut)
    behind_m = way * u_m + lag_m  # the machine is that far on its way when the support moves
    times = np.interp(behind_m, way * at_m, time_s)
    late = behind_m > way * at_m[-1]
    if oblique is None:
        times[late] = np.inf
    else:
        back_s, back_m = _travel(oblique)
        times[late] = np.interp(lag_m - way * u_m[late], -way * back_m, back_s)
    return times


def _travel(leg: Leg) -> tuple[Array, Array]:
    """Times and face coordinates of the machine along a leg, which it travels one way."""
    time_s = np.linspace(leg.start_s, leg.end_s, int(leg.profile.duration_s / _STEP_S) + 2)
    way_m, _ = leg.profile.at(time_s - leg.start_s)
    return time_s, np.asarray(leg.arc.u_of_s(way_m))
