"""The weakest directions of a covariance, in words.

The states are those of J. Zheng et al., Micromachines 12 (2021) 1527, equation 12, each the true value less the
estimate; the attitude error phi is in n: ``R_nb = Exp(phi) R_nb,estimate``.

With D the sigmas known before and ``S = D^-1 P D^-1 = U diag(l) U'``, the information that the data add along a
direction of U, in units of what was known before, is ``1 / l - 1``: nothing at l = 1, as much again at l = 1/2. The
directions with l > 1/2 are the weak ones. Where several have nearly the same l their basis is arbitrary, so it is
rotated to the one in which each direction consists of the fewest states (varimax).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from graphnav._schema import Array

#: Sigma over what was known before, at most, of an observable state: the data hold eight times that information.
OBSERVABLE = 1 / 3
#: Eigenvalue of the scaled covariance above which a direction is weak: the data hold less than was known before.
_WEAK = 0.5
#: A state is named in a direction that holds this much of its sigma (a third of its variance and more) ...
_NAMED = 0.6
#: ... or that consists of it by this much of its squared size.
_MAKES_UP = 0.5
#: One that is known well is named where this much of what is left of its sigma is the direction: known with the others
#: of it alone, as a sum.
_ONLY_WITH = 0.85


class State(NamedTuple):
    """One error state: its name, the group it is drawn with, and the unit it is reported in."""

    name: str
    group: str
    unit: str
    unit_si: float


_MG, _DEG = 9.80665e-3, np.pi / 180
_BODY = (
    *(State(f"gyro bias {axis}", "gyro bias", "deg/h", _DEG / 3600) for axis in ("right", "forward", "up")),
    *(State(f"accelerometer bias {axis}", "accelerometer bias", "mg", _MG) for axis in ("right", "forward", "up")),
    *(State(f"mounting angle about {axis}", "mounting and scale", "deg", _DEG) for axis in ("right", "forward", "up")),
    State("odometer scale", "mounting and scale", "%", 0.01),
)


def _moving(velocity: tuple[str, ...], tilt: tuple[str, str], position: tuple[str, ...]) -> tuple[State, ...]:
    attitude = (*(f"tilt about {axis}" for axis in tilt), "heading")
    return (
        *(State(f"velocity {axis}", "velocity", "m/s", 1.0) for axis in velocity),
        *(State(name, "attitude", "deg", _DEG) for name in attitude),
        *(State(f"position {axis}", "position", "m", 1.0) for axis in position),
    )


_ENU = ("east", "north", "up")
_FACE = ("across the face", "along the face", "up")
#: The 19 states with what moves in n (east, north, up).
STATES = (*_moving(_ENU, ("east", "north"), _ENU), *_BODY)
#: The same with what moves turned to the face: right of the first cut's direction, along it, up.
FACE_STATES = (*_moving(_FACE, ("right", "forward"), _FACE), *_BODY)
#: The LiDAR's calibration, which follows the others where legs take part: `factors.landmark`'s eight numbers.
LIDAR_STATES = (
    State("LiDAR range scale", "LiDAR range", "%", 0.01),
    State("LiDAR range bias", "LiDAR range", "m", 1.0),
    State("LiDAR angle bias", "LiDAR angle", "deg", _DEG),
    State("LiDAR angle scale", "LiDAR angle", "%", 0.01),
    State("LiDAR angle quadratic", "LiDAR angle", "1/deg", 1 / _DEG),
    *(State(f"LiDAR mounting about {axis}", "LiDAR mounting", "deg", _DEG) for axis in ("right", "forward", "up")),
)
#: The time offset of UWB ranges, last of all where it is estimated.
CLOCK_STATE = State("UWB time offset", "UWB clock", "s", 1.0)
#: Names of the states that do not move: biases, mounting angles and scale, the LiDAR's calibration, the UWB's clock.
CALIBRATION = {state.name for state in (*_BODY, *LIDAR_STATES, CLOCK_STATE)}


@dataclass(frozen=True)
class Direction:
    """A combination of states that the data leave undetermined.

    Attributes
    ----------
    size : one sigma along it over the reference; 1 where nothing was learnt.
    states, amounts : the states that it consists of, greatest first, and how much of each one sigma is (SI).
    """

    size: float
    states: tuple[State, ...]
    amounts: tuple[float, ...]

    @property
    def text(self) -> str:
        """In words: what can change together, by one sigma, with hardly a trace in the data."""
        parts = [
            f"{s.name} {_two_digits(a / s.unit_si)} {s.unit}" for s, a in zip(self.states, self.amounts, strict=True)
        ]
        if len(parts) < 3:
            return " with ".join(parts)
        return f"{parts[0]} with {', '.join(parts[1:-1])} and {parts[-1]}"

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        parts = zip(self.states, self.amounts, strict=True)
        amounts = [{"state": s.name, "amount": a / s.unit_si, "unit": s.unit} for s, a in parts]
        return {"text": self.text, "size": self.size, "states": amounts}


def weak_directions(covariance: Array, reference_sigma: Array, states: tuple[State, ...]) -> tuple[Direction, ...]:
    """Directions along which the data say less than the reference, weakest first.

    Their amounts are independent of each other, and together they hold all of the error in the weak subspace.

    Parameters
    ----------
    covariance : (K, K), reference_sigma : (K,), SI.
    """
    scaled = scaled_covariance(covariance, reference_sigma)
    eigenvalues, vectors = np.linalg.eigh(scaled)
    weak = eigenvalues > _WEAK
    if not weak.any():
        return ()
    sigma = np.sqrt(np.diag(scaled))
    factors = vectors[:, weak] * np.sqrt(eigenvalues[weak])
    named = sigma > min(OBSERVABLE, sigma.max() / 2)
    # what is known well anyway has no say in how the rest is told apart
    factors = factors @ _varimax((factors / sigma[:, None])[named])
    found = [_direction(column, sigma, named, reference_sigma, states) for column in factors.T]
    return tuple(sorted(found, key=lambda direction: -direction.size))


def _direction(
    column: Array, sigma: Array, named: npt.NDArray[np.bool_], reference: Array, states: tuple[State, ...]
) -> Direction:
    share = np.abs(column) / sigma
    share = np.where(named | (share > _ONLY_WITH), share, 0.0) if share[named].any() else share
    size = float(np.linalg.norm(column))
    chosen = np.flatnonzero((share >= min(_NAMED, share.max())) | (column**2 > _MAKES_UP * size**2))
    chosen = chosen[np.argsort(-np.abs(column[chosen]), kind="stable")]
    sign = 1.0 if column[chosen[0]] > 0 else -1.0
    amounts = sign * column[chosen] * reference[chosen]
    return Direction(size, tuple(states[k] for k in chosen), tuple(amounts.tolist()))


def _two_digits(value: float) -> str:
    digits = 1 - int(np.floor(np.log10(abs(value)))) if value else 0
    return f"{round(value, digits):+.{max(digits, 0)}f}"


def scaled_covariance(covariance: Array, sigma: Array) -> Array:
    """The covariance in units of `sigma`, made symmetric."""
    return np.asarray((covariance + covariance.T) / 2 / np.outer(sigma, sigma))


def _varimax(loadings: Array, rounds: int = 100) -> Array:
    """The rotation (m, m) after which each column of `loadings` (K, m) has few large entries.

    H. F. Kaiser, Psychometrika 23 (1958) 187: the variance of the squared entries is maximised.
    """
    rotation, reached = np.eye(loadings.shape[1]), 0.0
    for _ in range(rounds):
        turned = loadings @ rotation
        gradient = loadings.T @ (turned**3 - turned * (turned**2).mean(axis=0))
        left, values, right = np.linalg.svd(gradient)
        rotation = left @ right
        if values.sum() <= reached * (1 + 1e-9):
            break
        reached = values.sum()
    return np.asarray(rotation)
