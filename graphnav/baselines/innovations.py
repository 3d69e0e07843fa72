"""Innovations of a Kalman filter, kept for the judgement of its consistency."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from graphnav._consistency import band
from graphnav._schema import Array


@dataclass(frozen=True, eq=False)
class Innovations:
    """Every scalar measurement's innovation and its variance, in units of its own noise.

    A vector measurement is whitened and taken row by row, each row's innovation given those before it, so that the
    normalized innovations of a consistent filter are independent and of unit variance.

    Attributes
    ----------
    t_s : (M,) times, ascending.
    kind : (M,) index into `kinds`.
    kinds : names: "speed", "constraint" (no sideways or upward velocity), "zero velocity", "zero rate",
        "closed path", "position".
    innovation, variance : (M,) measured less predicted and its predicted variance.
    """

    t_s: Array
    kind: npt.NDArray[np.int64]
    kinds: tuple[str, ...]
    innovation: Array
    variance: Array

    @property
    def normalized(self) -> Array:
        """(M,) innovations by their predicted sigma."""
        return np.asarray(self.innovation / np.sqrt(self.variance))

    def nis(self, kind: str | None = None) -> Nis | None:
        """Normalized innovation squared of one kind of measurement, or of all; None where there is none."""
        chosen = self.normalized if kind is None else self.normalized[self.kind == self.kinds.index(kind)]
        return Nis.of(chosen) if len(chosen) else None

    def to_dict(self) -> dict[str, Any]:
        """NIS of all measurements and of each kind; plain numbers."""
        rows = {"all": self.nis(), **{kind: self.nis(kind) for kind in self.kinds}}
        return {name: nis.to_dict() for name, nis in rows.items() if nis is not None}


@dataclass(frozen=True)
class Nis:
    """Mean normalized innovation squared with its 95 % band.

    Attributes
    ----------
    rows : scalar measurements; mean : 1 is consistent, above 1 too sure of itself.
    low, high : band that holds the mean of a consistent filter in 95 of 100 logs: chi-square of `rows` over `rows`.
    lag_one : correlation of successive normalized innovations; 0 when they are white.
    """

    rows: int
    mean: float
    low: float
    high: float
    lag_one: float

    @property
    def inside(self) -> bool:
        """Whether the mean lies in the band."""
        return self.low <= self.mean <= self.high

    @classmethod
    def of(cls, normalized: Array) -> Nis:
        """From normalized innovations (M,), M > 0."""
        rows = len(normalized)
        low, high = band(rows)
        square = float(np.mean(normalized**2))
        lag = float(np.mean(normalized[1:] * normalized[:-1]) / square) if rows > 1 and square > 0 else 0.0
        return cls(rows, square, low, high, lag)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers; `inside` says whether the mean lies in the band."""
        return {**vars(self), "inside": self.inside}
