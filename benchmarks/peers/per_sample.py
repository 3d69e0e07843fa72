"""Peer (a): the problem as GTSAM's own examples write it.

IMU samples preintegrated one by one, a bias at every keyframe, the odometer as a Python `CustomFactor` on its speed at
the keyframe with scale factor and mounting angles as one 4-vector, `LevenbergMarquardtOptimizer`, `Marginals`. Inside
the optimizer every call of a Python factor copies all values, so its time grows with the square of the length.
"""

from __future__ import annotations

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, C, V, X

from benchmarks.peers.chain import Array, Chain, common_factors, dead_reckoned, displacement, preintegrated, sigmas
from benchmarks.peers.native import add_biases


def odometer_factor(
    pose_key: int, velocity_key: int, calibration_key: int, speed_m_s: float, noise: gtsam.noiseModel.Base
) -> gtsam.CustomFactor:
    """Forward speed and motion constraint: ``e = (1 + scale) v_m - [0, speed, 0]``, as graphnav has it."""

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        calibration = values.atVector(calibration_key)
        mounting = gtsam.Rot3.Expmap(calibration[1:]).matrix()
        rotation = values.atPose3(pose_key).rotation().matrix()
        in_b = rotation.T @ values.atVector(velocity_key)
        in_m = mounting @ in_b
        gain = 1.0 + calibration[0]
        if jacobians is not None:
            by_b = gain * mounting
            jacobians[0] = np.hstack([by_b @ _cross(in_b), np.zeros((3, 3))])
            jacobians[1] = by_b @ rotation.T
            by_angle = -by_b @ _cross(in_b) @ gtsam.Rot3.ExpmapDerivative(calibration[1:])
            jacobians[2] = np.column_stack([in_m, by_angle])
        return np.asarray(gain * in_m - [0.0, speed_m_s, 0.0])

    return gtsam.CustomFactor(noise, [pose_key, velocity_key, calibration_key], error)


def _cross(v: Array) -> Array:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def build(chain: Chain) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """The graph and its dead-reckoned initial value."""
    odometer, times = chain.log.odometer, chain.keyframe_s
    assert odometer is not None
    graph = common_factors(chain)
    turns: list[gtsam.Rot3] = []
    moves: list[Array] = []
    for i, (pim, distance_m) in enumerate(preintegrated(chain)):
        graph.add(gtsam.ImuFactor(X(i), V(i), X(i + 1), V(i + 1), B(i), pim))
        turns.append(pim.deltaRij())
        moves.append(displacement(turns[-1], distance_m))
    values = dead_reckoned(chain, turns, moves)
    add_biases(graph, values, chain, len(times) - 1, B)
    graph.add(
        gtsam.PriorFactorVector(
            C(0), np.zeros(4), sigmas(odometer.scale_sigma, *np.radians(odometer.mounting_sigma_deg))
        )
    )
    values.insert(C(0), np.zeros(4))
    noise = sigmas(odometer.slip_sigma_m_s, odometer.sigma_m_s, odometer.slip_sigma_m_s)
    for i, speed_m_s in enumerate(np.interp(times, odometer.t_s, odometer.speed_m_s).tolist()):
        graph.add(odometer_factor(X(i), V(i), C(0), speed_m_s, noise))
    return graph, values
