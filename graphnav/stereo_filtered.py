"""The methods of the stereo paper: inertial navigation alone, stereo odometry alone, and both in its Kalman filter.

"sins", "stereo" and "vio-kf", which its table 6 and figure 14 compare. Stereo odometry is the table `relative_pose`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from factors.so3 import Array
from graphnav._memory import peak_bytes
from graphnav.baselines import warm_up
from graphnav.baselines.stereo_chain import laid
from graphnav.baselines.vio_filter import Tuning, VioFilter
from graphnav.errors import LogError
from graphnav.filtered import as_inputs, bridged, diagnosed, history, inconsistent, last
from graphnav.frontends.motion_chain import held_chain, sightings
from graphnav.frontends.rest import rest_spans
from graphnav.keyframes import place_keyframes
from graphnav.run import Diagnostics, Run
from graphnav.sighted import Sighted
from graphnav.trajectory import Trajectory

if TYPE_CHECKING:
    from graphnav._stages import Stages
    from graphnav.config import Config
    from graphnav.log import SensorLog
    from graphnav.problem import Problem


def run_stereo(sighted: Sighted, config: Config, stages: Stages) -> Run:
    """The motions one behind the other from the initial pose on; where there are none the pose is held.

    Raises
    ------
    LogError : no motions, motions that overlap, or no initial state.
    """
    log = sighted.log
    with stages.stage("solve"):
        seen = sightings(log)
        if log.initial is None:
            raise LogError("missing", where="log.toml, [initial]", fix="give the initial pose with its sigmas")
        start_s = float(seen.t_from_s[0]) if log.imu is None else min(log.imu.start_s, float(seen.t_from_s[0]))
        chain, gaps = held_chain(seen, start_s)
        t_s = place_keyframes(float(chain.t_s[0]), float(chain.t_s[-1]), np.zeros(0), config, log)
        way = laid(chain, log.initial, t_s)
    trajectory = way if config.covariance else replace(way, cov=None)
    diagnostics = Diagnostics(
        method="stereo", converged=True, iterations=1, keyframes=len(t_s), seconds=stages.total(),
        peak_rss_mb=peak_bytes() / 1e6, warnings=[*sighted.notes, *_gap_notes(log, gaps)],
    )  # fmt: skip
    return Run(trajectory, {}, diagnostics, config)


def _gap_notes(log: SensorLog, gaps: Array) -> list[str]:
    """A warning for gaps in which the machine may have moved."""
    moving = gaps
    for low, high in rest_spans(log):
        moving = moving[(moving[:, 0] < low - 1e-3) | (moving[:, 1] > high + 1e-3)]
    if not len(moving):
        return []
    long_s = moving[:, 1] - moving[:, 0]
    return [
        f"no motion of the camera for {long_s.sum():.1f} s in {len(moving)} gaps, the longest {long_s.max():.1f} s"
        f" after {moving[np.argmax(long_s), 0]:.1f} s: the pose is held there; methods with an IMU bridge them"
    ]


def run_vio(problem: Problem, method: str, stages: Stages) -> Run:
    """Inertial navigation alone ("sins"), or the paper's filter.

    Raises
    ------
    LogError : no motions, or motions that overlap; SolveError : the filter diverged.
    """
    chosen, inputs = problem.config.vio_filter, as_inputs(problem)
    with stages.stage("assemble"):
        seen = sightings(problem.log) if method == "vio-kf" else None
        warm_up()
        sigma_rad = float(np.radians(chosen.attitude_sigma_deg))
        relative = chosen.relative and seen is not None
        forward = VioFilter(inputs, seen, Tuning(sigma_rad, chosen.position_sigma_m, relative=relative))
    with stages.stage("solve") as tick:
        forward.run(tick)
    estimates, innovations = forward.estimates, forward.innovations()
    with stages.stage("covariance"):
        quat, cov = estimates.house()
        known = history(problem, estimates, odometer=False)
    bridge = bridged(problem, estimates.gyro_bias_b[:-1], estimates.accel_bias_b[:-1])
    trajectory = Trajectory(
        problem.keyframe_s, estimates.pos_n, quat, estimates.vel_n, cov if problem.config.covariance else None, bridge
    )
    diagnostics = replace(diagnosed(problem, method, stages), nis=innovations.to_dict())
    diagnostics.warnings.extend(inconsistent(innovations))
    if seen is not None and forward.used == 0:
        diagnostics.warnings.append(
            "no motion of the camera counts: none lies within the IMU's record and ends after the standing start"
        )
    return Run(trajectory, last(known), diagnostics, problem.config, history=known, innovations=innovations)
