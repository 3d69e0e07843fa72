"""A planar LiDAR that sees the legs of the supports: its error model and the point features it detects.

The scan plane is the x-y plane of the LiDAR's frame s (right, forward, up). A leg is a leaning line, and its point
feature is where the scan plane cuts it, which changes with the machine's height and tilt. Range and angle follow
equations 1 to 6 of the paper; the angle is counter-clockwise from s's forward axis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from graphnav.log import Lidar, LidarPoints
from graphnav.simulation.lidar_figures import LidarSpec
from graphnav.simulation.supports import Supports

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

#: Steps of the recorded numbers: 0.06 mm and 0.9 milli-degrees, far below the noise. Such numbers pack well.
RANGE_STEP_M, ANGLE_STEP_RAD = 2.0**-14, 2.0**-16
_SCANS = 1024  # worked on at a time: few supports are near the machine within 41 s


@dataclass(frozen=True)
class LidarErrors:
    """What the LiDAR's declared geometry and readings have wrong.

    Attributes
    ----------
    mounting_rad : ``(3,)`` angles delta, ``R_bs = Exp(delta)`` for a declared mounting of none.
    range_scale, range_bias_m : ``measured = (1 + range_scale) true + range_bias_m``.
    angle_quadratic_per_deg, angle_scale, angle_bias_deg : in degrees,
        ``true = angle_quadratic measured^2 + (1 + angle_scale) measured + angle_bias``.
    """

    mounting_rad: Array
    range_scale: float
    range_bias_m: float
    angle_quadratic_per_deg: float
    angle_scale: float
    angle_bias_deg: float

    def measured_range(self, true_m: Array) -> Array:
        """Equation 4, upper line."""
        return (1 + self.range_scale) * true_m + self.range_bias_m

    def measured_angle(self, true_rad: Array) -> Array:
        """Equation 4, lower line; written so that it holds without a quadratic term, too."""
        beyond = np.rad2deg(true_rad) - self.angle_bias_deg
        linear = 1 + self.angle_scale
        root = np.sqrt(linear**2 + 4 * self.angle_quadratic_per_deg * beyond)
        return np.deg2rad(2 * beyond / (linear + root))

    def true_angle(self, measured_rad: Array) -> Array:
        """The inverse of `measured_angle`."""
        deg = np.rad2deg(measured_rad)
        true = (self.angle_quadratic_per_deg * deg + 1 + self.angle_scale) * deg + self.angle_bias_deg
        return np.deg2rad(true)


def draw_lidar_errors(spec: LidarSpec, rng: np.random.Generator, on: float) -> LidarErrors:
    """The scenario's fixed values, or draws with their sizes as sigmas; `on` times them, but the mounting as it is."""
    names = ("range_scale", "range_bias_m", "angle_quadratic_per_deg", "angle_scale", "angle_bias_deg")
    sizes = np.array([getattr(spec, name) for name in names])
    mounting_deg = np.array(spec.mounting_deg)
    if spec.draw:
        draws = rng.standard_normal(len(sizes) + 3)
        mounting_deg = np.array(spec.mounting_sigma_deg) * draws[:3]
        sizes = np.abs(sizes) * draws[3:]
    return LidarErrors(np.deg2rad(mounting_deg), **dict(zip(names, (on * sizes).tolist(), strict=True)))


def declared(spec: LidarSpec) -> Lidar:
    """The [lidar] section of the log: no mounting known, sigmas of the sizes that the errors have or are drawn with."""
    return Lidar(
        range_sigma_m=spec.range_sigma_m,
        angle_sigma_deg=spec.angle_sigma_deg,
        mounting_sigma_deg=np.array(spec.mounting_sigma_deg),
        range_scale_sigma=abs(spec.range_scale),
        range_bias_sigma_m=abs(spec.range_bias_m),
        angle_bias_sigma_deg=abs(spec.angle_bias_deg),
        angle_scale_sigma=abs(spec.angle_scale),
        angle_quadratic_sigma_per_deg=abs(spec.angle_quadratic_per_deg),
        feature_spacing_m=spec.supports.spacing_m,
        leg_diameter_m=spec.supports.leg_diameter_m,
    )


def cut_of_leg(pos_n: Array, rot_ns: Array, point_n: Array, axis_n: Array) -> Array:
    """Where the scan planes of N poses cut K lines, ``(N, K, 3)`` in s (the third component is zero).

    Parameters
    ----------
    pos_n, rot_ns : ``(N, 3)`` and ``(N, 3, 3)`` poses of the LiDAR.
    point_n, axis_n : ``(K, 3)`` or ``(N, K, 3)`` a point and the direction of each line.
    """
    point_s = (point_n - pos_n[:, None, :]) @ rot_ns
    axis_s = axis_n @ rot_ns
    return np.asarray(point_s - (point_s[..., 2] / axis_s[..., 2])[..., None] * axis_s)


