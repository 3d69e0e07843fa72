"""Figures of the roadheader's reproduction: medians over seeds of what each run gave, beside the paper's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from benchmarks._report import Row, Target, row
from benchmarks.papers import _vio_published as published
from benchmarks.papers._judged import Array
from benchmarks.papers._vio_cases import CASES, ENHANCED, GRAPH, RAW, Bounded, Course, Found
from benchmarks.papers._vio_features import ENHANCERS
from benchmarks.papers._vio_published import AXES, UNITS


@dataclass(frozen=True, eq=False)
class Results:
    """All logs that were run, and the milliseconds that each enhancement takes for a frame."""

    found: tuple[Found, ...]
    enhancement_ms: dict[str, float] = field(default_factory=dict)

    def courses(self, case: str) -> list[Course]:
        """Those of a case that succeeded."""
        every = [one.courses.get(case) for one in self.found]
        return [one for one in every if isinstance(one, Course)]

    def failure(self, case: str) -> str | None:
        """Why a case has no course, where none of its runs succeeded."""
        if self.courses(case):
            return None
        every = [one.courses.get(case) for one in self.found]
        texts = [one for one in every if isinstance(one, str)]
        return texts[0] if texts else "not measured"

    def median(self, case: str, of: Callable[[Course], Array | float]) -> Array | None:
        """Median over the seeds of a figure of a course."""
        courses = self.courses(case)
        return np.asarray(np.median([of(one) for one in courses], axis=0)) if courses else None

    def nees(self, case: str, which: int) -> float | None:
        """Mean over the seeds of position's (0) or attitude's (1) NEES."""
        values = [one.nees[which] for one in self.courses(case)]
        known = [value for value in values if value is not None]
        return float(np.mean(known)) if known else None

    def bound(self) -> Array | None:
        """Median over the seeds of the largest sigma (6,) of the bound."""
        bounds = [largest_sigma(one.bound) for one in self.found if one.bound is not None]
        return np.asarray(np.median(bounds, axis=0)) if bounds else None

    def matched(self, enhancer: str, true: bool = False) -> Array:
        """Matches (K,) of all pairs of frames of all seeds."""
        found = [(one.confirmed if true else one.matched).get(enhancer, np.zeros(0)) for one in self.found]
        return np.concatenate([np.zeros(0), *found])

    def front(self, enhancer: str, of: str) -> float | None:
        """Median over the seeds of a figure of the front end."""
        known = [getattr(one.front[enhancer], of) for one in self.found if enhancer in one.front]
        return float(np.median(known)) if known else None


def largest(one: Course) -> Array:
    """Largest error (6,)."""
    return np.asarray(np.abs(one.error).max(axis=0))


def mean(one: Course) -> Array:
    """Size of the mean error (6,): its sign is another one with every seed."""
    return np.asarray(np.abs(one.error.mean(axis=0)))


def deviation(one: Course) -> Array:
    """Standard deviation of the error (6,)."""
    return np.asarray(one.error.std(axis=0))


def rms_3d(one: Course) -> float:
    """Rms of the position error's norm, m."""
    return float(np.sqrt(np.mean(np.sum(one.error[:, :3] ** 2, axis=1))))


def largest_sigma(one: Bounded) -> Array:
    """Largest sigma (6,) while the machine drives."""
    return np.asarray(one.sigma.max(axis=0))


STATISTICS: dict[str, tuple[Callable[[Course], Array], dict[str, published.Six]]] = {
    "largest error": (largest, published.LARGEST),
    "mean error": (mean, published.MEAN),
    "standard deviation": (deviation, published.DEVIATION),
}


def theirs(case: str) -> str:
    """Which of the paper's methods stands beside a case: its SINS beside ours, its own filter beside all else."""
    return "sins" if case == "sins" else "vio-kf"


def asked(results: Results) -> Array:
    """What is asked of the graph's largest errors (6,): half of the paper's, or a multiple of the bound."""
    bound = results.bound()
    return np.array(published.ASKED) if bound is None else np.maximum(published.ASKED, published.BOUNDS * bound)


