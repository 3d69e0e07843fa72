"""A point's place in a rectified stereo pair: projection, triangulation, and the residual of one reading.

Source: the paper on stereo visual-inertial odometry of a roadheader (the roadheader stereo paper), equations 10 and 11:
the depth is ``z = f b / d`` with the disparity ``d = u_left - u_right``, and ``[u v 1] = K p / z``. A reading is the
three pixels (u_left, u_right, v); a rectified pair sees a point in the same row v on both sides. The left camera is c.

The mounting is the pose ``T_bc`` of c in b. All Jacobians by poses are those of the right perturbation, rotation before
translation (``R Exp(omega)``, ``p + R v``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from factors import so3
from factors.so3 import Array

if TYPE_CHECKING:
    import gtsam

#: Columns of a reading.
U_LEFT, U_RIGHT, V = 0, 1, 2


@dataclass(frozen=True)
class StereoCamera:
    """A rectified pair: focal lengths, principal point of both, and the right camera's distance along c's x axis."""

    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    baseline_m: float


def project(camera: StereoCamera, points_c: Array) -> Array:
    """Pixels (..., 3) at which points (..., 3) m in c are seen (equation 11).

    Raises
    ------
    ValueError : a point that is not in front of the camera.
    """
    return _seen(camera, np.asarray(points_c, float))


def project_with_jacobian(camera: StereoCamera, points_c: Array) -> tuple[Array, Array]:
    """`project`, and the Jacobian of the pixels by the points (..., 3, 3)."""
    points_c = np.asarray(points_c, float)
    pixels = _seen(camera, points_c)
    x, y, z = points_c[..., 0], points_c[..., 1], points_c[..., 2]
    jacobian = np.zeros((*points_c.shape, 3))
    jacobian[..., U_LEFT, 0] = jacobian[..., U_RIGHT, 0] = camera.fx_px / z
    jacobian[..., V, 1] = camera.fy_px / z
    jacobian[..., U_LEFT, 2] = -camera.fx_px * x / z**2
    jacobian[..., U_RIGHT, 2] = -camera.fx_px * (x - camera.baseline_m) / z**2
    jacobian[..., V, 2] = -camera.fy_px * y / z**2
    return pixels, jacobian


def triangulate(camera: StereoCamera, pixels: Array) -> Array:
    """Points (..., 3) m in c that are seen at pixels (..., 3) (equations 10 and 11 solved for the point).

    Raises
    ------
    ValueError : a disparity that is not above zero.
    """
    points, _ = triangulate_with_jacobian(camera, pixels)
    return points


def triangulate_with_jacobian(camera: StereoCamera, pixels: Array) -> tuple[Array, Array]:
    """`triangulate`, and the Jacobian of the points by the pixels (..., 3, 3)."""
    pixels = np.asarray(pixels, float)
    disparity = pixels[..., U_LEFT] - pixels[..., U_RIGHT]
    if (disparity <= 0).any():
        raise ValueError(
            f"a disparity of {disparity.min():.3g} px, expected above 0: the point is too far to tell, wrongly matched,"
            " or left and right are swapped"
        )
    depth = camera.fx_px * camera.baseline_m / disparity
    slope = np.stack([(pixels[..., U_LEFT] - camera.cx_px) / camera.fx_px,
                      (pixels[..., V] - camera.cy_px) / camera.fy_px, np.ones_like(depth)], axis=-1)  # fmt: skip
    points = slope * depth[..., None]
    jacobian = np.zeros((*points.shape, 3))
    jacobian[..., U_LEFT] = -points / disparity[..., None]
    jacobian[..., U_RIGHT] = points / disparity[..., None]
    jacobian[..., 0, U_LEFT] += depth / camera.fx_px
    jacobian[..., 1, V] += depth / camera.fy_px
    return points, jacobian


def triangulated_cov(camera: StereoCamera, pixels: Array, sigma_px: float) -> Array:
    """Covariance (..., 3, 3) m^2 of `triangulate` for equal, independent errors of the three pixels, to first order."""
    _, jacobian = triangulate_with_jacobian(camera, pixels)
    return np.asarray(sigma_px**2 * jacobian @ so3.transpose(jacobian))


def residual(
    rotation_nb: Array,
    pos_n: Array,
    point_n: Array,
    rotation_bc: Array,
    pos_b: Array,
    pixels: Array,
    camera: StereoCamera,
) -> tuple[Array, Array, Array, Array]:
    """One reading of a point: ``e = project(R_bc^T (R_nb^T (p_n - pos_n) - pos_b)) - pixels`` (equations 11 and 12).

    Parameters
    ----------
    rotation_nb, pos_n : (..., 3, 3) and (..., 3) pose of the body.
    point_n : (..., 3) the point.
    rotation_bc, pos_b : (..., 3, 3) and (..., 3) mounting of the left camera.
    pixels : (..., 3) u_left, u_right, v.

    Returns
    -------
    error (..., 3) px; Jacobians with respect to pose (..., 3, 6), point (..., 3, 3), mounting (..., 3, 6).

    Raises
    ------
    ValueError : the point is not in front of the camera.
    """
    point_b = np.einsum("...ji,...j->...i", rotation_nb, point_n - pos_n)
    point_c = np.einsum("...ji,...j->...i", rotation_bc, point_b - pos_b)
    predicted, by_c = project_with_jacobian(camera, point_c)
    by_b = by_c @ so3.transpose(rotation_bc)
    by_pose = np.concatenate([by_b @ so3.skew(point_b), -by_b], axis=-1)
    by_mounting = np.concatenate([by_c @ so3.skew(point_c), -by_c], axis=-1)
    return predicted - pixels, by_pose, by_b @ so3.transpose(rotation_nb), by_mounting


def stereo_factor(
    pose_key: int,
    point_key: int,
    pixels: Array,
    noise: gtsam.noiseModel.Base,
    camera: StereoCamera,
    rotation_bc: Array,
    pos_b: Array,
) -> gtsam.NonlinearFactor:
    """`residual` on a Pose3 and a Point3 with a fixed mounting (native `GenericStereoFactor3D`).

    Where the native factor finds a point behind the camera it stays silent: constant error, no slope.
    """
    import gtsam

    calibration = gtsam.Cal3_S2Stereo(camera.fx_px, camera.fy_px, 0.0, camera.cx_px, camera.cy_px, camera.baseline_m)
    mounting = gtsam.Pose3(gtsam.Rot3(rotation_bc), pos_b)
    measured = gtsam.StereoPoint2(*(float(pixel) for pixel in pixels))
    return gtsam.GenericStereoFactor3D(measured, noise, pose_key, point_key, calibration, mounting)


def mounted_stereo_factor(
    pose_key: int,
    point_key: int,
    mounting_key: int,
    pixels: Array,
    noise: gtsam.noiseModel.Base,
    camera: StereoCamera,
) -> gtsam.CustomFactor:
    """`residual` as a factor on a Pose3, a Point3 and the mounting, a Pose3."""
    import gtsam

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        pose, mounting = values.atPose3(pose_key).matrix(), values.atPose3(mounting_key).matrix()
        out = residual(
            pose[:3, :3], pose[:3, 3], values.atPoint3(point_key), mounting[:3, :3], mounting[:3, 3], pixels, camera
        )
        if jacobians is not None:
            for row, jacobian in enumerate(out[1:]):
                jacobians[row] = np.asfortranarray(jacobian)
        return out[0]

    return gtsam.CustomFactor(noise, [pose_key, point_key, mounting_key], error)


def _seen(camera: StereoCamera, points_c: Array) -> Array:
    depth = points_c[..., 2]
    if (depth <= 0).any():
        raise ValueError(f"a point at a depth of {depth.min():.3g} m is not in front of the camera")
    left = camera.fx_px * points_c[..., 0] / depth + camera.cx_px
    row = camera.fy_px * points_c[..., 1] / depth + camera.cy_px
    return np.stack([left, left - camera.fx_px * camera.baseline_m / depth, row], axis=-1)
