"""Tracks of features without images: points of the roadway's surfaces, projected into the pair with pixel noise."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from graphnav.log import StereoTracks
from graphnav.simulation.ray_caster import trace
from graphnav.simulation.roadheader_camera import R_BC
from graphnav.simulation.roadheader_figures import CameraSpec, RoadheaderSpec, TrackSpec
from graphnav.simulation.roadway_surfaces import box

Array = npt.NDArray[np.float64]

_NEAREST_M = 0.3


class Tracker:
    """Points in view, frame by frame: kept until they leave an image, are lost or are too far for the dust.

    Lost and gone points are replaced at once by others, evenly over the left image; a point seen again is a new track.
    """

    def __init__(self, spec: RoadheaderSpec, tracks: TrackSpec, rng: np.random.Generator, on: float) -> None:
        self._spec, self._tracks, self._rng, self._on = spec, tracks, rng, on
        self._box = tuple(box(spec.roadway))
        self._points, self._names = np.empty((0, 3)), np.empty(0, int)
        self._next = 1

    def frame(self, pos_n: Array, rot_nb: Rotation) -> tuple[npt.NDArray[np.int64], Array]:
        """Names ``(N,)`` and places ``(N, 3)`` (u left, u right, v; px) of the points seen from a body's pose."""
        place_n, rot_nc = camera_pose(self._spec.camera, pos_n, rot_nb)
        stays = np.exp(-1 / (self._spec.rate_hz * self._tracks.life_s))
        seen = self._seen(self._points, place_n, rot_nc) & (self._rng.random(len(self._points)) < stays)
        self._points, self._names = self._points[seen], self._names[seen]
        while len(self._points) < self._tracks.count:
            fresh = self._drawn(self._tracks.count - len(self._points), place_n, rot_nc)
            self._points = np.concatenate([self._points, fresh])
            self._names = np.concatenate([self._names, self._next + np.arange(len(fresh))])
            self._next += len(fresh)
        return self._names, project(self._spec.camera, (self._points - place_n) @ rot_nc)

    def measured(self, places_px: Array) -> Array:
        """Places with noise; those of wrong matches are off by up to `outlier_px`."""
        tracks, rng = self._tracks, self._rng
        noise = tracks.sigma_px * rng.standard_normal(places_px.shape)
        wrong = rng.random(len(places_px)) < tracks.outlier_share
        noise[wrong] = tracks.outlier_px * rng.uniform(-1, 1, (int(wrong.sum()), 3))
        found: Array = places_px + self._on * noise
        return found

    def _drawn(self, count: int, place_n: Array, rot_nc: Array) -> Array:
        """Up to `count` points where rays through random pixels meet a surface, in view of both cameras."""
        camera = self._spec.camera
        pixels = self._rng.uniform(-0.5, [camera.width_px - 0.5, camera.height_px - 0.5], (count, 2))
        centre = [(camera.width_px - 1) / 2, (camera.height_px - 1) / 2]
        rays = np.column_stack([(pixels - centre) / camera.focal_px, np.ones(count)]) @ rot_nc.T
        start = tuple(place_n.tolist())
        depth = np.array([trace(self._box, start, *ray)[2] for ray in rays.tolist()])
        points = place_n + depth[:, None] * rays
        return points[self._seen(points, place_n, rot_nc)]

    def _seen(self, points_n: Array, place_n: Array, rot_nc: Array) -> npt.NDArray[np.bool_]:
        camera, points_c = self._spec.camera, (points_n - place_n) @ rot_nc
        near = (points_c[:, 2] > _NEAREST_M) & (np.linalg.norm(points_c, axis=1) < self._tracks.reach_m)
        left, right, row = project(camera, np.where(near[:, None], points_c, 1.0)).T
        inside = (left >= -0.5) & (left < camera.width_px - 0.5) & (right >= -0.5) & (right < camera.width_px - 0.5)
        seen: npt.NDArray[np.bool_] = near & inside & (row >= -0.5) & (row < camera.height_px - 0.5)
        return seen


def camera_pose(camera: CameraSpec, pos_n: Array, rot_nb: Rotation) -> tuple[Array, Array]:
    """Place of the left camera in n and its attitude ``R_nc``."""
    return pos_n + rot_nb.apply(camera.lever_arm_b_m), rot_nb.as_matrix() @ R_BC


def project(camera: CameraSpec, points_c: Array) -> Array:
    """``(N, 3)``: column in the left image, column in the right one (less by f b / z), row; px."""
    x, y, z = points_c.T
    focal, cx, cy = camera.focal_px, (camera.width_px - 1) / 2, (camera.height_px - 1) / 2
    left = cx + focal * x / z
    return np.column_stack([left, left - focal * camera.baseline_m / z, cy + focal * y / z])


def tracks_table(
    spec: RoadheaderSpec,
    tracks: TrackSpec,
    t_s: Array,
    poses: tuple[Array, Rotation],
    rng: np.random.Generator,
    on: float,
) -> StereoTracks:
    """The log's table of tracks at frame times `t_s` and the body's poses then; `on`: factor on the errors."""
    tracker = Tracker(spec, tracks, rng, on)
    names, places, counts = [], [], []
    for pos_n, rot_nb in zip(*poses, strict=True):
        name, place = tracker.frame(pos_n, rot_nb)
        names.append(name)
        places.append(tracker.measured(place))
        counts.append(len(name))
    columns = np.concatenate(places).T
    return StereoTracks(np.repeat(t_s, counts), np.concatenate(names), *columns)
