"""The leg finder judged on the LEGO recording: which cylinders were in sight, which were found, and how well.

A cylinder counts as visible when, by the reference pose and the landmark file, its whole width lies within the scan,
its centre is 0.25 to 2 m from the scanner, and no other cylinder nearer to the scanner overlaps it.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from factors import so3
from factors.so3 import Array
from graphnav.frontends.legs import Circles, detect, planar_motion, undistorted
from graphnav.log import SensorLog
from graphnav.readers import lego

Int = npt.NDArray[np.int64]
NEAR_M, FAR_M = 0.25, 2.0
#: A centre farther than this from every landmark is something else.
MATCH_M = 0.15


@dataclass(frozen=True)
class Judged:
    """What was found of what was there.

    Attributes
    ----------
    visible, found : counts of cylinders over all scans; found ones among the visible.
    other : centres that match no landmark.
    error_m : (K, 2) in the direction of the ray and across, of the visible ones found, by the reference pose.
    landmark : (K,) which; scan : (K,) in which scan.
    own_heading_rms_m : root mean square of the error norm when every scan keeps the reference's place, but gets the
        heading that fits it best: the reference has none of its own.
    own_pose_rms_m : when every scan with three cylinders or more gets the pose that fits it best.
    own_map_rms_m : when the landmarks may move as well. All three are divided by the share of degrees of freedom left.
    """

    visible: int
    found: int
    other: int
    error_m: Array
    landmark: Int
    scan: Int
    own_heading_rms_m: float
    own_pose_rms_m: float
    own_map_rms_m: float

    @property
    def recall(self) -> float:
        """Share of the visible cylinders found."""
        return self.found / self.visible


def rms(error_m: Array) -> float:
    """Root mean square of the 2-D error norm."""
    return float(np.sqrt((error_m**2).sum(axis=1).mean()))


def judge(folder: Path, *, raw_reference: bool = False) -> Judged:
    """Find the cylinders in every scan and compare with landmark file and reference."""
    log = lego.convert(folder, raw_reference=raw_reference)
    landmarks = lego.landmarks(folder)
    circles = centres(log)
    pos, heading = scanner_poses(log)
    seen = in_scanner(landmarks, pos, heading)
    assert log.lidar is not None and log.lidar.leg_diameter_m is not None and log.lidar_scans is not None
    visible = in_sight(seen, log.lidar.leg_diameter_m, float(log.lidar_scans.angle_min_rad[0]))
    distance = np.linalg.norm(circles.pos_s_m[:, None] - seen[circles.scan], axis=-1)
    nearest = distance.argmin(axis=1)
    good = distance.min(axis=1) < MATCH_M
    hit = np.full(visible.shape, -1)
    for k in np.flatnonzero(good)[np.argsort(-distance.min(axis=1)[good])]:  # nearest last, so it stays
        hit[circles.scan[k], nearest[k]] = k
    rows, marks = np.nonzero(visible & (hit >= 0))
    error = circles.pos_s_m[hit[rows, marks]] - seen[rows, marks]
    ray = seen[rows, marks] / np.linalg.norm(seen[rows, marks], axis=1)[:, None]
    across = np.column_stack([-ray[:, 1], ray[:, 0]])
    split = np.column_stack([(error * ray).sum(axis=1), (error * across).sum(axis=1)])
    found = circles.pos_s_m[hit[rows, marks]]
    return Judged(
        visible=int(visible.sum()),
        found=len(rows),
        other=int((~good).sum()),
        error_m=split,
        landmark=marks,
        scan=rows,
        own_heading_rms_m=own_heading(found, rows, landmarks[marks] - pos[rows]),
        own_pose_rms_m=own_geometry(found, rows, marks, landmarks, adjust=False),
        own_map_rms_m=own_geometry(found, rows, marks, landmarks, adjust=True),
    )


def centres(log: SensorLog) -> Circles:
    """Cylinders of every scan, as seen from where the scanner is at the scan's stamp."""
    assert log.lidar is not None and log.lidar_scans is not None
    circles = detect(log.lidar_scans, log.lidar)
    motion = planar_motion(log, log.lidar_scans.t_s)
    since = lego.SWEEP_S * (circles.beam / 659 - 0.5)
    rate, turn = motion.rate_s_m_s[circles.scan], motion.turn_rate_rad_s[circles.scan]
    return dataclasses.replace(circles, pos_s_m=undistorted(circles.pos_s_m, since, rate, turn))


