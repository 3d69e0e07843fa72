"""Which UWB ranges, or motions of a camera, agree with all else: ranges by reflection are metres long, a camera takes
what moves for what rests, and neither must move the machine.

The graph is solved roughly with all of them, then with a loss under which those that are off count ever less, narrowed
in steps so that the first compromise is left behind (graduated non-convexity: A. Blake and A. Zisserman, Visual
Reconstruction, 1987; for Geman-McClure's loss H. Yang et al., IEEE RA-L 5 (2020)). What is then still off is left out,
and least squares have the last word.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from factors.mounted_motion import MotionFamily
from factors.ranging import RangeFamily
from factors.robust import Loss
from factors.stereo_tracks import TrackFamily
from graphnav.camera import Camera
from graphnav.config import Config, RelativePoseConfig, StereoConfig, UwbConfig
from graphnav.graph import SmoothingGraph
from graphnav.leg_means import npt_bool
from graphnav.solvers import batch

if TYPE_CHECKING:
    from collections.abc import Callable

    import gtsam

#: Where the narrowing starts below the worst one, and each step of it.
_START, _NARROWER = 0.25, 4.0
#: Joint sigmas at which a step of the narrowing is done, at which the last one is, and iterations at most.
_ON_THE_WAY, _ROUGH_SIGMAS, _ITERATIONS = 30.0, 3.0, 10
#: With all of them, wrong ones included, the error may creep: a step that lowers it by less than this share ends it.
_LEAST_GAIN = 0.05


def agreeing_ranges(graph: SmoothingGraph, config: UwbConfig, values: gtsam.Values) -> tuple[gtsam.Values, npt_bool]:
    """Values near the solution, and the ranges (K,) that agree with it.

    Parameters
    ----------
    graph : the problem with all ranges; values : to start from.
    """
    family = graph.ranges
    assert family is not None
    return _agreeing(
        graph, family, lambda loss, scale: replace(graph, ranges=replace(family, loss=loss, scale=scale)),
        _Rule.of(config), values,
    )  # fmt: skip


def agreeing_camera(
    graph: SmoothingGraph, config: Config, camera: Camera, values: gtsam.Values
) -> tuple[gtsam.Values, Camera, Camera]:
    """Values near the solution, what of the camera agrees with it, and what does not.

    Parameters
    ----------
    graph : the problem with all that the camera says; values : to start from.
    """
    motions, tracks = camera.motions, camera.tracks
    left_out = Camera(None, None)
    if motions is not None and config.relative_pose.loss != "none":
        by_motions = motions.family
        values, fit = _agreeing(
            graph, by_motions, lambda loss, scale: replace(graph, motions=replace(by_motions, loss=loss, scale=scale)),
            _Rule.of(config.relative_pose, by_motions.size), values,
        )  # fmt: skip
        left_out, motions = replace(left_out, motions=motions.only(~fit)), motions.only(fit)
        graph = replace(graph, motions=motions.family)
    if tracks is not None and config.stereo.loss != "none":
        by_tracks = tracks.family
        values, fit = _agreeing(
            graph, by_tracks, lambda loss, scale: replace(graph, tracks=replace(by_tracks, loss=loss, scale=scale)),
            _Rule.of(config.stereo, by_tracks.size), values,
        )  # fmt: skip
        fit &= by_tracks.near(values)
        left_out, tracks = replace(left_out, tracks=tracks.without(fit)), tracks.only(fit)
        tracks.prune(values)
    return values, Camera(motions, tracks), left_out


def rare_length(sigmas: float, size: int) -> float:
    """The length that `size` unit errors exceed as seldom as one of them exceeds `sigmas`."""
    from scipy.stats import chi2

    return float(np.sqrt(chi2.isf(chi2.sf(sigmas**2, 1), size)))


@dataclass(frozen=True)
class _Rule:
    """Which loss, where it departs from least squares, and from where on a measurement is left out, in sigmas."""

    loss: Loss
    loss_sigmas: float
    reject_sigmas: float

    @classmethod
    def of(cls, config: UwbConfig | RelativePoseConfig | StereoConfig, size: int = 1) -> _Rule:
        """The configured one, for the length of `size` errors: as rare as one error of so many sigmas."""
        return cls(config.loss, rare_length(config.loss_sigmas, size), rare_length(config.reject_sigmas, size))


def _agreeing(
    graph: SmoothingGraph,
    family: RangeFamily | MotionFamily | TrackFamily,
    with_loss: Callable[[Loss, float], SmoothingGraph],
    rule: _Rule,
    values: gtsam.Values,
) -> tuple[gtsam.Values, npt_bool]:
    """The same for one family of the graph, given how the graph is with a loss on it."""
    values = _roughly(graph, values, _ON_THE_WAY, _LEAST_GAIN)
    off = family.off(values)
    scale = max(_START * float(off.max(initial=0.0)), rule.loss_sigmas)
    while off.max(initial=0.0) > rule.reject_sigmas and scale >= rule.loss_sigmas:
        last = scale == rule.loss_sigmas
        values = _roughly(with_loss(rule.loss, scale), values, _ROUGH_SIGMAS if last else _ON_THE_WAY)
        off = family.off(values)
        if last:
            break
        scale = max(scale / _NARROWER, rule.loss_sigmas)
    return values, np.asarray(off <= rule.reject_sigmas)


def _roughly(graph: SmoothingGraph, values: gtsam.Values, sigmas: float, least_gain: float = 0.0) -> gtsam.Values:
    return batch.solve(
        graph,
        values,
        max_iterations=_ITERATIONS,
        least_gain=least_gain,
        tolerance_sigma=sigmas,
        first=graph.chain,
        exact=False,
    ).values
