"""Where the second of two stereo pairs sees what the first has seen, as a map from pixels to pixels.

A reading (u_left, u_right, v) is a point in homogeneous form: slope ``m = ((u_left - cx) / fx, (v - cy) / fy, 1)`` and
inverse depth ``rho = (u_left - u_right) / (fx b)``. In the second camera it is ``q = R^T (m - rho t)`` with the same
rho, which stays regular at infinity: a disparity that noise has made zero or negative needs no exception.

``T_from_to = (R, t)`` takes points of the second camera to the first, ``p_from = R p_to + t``; perturbed on the right.
The functions are compiled loops over points; `lens` is the array of the camera's five numbers (`lens_of`).
"""

from __future__ import annotations

import numpy as np

from factors.so3 import Array
from factors.stereo import U_LEFT, U_RIGHT, StereoCamera, V
from graphnav.baselines._compiled import compiled

#: A point at less than this share of its depth in the first camera is not in front of the second.
_IN_FRONT = 0.02
#: Trace of S beyond which a reading, so far magnified by the motion, tells nothing.
_MAGNIFIED = 1e4


def lens_of(camera: StereoCamera) -> Array:
    """(5,) the camera's numbers for the compiled functions."""
    return np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, camera.baseline_m])


def homogeneous(camera: StereoCamera, pixels: Array) -> tuple[Array, Array]:
    """Slopes (..., 3) and inverse depths (...,) 1/m of readings (..., 3)."""
    slope = np.ones(pixels.shape)
    slope[..., 0] = (pixels[..., U_LEFT] - camera.cx_px) / camera.fx_px
    slope[..., 1] = (pixels[..., V] - camera.cy_px) / camera.fy_px
    return slope, (pixels[..., U_LEFT] - pixels[..., U_RIGHT]) / (camera.fx_px * camera.baseline_m)


@compiled
def carry(
    lens: Array, rotation: Array, pos_m: Array, reading: Array, seen: Array, by_reading: Array, by_motion: Array
) -> bool:
    """Carry one reading (3,) over a motion; fills `seen` (3,) and its Jacobians (3, 3) and (3, 6).

    Returns
    -------
    bool
        Whether the point is in front of the second camera; if not, nothing is filled in.
    """
    fx, fy, cx, cy, baseline = lens
    rho = (reading[0] - reading[1]) / (fx * baseline)
    x = (reading[0] - cx) / fx - rho * pos_m[0]
    y = (reading[2] - cy) / fy - rho * pos_m[1]
    z = 1.0 - rho * pos_m[2]
    qx = rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0] * z
    qy = rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1] * z
    qz = rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2] * z
    if not qz > _IN_FRONT:
        return False
    seen[0] = fx * qx / qz + cx
    seen[1] = seen[0] - fx * baseline * rho / qz
    seen[2] = fy * qy / qz + cy
    for k in range(3):  # rows u_left, u_right, v; g is the row's derivative by q
        gx = fx / qz if k < 2 else 0.0
        gy = fy / qz if k == 2 else 0.0
        gz = -(gx * qx + gy * qy) / qz
        if k == 1:
            gz += fx * baseline * rho / qz**2
        by_slope_x = gx * rotation[0, 0] + gy * rotation[0, 1] + gz * rotation[0, 2]
        by_slope_y = gx * rotation[1, 0] + gy * rotation[1, 1] + gz * rotation[1, 2]
        by_slope_z = gx * rotation[2, 0] + gy * rotation[2, 1] + gz * rotation[2, 2]
        by_rho = -(by_slope_x * pos_m[0] + by_slope_y * pos_m[1] + by_slope_z * pos_m[2]) / (fx * baseline)
        by_reading[k, 0] = by_slope_x / fx + by_rho
        by_reading[k, 1] = -by_rho
        by_reading[k, 2] = by_slope_y / fy
        by_motion[k, 0] = gy * qz - gz * qy
        by_motion[k, 1] = gz * qx - gx * qz
        by_motion[k, 2] = gx * qy - gy * qx
        by_motion[k, 3], by_motion[k, 4], by_motion[k, 5] = -rho * gx, -rho * gy, -rho * gz
    by_reading[1, 0] -= 1 / qz
    by_reading[1, 1] += 1 / qz
    return True


