"""Raw scans: what the beams of the LiDAR hit of legs, gob shields, roadway walls and dust.

A leg is a leaning cylinder, a gob shield an upright plane behind each leg, a roadway's outer wall an upright surface
of straight pieces. The nearest of them returns the beam. All beams of a scan leave at one instant: at 0.1 m/s the
machine moves 4 mm between two scans.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from graphnav.log import LidarScans
from graphnav.simulation.lidar import LidarErrors
from graphnav.simulation.lidar_figures import LidarSpec
from graphnav.simulation.supports import Supports
from graphnav.simulation.world import World, face_frame

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

RANGE_STEP_M = 2.0**-10  # of the recorded ranges; a tenth of the noise
_SCANS = 32  # worked on at a time


def build_walls(world: World, spec: LidarSpec, rng: np.random.Generator) -> Array:
    """The outer walls of both roadways as straight pieces, ``(K, 2, 2)``: east and north of the ends of each."""
    raw, to_n = spec.raw, face_frame(world.spec)
    across = np.arange(raw.wall_from_m, raw.wall_to_m + 1e-9, raw.wall_step_m)
    ends_n = world.lines[0].at(np.array([0.0, world.spec.length_m]))[0]
    pieces = []
    for end_n, outwards in zip(ends_n, (-raw.wall_m, raw.wall_m), strict=True):
        along = outwards + raw.wall_rough_m * rng.standard_normal(len(across))
        corners = end_n + np.column_stack([across, along, np.zeros(len(across))]) @ to_n.T
        pieces.append(np.stack([corners[:-1, :2], corners[1:, :2]], axis=1))
    return np.concatenate(pieces)


def scanned(world: World, spec: LidarSpec) -> list[tuple[float, float]]:
    """Spans of time (s) in which raw scans are recorded, see `ScanSpec`."""
    raw, end_s = spec.raw, world.count / world.spec.imu_rate_hz
    if end_s <= raw.short_s:
        return [(0.0, end_s)]
    cuts = [leg for leg in world.timeline.legs if leg.cycle]
    spans = [(cuts[0].start_s, cuts[0].start_s + raw.setting_out_s)]
    for cut in cuts:
        spans += [(cut.start_s - raw.at_rest_s, cut.start_s), (cut.end_s, cut.end_s + raw.at_rest_s)]
    return spans


class ScanRecorder:
    """Collects the raw scans of a shift within the spans of `scanned`.

    Parameters
    ----------
    world, spec, supports, errors : the shift, the LiDAR, the legs it sees, and what it gets wrong.
    walls_rng, rng : of the walls, and of noise and dust.
    on : factor on noise and dust.
    """

    def __init__(
        self,
        world: World,
        spec: LidarSpec,
        supports: Supports,
        errors: LidarErrors,
        walls_rng: np.random.Generator,
        rng: np.random.Generator,
        on: float,
    ) -> None:
        self._spec, self._supports, self._errors, self._on = spec, supports, errors, on
        self._spans = scanned(world, spec)
        self._walls = build_walls(world, spec, walls_rng)
        self._forward_n = face_frame(world.spec)[:, 1]
        self._right_n = face_frame(world.spec)[:, 0]
        self._noise_rng, self._dust_rng = rng.spawn(2)
        self._mounting = Rotation.from_rotvec(errors.mounting_rad)
        low, high = spec.field_deg
        self.angles_rad = np.deg2rad(np.linspace(low, high, round((high - low) / spec.raw.step_deg) + 1))
        self._t_s: list[Array] = []
        self._ranges: list[npt.NDArray[np.float32]] = []

    def add(self, t_s: Array, pos_n: Array, rot_nb: Rotation) -> None:
        """Scan at those of the times that lie in a span; parameters as `PointRecorder.add`."""
        wanted = np.zeros(len(t_s), bool)
        for start_s, end_s in self._spans:
            wanted |= (t_s >= start_s) & (t_s <= end_s)
        rows = np.flatnonzero(wanted)
        for first in range(0, len(rows), _SCANS):
            part = rows[first : first + _SCANS]
            rot_ns = (rot_nb[part] * self._mounting).as_matrix()
            self._t_s.append(t_s[part])
            self._ranges.append(self._scan(t_s[part], pos_n[part], rot_ns).astype(np.float32))

    def table(self) -> LidarScans | None:
        """All scans; None where the log ends before the first."""
        if not self._t_s:
            return None
        t_s, step = np.concatenate(self._t_s), self.angles_rad[1] - self.angles_rad[0]
        ranges = np.concatenate(self._ranges).astype(np.float64)
        return LidarScans(
            t_s=t_s,
            angle_min_rad=np.full(len(t_s), self.angles_rad[0]),
            angle_step_rad=np.full(len(t_s), step),
            ranges_m=list(ranges),
        )

    def _scan(self, t_s: Array, pos_n: Array, rot_ns: Array) -> Array:
        """Measured ranges of N scans, ``(N, beams)``."""
        beams = (len(t_s), len(self.angles_rad))
        white = self._on * self._noise_rng.standard_normal((len(t_s), 2, beams[1]))
        angle_noise = np.deg2rad(self._spec.angle_sigma_deg) * white[:, 1]
        true_rad = self._errors.true_angle(self.angles_rad - angle_noise)
        beam_s = np.stack([-np.sin(true_rad), np.cos(true_rad), np.zeros(beams)], axis=-1)
        hit_m = self._nearest(t_s, pos_n, beam_s @ rot_ns.transpose(0, 2, 1))
        hit_m = self._dusty(hit_m)
        measured = self._errors.measured_range(hit_m) + self._spec.range_sigma_m * white[:, 0]
        if self._on:
            measured = np.round(measured / RANGE_STEP_M) * RANGE_STEP_M
        return np.where(hit_m <= self._spec.raw.reach_m, measured, self._spec.raw.no_return_m)

    def _nearest(self, t_s: Array, pos_n: Array, beam_n: Array) -> Array:
        """True distance along each beam to the first thing that it hits, ``(N, beams)``; infinite for none."""
        legs, reach_m = self._supports, self._spec.raw.reach_m + 2.0
        middle = pos_n.mean(axis=0)
        rows = np.flatnonzero(
            (np.linalg.norm((legs.pos_n_m - middle)[:, :2], axis=1) < reach_m)
            & (legs.from_s <= t_s[-1])
            & (legs.until_s + legs.spec.moving_s > t_s[0])
        )
        stand_n, there = legs.standing(rows, t_s)
        hit_m = self._to_legs(pos_n, beam_n, stand_n, legs.axis_n[rows], there)
        centre = stand_n - legs.spec.shield_m * self._right_n
        half = legs.spec.spacing_m / 2 * self._forward_n
        shields = np.stack([centre - half, centre + half], axis=-2)[..., :2]
        hit_m = np.minimum(hit_m, _to_pieces(pos_n, beam_n, shields, there))
        close = np.linalg.norm(self._walls.mean(axis=1) - middle[:2], axis=1) < reach_m
        walls = np.broadcast_to(self._walls[close], (len(t_s), int(close.sum()), 2, 2))
        return np.minimum(hit_m, _to_pieces(pos_n, beam_n, walls, np.ones(walls.shape[:2], bool)))

    def _to_legs(self, pos_n: Array, beam_n: Array, stand_n: Array, axis_n: Array, there: Mask) -> Array:
        """Distance to the first of K leaning cylinders, ``(N, beams)``."""
        away = pos_n[:, None, :] - stand_n
        along, off = beam_n @ axis_n.T, np.einsum("nki,ki->nk", away, axis_n)
        square = 1 - along**2
        cross = beam_n @ away.transpose(0, 2, 1) - along * off[:, None, :]
        radius = self._supports.spec.leg_diameter_m / 2
        rest = np.einsum("nki,nki->nk", away, away) - off**2 - radius**2
        root = cross**2 - square * rest[:, None, :]
        distance = (-cross - np.sqrt(np.maximum(root, 0.0))) / square
        hit = (root >= 0) & (distance > 0) & there[:, None, :]
        return _first(hit, distance)

    def _dusty(self, hit_m: Array) -> Array:
        """Some beams return from dust on their way, anywhere on it."""
        raw = self._spec.raw
        draws = self._dust_rng.random((*hit_m.shape[:1], 2, hit_m.shape[1]))
        way_m = np.minimum(hit_m, raw.reach_m)
        dust_m = raw.dust_from_m + draws[:, 1] * (way_m - raw.dust_from_m)
        return np.where(draws[:, 0] < self._on * raw.dust, dust_m, hit_m)


def _to_pieces(pos_n: Array, beam_n: Array, pieces: Array, there: Mask) -> Array:
    """Distance to the first of K upright planes above straight pieces ``(N, K, 2, 2)``, ``(N, beams)``."""
    start, run = pieces[..., 0, :], pieces[..., 1, :] - pieces[..., 0, :]
    normal = np.stack([-run[..., 1], run[..., 0]], axis=-1)
    to_start = start - pos_n[:, None, :2]
    flat = beam_n[..., :2]
    with np.errstate(divide="ignore", invalid="ignore"):
        towards = flat @ normal.transpose(0, 2, 1)
        distance = np.einsum("nki,nki->nk", to_start, normal)[:, None, :] / towards
        reached = distance * (flat @ run.transpose(0, 2, 1)) - np.einsum("nki,nki->nk", to_start, run)[:, None, :]
        share = reached / np.einsum("nki,nki->nk", run, run)[:, None, :]
        hit = (distance > 0) & (share >= 0) & (share <= 1) & there[:, None, :]
    return _first(hit, distance)


def _first(hit: Mask, distance_m: Array) -> Array:
    """The least distance of what is hit, ``(N, beams)`` from ``(N, beams, K)``."""
    return np.asarray(np.where(hit, distance_m, np.inf).min(axis=2, initial=np.inf))
