"""Logs of a machine with a camera: the IMU of a simulated scenario, relative poses drawn about its truth."""

from __future__ import annotations

import dataclasses

import numpy as np

import graphnav as gn
from factors import so3
from factors.relative_pose import relative
from graphnav.log import InitialState, RelativePose, SensorLog, Stereo

#: One sigma of each relative pose, rad and m.
SIGMA_RAD, SIGMA_M = 2e-3, 5e-3
CAMERA = {"fx_px": 212.0, "fy_px": 212.0, "cx_px": 212.0, "cy_px": 120.0, "baseline_m": 0.095}


def with_camera(
    seed: int, every_s: float = 2.0, mounting: np.ndarray | None = None, spans: tuple[tuple[float, float], ...] = ()
) -> SensorLog:
    """The face-end scenario with a camera in place of the ranges, 0.4 m ahead of the body and 0.1 m to its left.

    Parameters
    ----------
    mounting : (6,) true errors of the mounting (angles rad, place m), whose sigmas are declared; None: as declared.
    spans : without relative poses.
    """
    log = gn.simulate("face-end-uwb", seed=seed, site="surface")
    rng = np.random.default_rng([seed, 77])
    truth = log.truth
    assert truth is not None
    stereo = Stereo(**CAMERA, T_bc_pos_m=[-0.1, 0.4, 0.0])
    if mounting is not None:
        stereo = stereo.replace(mounting_sigma_deg=[1.0, 1.0, 1.0], T_bc_pos_sigma_m=[0.05, 0.05, 0.05])
    errors = np.zeros(6) if mounting is None else mounting
    turn_bc = so3.from_quaternion(stereo.T_bc_quat_wxyz) @ so3.exp(errors[:3])
    rows = np.arange(0, len(truth.t_s), round(every_s / float(np.median(np.diff(truth.t_s)))))
    rotation = so3.from_quaternion(truth.quat_nb[rows])
    pos = truth.pos_n_m[rows] + rotation @ (stereo.T_bc_pos_m + errors[3:])
    moved = relative(rotation[:-1] @ turn_bc, pos[:-1], rotation[1:] @ turn_bc, pos[1:])
    count = len(rows) - 1
    poses = RelativePose(
        t_from_s=truth.t_s[rows[:-1]],
        t_to_s=truth.t_s[rows[1:]],
        quat=so3.to_quaternion(moved[0] @ so3.exp(rng.normal(0, SIGMA_RAD, (count, 3)))),
        pos_m=moved[1] + rng.normal(0, SIGMA_M, (count, 3)),
        sigma_m=np.full(count, SIGMA_M),
        sigma_rad=np.full(count, SIGMA_RAD),
    )
    kept = np.ones(count, bool)
    for start, end in spans:
        kept &= (poses.t_to_s <= start) | (poses.t_from_s >= end)
    return dataclasses.replace(
        log, uwb=None, stereo=stereo, relative_pose=some(poses, kept), initial=_placed(log.initial, truth, rng)
    )


def some(poses: RelativePose, rows: np.ndarray) -> RelativePose:
    """Some of the relative poses."""
    columns = ("t_from_s", "t_to_s", "quat", "pos_m", "sigma_m", "sigma_rad")
    return RelativePose(**{name: getattr(poses, name)[rows] for name in columns})


def _placed(initial: InitialState | None, truth: object, rng: np.random.Generator) -> InitialState:
    """The scenario's start, with a position known to 1 cm."""
    assert initial is not None
    place = truth.pos_n_m[0] + rng.normal(0, 0.01, 3)
    return initial.replace(pos_n_m=place, pos_sigma_m=[0.01] * 3)
