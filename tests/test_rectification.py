"""Rectification: of cameras that are known, and of the EuRoC sequence, whose epipolar lines become rows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cv2")
import cv2

from factors import so3
from graphnav.errors import GraphnavError
from graphnav.frontends.image_pairs import read_grey
from graphnav.frontends.rectification import Pinhole, rectification
from graphnav.frontends.stereo_features import detected
from graphnav.frontends.stereo_matching import Window, matches
from graphnav.readers import euroc_cameras

SIZE = (320, 200)


def pinhole(turn: list[float], place: list[float], distortion: float = -0.1) -> Pinhole:
    """A camera that looks along the body's forward axis but for `turn`, at `place`."""
    ahead = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])
    matrix = np.array([[200.0, 0, 160.0], [0, 201.0, 98.0], [0, 0, 1.0]])
    rotation = ahead @ so3.exp(np.array(turn))
    return Pinhole(matrix, np.array([distortion, 0.01, 1e-3, 0.0]), SIZE, rotation, np.array(place))


def seen(camera: Pinhole, point_b: np.ndarray) -> np.ndarray:
    """Recorded pixel of a point."""
    local = camera.rotation_bc.T @ (point_b - camera.pos_bc_m)
    pixel, _ = cv2.projectPoints(local[None], np.zeros(3), np.zeros(3), camera.matrix, camera.distortion)
    return pixel.reshape(2)


def test_a_point_is_where_the_rectified_camera_has_it() -> None:
    """In both images, drawn as a spot on the recorded ones: same row, disparity f b / z, the pose of c."""
    left = pinhole([0.02, -0.03, 0.04], [0.1, 0.2, 0.3])
    right = pinhole([-0.03, 0.02, -0.01], [0.22, 0.205, 0.297], -0.15)
    turned = rectification(left, right)
    camera = turned.camera
    assert camera.size_px == SIZE
    assert camera.baseline_m == pytest.approx(np.linalg.norm(left.pos_bc_m - right.pos_bc_m), rel=1e-9)
    for point_b in np.array([[0.3, 2.2, 0.4], [-0.4, 3.2, 0.1], [0.6, 2.7, 0.9]]):
        spots = []
        for recorded in (left, right):
            u, v = seen(recorded, point_b)
            x, y = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
            spots.append(np.round(200 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / 8)).astype(np.uint8))
        places = []
        for image in turned.images(*spots):
            y, x = np.indices(image.shape)
            places.append(np.array([(x * image.astype(float)).sum(), (y * image.astype(float)).sum()]) / image.sum())
        local = so3.from_quaternion(camera.T_bc_quat_wxyz).T @ (point_b - camera.T_bc_pos_m)
        u, v = local[:2] / local[2] * [camera.fx_px, camera.fy_px] + [camera.cx_px, camera.cy_px]
        np.testing.assert_allclose(places[0], [u, v], atol=0.1)
        np.testing.assert_allclose(places[1], [u - camera.fx_px * camera.baseline_m / local[2], v], atol=0.1)


def test_cameras_that_are_no_pair() -> None:
    left, right = pinhole([0, 0, 0], [0, 0, 0]), pinhole([0, 0, 0], [0.1, 0, 0])
    with pytest.raises(GraphnavError, match="check their order"):
        rectification(right, left)
    turned = rectification(left, right)
    with pytest.raises(GraphnavError, match="right image of 10 x 20 pixels"):
        turned.images(np.zeros((200, 320), np.uint8), np.zeros((20, 10), np.uint8))


@pytest.mark.data
def test_rows_of_the_euroc_cameras_agree(data_dir: Path, tmp_path: Path) -> None:
    mav = data_dir / "euroc_v1_01_easy" / "mav0"
    if not mav.is_dir():
        pytest.skip(f"no recorded data: {mav} is no folder")
    camera, table = euroc_cameras.rectified_into(mav, tmp_path)
    assert len(table.t_s) == 17
    assert camera.baseline_m == pytest.approx(0.11, abs=1e-3)
    offsets = []
    for row in range(0, 17, 8):
        left, right = (read_grey(tmp_path / getattr(table, side)[row]) for side in ("left", "right"))
        one, other = detected(left, "orb", 500), detected(right, "orb", 500, spread=False)
        rows, others = matches(one, other, Window((-100, -15), (0, 15)))
        offsets.append((other.uv_px[others] - one.uv_px[rows])[:, 1])
    offset = np.concatenate(offsets)
    assert abs(np.median(offset)) < 0.5  # 12 px as recorded
    assert np.mean(np.abs(offset) < 2) > 0.8
