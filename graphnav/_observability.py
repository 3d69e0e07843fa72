"""What covariances over time say about observability: every state's sigma against what was known before the log, and
the directions in which the log says least (`graphnav._directions`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from graphnav._directions import CALIBRATION, OBSERVABLE, STATES, Direction, State, scaled_covariance, weak_directions
from graphnav._schema import Array

#: Sigma over what was known before, above this, of a state that is not observable: the data hold less than a ninth of
#: that information.
NOT_OBSERVABLE = 0.95


@dataclass(frozen=True, eq=False)
class Observability:
    """What a log says about K states at T times.

    Attributes
    ----------
    kind : "smoothed" (each time from the whole log) or "causal" (each time from the log up to it).
    states : K names with units; t_s : (T,).
    covariance : (T, K, K), SI; reference : (T, K) sigmas known before, SI.
    information : ascending, one for each direction of the biases, mounting angles and scale at the last time: what the
        data add along it, over what was known before.
    undetermined : the directions among them in which that is below 1.
    """

    kind: str
    states: tuple[State, ...]
    t_s: Array
    covariance: Array
    reference: Array
    information: Array
    undetermined: tuple[Direction, ...]

    @property
    def sigma(self) -> Array:
        """(T, K) sigmas, SI."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2)))

    @property
    def ratio(self) -> Array:
        """(T, K) sigma over reference."""
        return np.asarray(self.sigma / self.reference)

    @property
    def verdicts(self) -> tuple[str, ...]:
        """Per state at the last time: "observable", "improved" or "not observable"."""
        return tuple(verdict(ratio) for ratio in self.ratio[-1])

    @property
    def since_s(self) -> Array:
        """(K,) time from which on a state is observable to the end, NaN where it is not."""
        seen = self.ratio <= OBSERVABLE
        first = len(seen) - np.argmin(np.vstack([seen[::-1], np.zeros((1, seen.shape[1]), bool)]), axis=0)
        return np.where(seen[-1], self.t_s[np.minimum(first, len(seen) - 1)], np.nan)

    @cached_property
    def weakest(self) -> tuple[tuple[Direction, ...], ...]:
        """The weak directions at each time, weakest first."""
        return tuple(
            weak_directions(cov, ref, self.states) for cov, ref in zip(self.covariance, self.reference, strict=True)
        )

    def weakest_spans(self) -> list[tuple[float, float, Direction]]:
        """Spans of time with one and the same weakest direction: start, end, the direction where it is worst."""
        spans: list[tuple[float, float, Direction]] = []
        for t, found in zip(self.t_s.tolist(), self.weakest, strict=True):
            if found and spans and spans[-1][2].states == found[0].states:
                worst = max(spans[-1][2], found[0], key=lambda direction: direction.size)
                spans[-1] = (spans[-1][0], t, worst)
            elif found:
                spans.append((t, t, found[0]))
        return spans

    def to_dict(self) -> dict[str, Any]:
        """Plain values; sigmas in the units of the states."""
        unit = np.array([state.unit_si for state in self.states])
        rows = zip(
            self.states, self.reference[-1] / unit, self.sigma[-1] / unit, self.ratio[-1], self.ratio.max(axis=0),
            self.verdicts, self.since_s, strict=True,
        )  # fmt: skip
        names = ("state", "unit", "reference", "sigma", "ratio", "largest_ratio", "verdict", "observable_since_s")
        return {
            "kind": self.kind,
            "states": [dict(zip(names, (s.name, s.unit, *rest), strict=True)) for s, *rest in rows],
            "weakest": [direction.to_dict() for direction in self.weakest[-1]],
            "weakest_over_time": [
                {"start_s": a, "end_s": b, "text": direction.text} for a, b, direction in self.weakest_spans()
            ],
            "calibration": {
                "directions": len(self.information),
                "determined": int((self.information >= 1).sum()),
                "information": self.information.tolist(),
                "undetermined": [direction.to_dict() for direction in self.undetermined],
            },
            "t_s": self.t_s.tolist(),
            "ratio": self.ratio.tolist(),
        }


def analyse(
    t_s: Array,
    covariance: Array,
    reference_sigma: Array,
    states: tuple[State, ...] = STATES,
    kind: str = "smoothed",
) -> Observability:
    """Say what covariances over time mean for observability; any estimator's will do.

    Parameters
    ----------
    t_s : (T,) ascending.
    covariance : (T, K, K) of the errors of `states`, SI.
    reference_sigma : (K,) or (T, K) sigmas without this log's data: the declared ones, or a scale that makes sense.
    states : the K states: `STATES`, `FACE_STATES`, or their first 15 where there is no odometer.
    kind : "smoothed" or "causal".

    Raises
    ------
    ValueError : shapes that do not fit, no time, or a sigma that is not above zero.
    """
    t_s, covariance = np.asarray(t_s, float), np.asarray(covariance, float)
    shape = (len(t_s), len(states))
    if not len(t_s) or covariance.shape != (*shape, len(states)):
        raise ValueError(f"covariance has shape {covariance.shape}, expected {(*shape, len(states))} with T above 0")
    reference = np.broadcast_to(np.asarray(reference_sigma, float), shape)
    if not (reference > 0).all() or not (np.diagonal(covariance, axis1=1, axis2=2) > 0).all():
        raise ValueError("a sigma is not above zero")
    inner = np.array([state.name in CALIBRATION for state in states])
    last, known = covariance[-1][np.ix_(inner, inner)], reference[-1][inner]
    eigenvalues = np.maximum(np.linalg.eigvalsh(scaled_covariance(last, known)), np.finfo(float).tiny)
    names = tuple(state for state in states if state.name in CALIBRATION)
    return Observability(
        kind, states, t_s, covariance, reference, 1 / eigenvalues[::-1] - 1, weak_directions(last, known, names)
    )


def verdict(ratio: float) -> str:
    """Put sigma over reference in words: "observable", "improved" or "not observable"."""
    if ratio <= OBSERVABLE:
        return "observable"
    return "improved" if ratio <= NOT_OBSERVABLE else "not observable"