def range_and_bearing(vector_s: Array) -> tuple[Array, Array]:
    """Range (m) and angle (rad, counter-clockwise from the forward axis) in the scan plane of ``(..., 3)`` vectors."""
    return np.hypot(vector_s[..., 0], vector_s[..., 1]), np.arctan2(-vector_s[..., 0], vector_s[..., 1])


class PointRecorder:
    """Collects the point features of a shift, block by block, in little memory.

    Parameters
    ----------
    spec, supports, errors : the LiDAR, the world it sees, and what it gets wrong.
    rng : of the white noise.
    on : factor on the white noise; at zero the numbers are not rounded either.
    """

    def __init__(
        self, spec: LidarSpec, supports: Supports, errors: LidarErrors, rng: np.random.Generator, on: float
    ) -> None:
        self._spec, self._supports, self._errors, self._rng, self._on = spec, supports, errors, rng, on
        self._mounting = Rotation.from_rotvec(errors.mounting_rad)
        self._field_rad = np.deg2rad(spec.field_deg)
        self._parts: dict[str, list[npt.NDArray[np.generic]]] = {name: [] for name in ("scan", "feature", "r", "a")}
        self._times: list[Array] = []
        self._scans = 0

    def add(self, t_s: Array, pos_n: Array, rot_nb: Rotation) -> None:
        """Scan once at each of the times, ``(N,)``, positions ``(N, 3)`` and N attitudes of the body."""
        rot_ns = (rot_nb * self._mounting).as_matrix()
        for first in range(0, len(t_s), _SCANS):
            part = slice(first, first + _SCANS)
            self._add_some(t_s[part], pos_n[part], rot_ns[part])

    def table(self) -> LidarPoints | None:
        """All rows, in order of time and along the row of supports; None where nothing was seen."""
        if not any(map(len, self._parts["scan"])):
            return None
        times = np.concatenate(self._times)
        # One column at a time, its parts given up at once: the peak is one column above the table.
        return LidarPoints(
            t_s=times[np.concatenate(self._parts.pop("scan"))],
            feature=np.concatenate(self._parts.pop("feature")).astype(np.int64),
            range_m=np.concatenate(self._parts.pop("r")).astype(np.float64),
            angle_rad=np.concatenate(self._parts.pop("a")).astype(np.float64),
        )

    def _add_some(self, t_s: Array, pos_n: Array, rot_ns: Array) -> None:
        near = self._candidates(t_s, pos_n)
        legs = self._supports
        cut_s = cut_of_leg(pos_n, rot_ns, legs.pos_n_m[near], legs.axis_n[near])
        range_m, bearing_rad = range_and_bearing(cut_s)
        at_rest = (t_s[:, None] >= legs.from_s[near]) & (t_s[:, None] < legs.until_s[near])
        angle_rad = self._errors.measured_angle(bearing_rad)
        low, high = self._field_rad
        seen = at_rest & (range_m <= self._spec.reach_m) & (angle_rad >= low) & (angle_rad <= high)
        scan, leg = np.nonzero(seen)
        noisy_m, noisy_rad = self._noisy(self._errors.measured_range(range_m[seen]), angle_rad[seen])
        self._times.append(t_s)
        self._parts["scan"].append((scan + self._scans).astype(np.int32))
        self._parts["feature"].append(legs.feature[near][leg].astype(np.int32))
        self._parts["r"].append(noisy_m)
        self._parts["a"].append(noisy_rad)
        self._scans += len(t_s)

    def _candidates(self, t_s: Array, pos_n: Array) -> Integers:
        """Rows of the landmarks that may be seen, in their order along the face."""
        legs = self._supports
        middle = (pos_n.min(axis=0) + pos_n.max(axis=0)) / 2
        way_m = np.linalg.norm(np.ptp(pos_n, axis=0)) / 2
        # A leaning leg is cut off its reference point by what the plane's height differs from it: within a metre.
        close = np.linalg.norm((legs.pos_n_m - middle)[:, :2], axis=1) <= self._spec.reach_m + way_m + 1.0
        rows = np.flatnonzero(close & (legs.from_s <= t_s[-1]) & (legs.until_s > t_s[0]))
        return rows[np.lexsort((legs.advance[rows], legs.support[rows]))]

    def _noisy(self, range_m: Array, angle_rad: Array) -> tuple[npt.NDArray[np.floating], npt.NDArray[np.floating]]:
        if not self._on:
            return range_m, angle_rad
        white = self._on * self._rng.standard_normal((len(range_m), 2))
        range_m = range_m + self._spec.range_sigma_m * white[:, 0]
        angle_rad = angle_rad + np.deg2rad(self._spec.angle_sigma_deg) * white[:, 1]
        # Rounded to these steps the numbers are exact in half the memory.
        return (
            (np.round(range_m / RANGE_STEP_M) * RANGE_STEP_M).astype(np.float32),
            (np.round(angle_rad / ANGLE_STEP_RAD) * ANGLE_STEP_RAD).astype(np.float32),
        )
