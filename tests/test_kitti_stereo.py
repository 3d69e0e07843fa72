"""The KITTI stereo excerpt: reader, import with its images, damaged copies, and tracks against the reference."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from factors import so3
from graphnav import cli
from graphnav.config import StereoTracksConfig
from graphnav.errors import LogError
from graphnav.frontends.stereo_tracks import tracked
from graphnav.log import SensorLog
from graphnav.readers import kitti_stereo, read

IDENTITY = "1 0 0 0 0 1 0 0 0 0 1 0\n"


@pytest.fixture(scope="module")
def excerpt(data_dir: Path) -> Path:
    folder = data_dir / "kitti_stereo"
    if not folder.is_dir():
        pytest.skip(f"no recorded data: {folder} is no folder")
    return folder


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """Three pairs whose files are not looked into."""
    folder = tmp_path / "excerpt"
    for side in ("image_l", "image_r"):
        (folder / side).mkdir(parents=True)
        for k in range(3):
            (folder / side / f"{k:06d}.png").write_bytes(side.encode() + bytes([k]))
    camera = "700 0 600 {} 0 700 180 0 0 0 1 0\n"
    (folder / "calib.txt").write_text(camera.format(0) + camera.format(-350))
    (folder / "poses.txt").write_text(IDENTITY + "1 0 0 1 0 1 0 2 0 0 1 3\n" + IDENTITY)
    return folder


def test_axes_and_figures(small: Path) -> None:
    log = kitti_stereo.convert(small)
    assert log.stereo.baseline_m == 0.5 and log.stereo.size_px is None
    np.testing.assert_array_equal(log.truth.pos_n_m[1], [1, 3, -2])  # right, ahead, up of right, down, ahead
    np.testing.assert_allclose(log.truth.quat_nb, [[1, 0, 0, 0]] * 3, atol=1e-12)
    assert (log.stereo_pairs.folder / log.stereo_pairs.left[2]).read_bytes() == b"image_l\x02"


def test_the_size_is_that_of_the_images(small: Path) -> None:
    head = b"\x89PNG\r\n\x1a\n" + b"\0\0\0\rIHDR" + (1226).to_bytes(4, "big") + (370).to_bytes(4, "big")
    (small / "image_l" / "000000.png").write_bytes(head)
    assert kitti_stereo.convert(small).stereo.size_px == (1226, 370)


def test_import_copies_the_images(small: Path, tmp_path: Path) -> None:
    target = tmp_path / "log"
    command = ["import", "kitti-stereo", str(small), "-o", str(target)]
    assert cli.main(command) == 0
    log = read(target)
    for side, source in (("left", "image_l"), ("right", "image_r")):
        for k, name in enumerate(getattr(log.stereo_pairs, side)):
            assert (target / name).read_bytes() == source.encode() + bytes([k])
    (target / ".graphnav").mkdir()
    read(target)
    assert cli.main(command) != 0  # the folder holds images, which may be the only ones
    assert cli.main([*command, "--overwrite"]) == 0  # replaced as a whole, what was kept with it
    assert not (target / ".graphnav").exists()


@pytest.mark.parametrize(
    ("damage", "text"),
    [
        (lambda f: (f / "image_r" / "000001.png").unlink(), "3 left and 2 right images; image_r/000001.png is missing"),
        (lambda f: (f / "poses.txt").write_text(IDENTITY), "1 poses for 3 pairs"),
        (lambda f: (f / "poses.txt").write_text("1 2 3\n" * 3), "rows of 3 numbers"),
        (lambda f: (f / "calib.txt").write_text(IDENTITY * 2), "differ by -fx b alone"),
        (lambda f: (f / "calib.txt").unlink(), "no such file"),
        (lambda f: shutil.rmtree(f / "image_l"), "0 left and 3 right"),
        (lambda f: [shutil.rmtree(f / s) for s in ("image_l", "image_r")], "no images"),
    ],
)
def test_damaged_copies(small: Path, damage: object, text: str) -> None:
    damage(small)
    with pytest.raises(LogError, match=text):
        kitti_stereo.convert(small)


def _to_next(log: SensorLog, found: object) -> np.ndarray:
    """Errors (N, 3) of column, row and disparity in the next frame, expected from depth and the reference's motion."""
    table, camera = found.tracks, log.stereo
    frame = np.searchsorted(log.truth.t_s, table.t_s - 1e-6)
    order = np.lexsort((frame, table.track))
    again = np.flatnonzero(table.track[order][1:] == table.track[order][:-1])
    now, then = order[again], order[again + 1]
    turn = so3.from_quaternion(log.truth.quat_nb) @ so3.from_quaternion(camera.T_bc_quat_wxyz)
    centre, focal = np.array([camera.cx_px, camera.cy_px]), camera.fx_px
    pixel = np.column_stack([table.u_left_px, table.v_px])
    disparity = table.u_left_px - table.u_right_px
    depth = focal * camera.baseline_m / disparity[now]
    local = np.column_stack([(pixel[now] - centre) / focal * depth[:, None], depth])
    point_n = np.einsum("nij,nj->ni", turn[frame[now]], local) + log.truth.pos_n_m[frame[now]]
    seen = np.einsum("nji,nj->ni", turn[frame[then]], point_n - log.truth.pos_n_m[frame[then]])
    expected = seen[:, :2] / seen[:, 2:] * focal + centre
    return np.column_stack([pixel[then] - expected, disparity[then] - focal * camera.baseline_m / seen[:, 2]])


@pytest.mark.data
def test_tracks_move_as_the_reference_says(excerpt: Path) -> None:
    """The reference of KITTI itself is good to some 0.3 px from frame to frame; the disparity hardly feels it."""
    pytest.importorskip("cv2")
    log = kitti_stereo.convert(excerpt)
    found = tracked(log, StereoTracksConfig(), workers=1)
    assert len(found.t_s) == 51 and not found.skipped
    assert found.counts.min() > 40
    error = _to_next(log, found)
    assert len(error) > 2000
    assert (np.abs(np.median(error, axis=0)) < [0.3, 0.3, 0.1]).all()
    assert (1.4826 * np.median(np.abs(error - np.median(error, axis=0)), axis=0) < [0.5, 0.5, 0.25]).all()
    assert (np.mean(np.abs(error) > 3, axis=0) < 0.03).all()
    assert not (excerpt / ".graphnav").exists()  # nothing is kept beside images that are no log's
