"""The stereo camera, its images and tracked features, and motions from any odometry."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from graphnav._schema import Array, Record, column, param
from graphnav.records.rotation import QUAT, XYZ, unit_quaternion

#: No machine carries a pair of cameras farther apart, m.
_LONGEST_BASELINE_M = 5.0
_UPPER_6X6 = tuple(f"c_{i}{j}" for i in range(6) for j in range(i, 6))


@dataclass(frozen=True, eq=False)
class Stereo(Record):
    """The rectified stereo camera; its left camera is c.

    `sigma_px` is the 1-sigma error of a feature's column or row in one image, `disparity_sigma_px` of what all
    disparities are too large by (the angle between the two cameras). The camera sits in the body as declared but for
    errors of `T_bc_pos_sigma_m` (b) and angles of `mounting_sigma_deg` (``R_bc = R(T_bc_quat) Exp(angles)``,
    about c's axes); zero: as declared.
    """

    SECTION: ClassVar[str] = "stereo"
    fx_px: float = param(positive=True)
    fy_px: float = param(positive=True)
    cx_px: float = param()
    cy_px: float = param()
    baseline_m: float = param(positive=True)
    sigma_px: float = param(0.5, positive=True)
    disparity_sigma_px: float = param(0.0, nonnegative=True)
    T_bc_pos_m: Array = param((0.0, 0.0, 0.0), shape=(3,))
    T_bc_quat_wxyz: Array = param((0.7071067811865476, -0.7071067811865476, 0.0, 0.0), shape=(4,))
    T_bc_pos_sigma_m: Array = param((0.0, 0.0, 0.0), shape=(3,), nonnegative=True)
    mounting_sigma_deg: Array = param((0.0, 0.0, 0.0), shape=(3,), nonnegative=True)
    time_offset_s: float = param(0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        unit_quaternion(self, "T_bc_quat_wxyz")
        if self.baseline_m > _LONGEST_BASELINE_M:
            problem = f"{self.baseline_m:g}, expected metres, {_LONGEST_BASELINE_M:g} at most"
            raise self.error(problem, column="baseline_m", fix="multiply it by 0.001 if it is in mm")


@dataclass(frozen=True, eq=False)
class StereoPairs(Record):
    """Rectified image pairs: paths relative to `folder`, that of the log (None: a log that was not read from one)."""

    TABLE: ClassVar[str] = "stereo"
    FIELD: ClassVar[str] = "stereo_pairs"
    t_s: Array = column("t_s")
    left: Any = column("left", kind="str")
    right: Any = column("right", kind="str")
    folder: Path | None = field(default=None, compare=False)  # where it was read from, no part of what it says


@dataclass(frozen=True, eq=False)
class StereoTracks(Record):
    """Places of features in rectified image pairs; `track` is an integer that stands for one point at rest."""

    TABLE: ClassVar[str] = "stereo_tracks"
    STRICT: ClassVar[bool] = False
    t_s: Array = column("t_s")
    track: Any = column("track", kind="int")
    u_left_px: Array = column("u_left_px")
    u_right_px: Array = column("u_right_px")
    v_px: Array = column("v_px")


@dataclass(frozen=True, eq=False)
class RelativePose(Record):
    """Camera motions ``T_c_from_c_to`` from any odometry, with two sigmas or a full covariance."""

    TABLE: ClassVar[str] = "relative_pose"
    STRICT: ClassVar[bool] = False
    TIME: ClassVar[str] = "t_from_s"
    t_from_s: Array = column("t_from_s")
    t_to_s: Array = column("t_to_s")
    pos_m: Array = column(*XYZ)
    quat: Array = column(*QUAT)
    sigma_m: Array | None = column("sigma_m", positive=True, optional=True)
    sigma_rad: Array | None = column("sigma_rad", positive=True, optional=True)
    cov_upper: Array | None = column(*_UPPER_6X6, optional=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        unit_quaternion(self, "quat")
        if (self.sigma_m is None or self.sigma_rad is None) and self.cov_upper is None:
            raise self.error("no uncertainty", fix="add sigma_m and sigma_rad, or the 21 columns c_00 ... c_55")
