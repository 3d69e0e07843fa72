"""UTIAS AER1513, dataset 3 (``dataset3.mat``): a stereo camera carried over 20 points at rest, under motion capture.

- *Pixels*: column and row of each point seen in both images; -1 means unseen. `v_px` is the mean of both rows.
- *Rates*: forward and angular velocity of the vehicle frame. Row k holds until row k+1, as in the other datasets (the
  file's variances are exactly those of that rule against the motion capture), and becomes a motion of the camera.
- *Sigma of a pixel*: `SIGMA_PX`, what left and right rows of the same point differ by (1.8 px rms, by the root of two).
  The file's own `y_var` (6.2 px a column, 11.4 px a row) is of the pixels against the motion capture's poses and
  points: nine tenths of it is common to all points of a frame, an error of those poses and not of the image.

Axes: n is the motion capture's; the vehicle's are back, left, down, b's are right, forward, up about the same origin.
The points' places are in the file (`landmarks`), and in no log.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from factors import so3
from factors.relative_pose import Motions, seen_from
from graphnav._schema import Array
from graphnav.errors import LogError
from graphnav.log import Frames, InitialState, RelativePose, SensorLog, Stereo, StereoTracks, Truth
from graphnav.readers.mat_file import MatFile

NAMES = ("dataset3.mat",)
#: 1-sigma error of a column or row in one image.
SIGMA_PX = 1.3
#: Vehicle axes (back, left, down: the camera looks along its -x, hangs upright with its z down) -> right, forward, up.
_RFU_FROM_VEHICLE = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
#: What is known of the start, which is the truth's.
_POS_SIGMA_M, _ATT_SIGMA_DEG, _VEL_SIGMA_M_S = 0.01, 0.5, 0.02
_UPPER = np.triu_indices(6)


def stereo_log(mat: MatFile, frames: Frames) -> SensorLog:
    """The recording: motions by rates, tracks, truth; initial pose the truth's."""
    t_s = mat.times("t", row=True)
    truth = _truth(mat, t_s)
    rotation_cv, pos_v = _orthonormal(mat), mat.column("rho_v_c_v", 3)
    stereo = Stereo(
        fx_px=mat.number("fu"),
        fy_px=mat.number("fv"),
        cx_px=mat.number("cu"),
        cy_px=mat.number("cv"),
        baseline_m=mat.number("b"),
        sigma_px=SIGMA_PX,
        T_bc_pos_m=_RFU_FROM_VEHICLE @ pos_v,
        T_bc_quat_wxyz=so3.to_quaternion(_RFU_FROM_VEHICLE @ rotation_cv.T),
    )
    return SensorLog(
        name="aer1513-3",
        frames=frames,
        initial=_initial(truth),
        stereo=stereo,
        stereo_tracks=_tracks(mat, t_s),
        relative_pose=_motions(mat, t_s, rotation_cv, pos_v),
        truth=truth,
    )


def landmarks(folder: str | Path) -> Array:
    """Places (20, 3) of the tracks 1 to 20 in n, for judging alone."""
    return MatFile.first_of(Path(folder), NAMES).array("rho_i_pj_i", (3, None)).T


def _orthonormal(mat: MatFile) -> Array:
    """The turn vehicle -> camera, which the file has to a few digits."""
    given = mat.array("C_c_v", (3, 3))
    u, stretch, v = np.linalg.svd(given)
    if np.abs(stretch - 1).max() > 1e-2 or np.linalg.det(given) < 0:
        raise LogError("no rotation", where=str(mat.path), column="C_c_v", fix="fetch it again")
    return np.asarray(u @ v)


def _truth(mat: MatFile, t_s: Array) -> Truth:
    """Poses of b; the file's rotation vector is that of i seen from the vehicle, ``C_vi = Exp(-theta)``."""
    turn = mat.array("theta_vk_i", (3, len(t_s))).T
    return Truth(
        t_s=t_s,
        pos_n_m=mat.array("r_i_vk_i", (3, len(t_s))).T,
        quat_nb=so3.to_quaternion(so3.exp(turn) @ _RFU_FROM_VEHICLE.T),
    )


def _motions(mat: MatFile, t_s: Array, rotation_cv: Array, pos_v: Array) -> RelativePose:
    """Constant rates from row to row, as motions of c; variances of the rates are of one row each."""
    step = np.diff(t_s)[:, None]
    turn, way = (step * mat.array(name, (3, len(t_s))).T[:-1] for name in ("w_vk_vk_i", "v_vk_vk_i"))
    variance = np.concatenate([mat.column(name, 3) for name in ("w_var", "v_var")])
    if (variance <= 0).any():
        raise LogError(
            "expected variances above zero", where=str(mat.path), column="w_var, v_var", fix="fetch it again"
        )
    of_vehicle = Motions(
        so3.exp(turn),
        (so3.left_jacobian(turn) @ way[..., None])[..., 0],
        (step**2 * variance)[:, :, None] * np.eye(6),
    )
    of_camera = seen_from(of_vehicle, rotation_cv, -rotation_cv @ pos_v)
    return RelativePose(
        t_from_s=t_s[:-1],
        t_to_s=t_s[1:],
        pos_m=of_camera.pos,
        quat=so3.to_quaternion(of_camera.rotation),
        cov_upper=of_camera.cov[:, _UPPER[0], _UPPER[1]],
    )


def _tracks(mat: MatFile, t_s: Array) -> StereoTracks:
    pixels = mat.array("y_k_j", (4, len(t_s), None))
    frame, point = np.nonzero((pixels >= 0).all(axis=0))
    u_left, v_left, u_right, v_right = pixels[:, frame, point]
    return StereoTracks(
        t_s=t_s[frame], track=point + 1, u_left_px=u_left, u_right_px=u_right, v_px=(v_left + v_right) / 2
    )


def _initial(truth: Truth) -> InitialState:
    """The truth's first pose, to 1 cm and half a degree; it begins at rest."""
    return InitialState(
        pos_n_m=truth.pos_n_m[0],
        pos_sigma_m=np.full(3, _POS_SIGMA_M),
        quat_nb_wxyz=truth.quat_nb[0],
        att_sigma_deg=np.full(3, _ATT_SIGMA_DEG),
        vel_n_m_s=np.zeros(3),
        vel_sigma_m_s=np.full(3, _VEL_SIGMA_M_S),
    )
