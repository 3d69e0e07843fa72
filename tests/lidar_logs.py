"""Small simulated logs with LiDAR legs, made and smoothed once per session."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

from graphnav.config import Config
from graphnav.limits import Bound
from graphnav.log import SensorLog
from graphnav.run import Run
from graphnav.simulation.lidar_figures import LidarSpec
from graphnav.simulation.scenarios import LIDAR
from graphnav.simulation.shearer import simulate_shearer
from graphnav.smooth import smooth

#: Two cuts of 30 m at three times the speed, every error drawn.
SPEC = replace(
    LIDAR, length_m=30.0, cycles=2, speed_m_s=0.3, static_s=20.0, tail_s=1.0, pause_s=3.0, retreat_m=24.0,
    crossing_m=20.0, end_work_s=None, duration_s=None, att_error_deg=None, mounting_deg=None,
    lidar=LidarSpec(draw=True),
)  # fmt: skip
#: One cut of 10 m: as small as an inverse of everything may be.
TINY = replace(SPEC, length_m=10.0, cycles=1, static_s=5.0, speed_m_s=0.5)
BARE = Config.from_dict({"lidar": {"use": False}})


@cache
def log(seed: int = 0) -> SensorLog:
    return simulate_shearer("legs", SPEC, seed)


@cache
def tiny() -> SensorLog:
    return simulate_shearer("tiny", TINY, 0)


@cache
def run(seed: int = 0, use: bool = True, method: str = "batch") -> Run:
    return smooth(replace(log(seed), truth=None), Config() if use else BARE, method)


@cache
def limit(seed: int = 0, use: bool = True) -> Bound:
    from graphnav.bound import bound

    return bound(log(seed), Config() if use else BARE)
