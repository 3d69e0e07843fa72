"""What stays fixed while a log without an IMU is smoothed: its chain of motions, keyframes and declared start."""

from __future__ import annotations

from dataclasses import dataclass, replace

from factors.relative_pose import Chain
from factors.so3 import Array
from graphnav.config import Config
from graphnav.errors import LogError
from graphnav.frontends.motion_chain import guiding_chain, motion_chain
from graphnav.keyframes import Frontend
from graphnav.log import InitialState, SensorLog


@dataclass(frozen=True)
class ChainProblem:
    """What stays fixed while solving."""

    log: SensorLog
    config: Config
    frontend: Frontend
    chain: Chain
    initial: InitialState
    notes: tuple[str, ...] = ()

    @property
    def keyframe_s(self) -> Array:
        """(N,) keyframe times."""
        return self.frontend.keyframe_s


def pose_chain(log: SensorLog, config: Config, frontend: Frontend, notes: tuple[str, ...] = ()) -> ChainProblem:
    """Check what smoothing by relative poses needs.

    Raises
    ------
    LogError : no initial state, or motions that are no chain.
    """
    if log.initial is None:
        raise LogError("missing", where="log.toml, [initial]", fix="give the initial pose with its sigmas")
    guide = frontend.guide
    chain = motion_chain(log) if guide is None else guiding_chain(replace(log, relative_pose=guide))
    return ChainProblem(log, config, frontend, chain, log.initial, notes)
