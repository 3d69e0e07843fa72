"""The figures of the scenario's LiDAR and of the supports beside it."""

from __future__ import annotations

from dataclasses import dataclass, field

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class SupportSpec:
    """The row of supports, each with one leg that the LiDAR sees. Lengths m, times s.

    The paper: legs every 1.5 m, 4 m beside the track, leaning by about 10 deg, and a zone I of moving supports that
    lags 2 to 3 supports behind the rear drum. Chosen: everything else. The LiDAR rides in the middle of a machine of
    14 m from drum to drum, so zone I begins 7 m + 2.5 supports behind it; a support 9 m behind, the farthest that the
    paper uses, has then not moved. The row goes on beyond both ends of the travel as far as the paper's features do.
    """

    spacing_m: float = 1.5
    beside_m: float = 4.0
    leg_diameter_m: float = 0.4
    lean_deg: tuple[float, float] = (8.0, 10.0)  # the top towards the coal, uniform between these
    lean_azimuth_deg: float = 10.0  # 1-sigma of its direction
    beyond_m: float = 10.5
    lag_m: float = 10.75
    moving_s: float = 10.0
    shield_m: float = 1.2  # the gob shield stands so far behind the leg


@dataclass(frozen=True)
class ScanSpec:
    """Raw scans: chosen, but for the width of a roadway.

    Each log of up to `short_s` is scanned throughout; a longer one around every stop at an end of the face and as it
    sets out. The outer wall of each roadway stays where it is, so the creep of the face shows in its distance.
    """

    step_deg: float = 0.25
    reach_m: float = 30.0
    dust: float = 0.01  # share of beams that return early
    dust_from_m: float = 0.5
    short_s: float = 300.0
    at_rest_s: float = 5.0  # after each cut's end and before its start
    setting_out_s: float = 60.0
    wall_m: float = 12.5  # beyond the end of the travel: 7 m of conveyor and a roadway of 5.5 m
    wall_rough_m: float = 0.1  # 1-sigma, drawn every `wall_step_m`
    wall_step_m: float = 0.5
    wall_from_m: float = -10.0  # along the roadway, to the right of the first line
    wall_to_m: float = 10.0
    no_return_m: float = 0.0


@dataclass(frozen=True)
class LidarSpec:
    """A planar scanner that looks at the supports on the machine's left.

    Errors are fixed at these values, or drawn with their sizes as sigmas if `draw` says so; the log declares the sizes
    as sigmas in either case.

    Attributes
    ----------
    reach_m : a leg is detected up to this range. The paper uses legs from 9 m along the face on, hence up to 10.5 m
        along and 11.2 m away; legs nearer than 14 m do not hide one another.
    field_deg : measured angles, from s's forward axis to the left: the half circle of the scanner that the paper's
        error values come from.
    mounting_deg : residual angles, ``R_bs = Exp(mounting)``; right, forward, up.
    range_scale, range_bias_m : the paper's dK, db.
    angle_quadratic_per_deg, angle_scale, angle_bias_deg : the paper's a1, a2 - 1, a3.
    """

    rate_hz: int = 25
    reach_m: float = 12.0
    field_deg: tuple[float, float] = (0.0, 180.0)
    range_sigma_m: float = 0.01
    angle_sigma_deg: float = 0.05
    range_scale: float = 0.0006
    range_bias_m: float = 0.035
    angle_quadratic_per_deg: float = 0.00004
    angle_scale: float = -0.0075  # a2 = 0.9925
    angle_bias_deg: float = 0.0531
    mounting_deg: Triple = (-0.6 / 60, 0.0, 25.5 / 60)
    mounting_sigma_deg: Triple = (0.6 / 60, 0.001, 25.5 / 60)  # the paper's 0 is declared as 0.001 deg
    draw: bool = False
    scans: bool = False
    supports: SupportSpec = field(default_factory=SupportSpec)
    raw: ScanSpec = field(default_factory=ScanSpec)
