"""The RTS smoother on the filter's forward pass: over the whole log, or online at each end of the face.

Zheng et al. (2021), equations 28-31 and figure 4. The backward recursion is `kalman.backward`.
"""

from __future__ import annotations

import numpy as np

from graphnav.baselines import kalman
from graphnav.baselines.ekf import Filter, Progress
from graphnav.baselines.innovations import Innovations
from graphnav.baselines.inputs import Inputs, Preset
from graphnav.baselines.measurements import FirstPass
from graphnav.baselines.states import SIZE, unpacked
from graphnav.baselines.tape import Estimates


def filtered(inputs: Inputs, preset: Preset, progress: Progress | None = None) -> tuple[Estimates, Innovations]:
    """The forward pass alone: every keyframe from the past."""
    forward = Filter.start(inputs, preset, smoothing=False)
    for _ in forward.run(progress):
        pass
    return forward.estimates, forward.innovations()


def smoothed(inputs: Inputs, preset: Preset, progress: Progress | None = None) -> tuple[Estimates, Innovations]:
    """Online smoothing at the ends of the face on the way, and one backward pass over the whole log at the end.

    Without the former the closed-path points of a cycle would be the filter's, metres off before the first fix.
    """
    forward, out = _online(inputs, preset, progress)
    smooth_span(forward, 0, len(inputs.keyframe_s) - 1, out)
    return out, forward.innovations()


def smoothed_online(inputs: Inputs, preset: Preset, progress: Progress | None = None) -> tuple[Estimates, Innovations]:
    """Smoothed at each end of the face over the cycle just cut, optimal points updated at once (figure 4).

    A cycle's states know what was measured until its cut ended; those after the last cut are the filter's.
    """
    forward, out = _online(inputs, preset, progress)
    return out, forward.innovations()


def _online(inputs: Inputs, preset: Preset, progress: Progress | None) -> tuple[Filter, Estimates]:
    forward = Filter.start(inputs, preset, smoothing=True)
    last = len(inputs.keyframe_s) - 1
    out = Estimates.empty(last + 1)
    ends = {inputs.index(c.end_s) for c in inputs.cycles if c.end_s is not None}
    start = 0
    for i in forward.run(progress):
        if i in ends:
            smooth_span(forward, start, i, out)
            for first in forward.passes.keys() & range(start, i + 1):
                forward.passes[first] = FirstPass(out.nominal(first), unpacked(out.covariance[first]))
            start = i + 1
    for name, value in vars(forward.estimates).items():
        getattr(out, name)[start:] = value[start:]
    return forward, out


def smooth_span(forward: Filter, first: int, last: int, out: Estimates) -> None:
    """Backward from the filter's state at keyframe `last` to `first`, into `out`; both included (equations 29-30)."""
    assert forward.maps is not None
    adjoint, big = np.zeros(SIZE), np.zeros((SIZE, SIZE))
    filtered_, maps = forward.estimates, forward.maps
    out.put(last, filtered_.nominal(last), unpacked(filtered_.covariance[last]))
    for k in range(last - 1, first - 1, -1):
        covariance = unpacked(filtered_.covariance[k])
        adjoint, big, x, smoothed_ = kalman.backward(
            np.ascontiguousarray(maps.a[k]), np.ascontiguousarray(maps.c[k]), unpacked(maps.big_c[k]), covariance,
            adjoint, big,
        )  # fmt: skip
        out.put(k, filtered_.nominal(k).corrected(x), smoothed_)
        if k % 2000 == 0:
            filtered_.release()
            maps.release()
            out.release()
