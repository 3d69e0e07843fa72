"""The methods of the IMU/UWB paper: positions from ranges alone, or by its filter, and both smoothed by its VB-UKF.

Cao et al. (2023), table 4: "uwb", "uwb-vbukf", "imu-uwb", "imu-uwb-vbukf". Ranges alone tell no attitude: theirs is the
declared initial one, with the covariance of a wholly unknown one.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from factors.so3 import Array, from_quaternion
from graphnav._memory import peak_bytes
from graphnav.baselines import vbukf
from graphnav.baselines.innovations import Innovations
from graphnav.baselines.range_filter import RangeFilter, RangeTable, Tuning
from graphnav.baselines.squared_range import warm_up
from graphnav.errors import LogError
from graphnav.filtered import as_inputs, bridged, diagnosed, history, inconsistent, last
from graphnav.frontends.alignment import aligned
from graphnav.frontends.range_epochs import (
    RangeEpochs,
    is_unknown,
    positions,
    range_epochs,
    ranges_of,
    start_position,
)
from graphnav.log import InitialState, Uwb
from graphnav.range_outcome import geometry_warnings
from graphnav.run import Diagnostics, Run
from graphnav.trajectory import Trajectory

if TYPE_CHECKING:
    from graphnav._stages import Stages
    from graphnav.config import Config
    from graphnav.frontends.trilateration import Fix
    from graphnav.log import SensorLog
    from graphnav.problem import Problem

#: Methods that take the log's ranges alone, and neither need nor use an IMU.
ALONE = ("uwb", "uwb-vbukf")
#: An attitude of which nothing is known: evenly spread over a turn.
_ANY_RAD = np.pi / np.sqrt(3)
#: The trilaterated start only says where to linearize: its ranges come again, so it is this many times less sure.
_START_SIGMAS = 10.0
_GAP_S = 2.0


# Ranges alone -----------------------------------------------------------------------------------------------


def run_ranges(log: SensorLog, config: Config, method: str, stages: Stages) -> Run:
    """A position for every epoch of ranges, at its own time; with "uwb-vbukf" smoothed.

    Raises
    ------
    LogError : no ranges, or anchors that determine no position.
    """
    with stages.stage("solve"):
        epochs = _ascending(range_epochs(log))
        initial = log.initial
        near = None if initial is None or is_unknown(initial) else initial.pos_n_m
        found = positions(epochs, near)
        rotation = np.eye(3) if initial is None else from_quaternion(initial.quat_nb_wxyz)
        pos = found.pos_n - epochs.lever_arm_b @ rotation.T
        vel, vel_cov = _differences(epochs.t_s, pos, found.cov)
        cov, innovations = found.cov, None
    if method == "uwb-vbukf":
        with stages.stage("covariance"):
            pos, cov, vel, vel_cov, innovations = _smoothed(epochs.t_s, pos, found.cov, initial, config)
    full = np.zeros((len(pos), 9, 9))
    full[:, :3, :3] = np.eye(3) * _ANY_RAD**2
    full[:, 3:6, 3:6], full[:, 6:, 6:] = cov, vel_cov
    quat = np.array([1.0, 0, 0, 0]) if initial is None else initial.quat_nb_wxyz
    trajectory = Trajectory(epochs.t_s, pos, np.tile(quat, (len(pos), 1)), vel, full if config.covariance else None)
    diagnostics = Diagnostics(
        method=method, converged=bool(found.converged.mean() > 0.5), iterations=1, keyframes=len(pos),
        seconds=stages.total(), peak_rss_mb=peak_bytes() / 1e6, warnings=_notes(epochs, found),
        history=[_dilution(found)], nis=None if innovations is None else innovations.to_dict(),
    )  # fmt: skip
    return Run(trajectory, {}, diagnostics, config, innovations=innovations)


def _ascending(epochs: RangeEpochs) -> RangeEpochs:
    """Epochs at times of their own: where several tags are heard at once, the first of them."""
    apart = np.diff(epochs.t_s, prepend=-np.inf) > 1e-6
    if apart.sum() < 2:
        raise LogError("one epoch of ranges, a trajectory needs two", where="table uwb", fix="record for longer")
    rows = {name: getattr(epochs, name)[apart] for name in ("t_s", "ranges_m", "lever_arm_b")}
    return replace(epochs, **rows)


def _differences(t_s: Array, pos_n: Array, cov: Array) -> tuple[Array, Array]:
    """Velocities (N, 3) as the slopes between neighbouring positions, and their covariances (N, 3, 3)."""
    low, high = np.maximum(np.arange(len(t_s)) - 1, 0), np.minimum(np.arange(len(t_s)) + 1, len(t_s) - 1)
    span = (t_s[high] - t_s[low])[:, None]
    return (pos_n[high] - pos_n[low]) / span, (cov[high] + cov[low]) / span[..., None] ** 2


def _dilution(found: Fix) -> dict[str, float]:
    """Dilution of precision over the log."""
    out = {"epochs": float(len(found.pdop)), "epochs_of_either_side": float(found.ambiguous.sum())}
    for name in ("gdop", "pdop", "hdop", "vdop"):
        value = getattr(found, name)
        out |= {f"{name}_median": float(np.median(value)), f"{name}_max": float(value.max())}
    return out


def _notes(epochs: RangeEpochs, found: Fix) -> list[str]:
    """What the user should know of positions from ranges alone."""
    notes = ["ranges alone tell no attitude: it is the declared one, and counts as unknown"]
    restless = int((~found.converged).sum())
    if restless:
        notes.append(
            f"{restless} of {len(found.pos_n)} positions are not settled: the tag is beside its anchors' plane"
        )
    gap = np.diff(epochs.t_s)
    if gap.max() > _GAP_S:
        notes.append(f"no position for {gap.max():.1f} s after {epochs.t_s[np.argmax(gap)]:.1f} s: too few ranges")
    return notes


# The paper's filter -----------------------------------------------------------------------------------------


def run_range_filter(problem: Problem, method: str, stages: Stages) -> Run:
    """The paper's filter over the whole log; with "imu-uwb-vbukf" its positions smoothed.

    Raises
    ------
    LogError : no ranges, or a start without a position that the ranges do not determine.
    SolveError : the filter diverged.
    """
    config, inputs = problem.config.uwb_filter, as_inputs(problem)
    with stages.stage("assemble"):
        table = range_table(ranges_of(problem.log), inflate=config.inflate)
        tuning = Tuning.of(inputs, config.bias_time_s, config.gate_sigmas)
        warm_up()
        forward = RangeFilter(inputs, table, tuning, _start(problem))
    with stages.stage("solve") as tick:
        forward.run(tick)
    estimates, innovations = forward.estimates, forward.innovations()
    with stages.stage("covariance"):
        quat, cov = estimates.house()
        known = history(problem, estimates, odometer=False)
        pos, vel, bridge = estimates.pos_n, estimates.vel_n, None
        if method == "imu-uwb-vbukf":
            pos, cov[:, 3:6, 3:6], vel, cov[:, 6:, 6:], innovations = _smoothed(
                problem.keyframe_s, pos, cov[:, 3:6, 3:6], problem.initial, problem.config
            )
            # what the attitude has in common with these positions is not known
            cov[:, :3, 3:], cov[:, 3:, :3], cov[:, 3:6, 6:], cov[:, 6:, 3:6] = 0.0, 0.0, 0.0, 0.0
        else:
            bridge = bridged(problem, estimates.gyro_bias_b[:-1], estimates.accel_bias_b[:-1])
    trajectory = Trajectory(problem.keyframe_s, pos, quat, vel, cov if problem.config.covariance else None, bridge)
    rejected = {"uwb": forward.rejected} if forward.rejected else {}
    diagnostics = replace(diagnosed(problem, method, stages), nis=innovations.to_dict(), rejected=rejected)
    diagnostics.warnings.extend(inconsistent(innovations) + geometry_warnings(ranges_of(problem.log)))
    return Run(trajectory, last(known), diagnostics, problem.config, history=known, innovations=innovations)


def range_table(uwb: Uwb, *, inflate: bool) -> RangeTable:
    """The log's ranges with what each is worth, taken for white as in the paper.

    Parameters
    ----------
    inflate : whether the Markov part counts once in two of its time constants, as it deserves, and not at every range.
    """
    levers = {tag.id: tag.lever_arm_b_m for tag in uwb.tag}
    anchors = {anchor.id: anchor for anchor in uwb.anchor}
    markov = uwb.markov_sigma_m or 0.0
    if inflate and markov:
        every_s = float(np.median(np.diff(uwb.t_s))) * len(anchors)
        markov *= np.sqrt(max(1.0, 2 * (uwb.markov_time_s or 0.0) / max(every_s, 1e-6)))
    quick = uwb.sigma_m**2 + markov**2
    constant = dict(zip(anchors, uwb.constant_sigma_m.tolist(), strict=True))
    fixed = np.array([constant[name] ** 2 + anchors[name].sigma_m ** 2 for name in uwb.anchor_id])
    return RangeTable(
        uwb.t_s, uwb.range_m, np.array([anchors[name].pos_n_m for name in uwb.anchor_id]),
        np.array([levers[name] for name in uwb.tag_id]), np.sqrt(quick + fixed),
        np.sqrt(uwb.rest_factor**2 * quick + fixed),
    )  # fmt: skip


def _start(problem: Problem) -> tuple[Array, Array] | None:
    """Position at the start and covariance from the ranges, where the log declares none."""
    if not is_unknown(problem.initial):
        return None
    rotation, _ = aligned(
        problem.imu.samples, problem.frontend.rest_s, problem.initial, problem.noise, problem.gravity_m_s2,
        problem.earth_rate_n,
    )  # fmt: skip
    pos, cov = start_position(problem.log, rotation, float(problem.keyframe_s[0]), problem.frontend.rest_s)
    return pos, cov * _START_SIGMAS**2


# The VB-UKF -------------------------------------------------------------------------------------------------


def _smoothed(
    t_s: Array, pos_n: Array, cov_n: Array, initial: InitialState | None, config: Config
) -> tuple[Array, Array, Array, Array, Innovations]:
    """Positions, their covariances, velocities, theirs, and the innovations, from the VB-UKF."""
    chosen = config.uwb_filter
    still = np.zeros(3), np.ones(3)
    velocity = still if initial is None else (initial.vel_n_m_s, initial.vel_sigma_m_s)
    adaptation = vbukf.Adaptation(chosen.accel_density_m_s2_sqrt_hz, chosen.noise_memory_s)
    out = vbukf.smooth(t_s, pos_n, cov_n[:50].mean(axis=0), velocity, adaptation)
    times = np.repeat(t_s[1:], 3)
    innovations = Innovations(
        times, np.zeros(len(times), np.int64), vbukf.KINDS, out.innovation[1:].ravel(), out.variance[1:].ravel()
    )
    return out.state[:, :3], out.cov[:, :3, :3], out.state[:, 3:], out.cov[:, 3:, 3:], innovations
