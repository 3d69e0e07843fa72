"""STAR-loc's stereo camera: centres of AprilTags in rectified pairs, as tracks whose number is the tag's.

- *Camera on the IMU*: both are in one housing, and ``calib.json`` has the IMU's pose in the camera (`tf_cam_imu`, axes
  forward, left, up), which agrees with the data. The housing hangs upside down on the rig; `tf_cam_rig` has it upright.
- *Clock*: stamps are 1.48 s before those of ``imu.csv``: the poses in both tables agree at 1.56 and 1.58 s, and pixels
  are best by poses 80 and 94 ms earlier than that, which is how late an image is stamped. A calibration.
- *Sigma of a pixel*: `SIGMA_PX`. Rows of one tag in both images differ by 0.42 px rms (2-D loop) and 0.94 px (3-D
  loop), but what images have in common does not show in that: one stamped 2 ms off a turn of 1 rad/s is off by 2 px.
  What the graph of IMU, ranges and tags leaves of a pixel, without the reference, is 1.8 and 2.7 px: their rms is
  declared.
- *What is left of the clock*: found in steps of 20 ms it is off by 5.8 ms (1 sigma), which the graph estimates.
- *Mounting and disparity*: what a factory's calibration leaves of a hand-held pair is a degree against the rig and a
  twentieth of a degree (1 px) between the cameras. (An error of the disparities of 1 px, against the reference, had
  been seen before.) The graph estimates both.

The motion capture's places of the tags are in no log.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from factors import so3
from factors.so3 import Array
from graphnav.errors import LogError
from graphnav.log import Stereo, StereoTracks
from graphnav.readers.named_csv import NamedCsv

#: 1-sigma error of a column or row in one image.
SIGMA_PX = 2.3
#: How well the factory knows the camera on the IMU, and one camera's direction in the other.
_MOUNTING_SIGMA_DEG, _PLACE_SIGMA_M, DISPARITY_SIGMA_PX = 1.0, 0.005, 1.0
#: What a clock found in steps of 20 ms is off by: 20 / sqrt(12) ms.
_TIME_SIGMA_S = 0.0058
#: Camera axes (right, down, forward) -> forward, left, up.
_FORWARD_FROM_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def tag_tracks(folder: Path, rotation_b_imu: Array, later_s: float) -> tuple[Stereo, StereoTracks]:
    """Camera and tags of a recording.

    Parameters
    ----------
    rotation_b_imu : (3, 3) axes of the IMU's samples -> b, whose origin is the IMU; later_s : added to the stamps.
    """
    numbers, rotation_cam_imu, imu_cam_m = _calibration(folder / "calib.json")
    to_b = rotation_b_imu @ rotation_cam_imu.T
    stereo = Stereo(
        fx_px=numbers["fu"],
        fy_px=numbers["fv"],
        cx_px=numbers["cu"],
        cy_px=numbers["cv"],
        baseline_m=numbers["b"],
        sigma_px=SIGMA_PX,
        disparity_sigma_px=DISPARITY_SIGMA_PX,
        T_bc_pos_m=-to_b @ imu_cam_m,
        T_bc_quat_wxyz=so3.to_quaternion(to_b @ _FORWARD_FROM_CAMERA),
        T_bc_pos_sigma_m=np.full(3, _PLACE_SIGMA_M),
        mounting_sigma_deg=np.full(3, _MOUNTING_SIGMA_DEG),
        time_sigma_s=_TIME_SIGMA_S,
    )
    table = NamedCsv(folder / "apriltag_cal_global.csv")
    u_left, v_left, u_right, v_right = table.columns("left_u", "left_v", "right_u", "right_v").T
    return stereo, StereoTracks(
        t_s=table.times("time_s", apart=False) + later_s,
        track=table.column("apriltag_id").astype(np.int64),
        u_left_px=u_left,
        u_right_px=u_right,
        v_px=(v_left + v_right) / 2,
    )


def _calibration(path: Path) -> tuple[dict[str, float], Array, Array]:
    """Numbers of ``calib.json``, and rotation (3, 3) and place (3,) of the IMU in the camera."""
    fix = "fetch it again"
    try:
        given = json.loads(path.read_text(encoding="utf-8"))
        found = {name: float(given[name]) for name in ("fu", "fv", "cu", "cv", "b")}
        turn, place = (
            np.array([float(given["tf_cam_imu"][name]) for name in names])
            for names in (("w", "rot_x", "rot_y", "rot_z"), ("x", "y", "z"))
        )
    except FileNotFoundError:
        raise LogError("no such file", where=str(path), fix="pass the folder of the recording") from None
    except KeyError as error:
        raise LogError("missing", where=str(path), column=str(error.args[0]), fix=fix) from None
    except (OSError, ValueError, TypeError) as error:
        raise LogError(f"no calibration ({error})", where=str(path), fix=fix) from None
    return found, so3.from_quaternion(turn / np.linalg.norm(turn)), place
