"""AER1513, dataset 3: the stereo camera's importer on hand-made files and, by the motion capture, on the recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat
from test_aer1513 import Variables, at, put, without
from test_importers import same

from factors import so3
from factors.relative_pose import relative
from factors.stereo import project
from graphnav.errors import LogError
from graphnav.frontends.motion_chain import body_motions, camera_mounting
from graphnav.log import SensorLog
from graphnav.readers import aer1513, aer1513_stereo, read, write
from graphnav.readers.mat_file import MatFile
from graphnav.tracks import camera_of

#: Axes of b in the vehicle's (back, left, down).
RFU = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
#: A camera 0.1 m ahead of the vehicle's origin that looks ahead: right is -left, down is down, ahead is -back.
AHEAD = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
PLACE_V = np.array([-0.1, 0.0, 0.0])


def seen_pixels(rotation_nb: np.ndarray, pos_n: np.ndarray, places_n: np.ndarray, log: SensorLog) -> np.ndarray:
    """(K, 3) u_left, u_right, v of points (K, 3) from poses of b (K, 3, 3), (K, 3), by the log's own camera."""
    rotation_bc, pos_b = camera_mounting(log.stereo)
    in_b = np.einsum("kji,kj->ki", rotation_nb, places_n - pos_n)
    return project(camera_of(log.stereo), (in_b - pos_b) @ rotation_bc)


def off(log: SensorLog, places_n: np.ndarray) -> np.ndarray:
    """(K, 3) pixels less those that the truth and these places (J, 3) of the tracks give."""
    tracks, truth = log.stereo_tracks, log.truth
    row = np.searchsorted(truth.t_s, tracks.t_s)
    expected = seen_pixels(so3.from_quaternion(truth.quat_nb[row]), truth.pos_n_m[row], places_n[tracks.track - 1], log)
    return np.column_stack([tracks.u_left_px, tracks.u_right_px, tracks.v_px]) - expected


# Hand-made files --------------------------------------------------------------------------------------------


def carried(count: int = 21) -> Variables:
    """Ahead at 0.2 m/s while it turns at 0.3 rad/s to the left, past two points; the second is seen from row 5 on."""
    t = 0.1 * np.arange(count)
    heading = 0.3 * t
    turn_nv = so3.exp(np.outer(heading, [0.0, 0.0, 1.0])) @ RFU
    ahead = -turn_nv[:, :, 0]
    pos = np.array([1.0, 2.0, 0.5]) + np.cumsum(np.vstack([np.zeros(3), 0.02 * (ahead[1:] + ahead[:-1]) / 2]), axis=0)
    points = np.array([[0.0, 6.0, 0.0], [-1.0, 5.0, 1.0]])
    in_c = (np.einsum("kji,klj->kli", turn_nv, points[None] - pos[:, None]) - PLACE_V) @ AHEAD.T
    u, v = 400.0 * in_c[..., 0] / in_c[..., 2] + 320, 410.0 * in_c[..., 1] / in_c[..., 2] + 240
    pixels = np.stack([u, v + 0.5, u - 400.0 * 0.25 / in_c[..., 2], v - 0.5])
    pixels[:, :5, 1] = -1.0
    return {
        "t": t[None], "theta_vk_i": so3.log(turn_nv).T, "r_i_vk_i": pos.T,
        "v_vk_vk_i": np.tile([[-0.2], [0.0], [0.0]], count), "w_vk_vk_i": np.tile([[0.0], [0.0], [-0.3]], count),
        "v_var": np.array([[0.01], [0.02], [0.03]]), "w_var": np.array([[0.001], [0.002], [0.003]]),
        "rho_i_pj_i": points.T, "y_k_j": pixels, "C_c_v": AHEAD, "rho_v_c_v": PLACE_V[:, None],
        "fu": np.array([[400.0]]), "fv": np.array([[410.0]]), "cu": np.array([[320.0]]), "cv": np.array([[240.0]]),
        "b": np.array([[0.25]]),
    }  # fmt: skip


def saved(folder: Path, variables: Variables) -> Path:
    savemat(folder / "dataset3.mat", variables)
    return folder


