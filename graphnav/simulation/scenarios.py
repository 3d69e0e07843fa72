"""The figures of the reference scenarios and the choices a user has.

Noise levels are fixed: a scenario is a yardstick, and a knob on its noise would let it be bent. What can be
chosen is listed per scenario in `graphnav.simulation.SCENARIOS`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from graphnav.errors import ConfigError
from graphnav.simulation.lidar_figures import LidarSpec
from graphnav.simulation.machine_figures import MEMS_IMU, ImuGrade, MachineSpec, Triple
from graphnav.simulation.roadheader_figures import RoadheaderSpec, roadheader_stereo
from graphnav.simulation.uwb_figures import CARRIER, FaceEndSpec, RangingSpec, face_end_uwb


@dataclass(frozen=True, kw_only=True)
class ShearerSpec(MachineSpec):
    """A shearer scenario in full. Lengths m, times s; sigmas are those drawn from and declared."""

    length_m: float
    cycles: int
    push_m: float
    bend_m: float
    pause_s: float
    retreat_m: float
    crossing_m: float
    end_work_s: float | None  # None: as long as the oblique cut with `pause_s` takes
    duration_s: float | None  # None: all cycles and `tail_s`
    pos_sigma_m: float
    slip_sigma_m_s: float
    scale_sigma: float
    mounting_sigma_deg: Triple
    mounting_deg: Triple | None = None  # the odometer's mounting; None: drawn
    att_error_deg: Triple | None = None  # of the declared initial attitude; None: drawn
    creep_m: tuple[float, ...] = ()  # of the near end along the face, push by push
    creep_sigma_m: float = 0.0
    lidar: LidarSpec | None = None
    interval_m: float = 2.0
    sensors: tuple[str, ...] = ("imu", "odometer", "closed-path")
    ranging: RangingSpec = CARRIER  # at the near end, if the sensors have "uwb"
    odometer_sigma_m_s: float = 0.01
    push_sigma_m: float = 0.03
    along_sigma_m: float = 0.03
    survey_sigma_m: float = 0.02
    heading_deg: float = 17.0
    undulation_m: float = 0.02
    wavelength_m: float = 60.0
    roll_sigma_deg: float = 0.5
    odometer_rate_hz: int = 10


MEMS = ShearerSpec(
    length_m=44.6,
    cycles=4,
    push_m=0.4,
    bend_m=0.03,
    speed_m_s=0.3,
    pause_s=10.0,
    retreat_m=12.0,
    crossing_m=10.0,
    end_work_s=None,
    duration_s=None,
    imu=MEMS_IMU,
    att_sigma_deg=(0.3, 0.3, 1.0),
    pos_sigma_m=0.05,
    slip_sigma_m_s=0.01,
    scale_sigma=0.05,
    mounting_sigma_deg=(3.0, 0.5, 3.0),
)

FULL_SHIFT = ShearerSpec(
    length_m=350.0,
    cycles=6,
    push_m=1.0,
    bend_m=0.1,
    speed_m_s=0.1,
    pause_s=10.0,
    retreat_m=40.0,
    crossing_m=30.0,
    end_work_s=870.0,
    duration_s=7.1 * 3600,
    imu=ImuGrade(0.05, 0.01, 0.05, 0.01),
    att_sigma_deg=(0.18 / 60, 0.13 / 60, 20.9 / 60),
    pos_sigma_m=0.01,
    slip_sigma_m_s=0.001,
    scale_sigma=0.002,
    mounting_sigma_deg=(0.72 / 60, 0.001, 20.3 / 60),  # the paper's 0 is declared as 0.001 deg
)

#: The paper's traverse lies along north and the two horizontal errors of its tables are along and across the face. Its
#: residual errors, right, forward, up: of the initial attitude ``[-0.18', 0.13', -20.9']`` in ``(I - phi x)``, of the
#: odometer's mounting ``[-0.72', 0, 20.3']`` from m to b. This project's angles are their negatives: the declared
#: attitude is the true one turned by ``Exp(att_error)``, and ``v_m = Exp(mounting) v_b``.
LIDAR = replace(
    FULL_SHIFT,
    heading_deg=0.0,
    att_error_deg=(0.18 / 60, -0.13 / 60, 20.9 / 60),
    mounting_deg=(0.72 / 60, 0.0, -20.3 / 60),
    creep_m=(-0.176, -0.225, -0.175, -0.225, -0.175),
    creep_sigma_m=0.3,
    lidar=LidarSpec(),
)

#: The paper's Table 2: error settings added on top, by number (0 adds nothing).
ADDED_ERRORS: tuple[ImuGrade, ...] = (
    ImuGrade(0, 0, 0, 0),
    *(ImuGrade(100 * i, 0, 0, 0) for i in (1, 2, 3)),
    *(ImuGrade(0, i, 0, 0) for i in (1, 2, 3)),
    *(ImuGrade(0, 0, i, 0) for i in (1, 2, 3)),
    *(ImuGrade(0, 0, 0, i) for i in (1, 2, 3)),
)
INTERVALS_M = (2.0, 6.0, 10.0)
SENSORS = ("imu", "odometer", "closed-path")
ALL_SENSORS = (*SENSORS, "uwb")
MIN_HOURS, MAX_HOURS = 0.02, 7.1


def shearer_mems(interval_m: float = 2.0, par: int = 0, sensors: str | Iterable[str] = SENSORS) -> ShearerSpec:
    """`shearer-mems` with a closed-path interval, an added error setting and some of its sensors."""
    if interval_m not in INTERVALS_M:
        raise ConfigError(f"interval_m = {interval_m!r}, expected one of {', '.join(map(str, INTERVALS_M))}")
    if isinstance(par, bool) or par not in range(len(ADDED_ERRORS)):
        raise ConfigError(f"par = {par!r}, expected a whole number 0 to {len(ADDED_ERRORS) - 1}")
    imu = MEMS.imu.with_added(ADDED_ERRORS[int(par)])
    return replace(MEMS, interval_m=float(interval_m), imu=imu, sensors=_chosen("shearer-mems", sensors))


def full_shift(hours: float = MAX_HOURS, sensors: str | Iterable[str] = SENSORS) -> ShearerSpec:
    """`full-shift`, its first `hours`, with some of its sensors."""
    if isinstance(hours, bool) or not isinstance(hours, int | float) or not MIN_HOURS <= hours <= MAX_HOURS:
        raise ConfigError(f"hours = {hours!r}, expected {MIN_HOURS} to {MAX_HOURS}")
    return replace(FULL_SHIFT, duration_s=3600.0 * hours, sensors=_chosen("full-shift", sensors))


def _chosen(scenario: str, sensors: str | Iterable[str]) -> tuple[str, ...]:
    """The sensors that are wanted, checked; by their names or a text of names."""
    chosen = tuple(s.strip() for s in sensors.split(",")) if isinstance(sensors, str) else tuple(sensors)
    for sensor in chosen:
        if sensor not in ALL_SENSORS:
            known = ", ".join(ALL_SENSORS)
            raise ConfigError(f'{scenario}: sensor "{sensor}" is not available yet; choose from {known}')
    if not {"imu", "odometer"} <= set(chosen):
        raise ConfigError(f'{scenario}: sensors must include "imu" and "odometer"')
    return chosen


def shearer_lidar(cycles: int = 6, scans: bool = True, draw: bool = False) -> ShearerSpec:
    """`shearer-lidar`, its first `cycles`; raw scans as well, or not; errors drawn, or the paper's values."""
    if isinstance(cycles, bool) or not isinstance(cycles, int) or not 1 <= cycles <= LIDAR.cycles:
        raise ConfigError(f"cycles = {cycles!r}, expected a whole number 1 to {LIDAR.cycles}")
    for name, value in (("scans", scans), ("draw", draw)):
        if not isinstance(value, bool):
            raise ConfigError(f"{name} = {value!r}, expected True or False")
    duration_s = LIDAR.duration_s if cycles == LIDAR.cycles else None
    spec = replace(LIDAR, cycles=cycles, duration_s=duration_s, lidar=LidarSpec(scans=scans, draw=draw))
    return replace(spec, att_error_deg=None, mounting_deg=None) if draw else spec


Spec = ShearerSpec | FaceEndSpec | RoadheaderSpec
BUILDERS: Mapping[str, Callable[..., Spec]] = {
    "shearer-mems": shearer_mems,
    "full-shift": full_shift,
    "shearer-lidar": shearer_lidar,
    "face-end-uwb": face_end_uwb,
    "roadheader-stereo": roadheader_stereo,
}


def resolve(scenario: str, options: Mapping[str, Any]) -> Spec:
    """The figures of a scenario with options.

    Raises
    ------
    ConfigError
        Unknown scenario or option, or a value out of range; the text names the valid ones.
    """
    if scenario not in BUILDERS:
        raise ConfigError(f'unknown scenario "{scenario}", expected one of {", ".join(BUILDERS)}')
    builder = BUILDERS[scenario]
    valid = tuple(inspect.signature(builder).parameters)
    for name in options:
        if name not in valid:
            raise ConfigError(f'{scenario}: unknown option "{name}", expected one of {", ".join(valid)}')
    return builder(**options)
