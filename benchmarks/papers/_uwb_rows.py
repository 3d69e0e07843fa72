"""Figures of the IMU/UWB reproduction over the seeds, and the rows that are printed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks._report import Row, Target, row
from benchmarks.papers import _uwb_published as published
from benchmarks.papers._judged import Array
from benchmarks.papers._uwb_cases import CASES, GRAPH, SITES, Course, Found

X, Z = 0, 2
AXES = {"x": X, "z": Z}
#: 95 % band of the mean of NEES over seeds, each seed taken for one draw of three axes.
_ALPHA = 0.05


@dataclass(frozen=True, eq=False)
class Results:
    """All logs that were run."""

    found: tuple[Found, ...]

    def at(self, site: str) -> list[Found]:
        """The logs of a site."""
        return [one for one in self.found if one.site == site]

    def courses(self, site: str, case: str) -> list[Course]:
        """Those of a case that succeeded."""
        every = [one.courses.get(case) for one in self.at(site)]
        return [one for one in every if isinstance(one, Course)]

    def failure(self, site: str, case: str) -> str | None:
        """Why a case has no course, where none of its runs succeeded."""
        if self.courses(site, case):
            return None
        every = [one.courses.get(case) for one in self.at(site)]
        texts = [one for one in every if isinstance(one, str)]
        return texts[0] if texts else "not measured"

    def median(self, site: str, case: str, of: Callable[[Course], Array | float]) -> Array | None:
        """Median over the seeds of a figure of a course."""
        courses = self.courses(site, case)
        return np.median([of(one) for one in courses], axis=0) if courses else None

    def nees(self, site: str, case: str, which: int) -> float | None:
        """Mean over the seeds of position's (0) or attitude's (1) NEES."""
        known = [one.nees[which] for one in self.courses(site, case)]
        values = [value for value in known if value is not None]
        return float(np.mean(values)) if values else None


def mean_error(one: Course) -> Array:
    """Mean absolute error (3,), m: the paper's figure, equation 27."""
    return np.asarray(np.abs(one.error_m).mean(axis=0))


def spread(one: Course) -> Array:
    """Standard deviation of the absolute error (3,), m."""
    return np.asarray(np.abs(one.error_m).std(axis=0))


def largest(one: Course) -> Array:
    """Largest absolute error (3,), m."""
    return np.asarray(np.abs(one.error_m).max(axis=0))


def nine_tenths(one: Course) -> Array:
    """Absolute error that nine tenths of the epochs do not exceed (3,), m."""
    return np.asarray(np.quantile(np.abs(one.error_m), 0.9, axis=0))


def largest_angle(one: Course) -> float:
    """Largest attitude error about any axis, deg."""
    return float(np.abs(one.angle_error_deg).max())


def all_rows(results: Results) -> list[Row]:
    """Mean errors beside the paper's, the graph's against UWB alone, consistency, seconds."""
    rows = []
    for site in SITES:
        for case in CASES:
            rows += _case_rows(results, site, case)
        rows += _graph_rows(results, site)
    return rows


def _case_rows(results: Results, site: str, case: str) -> list[Row]:
    failed = results.failure(site, case)
    if failed is not None:
        return [row(f"{site}, {case}: failed: {failed}", None, "m")]
    mean, theirs = results.median(site, case, mean_error), published.mean(site, case)
    assert mean is not None
    rows = [
        row(f"{site}, {case}: mean error {name}", float(mean[axis]), "m", peer=theirs[k] if theirs else None)
        for k, (name, axis) in enumerate(AXES.items())
    ]
    angle, seconds = (results.median(site, case, of) for of in (largest_angle, lambda one: one.seconds))
    peer = published.ATTITUDE_DEG if case.startswith("imu") else None
    rows.append(row(f"{site}, {case}: largest attitude error", _number(angle), "deg", peer=peer))
    rows.append(row(f"{site}, {case}: position NEES", results.nees(site, case, 0), "1"))
    rows.append(row(f"{site}, {case}: attitude NEES", results.nees(site, case, 1), "1"))
    return [*rows, row(f"{site}, {case}: seconds", _number(seconds), "s")]


def _number(value: Array | float | None) -> float | None:
    return None if value is None else float(value)


def _graph_rows(results: Results, site: str) -> list[Row]:
    """What the scenario asks of the graph."""
    mean, alone = (results.median(site, case, mean_error) for case in (GRAPH, "uwb"))
    count, rows = len(results.courses(site, GRAPH)), []
    for name, axis in AXES.items():
        ours, peer = (None if value is None else float(value[axis]) for value in (mean, alone))
        target = Target(high=0.30, of_ratio=True)
        rows.append(row(f"{site}, graph by UWB alone: mean error {name}", ours, "m", peer=peer, target=target))
    rms, bound = _rms_and_bound(results, site)
    rows.append(row(f"{site}, graph: rms 3-D by the bound", rms, "m", peer=bound, target=Target(None, 1.15, True)))
    low, high = _band(max(count, 1))
    nees = results.nees(site, GRAPH, 1)
    return [*rows, row(f"{site}, graph: attitude NEES", nees, "1", target=Target(low, high))]


def _rms_and_bound(results: Results, site: str) -> tuple[float | None, float | None]:
    both = [(one.courses[GRAPH], one.bound_m) for one in results.at(site) if one.bound_m is not None]
    if not both:
        return None, None
    square = [np.mean(np.sum(c.error_m**2, axis=1)) for c, _ in both if isinstance(c, Course)]
    return float(np.sqrt(np.mean(square))), float(np.sqrt(np.mean([np.sum(b**2) for _, b in both])))


def _band(count: int) -> tuple[float, float]:
    from scipy.stats import chi2

    return tuple(float(chi2.ppf(p, 3 * count) / (3 * count)) for p in (_ALPHA / 2, 1 - _ALPHA / 2))
