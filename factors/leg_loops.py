"""The loop of `factors.landmark.leg_residual` over readings of legs, compiled.

Imported where it is called: the compiler takes a third of a second to import.
"""

from __future__ import annotations

import math

import numpy as np

from factors.compilation import compiled
from factors.so3 import Array

Ints = np.ndarray[tuple[int, ...], np.dtype[np.int64]]


@compiled
def _times(matrix: Array, vector: Array, out: Array) -> None:
    """``out = M v`` of 3 x 3."""
    for i in range(3):
        out[i] = matrix[i, 0] * vector[0] + matrix[i, 1] * vector[1] + matrix[i, 2] * vector[2]


@compiled
def _back(matrix: Array, vector: Array, out: Array) -> None:
    """``out = M' v`` of 3 x 3; for a row ``v' M``."""
    for i in range(3):
        out[i] = matrix[0, i] * vector[0] + matrix[1, i] * vector[1] + matrix[2, i] * vector[2]


@compiled
def _cross(a: Array, b: Array, out: Array) -> None:
    """``out = a x b``."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@compiled
def cut_legs(
    pose_nb: Array,
    pose_n: Array,
    turn_b: Array,
    shift_n: Array,
    leg_n: Array,
    reading: Array,
    spread: Array,
    which: Ints,
    calibration: Array,
    to_s: Array,
    by_delta: Array,
    rotation_bs: Array,
    lever_arm_b: Array,
) -> tuple[Array, Array, Array, Array]:
    """Errors (K, 2), Jacobians by pose (K, 2, 6), leg (K, 2, 4) and calibration (K, 2, 8); equations in `leg_residual`.

    Parameters
    ----------
    pose_nb, pose_n : (K, 3, 3) and (K, 3) pose; turn_b, shift_n : (K, 3, 3) and (K, 3) from it to that of the reading.
    leg_n : (K, 4); reading : (K, 4) range, angle, height and height above the plane.
    spread : (K, 3, 8) see `factors.legs.LegFamily`, by the calibration's own numbers.
    which : (K,) row of the next three; calibration : (C, 8); to_s : (C, 3, 3) turn from b to s; by_delta : (C, 3, 3)
        right Jacobian of its mounting angles.
    rotation_bs, lever_arm_b : (3, 3) and (3,) declared mounting.
    """
    count = len(reading)
    error, by_pose = np.empty((count, 2)), np.empty((count, 2, 6))
    by_leg, by_calibration = np.empty((count, 2, 4)), np.zeros((count, 2, 8))
    rotation, scanner, axis, line = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3)
    away_n, away_b, away_s, line_s = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    turned, arm, slid, by_b = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    some, other = np.empty(3), np.empty(3)
    for k in range(count):
        known, to, jacobian = calibration[which[k]], to_s[which[k]], by_delta[which[k]]
        for i in range(3):
            for j in range(3):
                rotation[i, j] = 0.0
                for m in range(3):
                    rotation[i, j] += pose_nb[k, i, m] * turn_b[k, m, j]
        moved_m, moved_rad, moved_off = 0.0, 0.0, 0.0
        for i in range(8):
            moved_m += spread[k, 0, i] * known[i]
            moved_rad += spread[k, 1, i] * known[i]
            moved_off += spread[k, 2, i] * known[i]
        # where the scan plane cuts the line
        _times(rotation, lever_arm_b, scanner)
        _times(rotation, to[2], axis)
        for i in range(3):
            scanner[i] += pose_n[k, i] + shift_n[k, i]
        line[0], line[1], line[2] = leg_n[k, 2], leg_n[k, 3], 1.0
        start_x, start_y = leg_n[k, 0] - scanner[0], leg_n[k, 1] - scanner[1]
        rise = reading[k, 2] - scanner[2]
        tilt = axis[0] * line[0] + axis[1] * line[1] + axis[2]
        level = axis[0] * start_x + axis[1] * start_y + axis[2] * rise
        above = (reading[k, 3] - moved_off - level) / tilt
        away_n[0], away_n[1], away_n[2] = start_x + line[0] * above, start_y + line[1] * above, rise + above
        _back(rotation, away_n, away_b)
        _times(to, away_b, away_s)
        # range and angle there
        x, y, angle = away_s[0], away_s[1], reading[k, 1]
        square = x * x + y * y
        rho, gain = math.sqrt(square), 1 + known[0]
        theta = angle + known[2] + known[3] * angle + known[4] * angle**2
        error[k, 0] = gain * rho + known[1] - reading[k, 0] + moved_m
        error[k, 1] = (math.atan2(-x, y) - theta + math.pi) % (2 * math.pi) - math.pi + moved_rad
        by_calibration[k, 0, 0], by_calibration[k, 0, 1] = rho, 1.0
        by_calibration[k, 1, 2], by_calibration[k, 1, 3], by_calibration[k, 1, 4] = -1.0, -angle, -(angle**2)
        # any change is followed along the line until the point lies in the scan plane again
        _back(rotation, line, some)
        _times(to, some, line_s)
        # away_b in the frame of s as declared: to' is Exp(delta) R, so that R (to away_b) is Exp(-delta) away_b
        _times(rotation_bs, away_s, turned)
        for i in range(3):
            arm[i] = away_b[i] + lever_arm_b[i]
        for row in range(2):
            slid[0], slid[1] = (gain * x / rho, gain * y / rho) if row == 0 else (-y / square, x / square)
            slid[2] = -(slid[0] * line_s[0] + slid[1] * line_s[1]) / line_s[2]
            _back(to, slid, by_b)
            # by_b [arm x], in the frame of the pose
            _cross(by_b, arm, some)
            _times(turn_b[k], some, other)
            by_pose[k, row, :3] = other
            _times(turn_b[k], by_b, other)
            for i in range(3):
                by_pose[k, row, 3 + i] = -other[i]
            _times(rotation, by_b, other)
            for i in range(2):
                by_leg[k, row, i], by_leg[k, row, 2 + i] = other[i], other[i] * above
            # slid R' [turned x] J
            _times(rotation_bs, slid, some)
            _cross(some, turned, other)
            _back(jacobian, other, some)
            for i in range(3):
                by_calibration[k, row, 5 + i] += some[i]
            # a plane that is cut higher is as a scanner that stands higher
            by_off = -(by_b[0] * to[2, 0] + by_b[1] * to[2, 1] + by_b[2] * to[2, 2])
            for i in range(8):
                by_calibration[k, row, i] += spread[k, row, i] - by_off * spread[k, 2, i]
    return error, by_pose, by_leg, by_calibration
