"""The figures of UWB ranging at the face end: anchors, range errors and the two sites of the paper.

All error figures are chosen, as the scenario has it, to give UWB alone about the paper's mean errors. Not of the paper
either: the survey's millimetre, which is declared because a log has no anchor without a sigma.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from graphnav.errors import ConfigError
from graphnav.simulation.machine_figures import MEMS_IMU, MachineSpec, Triple

_M_MIN = 1.0 / 60


@dataclass(frozen=True)
class Multipath:
    """Ranges of one anchor that come late by an exponential delay."""

    anchor: int  # its place in the turn, from 0
    share: float
    mean_m: float


@dataclass(frozen=True, kw_only=True)
class RangingSpec:
    """One tag and anchors that measure their ranges in turn, `rate_hz` in all.

    A range has white noise, a first-order Markov process of its anchor and a constant of its anchor; at rest
    `rest_factor` times the first two. Sigmas are those drawn from and declared; `multipath` and the NLOS ranges, a
    share of all with a delay uniform up to `nlos_max_m`, are not declared.
    """

    anchors_m: tuple[Triple, ...]
    white_m: float
    markov_m: float
    markov_time_s: float
    constant_m: float
    rest_factor: float = 1.0
    multipath: Multipath | None = None
    nlos_share: float = 0.0
    nlos_max_m: float = 3.0
    rate_hz: float = 40.0
    reach_m: float = math.inf
    survey_m: float = 0.001
    group_m: float = 0.03  # where anchors are moved: of each axis of the displacement that they share
    group_turn_deg: float = 0.5
    lever_arm_b_m: Triple = (0.0, 0.0, -0.3)


@dataclass(frozen=True, kw_only=True)
class FaceEndSpec(MachineSpec):
    """A machine that drives past the face end once, along y of n and without turning round.

    Its tag keeps to the line at `tag_x_m`, `tag_z_m` but for its lever arm's share of the vibration, in which the IMU
    stays on its own line. Speeding up and slowing down take 3 s each, which makes the paper's 7 m last its 108 s.
    """

    ranging: RangingSpec
    tag_x_m: float = 0.5
    tag_z_m: float
    from_y_m: float
    to_y_m: float
    vibration_deg: float = 0.2


SURFACE = FaceEndSpec(
    imu=MEMS_IMU,
    att_sigma_deg=(0.3, 0.3, 1.0),
    speed_m_s=4 * _M_MIN,
    accel_m_s2=4 * _M_MIN / 3,
    static_s=10.0,
    tail_s=0.0,
    tag_z_m=0.0,
    from_y_m=9.0,
    to_y_m=2.0,
    ranging=RangingSpec(
        anchors_m=((1.112, 0.471, 1.375), (0.442, 1.483, 1.556), (1.925, 1.551, 1.913), (1.073, 0.542, 2.532)),
        white_m=0.013,
        markov_m=0.010,
        markov_time_s=2.0,
        constant_m=0.003,
    ),
)

UNDERGROUND = replace(
    SURFACE,
    static_s=45.0,
    tail_s=13.0,
    tag_z_m=0.5,
    from_y_m=-5.0,
    to_y_m=2.0,
    ranging=RangingSpec(
        anchors_m=((1.251, 3.352, -0.251), (0.0, 0.0, 0.0), (-0.110, 2.375, 0.311), (-1.223, 2.758, 0.349)),
        white_m=0.045,
        markov_m=0.045,
        markov_time_s=3.0,
        constant_m=0.010,
        rest_factor=0.25,
        multipath=Multipath(anchor=0, share=0.05, mean_m=0.3),
    ),
)
#: For a shift: anchors on a carrier, used where the machine is near them.
CARRIER = replace(UNDERGROUND.ranging, reach_m=10.0, survey_m=0.005)
SITES = {"surface": SURFACE, "underground": UNDERGROUND}


def face_end_uwb(site: str = "underground", nlos_share: float = 0.0, nlos_max_m: float = 3.0) -> FaceEndSpec:
    """`face-end-uwb` at one of its sites; for experiments with a share of NLOS ranges."""
    if site not in SITES:
        raise ConfigError(f"site = {site!r}, expected one of {', '.join(SITES)}")
    for name, value, most in (("nlos_share", nlos_share, 1.0), ("nlos_max_m", nlos_max_m, 100.0)):
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= most:
            raise ConfigError(f"{name} = {value!r}, expected 0 to {most:g}")
    spec = SITES[site]
    return replace(spec, ranging=replace(spec.ranging, nlos_share=float(nlos_share), nlos_max_m=float(nlos_max_m)))
