"""Scans along a row of supports, cast ray by ray: what the leg finder is tested and timed on.

The row stands on the left of the track, a wall of shields behind it, the coal face on the right. Legs lean, so that the
scan plane cuts ellipses; dust stops beams short, some return nothing.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from factors.so3 import Array
from graphnav.log import Frames, Imu, Lidar, LidarScans, Odometer, SensorLog


@dataclass(frozen=True)
class Row:
    """What stands beside the track, and how it is scanned.

    Attributes
    ----------
    spacing_m, offset_m, diameter_m : of the legs. tilt_deg : how far they lean, each in a direction of its own.
    beams, fov_deg : of a scan, about the machine's left. rate_hz, speed_m_s : of the scans and the machine.
    range_sigma_m, angle_sigma_deg : noise. dust, lost : shares of beams that stop short or return nothing.
    wall_m : the shields' distance from the track; max_range_m : beams reach no farther.
    """

    spacing_m: float = 1.5
    offset_m: float = 4.0
    diameter_m: float = 0.4
    tilt_deg: float = 10.0
    beams: int = 720
    fov_deg: float = 180.0
    rate_hz: float = 25.0
    speed_m_s: float = 0.1
    range_sigma_m: float = 0.01
    angle_sigma_deg: float = 0.05
    dust: float = 0.01
    lost: float = 0.01
    wall_m: float = 6.0
    max_range_m: float = 12.0

    def lidar(self) -> Lidar:
        """What a log declares of it."""
        return Lidar(
            range_sigma_m=self.range_sigma_m,
            angle_sigma_deg=self.angle_sigma_deg,
            feature_spacing_m=self.spacing_m,
            leg_diameter_m=self.diameter_m,
        )


@dataclass(frozen=True)
class Push:
    """A support that advances: leg, when it starts, how far towards the track, how fast."""

    leg: int
    start_s: float
    push_m: float = 1.0
    speed_m_s: float = 0.1

    def moved(self, t_s: Array) -> Array:
        """How far it has come."""
        return np.clip((t_s - self.start_s) * self.speed_m_s, 0.0, self.push_m)


@dataclass(frozen=True)
class Scanned:
    """A log of scans and what is true of it.

    Attributes
    ----------
    log : scans and odometer.
    legs_m : (S, L, 2) centres of the legs in the machine's axes (right, forward) at each scan.
    share : (S, L) share of a leg's width within the scan and not behind something else, 0 out of reach.
    """

    log: SensorLog
    legs_m: Array
    share: Array


def scanned(row: Row, seconds: float, seed: int, pushes: tuple[Push, ...] = (), block: int = 500) -> Scanned:
    """Scans of a machine that drives along the row at constant speed.

    Parameters
    ----------
    row : the surroundings and the sensor.
    seconds : duration.
    seed : of every draw.
    pushes : supports that advance meanwhile.
    block : scans cast at one time.
    """
    rng = np.random.default_rng(seed)
    t_s = np.arange(0.0, seconds, 1 / row.rate_hz)
    gone = row.speed_m_s * t_s
    count = int((gone[-1] + 2 * row.max_range_m) / row.spacing_m) + 1
    along = np.arange(count) * row.spacing_m - row.max_range_m
    legs = np.empty((len(t_s), count, 2))
    legs[..., 0] = -row.offset_m
    for push in pushes:
        legs[:, push.leg, 0] += push.moved(t_s)
    legs[..., 1] = along - gone[:, None]
    lean = rng.uniform(0, np.pi, count)
    angles = np.pi / 2 + np.radians(row.fov_deg) * (np.arange(row.beams) / (row.beams - 1) - 0.5)
    ranges, share = np.empty((len(t_s), row.beams)), np.empty((len(t_s), count))
    for low in range(0, len(t_s), block):
        part = slice(low, low + block)
        ranges[part], share[part] = _cast(row, rng, legs[part], lean, angles)
    log = SensorLog(
        name="row",
        frames=Frames(latitude_deg=35.0),
        imu=_imu(rng, seconds),
        odometer=_odometer(row, rng, seconds),
        lidar=row.lidar(),
        lidar_scans=LidarScans(
            t_s=t_s,
            angle_min_rad=np.full(len(t_s), angles[0]),
            angle_step_rad=np.full(len(t_s), angles[1] - angles[0]),
            ranges_m=list(ranges),
        ),
    )
    return Scanned(log, legs, share)


def without(log: SensorLog, start_s: float, end_s: float) -> SensorLog:
    """The log without the scans in a span."""
    scans = log.lidar_scans
    assert scans is not None
    keep = (scans.t_s < start_s) | (scans.t_s >= end_s)
    kept = LidarScans(
        t_s=scans.t_s[keep],
        angle_min_rad=scans.angle_min_rad[keep],
        angle_step_rad=scans.angle_step_rad[keep],
        ranges_m=list(scans.ranges_m[keep]),
    )
    return dataclasses.replace(log, lidar_scans=kept)


def _imu(rng: np.random.Generator, seconds: float) -> Imu:
    """A machine that does not turn, at 20 Hz, with the lidar paper's gyro; Earth rate left out."""
    t_s = np.arange(0.05, seconds + 0.1, 0.05)
    noise = np.radians(0.01) / 60 / np.sqrt(0.05)
    return Imu(
        t_s=t_s,
        gyro_b_rad_s=rng.normal(0, noise, (len(t_s), 3)),
        accel_b_m_s2=np.tile([0.0, 0.0, 9.8], (len(t_s), 1)),
        gyro_bias_deg_h=0.05,
        gyro_random_walk_deg_sqrt_h=0.01,
        accel_bias_mg=0.05,
        accel_random_walk_mg_sqrt_hz=0.01,
    )


