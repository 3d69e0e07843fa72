"""Which anchor's ranges may be off by a constant, when ranges contradict each other: what positions alone say.

Four ranges of an epoch determine three coordinates, and one is left over. Each anchor in turn is taken for the wrong
one: its ranges are lessened by a constant, the position of every epoch is found anew, and what the ranges then still
disagree by is summed over the epochs. It is small for the right anchor and constant alone (fault detection and
identification as satellite receivers do it: B. Parkinson and P. Axelrad, Navigation 35 (1988)), but for mirror images.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from factors.robust import Loss, losses
from factors.so3 import Array
from graphnav.errors import LogError
from graphnav.frontends.range_epochs import RangeEpochs, positions, range_epochs, ranges_of
from graphnav.log import SensorLog

#: Seconds of ranges of which medians are taken, and the most of these that are looked at.
_SPAN_S, _MOST = 1.0, 60
#: Constants looked at: up to this, in steps of this.
_FAR_M, _STEP_M = 3.0, 0.25
#: Minima of one anchor that are followed up: mirror images have others.
_MINIMA = 3
#: Then nearer and nearer by, so many each time: Huber's loss has a slope far off, a bounded one is not led by epochs of
#: reflections.
_SEARCHES: tuple[tuple[Loss, float], ...] = (("huber", _STEP_M), ("geman-mcclure", 0.1), ("geman-mcclure", 0.02))
_FINER = 11
#: Seconds between the epochs of one constant and the next, more than over which a side is voted.
_APART_S = 1000.0
#: Where the loss departs from least squares, in sigmas.
_LOSS_SIGMAS = 3.0
#: Ranges of an epoch that a position needs, and one over.
_REDUNDANT = 4


@dataclass(frozen=True)
class Fault:
    """An anchor whose ranges may be too long by a constant.

    Attributes
    ----------
    anchor : index in the log; bias_m : the constant.
    cost : twice the loss of what ranges then disagree by, in independent epochs.
    """

    anchor: int
    bias_m: float
    cost: float


def faults(log: SensorLog, near_n: Array | None) -> list[Fault]:
    """Every anchor heard in redundant epochs, with the constants that explain the ranges best; the best one first.

    Parameters
    ----------
    near_n : (3,) a place on the machine's side, for anchors that lie in one plane.
    """
    try:
        epochs = range_epochs(log).medians(_SPAN_S)
        count = np.isfinite(epochs.ranges_m).sum(axis=1)
        rows = np.flatnonzero(count >= _REDUNDANT)
        epochs = epochs.only(rows[:: -(-len(rows) // _MOST) or 1])
        heard = np.flatnonzero(np.isfinite(epochs.ranges_m).any(axis=0)).tolist() if len(rows) else []
        found = [fault for a in heard for fault in _minima(epochs, a, near_n)]
    except LogError:  # no position without knowing the side of a plane
        return []
    alone = _independent(log, epochs.t_s)
    return sorted((replace(each, cost=each.cost * alone) for each in found), key=lambda each: each.cost)


def lessened(log: SensorLog, fault: Fault) -> SensorLog:
    """The log with that anchor's ranges less the constant."""
    uwb = ranges_of(log)
    its = np.asarray(uwb.anchor_id) == uwb.anchor[fault.anchor].id
    # a range of nothing is none: those that would be are as good as any for a start
    return replace(log, uwb=replace(uwb, range_m=np.maximum(uwb.range_m - fault.bias_m * its, 1e-3)))


def _minima(epochs: RangeEpochs, a: int, near_n: Array | None) -> list[Fault]:
    """The best constants of one anchor."""
    grid = np.arange(-_FAR_M, _FAR_M + _STEP_M / 2, _STEP_M)
    cost = _costs(epochs, a, near_n, "huber", grid)
    walled = np.concatenate([[np.inf], cost, [np.inf]])
    lowest = np.flatnonzero((cost <= walled[:-2]) & (cost <= walled[2:]))
    found = []
    for k in lowest[np.argsort(cost[lowest])][:_MINIMA].tolist():
        bias, least = float(grid[k]), np.inf
        for loss, within_m in _SEARCHES:
            finer = bias + np.linspace(-within_m, within_m, _FINER)
            costs = _costs(epochs, a, near_n, loss, finer)
            bias, least = float(finer[np.argmin(costs)]), float(costs.min())
        found.append(Fault(a, bias, least))
    return found


def _costs(epochs: RangeEpochs, a: int, near_n: Array | None, loss: Loss, biases_m: Array) -> Array:
    """Twice the loss of what the ranges disagree by, over all epochs, for each constant (J,) of one anchor."""
    count = len(biases_m)
    ranges = np.tile(epochs.ranges_m, (count, 1, 1))
    ranges[:, :, a] -= biases_m[:, None]
    # all at once, as if one after the other: no epoch has a say in the side that those of another constant are on
    later_s = np.arange(count)[:, None] * (np.ptp(epochs.t_s) + _APART_S)
    stacked = replace(
        epochs, t_s=(epochs.t_s + later_s).ravel(), ranges_m=ranges.reshape(-1, ranges.shape[2]),
        lever_arm_b=np.tile(epochs.lever_arm_b, (count, 1)),
    )  # fmt: skip
    off = np.sqrt(positions(stacked, near_n).cost)
    return np.asarray(2 * losses(off, loss, _LOSS_SIGMAS).reshape(count, -1).sum(axis=1))


def _independent(log: SensorLog, t_s: Array) -> float:
    """Share of epochs that count, as Markov errors outlast them: the variance of a mean over two of their times."""
    every_s = float(np.median(np.diff(t_s))) if len(t_s) > 1 else _SPAN_S
    return min(1.0, every_s / max(2 * (ranges_of(log).markov_time_s or 0.0), 1e-9))