def all_rows(results: Results) -> list[Row]:
    """The graph against what is asked of it, all cases beside table 6, consistency, features, speed."""
    rows = _asked_rows(results)
    for case in CASES:
        rows += _case_rows(results, case)
    return [*rows, *_gain_rows(results), *_feature_rows(results), *_speed_rows(results)]


def _asked_rows(results: Results) -> list[Row]:
    """The graph's largest errors, and the largest sigmas of the bound."""
    ours, limits, bound, rows = results.median(GRAPH, largest), asked(results), results.bound(), []
    for k, (axis, unit) in enumerate(zip(AXES, UNITS, strict=True)):
        peer, target = published.LARGEST["vio-kf"][k], Target(high=float(limits[k]))
        value = None if ours is None else float(ours[k])
        rows.append(row(f"graph: largest error {axis}", value, unit, peer=peer, target=target))
    for k, (axis, unit) in enumerate(zip(AXES, UNITS, strict=True)):
        rows.append(row(f"bound: largest sigma {axis}", None if bound is None else float(bound[k]), unit))
    return rows


def _case_rows(results: Results, case: str) -> list[Row]:
    failed = results.failure(case)
    if failed is not None:
        return [row(f"{case}: failed: {failed}", None, "m")]
    rows = []
    for name, (of, paper) in STATISTICS.items():
        ours = results.median(case, of)
        assert ours is not None
        peers = np.abs(paper[theirs(case)])
        rows += [
            row(f"{case}: {name} {axis}", float(ours[k]), UNITS[k], peer=float(peers[k])) for k, axis in enumerate(AXES)
        ]
    rows.append(row(f"{case}: position NEES", results.nees(case, 0), "1"))
    rows.append(row(f"{case}: attitude NEES", results.nees(case, 1), "1"))
    return [
        *rows,
        row(f"{case}: seconds without the front end", _number(results.median(case, lambda one: one.seconds)), "s"),
    ]


def _gain_rows(results: Results) -> list[Row]:
    """What enhancement does to the graph's accuracy: below 1 it gains."""
    raw, *others = (_number(results.median(case, rms_3d)) for case in (GRAPH, RAW, ENHANCED))
    return [
        row(f"{case} by {GRAPH}: rms 3-D", ours, "m", peer=raw)
        for case, ours in zip((RAW, ENHANCED), others, strict=True)
    ]


def _number(value: Array | None) -> float | None:
    return None if value is None else float(value)


def _feature_rows(results: Results) -> list[Row]:
    rows = []
    for true, said in ((False, "matched features kept by RANSAC"), (True, "and true to the motion")):
        raw = _mean(results.matched("none", true))
        for enhancer in ("clahe", "retinex-dust"):
            target = Target(low=1.2, of_ratio=True) if enhancer == "retinex-dust" and not true else None
            value = _mean(results.matched(enhancer, true))
            rows.append(row(f"{said}, {ENHANCERS[enhancer]}", value, "1", peer=raw, target=target))
    return rows


def _mean(values: Array) -> float | None:
    return float(values.mean()) if len(values) else None


def _speed_rows(results: Results) -> list[Row]:
    """The paper's 30 frames a second are the peer."""
    rows = []
    for enhancer, said in ENHANCERS.items():
        speed, target = results.front(enhancer, "pairs_per_s"), Target(low=60.0) if enhancer == "none" else None
        peer = published.FRAMES_PER_SECOND
        rows.append(row(f"front end, {said}: pairs a second, 2 workers", speed, "1/s", peer=peer, target=target))
        rows.append(row(f"front end, {said}: features in a pair", results.front(enhancer, "features"), "1"))
        rows.append(row(f"front end, {said}: frames of a track", results.front(enhancer, "length"), "1"))
    for enhancer in ("clahe", "retinex-dust"):
        target = Target(high=4.0) if enhancer == "retinex-dust" else None
        name = f"enhancement, {ENHANCERS[enhancer]}: milliseconds a frame"
        rows.append(row(name, results.enhancement_ms.get(enhancer), "ms", target=target))
    return rows