def _odometer(row: Row, rng: np.random.Generator, seconds: float) -> Odometer:
    t_s = np.arange(0.0, seconds + 0.1, 0.1)
    return Odometer(
        t_s=t_s,
        speed_m_s=row.speed_m_s * 1.002 + rng.normal(0, 0.01, len(t_s)),
        sigma_m_s=0.01,
        slip_sigma_m_s=0.001,
        scale_sigma=0.002,
        mounting_sigma_deg=np.array([0.3, 0.3, 0.3]),
    )


def _cast(row: Row, rng: np.random.Generator, legs: Array, lean: Array, angles: Array) -> tuple[Array, Array]:
    """Ranges (S, B) with noise, and how much of each leg is in sight (S, L)."""
    scans, count = legs.shape[:2]
    true_angles = angles + rng.normal(0, np.radians(row.angle_sigma_deg), (scans, len(angles)))
    ray = np.stack([-np.sin(true_angles), np.cos(true_angles)], axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        wall = np.where(ray[..., 0] < 0, -row.wall_m / ray[..., 0], np.inf)
    hit = np.where(wall < row.max_range_m, wall, np.inf)
    owner = np.full(hit.shape, -1)
    widths = np.zeros((scans, count))
    stretch = 1 / np.cos(np.radians(row.tilt_deg))
    for leg in range(count):
        range_m = _ellipse(ray, legs[:, leg], lean[leg], row.diameter_m / 2, stretch)
        widths[:, leg] = np.isfinite(range_m).sum(axis=1)
        nearer = (range_m < hit) & (range_m < row.max_range_m)
        owner = np.where(nearer, leg, owner)
        hit = np.where(nearer, range_m, hit)
    step = angles[1] - angles[0]
    distance = np.linalg.norm(legs, axis=-1)
    whole = 2 * np.arcsin(np.minimum(row.diameter_m / 2 / distance, 1.0)) / step
    seen = np.stack([(owner == leg).sum(axis=1) for leg in range(count)], axis=1)
    share = seen / whole * (distance < row.max_range_m)
    ranges = hit + rng.normal(0, row.range_sigma_m, hit.shape)
    drawn = rng.random(hit.shape)
    short = drawn < row.dust
    ranges[short] = rng.uniform(0.3, 1.0, short.sum()) * np.minimum(hit[short], row.max_range_m)
    ranges[(drawn > 1 - row.lost) | ~np.isfinite(ranges)] = 0.0
    return ranges, share


def _ellipse(ray: Array, centre: Array, lean: float, radius: float, stretch: float) -> Array:
    """Where rays from the origin meet an ellipse about each scan's centre; infinite where they miss it."""
    c, s = np.cos(lean), np.sin(lean)
    axes = np.array([[c / stretch, s / stretch], [-s, c]]) / radius
    direction, start = ray @ axes.T, -(centre @ axes.T)[:, None]
    a, b = (direction**2).sum(axis=-1), (direction * start).sum(axis=-1)
    inside = b * b - a * ((start**2).sum(axis=-1) - 1)
    range_m = (-b - np.sqrt(np.maximum(inside, 0.0))) / a
    return np.where((inside > 0) & (range_m > 0), range_m, np.inf)