@compiled
def weigh(by_reading: Array, weight: Array) -> bool:
    """Fill `weight` (3, 3) with the inverse of ``S = I + H H^T``; False, and nothing filled, when S is too large."""
    s = np.empty(6)
    n = 0
    for i in range(3):
        for j in range(i, 3):
            s[n] = by_reading[i, 0] * by_reading[j, 0] + by_reading[i, 1] * by_reading[j, 1]
            s[n] += by_reading[i, 2] * by_reading[j, 2] + (1.0 if i == j else 0.0)
            n += 1
    a, b, c, d, e, f = s
    if not a + d + f < _MAGNIFIED:
        return False
    weight[0, 0], weight[1, 1], weight[2, 2] = d * f - e * e, a * f - c * c, a * d - b * b
    weight[0, 1] = weight[1, 0] = c * e - b * f
    weight[0, 2] = weight[2, 0] = b * e - c * d
    weight[1, 2] = weight[2, 1] = b * c - a * e
    weight /= a * weight[0, 0] + b * weight[0, 1] + c * weight[0, 2]
    return True


@compiled
def eliminate(
    lens: Array, rotation: Array, pos_m: Array, first: Array, second: Array, readings: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """Errors left when every point has been eliminated, linearized at its reading without noise.

    Parameters
    ----------
    first, second : (N, 3) readings; readings : (N, 3) those of the first pair without noise.

    Returns
    -------
    error (N, 3) px, its inverse covariance in units of a pixel's (N, 3, 3), Jacobians by the reading H (N, 3, 3) and by
    the motion (N, 3, 6), squared errors (N,) in units of a pixel's variance. A point that is not in front of the second
    camera has no weight, and an infinite squared error.
    """
    count = len(first)
    error, weight, by_reading = np.zeros((count, 3)), np.zeros((count, 3, 3)), np.zeros((count, 3, 3))
    by_motion, squared, seen = np.zeros((count, 3, 6)), np.full(count, np.inf), np.empty(3)
    for i in range(count):
        if not carry(lens, rotation, pos_m, readings[i], seen, by_reading[i], by_motion[i]):
            continue
        if not weigh(by_reading[i], weight[i]):
            continue
        for k in range(3):
            error[i, k] = second[i, k] - seen[k]
            for j in range(3):
                error[i, k] -= by_reading[i, k, j] * (first[i, j] - readings[i, j])
        total = 0.0
        for k in range(3):
            for j in range(3):
                total += error[i, k] * weight[i, k, j] * error[i, j]
        squared[i] = total
    return error, weight, by_reading, by_motion, squared


@compiled
def normal_equations(weight: Array, by_motion: Array, error: Array, share: Array) -> tuple[Array, Array]:
    """``sum share J^T W J`` (6, 6) and ``sum share J^T W e`` (6,)."""
    matrix, gradient, left = np.zeros((6, 6)), np.zeros(6), np.empty(3)
    for i in range(len(share)):
        if share[i] == 0.0:
            continue
        for a in range(6):
            for k in range(3):
                left[k] = 0.0
                for j in range(3):
                    left[k] += by_motion[i, j, a] * weight[i, j, k]
                left[k] *= share[i]
            for b in range(a, 6):
                matrix[a, b] += (
                    left[0] * by_motion[i, 0, b] + left[1] * by_motion[i, 1, b] + left[2] * by_motion[i, 2, b]
                )
            gradient[a] += left[0] * error[i, 0] + left[1] * error[i, 1] + left[2] * error[i, 2]
    for a in range(6):
        for b in range(a):
            matrix[a, b] = matrix[b, a]
    return matrix, gradient


@compiled
def squared_errors(lens: Array, rotation: Array, pos_m: Array, first: Array, second: Array) -> Array:
    """Squared errors (M, N) in units of a pixel's variance of N points under M motions (M, 3, 3), (M, 3)."""
    out = np.full((len(pos_m), len(first)), np.inf)
    seen, by_reading, by_motion, weight = np.empty(3), np.empty((3, 3)), np.empty((3, 6)), np.empty((3, 3))
    for m in range(len(pos_m)):
        for i in range(len(first)):
            if not carry(lens, rotation[m], pos_m[m], first[i], seen, by_reading, by_motion):
                continue
            if not weigh(by_reading, weight):
                continue
            total = 0.0
            for k in range(3):
                for j in range(3):
                    total += (second[i, k] - seen[k]) * weight[k, j] * (second[i, j] - seen[j])
            out[m, i] = total
    return out


@compiled
def sample_equations(lens: Array, rotation: Array, pos_m: Array, first: Array, second: Array) -> tuple[Array, Array]:
    """Normal equations (M, 6, 6), (M, 6) of M motions, each from points (M, K, 3) of its own."""
    matrix, gradient, share = np.empty((len(pos_m), 6, 6)), np.empty((len(pos_m), 6)), np.ones(first.shape[1])
    for m in range(len(pos_m)):
        error, weight, _, by_motion, _ = eliminate(lens, rotation[m], pos_m[m], first[m], second[m], first[m])
        matrix[m], gradient[m] = normal_equations(weight, by_motion, error, share)
    return matrix, gradient
