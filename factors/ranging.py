"""Ranges between a tag on the machine and anchors, each at its own time between two keyframes.

``e = |p(t) + R(t) l - a| + b + s m(t) - r`` with the pose at the time of the range carried from the keyframe before it
by the preintegrated IMU (C. Forster et al., IEEE T-RO 33 (2017), equation 26, and its first-order dependence on the
biases), l the tag's lever arm, a the anchor, b its constant error and m a first-order Markov process of unit variance,
s its sigma at the moment. The IMU/UWB face-end paper squares the range and linearizes (its equations 14-16); here the
range itself is the measurement, whose noise does not depend on the distance.

Noise that the IMU adds between the keyframe and a range (0.1 mm in 0.3 s for MEMS) is left out.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from factors import lookup, so3
from factors.increments import npt_int
from factors.inertial import Motion, predict
from factors.known import jacobian_factor
from factors.range_layout import RangeLayout
from factors.robust import Loss, losses, weights
from factors.so3 import Array
from factors.time_offset import TimeOffset

if TYPE_CHECKING:
    import gtsam


def range_residual(
    rotation_nb: Array, pos_n: Array, lever_arm_b: Array, anchor_n: Array, range_m: Array
) -> tuple[Array, Array, Array]:
    """Distance from tag to anchor less the range.

    Parameters
    ----------
    rotation_nb, pos_n : (..., 3, 3) and (..., 3) pose; lever_arm_b, anchor_n : (..., 3); range_m : (...,).

    Returns
    -------
    error (...,) m; Jacobians with respect to pose (..., 6) and anchor (..., 3).
    """
    away_n = pos_n + np.einsum("...ij,...j->...i", rotation_nb, lever_arm_b) - anchor_n
    distance = np.linalg.norm(away_n, axis=-1)
    ray_n = away_n / np.maximum(distance, 1e-9)[..., None]
    ray_b = np.einsum("...ji,...j->...i", rotation_nb, ray_n)
    jac_pose = np.concatenate([np.cross(lever_arm_b, ray_b), ray_b], axis=-1)
    return distance - range_m, jac_pose, -ray_n


def markov_weights(unit: Array, span: Array) -> tuple[Array, Array, Array]:
    """A first-order Markov process of unit variance between two times at which it is known.

    Parameters
    ----------
    unit, span : (K,) time since the first of the two, and from it to the second, in correlation times.

    Returns
    -------
    Weights (K,) of the first and second value in its mean, and the variance (K,) about that mean.
    """
    first, second, both = np.exp(-unit), np.exp(-(span - unit)), np.exp(-span)
    left = np.maximum(1 - both**2, 1e-12)
    w_first, w_second = (first - both * second) / left, (second - both * first) / left
    return w_first, w_second, np.maximum(1 - w_first * first - w_second * second, 0.0)


@dataclass(frozen=True)
class RangeFamily:
    """All ranges of a log as arrays, in groups that share a keyframe: linearized at once.

    Attributes
    ----------
    pose_key, velocity_key, bias_key : (K,) of the keyframe before each range, ascending.
    markov_key, next_key : (K,) vectors of the Markov errors at that keyframe and the next, or -1 for none.
    slot : (K,) entry of the range's anchor in these; slots : (K,) their size.
    anchor_key : (K,) 4-vector of each anchor: constant error, and displacement from where it is declared, m.
    motion : K intervals from the keyframe to the range, preintegrated at the biases accel_bias_b, gyro_bias_b (K, 3).
    lever_arm_b, anchor_n : (K, 3); range_m, sigma_m : (K,).
    markov_m : (K, 2) what the two Markov values add to the range.
    gravity_m_s2, earth_rate_n : of the frame n.
    loss, scale : see `factors.robust`.
    clock : the time offset of the ranges where it is a variable, or None.
    """

    pose_key: npt_int
    velocity_key: npt_int
    bias_key: npt_int
    markov_key: npt_int
    next_key: npt_int
    slot: npt_int
    slots: npt_int
    anchor_key: npt_int
    motion: Motion
    accel_bias_b: Array
    gyro_bias_b: Array
    lever_arm_b: Array
    anchor_n: Array
    range_m: Array
    sigma_m: Array
    markov_m: Array
    gravity_m_s2: float
    earth_rate_n: Array
    loss: Loss = "none"
    scale: float = 3.0
    clock: TimeOffset | None = None

    def only(self, rows: npt_int | np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> RangeFamily:
        """Some of the ranges."""
        same = ("motion", "gravity_m_s2", "earth_rate_n", "loss", "scale", "clock")
        some = {f.name: getattr(self, f.name)[rows] for f in fields(self) if f.name not in same}
        m = self.motion
        motion = Motion(m.first, *(each[rows] for each in (m.elapsed_s, m.rotation, m.velocity_b, m.position_b)))
        clock = None if self.clock is None else self.clock.only(rows)
        return replace(self, motion=motion, clock=clock, **some)

    def residuals(self, values: gtsam.Values) -> tuple[Array, dict[str, Array]]:
        """Whitened errors (K,), Jacobians (K, size) by pose, velocity, bias, anchor, the two Markov values, offset."""
        t, motion = self.motion.elapsed_s[:, None], self.motion
        pose, bias = lookup.poses(values, self.pose_key), lookup.biases(values, self.bias_key)
        rotation, vel = pose[:, :3, :3], lookup.vectors(values, self.velocity_key)
        accel, gyro = bias[:, :3] - self.accel_bias_b, bias[:, 3:] - self.gyro_bias_b
        moved = Motion(
            motion.first,
            motion.elapsed_s,
            motion.rotation @ so3.exp(-gyro * t),
            motion.velocity_b - accel * t + np.cross(motion.velocity_b, gyro) * t / 2,
            motion.position_b - accel * t**2 / 2 + np.cross(motion.position_b, gyro) * t / 3,
        )
        at, pos, _ = predict(
            rotation, pose[:, :3, 3], vel, moved, np.arange(len(t)), self.gravity_m_s2, self.earth_rate_n
        )
        if self.clock is not None:
            pos = pos + self.clock.moved_n(values)
        anchor = lookup.vectors(values, self.anchor_key)
        error, by_at, by_anchor = range_residual(at, pos, self.lever_arm_b, self.anchor_n + anchor[:, 1:], self.range_m)
        error = error + anchor[:, 0] + self._markov(values)
        # what follows from the keyframe's pose, in its axes
        ray = np.einsum("kji,kj->ki", rotation, -by_anchor)
        lever = np.einsum("kij,kj->ki", moved.rotation, self.lever_arm_b)
        by_gyro = np.cross(ray, motion.position_b) * t / 3 - by_at[:, :3] * t
        jacobians = {
            "pose": np.concatenate([np.cross(moved.position_b + lever, ray), ray], axis=1),
            "velocity": -by_anchor * t,
            "bias": np.concatenate([-ray * t**2 / 2, by_gyro], axis=1),
            "anchor": np.concatenate([np.ones_like(t), by_anchor], axis=1),
            "markov": self.markov_m,
        }
        if self.clock is not None:
            jacobians["offset"] = self.clock.jacobian(-by_anchor)
        sigma = self.sigma_m[:, None]
        return error / self.sigma_m, {name: each / sigma for name, each in jacobians.items()}

    def off(self, values: gtsam.Values) -> Array:
        """How far each range is off (K,), in sigmas."""
        return np.abs(self.residuals(values)[0])

    def _markov(self, values: gtsam.Values) -> Array:
        """What the Markov errors add (K,) m."""
        keys = np.stack([self.markov_key, self.next_key], axis=1)
        there = keys >= 0
        if not there.any():
            return np.zeros(len(keys))
        different, which = np.unique(keys[there], return_inverse=True)
        known = [values.atVector(key) for key in different.tolist()]
        first = np.cumsum([0] + [len(each) for each in known])[:-1]
        found = np.zeros(keys.shape)
        found[there] = np.concatenate(known)[first[which] + np.stack([self.slot] * 2, axis=1)[there]]
        return np.asarray(self.markov_m[:, 0] * found[:, 0] + self.markov_m[:, 1] * found[:, 1])

    def linearize_into(self, linear: gtsam.GaussianFactorGraph, values: gtsam.Values) -> None:
        """Append the whitened Jacobian factors at `values`, one for each group of ranges."""
        import gtsam

        if not len(self.range_m):
            return
        error, jacobians = self.residuals(values)
        excess = 0.0
        if self.loss != "none":
            weight = weights(error, self.loss, self.scale)
            excess = float((2 * losses(error, self.loss, self.scale) - weight * error**2).sum())
            root = np.sqrt(weight)
            error, jacobians = root * error, {name: root[:, None] * each for name, each in jacobians.items()}
        for rows, keys, blocks in self.every_block(jacobians):
            linear.push_back(jacobian_factor(keys, blocks, error[rows]))
        # a row of no variable's makes the linear graph's error that of the loss
        held = int(self.pose_key[0])
        unit = gtsam.noiseModel.Unit.Create(1)
        linear.push_back(gtsam.JacobianFactor(held, np.zeros((1, 6)), np.array([np.sqrt(max(excess, 0.0))]), unit))

    def every_block(self, jacobians: dict[str, Array]) -> Iterator[tuple[slice, list[int], list[Array]]]:
        """Rows, keys and Jacobians of every keyframe's ranges: `blocks` of all of them at once."""
        layout = self._layout
        clock = [] if self.clock is None else [self.clock.key]
        found = layout.blocks(
            (jacobians["pose"], jacobians["velocity"], jacobians["bias"]), jacobians["markov"], self.slot,
            int(self.slots[0]), jacobians["anchor"], jacobians.get("offset"),
        )  # fmt: skip
        for rows, keys, blocks in zip(layout.groups, layout.keys, found, strict=True):
            yield rows, keys + clock, blocks

    @cached_property
    def _layout(self) -> RangeLayout:
        states = (self.pose_key, self.velocity_key, self.bias_key)
        return RangeLayout.of(self.groups(), states, (self.markov_key, self.next_key), self.anchor_key)

    def groups(self) -> list[slice]:
        """Ranges that share keyframes."""
        first = np.flatnonzero(np.diff(self.pose_key, prepend=-1) | np.diff(self.markov_key, prepend=-1))
        last = np.append(first[1:], len(self.pose_key))
        return [slice(lo, hi) for lo, hi in zip(first.tolist(), last.tolist(), strict=True)]

    def blocks(self, rows: slice, jacobians: dict[str, Array]) -> tuple[list[int], list[Array]]:
        """Keys and Jacobians of the ranges of one keyframe."""
        at, count = rows.start, rows.stop - rows.start
        keys = [int(each[at]) for each in (self.pose_key, self.velocity_key, self.bias_key)]
        blocks = [jacobians[name][rows] for name in ("pose", "velocity", "bias")]
        for column, own in enumerate((self.markov_key, self.next_key)):
            if own[at] >= 0:
                block = np.zeros((count, int(self.slots[at])))
                block[np.arange(count), self.slot[rows]] = jacobians["markov"][rows, column]
                keys.append(int(own[at]))
                blocks.append(block)
        of_anchor: dict[int, list[int]] = {}
        for row, key in enumerate(self.anchor_key[rows].tolist()):
            of_anchor.setdefault(key, []).append(row)
        by_anchor = jacobians["anchor"][rows]
        for key, own_rows in of_anchor.items():
            block = np.zeros((count, 4))
            block[own_rows] = by_anchor[own_rows]
            keys.append(key)
            blocks.append(block)
        if self.clock is not None:
            keys.append(self.clock.key)
            blocks.append(jacobians["offset"][rows])
        return keys, blocks

    def factors(self) -> list[gtsam.CustomFactor]:
        """The ranges of each keyframe as a factor evaluated anew, for an incremental solver.

        With a loss each range has the weight of its error where it is linearized (least squares, weighted anew).
        """
        import gtsam

        found = []
        for rows in self.groups():
            some = self.only(np.arange(rows.start, rows.stop))
            every = slice(0, rows.stop - rows.start)
            keys, _ = some.blocks(every, {name: np.zeros((every.stop, size)) for name, size in _SIZES.items()})
            unit = gtsam.noiseModel.Unit.Create(every.stop)
            found.append(gtsam.CustomFactor(unit, keys, _Evaluated(some, every)))
        return found