def test_a_camera_that_is_carried_ahead(tmp_path: Path) -> None:
    log = aer1513.convert(saved(tmp_path, carried()), dataset=3)
    rotation_bc, pos_b = camera_mounting(log.stereo)
    np.testing.assert_allclose(rotation_bc, camera_mounting(None)[0], atol=1e-12)
    np.testing.assert_allclose(pos_b, [0.0, 0.1, 0.0], atol=1e-12)
    assert len(log.stereo_tracks) == 21 + 16
    assert (log.stereo_tracks.track[log.stereo_tracks.t_s < 0.45] == 1).all()
    assert np.abs(off(log, aer1513_stereo.landmarks(tmp_path))).max() < 1e-6
    # upright, north at first, then to the left
    rotation = so3.from_quaternion(log.truth.quat_nb)
    np.testing.assert_allclose(rotation[[0, -1], :, 1], [[0, 1, 0], [-np.sin(0.6), np.cos(0.6), 0]], atol=1e-9)
    motions = body_motions(log.relative_pose, log.stereo)
    turned, moved = relative(rotation[:-1], log.truth.pos_n_m[:-1], rotation[1:], log.truth.pos_n_m[1:])
    np.testing.assert_allclose(motions.rotation, turned, atol=1e-9)
    np.testing.assert_allclose(motions.pos, moved, atol=1e-5)
    # sigmas of a rate times the step, in b's axes: right is the vehicle's y, forward its x
    sigma = 0.1 * np.sqrt([0.002, 0.001, 0.003, 0.02, 0.01, 0.03])
    np.testing.assert_allclose(np.sqrt(np.diagonal(motions.cov[3])), sigma, rtol=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (without("y_k_j"), "y_k_j: missing variable"),
        (put("y_k_j", np.zeros((3, 21, 2))), "y_k_j: 3 x 21 x 2 numbers, expected 4 x 21 x N"),
        (put("r_i_vk_i", np.zeros((3, 20))), "r_i_vk_i: 3 x 20 numbers, expected 3 x 21"),
        (put("t", np.zeros((21, 1))), "t: 21 x 1 numbers, expected 1 x N"),
        (put("t", 0.1 * np.minimum(np.arange(21), 19)[None]), "row 21, t: time does not ascend"),
        (put("C_c_v", 2 * AHEAD), "C_c_v: no rotation"),
        (put("w_var", np.zeros((3, 1))), "w_var, v_var: expected variances above zero"),
        (at("v_vk_vk_i", 1, np.nan), "v_vk_vk_i: expected a finite number"),
    ],
)
def test_what_is_damaged_is_named(tmp_path: Path, change: object, message: str) -> None:
    with pytest.raises(LogError) as error:
        aer1513.convert(saved(tmp_path, change(carried())), dataset=3)
    assert "dataset3.mat" in str(error.value)
    assert message in str(error.value)


# The recording ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def folder(data_dir: Path) -> Path:
    found = data_dir / "aer1513_utias"
    if not found.is_dir():
        pytest.skip(f"no recording at {found}")
    return found


@pytest.fixture(scope="module")
def log(folder: Path) -> SensorLog:
    return aer1513.convert(folder, dataset=3)


@pytest.mark.data
def test_recording_is_whole(log: SensorLog, tmp_path: Path) -> None:
    assert (len(log.relative_pose), len(log.truth), len(log.stereo_tracks)) == (1899, 1900, 9410)
    write(log, tmp_path / "log")
    same(read(tmp_path / "log"), log)


@pytest.mark.data
def test_pixels_are_where_the_motion_capture_has_the_points(log: SensorLog, folder: Path) -> None:
    """What is left of them has the variances that the file states, which are those of this very comparison."""
    left = off(log, aer1513_stereo.landmarks(folder))
    stated = MatFile.first_of(folder, aer1513_stereo.NAMES).column("y_var", 4)
    assert np.abs(left.mean(axis=0)).max() < 1.5
    np.testing.assert_allclose(left.std(axis=0)[:2] ** 2, stated[[0, 2]], rtol=1e-3)
    # the mean of two rows
    assert min(stated[[1, 3]]) * 0.95 < left[:, 2].std() ** 2 < max(stated[[1, 3]])


@pytest.mark.data
def test_sigma_of_a_pixel_is_that_of_the_rows(folder: Path) -> None:
    pixels = MatFile.first_of(folder, aer1513_stereo.NAMES).array("y_k_j", (4, 1900, None))
    rows = (pixels[1] - pixels[3])[(pixels >= 0).all(axis=0)]
    assert np.sqrt((rows**2).mean() / 2) == pytest.approx(aer1513_stereo.SIGMA_PX, rel=0.02)


@pytest.mark.data
def test_motions_are_the_motion_captures(log: SensorLog) -> None:
    """Row by row against the truth, in sigmas: the file's variances are those of this comparison."""
    rotation = so3.from_quaternion(log.truth.quat_nb)
    turned, moved = relative(rotation[:-1], log.truth.pos_n_m[:-1], rotation[1:], log.truth.pos_n_m[1:])
    motions = body_motions(log.relative_pose, log.stereo)
    wrong = np.concatenate([so3.log(so3.transpose(motions.rotation) @ turned), moved - motions.pos], axis=1)
    sigma = np.sqrt(np.diagonal(motions.cov, axis1=1, axis2=2))
    step = np.diff(log.truth.t_s)[:, None]
    spread = (wrong / step).std(axis=0) / (sigma / step).mean(axis=0)
    assert (np.abs(spread - 1) < 0.1).all(), spread
