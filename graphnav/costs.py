"""What each kind of measurement costs at given values: where a solution fails, the kind to look at first."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Protocol

from factors.increments import npt_int
from graphnav.camera import Camera
from graphnav.errors import SolveError
from graphnav.graph import SmoothingGraph
from graphnav.solvers.batch import StuckError

if TYPE_CHECKING:
    import gtsam

#: Chi-square per residual, and share of measurements left out, that stand out.
_DEAR, _MANY = 3.0, 0.2
#: Letters of a native factor's keys -> what it is; the first row whose letters it has names it.
_NATIVE = (
    ("xvb", "IMU samples"),
    ("k", "closed path"),
    ("xc", "closed path"),
    ("xt", "UWB ranges"),
    ("xvc", "odometer"),
    ("b", "declared IMU biases"),
    ("c", "declared odometer calibration"),
    ("l", "declared places of legs"),
    ("d", "declared [lidar] errors"),
    ("e", "declared camera mounting"),
    ("a", "declared UWB anchors"),
    ("m", "declared UWB errors"),
)
_POSES = {1: "initial pose and positions", 2: "motions between keyframes"}


class Part(Protocol):
    """Some measurements, by their rows."""

    @property
    def row(self) -> npt_int:
        """(K,) of the table."""


class _Family(Protocol):
    def linearize_into(self, linear: gtsam.GaussianFactorGraph, values: gtsam.Values) -> None: ...


def suspects(graph: SmoothingGraph, values: gtsam.Values, left_out: dict[str, tuple[int, int]] | None = None) -> str:
    """What of a log to look at first where its measurements do not come together; empty where nothing stands out.

    The kind with the largest chi-square per residual: of errors as they are declared each residual costs about 1,
    whatever its kind. Where measurements contradict each other, the cost is on one of them: often the wrong one,
    sometimes what holds against it. And kinds of which a good part was left out, which costs nothing any more.

    Parameters
    ----------
    left_out : kind -> how many of it were left out, and of how many.
    """
    found = [
        f"{wrong:,} of {total:,} {kind} disagree with the rest"
        for kind, (wrong, total) in (left_out or {}).items()
        if wrong > _MANY * total
    ]
    cost = {kind: chi2 / rows for kind, (chi2, rows) in costs(graph, values).items() if rows}
    kind = max(cost, key=lambda each: cost[each])
    if cost[kind] > _DEAR:
        found.append(f"{kind} cost {cost[kind]:,.0f} per residual where 1 is expected")
    return ", ".join(found)


@contextmanager
def suspecting(graph: SmoothingGraph) -> Iterator[None]:
    """An error of a solver that gets stuck says what stands out there."""
    try:
        yield
    except StuckError as error:
        raise SolveError.stuck(suspects(graph, error.values)) from None


Parts = tuple[Part | None, Part | None]


def parted(ranges: Parts, camera: tuple[Camera | None, Camera | None]) -> dict[str, tuple[int, int]]:
    """Kind -> rows left out and all rows, from what took part and what was left out of it, None where there is none."""
    used, wrong = (each or Camera(None, None) for each in camera)
    named: dict[str, Parts] = {
        "UWB ranges": ranges,
        "camera motions": (used.motions, wrong.motions),
        "camera readings": (used.tracks, wrong.tracks),
    }
    return {
        kind: (len(out.row), len(out.row) + len(inside.row))
        for kind, (inside, out) in named.items()
        if inside is not None and out is not None
    }


def costs(graph: SmoothingGraph, values: gtsam.Values) -> dict[str, tuple[float, int]]:
    """Kind of measurement -> its chi-square and its number of residuals."""
    import gtsam

    found: dict[str, list[float]] = defaultdict(lambda: [0.0, 0])
    zero = values.zeroVectors()
    for kind, family in _families(graph):
        linear = gtsam.GaussianFactorGraph()
        family.linearize_into(linear, values)
        found[kind][0] += 2 * linear.error(zero)
        found[kind][1] += sum(_rows(linear.at(k)) for k in range(linear.size()))
    for k in range(graph.native.size()):
        factor = graph.native.at(k)
        kind = _kind(factor.keys())
        found[kind][0] += 2 * factor.error(values)
        found[kind][1] += factor.dim()
    return {kind: (chi2, int(rows)) for kind, (chi2, rows) in found.items()}


def _families(graph: SmoothingGraph) -> Iterator[tuple[str, _Family]]:
    named: tuple[tuple[str, _Family | None], ...] = (
        ("odometer", graph.displacements),
        ("LiDAR readings of legs", graph.legs),
        ("advances of legs", graph.advances),
        ("UWB ranges", graph.ranges),
        ("camera motions", graph.motions),
        ("camera readings", graph.tracks),
    )
    return ((kind, family) for kind, family in named if family is not None)


def _rows(factor: gtsam.GaussianFactor) -> int:
    """Residuals of a whitened Jacobian factor."""
    return int(factor.jacobian()[1].size)


def _kind(keys: list[int]) -> str:
    letters = {chr(key >> 56) for key in keys}
    for needed, kind in _NATIVE:
        if letters >= set(needed):
            return kind
    return "velocities at rest" if letters == {"v"} else _POSES.get(len(keys), "others")