def scanner_poses(log: SensorLog) -> tuple[Array, Array]:
    """Place (S, 2) in n and heading (S,) about up of the scanner at the scans, by the reference."""
    truth, lidar, scans = log.truth, log.lidar, log.lidar_scans
    assert truth is not None and lidar is not None and scans is not None
    forward = so3.from_quaternion(truth.quat_nb)[:, :2, 1]
    yaw = np.unwrap(np.arctan2(-forward[:, 0], forward[:, 1]))
    heading = np.interp(scans.t_s, truth.t_s, yaw)
    mark = np.column_stack([np.interp(scans.t_s, truth.t_s, axis) for axis in truth.pos_n_m.T[:2]])
    return mark + turned(heading, np.broadcast_to(lidar.T_bs_pos_m[:2], mark.shape)), heading


def turned(angle: Array, vectors: Array) -> Array:
    """Vectors (..., 2) turned counter-clockwise."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * vectors[..., 0] - s * vectors[..., 1], s * vectors[..., 0] + c * vectors[..., 1]], axis=-1)


def in_scanner(landmarks: Array, pos: Array, heading: Array) -> Array:
    """Landmarks (S, L, 2) in s."""
    return turned(-heading[:, None], landmarks[None] - pos[:, None])


def in_sight(seen: Array, diameter_m: float, angle_min_rad: float) -> npt.NDArray[np.bool_]:
    """(S, L) which landmarks are visible; see the module's docstring."""
    distance = np.linalg.norm(seen, axis=-1)
    half = np.arcsin(np.minimum(diameter_m / 2 / distance, 1.0))
    angle = np.arctan2(-seen[..., 0], seen[..., 1])
    angle_max = angle_min_rad + 659 * 0.006135923151543
    visible = (distance > NEAR_M) & (distance < FAR_M) & (angle - half > angle_min_rad) & (angle + half < angle_max)
    apart = np.abs((angle[:, :, None] - angle[:, None] + np.pi) % (2 * np.pi) - np.pi)
    in_front = (distance[:, None] < distance[:, :, None]) & (apart < half[:, :, None] + half[:, None])
    hidden = in_front.any(axis=2)
    sight: npt.NDArray[np.bool_] = visible & ~hidden
    return sight


def own_heading(found: Array, scan: Int, goal: Array) -> float:
    """Error when every scan is turned about the scanner onto the landmarks, seen from the reference's place."""
    rows, at = np.unique(scan, return_inverse=True)
    sine = np.bincount(at, found[:, 0] * goal[:, 1] - found[:, 1] * goal[:, 0])
    cosine = np.bincount(at, (found * goal).sum(axis=1))
    error = turned(np.arctan2(sine, cosine)[at], found) - goal
    return rms(error) / float(np.sqrt(1 - len(rows) / error.size))


def own_geometry(found: Array, scan: Int, mark: Int, landmarks: Array, *, adjust: bool) -> float:
    """Error when every scan gets the pose that fits it best, with the landmark file as it is or adjusted along."""
    _, at = np.unique(scan, return_inverse=True)
    enough = np.bincount(at)[at] >= 3
    found, scan, mark = found[enough], scan[enough], mark[enough]
    rows, at = np.unique(scan, return_inverse=True)
    map_m = landmarks.copy()
    for _ in range(300 if adjust else 1):
        place, yaw = fitted_poses(found, at, map_m[mark])
        error = place[at] + turned(yaw[at], found) - map_m[mark]
        if adjust:
            count = np.bincount(mark, minlength=len(map_m))[:, None]
            map_m += np.column_stack([np.bincount(mark, axis, len(map_m)) for axis in error.T]) / np.maximum(count, 1)
    # place and heading of an adjusted map are the poses' to choose
    fitted = 3 * len(rows) + (2 * len(map_m) - 3 if adjust else 0)
    return rms(error) / float(np.sqrt(1 - fitted / error.size))


def fitted_poses(found: Array, at: Int, marks: Array) -> tuple[Array, Array]:
    """Pose of every scan that takes what it found onto the landmarks best (least squares in closed form)."""
    count = np.bincount(at)[:, None]
    mean = np.column_stack([np.bincount(at, axis) for axis in found.T]) / count
    goal = np.column_stack([np.bincount(at, axis) for axis in marks.T]) / count
    a, b = found - mean[at], marks - goal[at]
    sine = np.bincount(at, a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    cosine = np.bincount(at, (a * b).sum(axis=1))
    yaw = np.arctan2(sine, cosine)
    return goal - turned(yaw, mean), yaw
