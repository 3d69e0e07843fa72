"""Features that a stereo camera tracks, all readings of a log at once: the tight counterpart of relative poses.

Every feature is a point of its own in the graph and every reading ties it to the pose it was seen from, so that what
readings of one feature have in common counts once, from however many poses it was seen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from factors import lookup, so3
from factors.carried import CAMERA_ERRORS, Carried, Moments
from factors.condensed_points import Condensed, PointRows
from factors.increments import npt_int
from factors.robust import Loss, reweighted
from factors.so3 import Array
from factors.stereo import StereoCamera, residual

if TYPE_CHECKING:
    import gtsam

#: Rows of a reading: u_left, u_right, v.
_ROWS = 3
#: Nearest depth at which a reading is looked at: behind it an iteration has gone astray, and it does not count, m.
_NEAREST_M = 0.05
#: No step of a point is expected to be longer, m: with this sigma, and no error, it is held to where it is.
_FARTHEST_M = 1e3
#: A point seen from more poses than this is not eliminated before them: what is left of it ties each to all others.
_MOST_POSES = 200


@dataclass(frozen=True)
class TrackFamily:
    """All readings of tracked features as arrays.

    Attributes
    ----------
    pose_key, point_key : (K,) pose T_nb from which a feature was seen, and its place in n (a 3-vector).
    camera_key : of the 8-vector of the camera's errors (mounting: angles about c's axes, place in b; what disparities
        are too large by, px; how much later than stamped its images are, s), or None where they are known.
    pixels : (K, 3) u_left, u_right, v; sigma_px : of each of them.
    camera : the rectified pair; rotation_bc, pos_bc : (3, 3), (3,) its mounting as declared.
    loss, scale : of a reading's length in sigmas, see `factors.robust`.
    moments : of the poses, where the clock may be off; None: it is right.
    """

    pose_key: npt_int
    point_key: npt_int
    camera_key: int | None
    pixels: Array
    sigma_px: float
    camera: StereoCamera
    rotation_bc: Array
    pos_bc: Array
    loss: Loss = "none"
    scale: float = 3.0
    moments: Moments | None = None

    @property
    def size(self) -> int:
        """Rows of one error."""
        return _ROWS

    def only(self, rows: npt_int | np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> TrackFamily:
        """Some of the readings."""
        return replace(
            self, pose_key=self.pose_key[rows], point_key=self.point_key[rows], pixels=self.pixels[rows],
            moments=None if self.moments is None else self.moments.only(rows),
        )  # fmt: skip

    def residuals(self, values: gtsam.Values) -> tuple[Array, list[Array]]:
        """Whitened errors (K, 3) and Jacobians (K, 3, size) by pose, point and the camera's errors, if unknown.

        A point that is not in front of the camera (an iteration gone astray) has no slope, and errors of a whole image.
        """
        unknown = np.zeros(CAMERA_ERRORS) if self.camera_key is None else values.atVector(self.camera_key)
        then = Carried.by(lookup.poses(values, self.pose_key), self.moments, float(unknown[7]))
        pose, point = then.pose, lookup.vectors(values, self.point_key)
        turn_bc, place = self.rotation_bc @ so3.exp(unknown[:3]), self.pos_bc + unknown[3:6]
        point_b = _times(so3.transpose(pose[:, :3, :3]), point - pose[:, :3, 3])
        good = np.flatnonzero((point_b - place) @ turn_bc[:, 2] > _NEAREST_M)
        error = np.full((len(pose), _ROWS), 2 * self.camera.cx_px)
        by_pose, by_point = np.zeros((len(pose), _ROWS, 6)), np.zeros((len(pose), _ROWS, 3))
        by_camera = np.zeros((len(pose), _ROWS, CAMERA_ERRORS))
        read = self.pixels + unknown[6] * np.array([0.0, 1.0, 0.0])  # a disparity too large: u_right too small
        error[good], by_pose[good], by_point[good], by_camera[good, :, :6] = residual(
            pose[good, :3, :3], pose[good, :3, 3], point[good], turn_bc, place, read[good], self.camera
        )
        jacobians = [by_pose @ then.by_pose, by_point]
        if self.camera_key is not None:
            # of a pose's perturbation; here the angles are a vector, and the place is in b
            by_camera[:, :, :3] = by_camera[:, :, :3] @ so3.right_jacobian(unknown[:3])
            by_camera[:, :, 3:6] = by_camera[:, :, 3:6] @ turn_bc.T
            by_camera[good, 1, 6] = -1.0
            by_camera[:, :, 7] = (by_pose @ then.by_time[..., None])[..., 0]
            jacobians.append(by_camera)
        return error / self.sigma_px, [each / self.sigma_px for each in jacobians]

    def off(self, values: gtsam.Values) -> Array:
        """Length (K,) of each whitened error."""
        return np.asarray(np.linalg.norm(self.residuals(values)[0], axis=1))

    def near(self, values: gtsam.Values) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        """Whether each reading's point (K,) is so near that its disparity is more than the error of one."""
        pose, point = lookup.poses(values, self.pose_key), lookup.vectors(values, self.point_key)
        point_b = _times(so3.transpose(pose[:, :3, :3]), point - pose[:, :3, 3])
        depth = (point_b - self.pos_bc) @ self.rotation_bc[:, 2]
        return np.asarray((depth > 0) & (depth * self.sigma_px < self.camera.fx_px * self.camera.baseline_m))

    def linearize_into(self, linear: gtsam.GaussianFactorGraph, values: gtsam.Values) -> None:
        """Append the whitened Jacobian factors at `values`."""
        import gtsam

        if not len(self.pose_key):
            return
        error, by, excess = self._weighted(values)
        unit, m = gtsam.noiseModel.Unit.Create(_ROWS), self.camera_key
        for k, (x, p) in enumerate(zip(self.pose_key.tolist(), self.point_key.tolist(), strict=True)):
            if m is None:
                linear.push_back(gtsam.JacobianFactor(x, by[0][k], p, by[1][k], -error[k], unit))
            else:
                linear.push_back(gtsam.JacobianFactor(x, by[0][k], p, by[1][k], m, by[2][k], -error[k], unit))
        # held where it is: a point behind all its cameras has no slope, and one that runs off to infinity next to none
        still, nothing = np.eye(_ROWS) / _FARTHEST_M, np.zeros(_ROWS)
        for p in np.unique(self.point_key).tolist():
            linear.push_back(gtsam.JacobianFactor(p, still, nothing, unit))
        linear.push_back(self._rest(excess))

    def condense_into(self, linear: gtsam.GaussianFactorGraph, values: gtsam.Values) -> Condensed | None:
        """The same with the points eliminated: they are no part of the linear graph.

        None without readings, and where a point is seen from so many poses that these would all be tied to each other:
        there the points stay, as in `linearize_into`.
        """
        if not len(self.pose_key):
            return None
        if np.unique(self.point_key, return_counts=True)[1].max() > _MOST_POSES:
            self.linearize_into(linear, values)
            return None
        error, by, excess = self._weighted(values)
        rows = PointRows.sorted(self.pose_key, self.point_key, self.camera_key, error, by)
        condensed = Condensed.of(rows, 1 / _FARTHEST_M**2)
        condensed.linearize_into(linear)
        linear.push_back(self._rest(excess))
        return condensed

    def _weighted(self, values: gtsam.Values) -> tuple[Array, list[Array], float]:
        """`residuals` under the loss, and by how much the sum of squares falls short of the loss (twice the error)."""
        return reweighted(*self.residuals(values), self.loss, self.scale)

    def _rest(self, excess: float) -> gtsam.JacobianFactor:
        """A row of no variable's, which makes the linear graph's error that of the loss."""
        import gtsam

        rest, held = np.array([np.sqrt(max(excess, 0.0))]), int(self.pose_key[0])
        return gtsam.JacobianFactor(held, np.zeros((1, 6)), rest, gtsam.noiseModel.Unit.Create(1))


def _times(matrix: Array, vectors: Array) -> Array:
    out: Array = (matrix @ vectors[..., None])[..., 0]
    return out