_SIZES = {"pose": 6, "velocity": 3, "bias": 6, "anchor": 4, "markov": 2, "offset": 1}


@dataclass(frozen=True)
class _Evaluated:
    """A factor's error function."""

    family: RangeFamily
    rows: slice

    def __call__(self, factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        error, by = self.family.residuals(values)
        if self.family.loss != "none":
            root = np.sqrt(weights(error, self.family.loss, self.family.scale))
            error, by = root * error, {name: root[:, None] * each for name, each in by.items()}
        if jacobians is not None:
            for k, block in enumerate(self.family.blocks(self.rows, by)[1]):
                jacobians[k] = block
        return error


def markov_factor(key_1: int, key_2: int, span: float, size: int) -> gtsam.CustomFactor:
    """Transition of `size` Markov processes of unit variance over `span` correlation times.

    ``m_2 = exp(-span) m_1 + w``, w of variance ``1 - exp(-2 span)`` (the face-end paper's equation 12, exactly
    discretized).
    """
    import gtsam

    decay = float(np.exp(-span))
    root = float(np.sqrt(-np.expm1(-2 * span)))
    by_1, by_2 = -decay / root * np.eye(size), np.eye(size) / root

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        if jacobians is not None:
            jacobians[0], jacobians[1] = by_1, by_2
        return np.asarray((values.atVector(key_2) - decay * values.atVector(key_1)) / root)

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(size), [key_1, key_2], error)
