"""Rotations as arrays: exponential map, its Jacobians, quaternions; all broadcast over leading axes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def skew(v: Array) -> Array:
    """Cross-product matrices ``[v x]``, shape (..., 3, 3)."""
    v = np.asarray(v, float)
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def _coefficients(angle2: Array) -> tuple[Array, Array, Array]:
    """``sin(a)/a``, ``(1-cos a)/a^2`` and ``(a-sin a)/a^3`` for squared angles, by series where they vanish."""
    small = angle2 < 1e-6
    safe = np.where(small, 1.0, angle2)
    angle = np.sqrt(safe)
    s = np.where(small, 1 - angle2 / 6, np.sin(angle) / angle)
    c = np.where(small, 0.5 - angle2 / 24, 2 * np.sin(angle / 2) ** 2 / safe)
    d = np.where(small, 1 / 6 - angle2 / 120, (angle - np.sin(angle)) / (safe * angle))
    return s, c, d


def exp(phi: Array) -> Array:
    """Rotation matrices of rotation vectors `phi` (..., 3) in rad (Rodrigues)."""
    phi = np.asarray(phi, float)
    s, c, _ = _coefficients(np.sum(phi * phi, axis=-1))
    k = skew(phi)
    return np.eye(3) + s[..., None, None] * k + c[..., None, None] * (k @ k)


def left_jacobian(phi: Array) -> Array:
    """``Exp(phi + d) = Exp(J_l(phi) d) Exp(phi)`` to first order; also the mean of ``Exp(t phi)``, t in 0..1."""
    phi = np.asarray(phi, float)
    _, c, d = _coefficients(np.sum(phi * phi, axis=-1))
    k = skew(phi)
    return np.eye(3) + c[..., None, None] * k + d[..., None, None] * (k @ k)


def right_jacobian(phi: Array) -> Array:
    """``Exp(phi + d) = Exp(phi) Exp(J_r(phi) d)`` to first order."""
    return left_jacobian(-np.asarray(phi, float))


def transpose(matrix: Array) -> Array:
    """Transpose of the last two axes: the inverse of a rotation."""
    return np.swapaxes(matrix, -1, -2)


def log(matrix: Array) -> Array:
    """Rotation vectors (..., 3) in rad of rotation matrices, correct up to pi."""
    from scipy.spatial.transform import Rotation

    matrix = np.asarray(matrix, float)
    out: Array = Rotation.from_matrix(matrix.reshape(-1, 3, 3)).as_rotvec()
    return out.reshape(matrix.shape[:-1])


def from_quaternion(quat: Array) -> Array:
    """Rotation matrices of unit quaternions w, x, y, z (..., 4)."""
    from scipy.spatial.transform import Rotation

    quat = np.asarray(quat, float)
    out: Array = Rotation.from_quat(quat.reshape(-1, 4), scalar_first=True).as_matrix()
    return out.reshape((*quat.shape[:-1], 3, 3))


def to_quaternion(matrix: Array) -> Array:
    """Unit quaternions w, x, y, z (..., 4), w >= 0, of rotation matrices."""
    from scipy.spatial.transform import Rotation

    matrix = np.asarray(matrix, float)
    out: Array = Rotation.from_matrix(matrix.reshape(-1, 3, 3)).as_quat(canonical=True, scalar_first=True)
    return out.reshape((*matrix.shape[:-2], 4))
