"""Where the machine starts, where it is known to have been, and the reference."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from graphnav._schema import Array, Record, column, param
from graphnav.records.rotation import QUAT, XYZ, unit_quaternion


@dataclass(frozen=True, eq=False)
class Frames(Record):
    """Origin of the navigation frame n (east, north, up; tangent plane)."""

    SECTION: ClassVar[str] = "frames"
    latitude_deg: float = param()
    longitude_deg: float = param(0.0)
    height_m: float = param(0.0)
    gravity_m_s2: float | None = param(None, positive=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if abs(self.latitude_deg) > 90:
            raise self.error(f"{self.latitude_deg}, expected -90 to 90", column="latitude_deg")
        if self.gravity_m_s2 is not None and not 9.7 < self.gravity_m_s2 < 9.9:
            raise self.error(f"{self.gravity_m_s2}, expected 9.7 to 9.9 m/s^2", column="gravity_m_s2")


@dataclass(frozen=True, eq=False, kw_only=True)
class InitialState(Record):
    """State at the start of the first IMU row's interval, with 1-sigma.

    Without `pos_n_m` and `pos_sigma_m` the position is unknown: zeros, with a sigma of 1000 m.
    """

    SECTION: ClassVar[str] = "initial"
    UNKNOWN_M: ClassVar[float] = 100.0
    pos_n_m: Array = param(None, shape=(3,))
    pos_sigma_m: Array = param(None, shape=(3,), positive=True)
    quat_nb_wxyz: Array = param(shape=(4,))
    att_sigma_deg: Array = param(shape=(3,), positive=True)
    vel_n_m_s: Array = param(shape=(3,))
    vel_sigma_m_s: Array = param(shape=(3,), positive=True)
    static_until_s: float | None = param(None)

    @property
    def pos_known(self) -> bool:
        """Whether the position is declared to better than 100 m; if not, measurements have to give it."""
        return bool((self.pos_sigma_m < self.UNKNOWN_M).all())

    def __post_init__(self) -> None:
        missing = [getattr(self, name) is None for name in ("pos_n_m", "pos_sigma_m")]
        if any(missing) and not all(missing):
            raise self.error("pos_n_m and pos_sigma_m belong together", fix="declare both, or neither")
        if all(missing):
            object.__setattr__(self, "pos_n_m", np.zeros(3))
            object.__setattr__(self, "pos_sigma_m", np.full(3, 1000.0))
        super().__post_init__()
        unit_quaternion(self, "quat_nb_wxyz")


@dataclass(frozen=True, eq=False)
class SurveyedPoint(Record):
    """A known position of the machine: at time `t_s`, or on its first arrival at an `end` of the face."""

    SECTION: ClassVar[str] = "surveyed"
    pos_n_m: Array = param(shape=(3,))
    sigma_m: float = param(positive=True)
    t_s: float | None = param(None)
    end: str | None = param(None, kind="str")

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.t_s is None) == (self.end is None):
            raise self.error("expected either t_s or end", column="t_s")
        if self.end not in (None, "far", "near"):
            raise self.error(f'"{self.end}", expected "far" or "near"', column="end")


@dataclass(frozen=True, eq=False)
class Position(Record):
    """Absolute positions in n (GNSS, total station), each with its own sigmas."""

    TABLE: ClassVar[str] = "position"
    t_s: Array = column("t_s")
    pos_n_m: Array = column(*XYZ)
    sigma_n_m: Array = column("sigma_x_m", "sigma_y_m", "sigma_z_m", positive=True)


@dataclass(frozen=True, eq=False)
class Truth(Record):
    """Reference trajectory; for evaluation alone, never for an estimator."""

    TABLE: ClassVar[str] = "truth"
    t_s: Array = column("t_s")
    pos_n_m: Array = column(*XYZ)
    quat_nb: Array = column(*QUAT)
    vel_n_m_s: Array | None = column("vx_m_s", "vy_m_s", "vz_m_s", optional=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        unit_quaternion(self, "quat_nb")
