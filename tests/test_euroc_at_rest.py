"""EuRoC's stored image pairs, in which the drone stands: rectified here, and no motion may come out.

It is touched twice: for a moment after 0.9 s (by the gyro, too), and from 2.7 s on.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from factors import so3
from graphnav.config import StereoMotionsConfig, StereoTracksConfig
from graphnav.frontends.stereo_frames import TrackedFrames
from graphnav.frontends.stereo_motion import StereoMotion, stereo_motion
from graphnav.frontends.stereo_odometry import camera_of
from graphnav.frontends.stereo_tracks import tracked
from graphnav.log import Frames, SensorLog, Stereo, StereoPairs

#: Of a false alarm, in the largest of all motions at rest.
ALARM = 1e-3
SIZE = (752, 480)


def calibration(folder: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Camera matrix, distortion and pose of a camera in the body, of its sensor.yaml."""
    lists = re.findall(r"(\w+): \[([^\]]*)\]", (folder / "sensor.yaml").read_text())
    rows = {name: [float(number) for number in numbers.split(",")] for name, numbers in lists}
    fu, fv, cu, cv = rows["intrinsics"]
    matrix = np.array([[fu, 0, cu], [0, fv, cv], [0, 0, 1.0]])
    return matrix, np.array(rows["distortion_coefficients"]), np.array(rows["data"]).reshape(4, 4)


@pytest.fixture(scope="module")
def log(data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> SensorLog:
    """The pairs, rectified as the factory's calibration tells."""
    source = data_dir / "euroc_v1_01_easy" / "mav0"
    if not source.is_dir():
        pytest.skip(f"no recorded data: {source} is no folder")
    import cv2

    (k0, d0, t0), (k1, d1, t1) = (calibration(source / side) for side in ("cam0", "cam1"))
    between = np.linalg.inv(t1) @ t0
    r0, r1, p0, p1, *_ = cv2.stereoRectify(k0, d0, k1, d1, SIZE, between[:3, :3], between[:3, 3:], alpha=0)
    folder = tmp_path_factory.mktemp("euroc")
    names = sorted(path.name for path in (source / "cam0" / "data").glob("*.png"))
    for side, matrix, distortion, turn, camera in (("cam0", k0, d0, r0, p0), ("cam1", k1, d1, r1, p1)):
        maps = cv2.initUndistortRectifyMap(matrix, distortion, turn, camera, SIZE, cv2.CV_32FC1)
        (folder / side).mkdir()
        for name in names:
            image = cv2.imread(str(source / side / "data" / name), cv2.IMREAD_GRAYSCALE)
            cv2.imwrite(str(folder / side / name), cv2.remap(image, *maps, cv2.INTER_CUBIC))
    t_s = np.array([int(name[:-4]) for name in names]) * 1e-9
    return SensorLog(
        name="euroc-at-rest",
        frames=Frames(latitude_deg=47.4, longitude_deg=8.5, height_m=400.0),
        stereo=Stereo(fx_px=p0[0, 0], fy_px=p0[1, 1], cx_px=p0[0, 2], cy_px=p0[1, 2], baseline_m=-p1[0, 3] / p1[0, 0]),
        stereo_pairs=StereoPairs(
            t_s=t_s - t_s[0],
            left=[f"cam0/{name}" for name in names],
            right=[f"cam1/{name}" for name in names],
            folder=folder,
        ),
    )


def motions(log: SensorLog, features: str) -> list[StereoMotion]:
    """From the first pair to each other one."""
    found = tracked(log, StereoTracksConfig(features=features), workers=1, cache=False)
    assert not found.skipped and len(found.t_s) == 17
    frames = TrackedFrames.of(found.tracks)
    moved = [
        stereo_motion(camera_of(log.stereo), frames.matches(0, k, log.stereo.sigma_px), StereoMotionsConfig())
        for k in range(1, len(frames))
    ]
    assert all(isinstance(motion, StereoMotion) for motion in moved)
    return moved


def turn_deg(motion: StereoMotion) -> float:
    return float(np.degrees(np.linalg.norm(so3.log(motion.rotation[None])[0])))


@pytest.mark.data
@pytest.mark.parametrize("features", ["orb", pytest.param("sift", marks=pytest.mark.slow)])
def test_a_camera_at_rest_does_not_move(log: SensorLog, features: str) -> None:
    """Up to 2.4 s it stands but for 0.9 and 1.2 s; then it is moved by what the reference has, 0.15 deg and 2.2 mm."""
    moved = motions(log, features)
    t_s = log.stereo_pairs.t_s[1:]
    still = (t_s < 2.5) & ~((t_s > 0.8) & (t_s < 1.3))
    assert still.sum() == 6
    for motion in (moved[k] for k in np.flatnonzero(still)):
        error = np.r_[so3.log(motion.rotation[None])[0], motion.pos_m]
        assert error @ np.linalg.solve(motion.cov, error) < chi2.isf(ALARM / still.sum(), 6)
        assert turn_deg(motion) < 0.03 and np.linalg.norm(motion.pos_m) < 1e-3
    assert turn_deg(moved[-1]) == pytest.approx(0.152, abs=0.05)
    assert np.linalg.norm(moved[-1].pos_m) == pytest.approx(2.16e-3, abs=1.5e-3)
