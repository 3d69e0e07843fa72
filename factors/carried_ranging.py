"""Ranges of a machine without an IMU: each at its own time, carried from the keyframe before it by measured motions.

The residual is that of `factors.ranging`; wheels or a camera say how the body moved since the keyframe, so the tag is a
point that is fixed to it: ``e = (1 + c) |p + R l - a| + b + s m(t) - r`` with ``l = p_m + R_m l_b``, l_b the tag's
lever arm, p_m, R_m the motion, c a scale error that all ranges share. What the motion has wrong between the keyframe
and the range is left out (Plaza1: 5 cm in a second beside ranges of 50 cm).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from factors import lookup
from factors.increments import npt_int
from factors.inertial import Motion
from factors.ranging import RangeFamily, range_residual
from factors.so3 import Array

if TYPE_CHECKING:
    import gtsam


@dataclass(frozen=True)
class CarriedRanges(RangeFamily):
    """Ranges that hang on poses alone; `lever_arm_b` (K, 3) is the tag in the axes of the keyframe before the range.

    `scale_key` (K,) is the variable (1-vector) of the ranges' scale error, or -1 for none.
    """

    scale_key: npt_int = field(default_factory=lambda: np.zeros(0, np.int64))

    @classmethod
    def of(
        cls,
        *,
        pose_key: npt_int,
        anchor_key: npt_int,
        lever_arm_b: Array,
        anchor_n: Array,
        range_m: Array,
        sigma_m: Array,
        markov_key: npt_int,
        next_key: npt_int,
        slot: npt_int,
        slots: npt_int,
        markov_m: Array,
        scale_key: int = -1,
    ) -> CarriedRanges:
        """Without what belongs to an IMU; parameters as in `RangeFamily`."""
        count = len(range_m)
        none, zero = np.full(count, -1, np.int64), np.zeros((count, 3))
        still = Motion(np.arange(count + 1), np.zeros(count), np.broadcast_to(np.eye(3), (count, 3, 3)), zero, zero)
        return cls(
            pose_key=pose_key,
            velocity_key=none,
            bias_key=none,
            markov_key=markov_key,
            next_key=next_key,
            slot=slot,
            slots=slots,
            anchor_key=anchor_key,
            motion=still,
            accel_bias_b=zero,
            gyro_bias_b=zero,
            lever_arm_b=lever_arm_b,
            anchor_n=anchor_n,
            range_m=range_m,
            sigma_m=sigma_m,
            markov_m=markov_m,
            gravity_m_s2=0.0,
            earth_rate_n=np.zeros(3),
            scale_key=np.full(count, scale_key, np.int64),
        )

    def residuals(self, values: gtsam.Values) -> tuple[Array, dict[str, Array]]:
        """Whitened errors (K,) and Jacobians (K, size) by pose, anchor, the two Markov values and scale."""
        pose, anchor = lookup.poses(values, self.pose_key), lookup.vectors(values, self.anchor_key)
        error, by_pose, by_anchor = range_residual(
            pose[:, :3, :3], pose[:, :3, 3], self.lever_arm_b, self.anchor_n + anchor[:, 1:], self.range_m
        )
        distance = error + self.range_m
        larger = 1.0 + self._scale(values)
        error = larger * distance + anchor[:, 0] + self._markov(values) - self.range_m
        sigma = self.sigma_m[:, None]
        jacobians = {
            "pose": larger * by_pose / sigma,
            "anchor": np.concatenate([np.ones_like(sigma), larger * by_anchor], axis=1) / sigma,
            "markov": self.markov_m / sigma,
            "scale": distance[:, None] / sigma,
        }
        return error / self.sigma_m, jacobians

    def _scale(self, values: gtsam.Values) -> float:
        if not len(self.scale_key) or self.scale_key[0] < 0:
            return 0.0
        return float(values.atVector(int(self.scale_key[0]))[0])

    def every_block(self, jacobians: dict[str, Array]) -> Iterator[tuple[slice, list[int], list[Array]]]:
        """Rows, keys and Jacobians of every keyframe's ranges."""
        for rows in self.groups():
            yield rows, *self.blocks(rows, jacobians)

    def blocks(self, rows: slice, jacobians: dict[str, Array]) -> tuple[list[int], list[Array]]:
        """Keys and Jacobians of the ranges of one keyframe."""
        none = np.zeros((len(self.range_m), 0))
        keys, blocks = super().blocks(rows, {"velocity": none, "bias": none, **jacobians})
        # the second and third are the velocity's and the bias's, which a pose has not
        keys, blocks = [keys[0], *keys[3:]], [blocks[0], *blocks[3:]]
        own = int(self.scale_key[rows.start])
        if own < 0:
            return keys, blocks
        scale = jacobians.get("scale", np.zeros((len(self.range_m), 1)))
        return [*keys, own], [*blocks, scale[rows]]
