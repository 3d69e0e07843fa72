"""Columns of places and unit quaternions, and the check on the latter."""

from __future__ import annotations

import numpy as np

from graphnav._schema import Record

QUAT = ("qw", "qx", "qy", "qz")
XYZ = ("x_m", "y_m", "z_m")


def unit_quaternion(record: Record, name: str) -> None:
    """Normalise quaternions of `record.name` in place of rounding; refuse what is no rotation."""
    quat = np.atleast_2d(getattr(record, name))
    norm = np.linalg.norm(quat, axis=1)
    wrong = np.abs(norm - 1) > 1e-3
    if wrong.any():
        row = int(np.argmax(wrong))
        raise record.error(
            f"quaternion of length {norm[row]:.6g}, expected 1 (order w, x, y, z)",
            row=row if record.TABLE else None,
            column=name,
        )
    # What is of unit length to rounding stays as it is, so that a log written and read again is unchanged.
    norm[np.abs(norm - 1) < 1e-12] = 1.0
    unit = (quat / norm[:, None]).reshape(getattr(record, name).shape)
    unit.flags.writeable = False
    object.__setattr__(record, name, unit)
