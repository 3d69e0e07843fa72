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

    `width_px` and `height_px` are the size of the images that were calibrated; without them it is not checked.
    `sigma_px` is the 1-sigma error of a feature's column or row in one image, `disparity_sigma_px` of what all
    disparities are too large by (the angle between the two cameras). The camera sits in the body as declared but for
    errors of `T_bc_pos_sigma_m` (b) and angles of `mounting_sigma_deg` (``R_bc = R(T_bc_quat) Exp(angles)``,
    about c's axes), and an image at t shows what was at t + d, d to `time_sigma_s`; zero: as declared.
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
    time_sigma_s: float = param(0.0, nonnegative=True)
    width_px: int | None = param(None, kind="int")
    height_px: int | None = param(None, kind="int")

    def __post_init__(self) -> None:
        super().__post_init__()
        unit_quaternion(self, "T_bc_quat_wxyz")
        self._check_size()
        if self.baseline_m > _LONGEST_BASELINE_M:
            problem = f"{self.baseline_m:g}, expected metres, {_LONGEST_BASELINE_M:g} at most"
            raise self.error(problem, column="baseline_m", fix="multiply it by 0.001 if it is in mm")

    @property
    def size_px(self) -> tuple[int, int] | None:
        """Width and height of the images, where declared."""
        return None if self.width_px is None or self.height_px is None else (self.width_px, self.height_px)

    def _check_size(self) -> None:
        for name, other in (("width_px", "height_px"), ("height_px", "width_px")):
            value = getattr(self, name)
            if value is None and getattr(self, other) is not None:
                raise self.error("missing key", column=name, fix=f"it comes with {other}")
            if value is not None and value <= 0:
                raise self.error(f"{value}, expected a number above zero", column=name)
        if self.size_px is not None and not (self.cx_px < self.size_px[0] and self.cy_px < self.size_px[1]):
            problem = f"({self.cx_px:g}, {self.cy_px:g}), expected a place in the image of {_by(self.size_px)}"
            raise self.error(problem, column="cx_px, cy_px", fix="give the calibration of images of this size")


def _by(size_px: tuple[int, int]) -> str:
    return f"{size_px[0]} x {size_px[1]} pixels"


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
