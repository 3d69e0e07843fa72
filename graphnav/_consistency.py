"""Chi-square bands of mean normalized errors squared (NEES, NIS).

The mean of ``d`` independent squares of unit variance is a chi-square of d degrees of freedom over d. What is one draw
matters more than the formula: errors at the keyframes of one run share the initial state, the biases and the survey,
so a run of a thousand keyframes is far from a thousand draws. One run is taken for one draw of each group of axes, and
several runs for what their scatter says.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

Band = tuple[float, float]
LEVEL = 0.95


def band(freedom: float, level: float = LEVEL) -> Band:
    """Bounds that hold a chi-square over its degrees of freedom with probability `level`, as much out on each side."""
    from scipy.special import gammaincinv

    # quantiles of chi-square; scipy.stats has them too, and takes 50 MB to load
    low, high = 2 * gammaincinv(freedom / 2, ((1 - level) / 2, (1 + level) / 2)) / freedom
    return float(low), float(high)


def one_run_band(axes: int) -> Band:
    """The 95 % band of the mean NEES of one run over `axes` axes, the run taken for one draw.

    It is the band of a run whose keyframes are all of a piece. Keyframes that vary on their own average, so a
    consistent estimator falls outside less often than 5 times in 100, and the band is wide: a run inside it proves
    little, a run outside it a lot.
    """
    return band(axes)


def false_alarm(freedom: float, low: float | None, high: float | None) -> float:
    """Chance that a chi-square over its degrees of freedom falls outside the bounds; None is no bound."""
    from scipy.stats import chi2

    below = chi2.cdf(low * freedom, freedom) if low is not None else 0.0
    above = chi2.sf(high * freedom, freedom) if high is not None else 0.0
    return float(below + above)


@dataclass(frozen=True)
class OverRuns:
    """Mean NEES over independent runs (seeds) with what is known of its scatter.

    Attributes
    ----------
    runs : how many; mean : of their mean NEES, 1 is consistent.
    standard_error : of the mean, from the runs' scatter; None with fewer than three runs.
    freedom : degrees of freedom of one run, ``2 mean^2 / variance`` of the runs: a run's mean NEES is taken for a
        chi-square of d degrees of freedom over d. None with fewer than three runs.
    low, high : 95 % band of the mean for a consistent estimator, whose runs scatter with as many degrees of freedom;
        None where these are unknown.
    """

    runs: int
    mean: float
    standard_error: float | None = None
    freedom: float | None = None
    low: float | None = None
    high: float | None = None

    @classmethod
    def of(cls, values: Sequence[float]) -> OverRuns | None:
        """From the mean NEES of each run; None without runs."""
        if not values:
            return None
        mean, runs = statistics.fmean(values), len(values)
        scatter = statistics.stdev(values) if runs > 2 else 0.0
        if scatter == 0:
            return cls(runs, mean)
        freedom = 2 * mean**2 / scatter**2
        return cls(runs, mean, scatter / math.sqrt(runs), freedom, *band(runs * freedom))

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers."""
        return dict(vars(self))
