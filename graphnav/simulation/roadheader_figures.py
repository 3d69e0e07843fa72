"""The figures of the roadheader scenario: machine, roadway, stereo camera, lamps and dust.

The paper on a roadheader's visual-inertial odometry (stereo camera and SINS) has the roadway, the camera and the times
of the turns; the scenario has the IMU, the rest at the start and the visibility. All else here is chosen: how the
machine turns and vibrates, lamps, exposure and the tracks of features.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from graphnav.errors import ConfigError
from graphnav.simulation.machine_figures import ImuGrade, MachineSpec, Triple


@dataclass(frozen=True)
class RoadwaySpec:
    """A box in n with steel arches.

    The machine starts at the origin, which is 1.8 m above the floor, midway between the walls and 1.5 m from the end
    behind it. Arches stand proud of walls and roof; the face, to be cut, closes the roadway ahead.
    """

    half_width_m: float = 2.0
    floor_m: float = -1.8
    roof_m: float = 3.7
    back_m: float = -1.5
    face_m: float = 23.5
    arch_spacing_m: float = 1.0
    arch_width_m: float = 0.12
    arch_depth_m: float = 0.12


@dataclass(frozen=True)
class CameraSpec:
    """A rectified pair. Pixel centres lie at whole numbers, so that the image's centre is at half ones."""

    width_px: int = 424
    height_px: int = 240
    field_of_view_deg: float = 87.0
    baseline_m: float = 0.095
    lever_arm_b_m: Triple = (0.0, 0.3, 0.0)

    @property
    def focal_px(self) -> float:
        """Focal length, the same in both directions."""
        return self.width_px / 2 / math.tan(math.radians(self.field_of_view_deg / 2))


@dataclass(frozen=True)
class Lamp:
    """A headlamp on the machine: place and aim in the left camera's frame (right, down, ahead), relative power."""

    place_c_m: Triple
    aim_c: Triple
    power: float
    spread_deg: float


@dataclass(frozen=True)
class LightSpec:
    """Lamps, dust and exposure.

    A wall's light falls off with the square of its distance from the lamp. Dust takes ``exp(-3.912 z / visibility)`` of
    it on the way to the camera (Koschmieder: 2 % contrast left at the visibility) and `lamp_share` of that exponent on
    the way from the lamp, because dust scatters forward most of all. What it scatters back is added as airlight.
    """

    lamps: tuple[Lamp, ...] = (
        Lamp((-0.55, 0.25, -0.1), (-0.12, 0.06, 1.0), 1.0, 27.0),
        Lamp((0.65, 0.2, -0.1), (0.2, 0.1, 1.0), 0.55, 22.0),
    )
    visibility_m: float = 15.0
    lamp_share: float = 0.5
    backscatter: float = 0.011
    drift: float = 0.25  # 1-sigma of the slow change of airlight from place to place, as a share
    drift_time_s: float = 4.0
    exposure: float = 13.0  # electrons at full scale per unit of radiance, as a share of full scale
    full_electrons: float = 3000.0
    read_electrons: float = 4.0

    @property
    def extinction_1_m(self) -> float:
        """Koschmieder's extinction coefficient."""
        return 3.912 / self.visibility_m


@dataclass(frozen=True)
class TrackSpec:
    """Feature tracks drawn without images: `count` in view, each kept until it leaves or is lost."""

    count: int = 150
    sigma_px: float = 0.5
    reach_m: float = 12.0
    life_s: float = 5.0
    outlier_share: float = 0.0
    outlier_px: float = 30.0


@dataclass(frozen=True, kw_only=True)
class RoadheaderSpec(MachineSpec):
    """A roadheader that drives along y of n for 240 s and turns out and back twice."""

    length_m: float = 20.0
    turns_s: tuple[float, float] = (75.0, 180.0)  # after the start of travel; to the left first, then to the right
    turn_deg: float = 16.0
    turning_s: float = 12.0
    turned_s: float = 8.0
    undulation_m: float = 0.003  # of each of the floor's waves
    wavelengths_m: Triple = (1.7, 2.9, 5.3)
    roll_deg: float = 0.3
    vibration_rad: Triple = (0.003, 0.003, 0.001)  # right, forward, up
    rate_hz: float = 5.0
    images: bool = True
    tracks: TrackSpec | None = None
    roadway: RoadwaySpec = field(default_factory=RoadwaySpec)
    camera: CameraSpec = field(default_factory=CameraSpec)
    light: LightSpec = field(default_factory=LightSpec)
    sigma_px: float = 0.5


_SPEED_M_S = 20.0 / 237.0  # 20 m in 240 s, speeding up and slowing down for 3 s each
ROADHEADER = RoadheaderSpec(
    imu=ImuGrade(3.5, 0.05, 0.5, 0.05),
    speed_m_s=_SPEED_M_S,
    accel_m_s2=_SPEED_M_S / 3,
    att_sigma_deg=(0.01, 0.01, 0.01),
    pos_sigma_m=0.001,
)
MIN_RATE_HZ, MAX_RATE_HZ = 1.0, 30.0


def roadheader_stereo(
    rate_hz: float = 5.0, images: bool = True, tracks: bool = False, outlier_share: float = 0.0
) -> RoadheaderSpec:
    """`roadheader-stereo` at a frame rate, with images, tracks of features or both."""
    if isinstance(rate_hz, bool) or not isinstance(rate_hz, int | float) or not MIN_RATE_HZ <= rate_hz <= MAX_RATE_HZ:
        raise ConfigError(f"rate_hz = {rate_hz!r}, expected {MIN_RATE_HZ:g} to {MAX_RATE_HZ:g}")
    for name, value in (("images", images), ("tracks", tracks)):
        if not isinstance(value, bool):
            raise ConfigError(f"{name} = {value!r}, expected True or False")
    share = outlier_share
    if isinstance(share, bool) or not isinstance(share, int | float) or not 0 <= share < 1:
        raise ConfigError(f"outlier_share = {share!r}, expected 0 to less than 1")
    if share > 0 and not tracks:
        raise ConfigError(f"outlier_share = {share!r} without tracks; add tracks, or leave it out")
    drawn = TrackSpec(outlier_share=float(share), sigma_px=ROADHEADER.sigma_px) if tracks else None
    return replace(ROADHEADER, rate_hz=float(rate_hz), images=images, tracks=drawn)
