"""All seeds together: what the rows, the tables and the text are made of."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from benchmarks.papers._judged import Array, Calibrated, Found, Judged


@dataclass(frozen=True, eq=False)
class Results:
    """What succeeded, and one line for each run that failed."""

    found: tuple[Found, ...]
    failed: tuple[str, ...]

    @classmethod
    def of(cls, outcomes: Iterable[Found | str]) -> Results:
        """Sort outcomes."""
        known = list(outcomes)
        return cls(
            tuple(one for one in known if isinstance(one, Found)), tuple(one for one in known if isinstance(one, str))
        )

    def of_log(self, log: str) -> list[Found]:
        """All seeds of one case."""
        return [one for one in self.found if one.log == log]

    def seeds(self, log: str) -> int:
        """How many seeds a case has."""
        return len(self.of_log(log))

    def drawn(self, log: str = "interval 2") -> Found | None:
        """The one whose course was kept."""
        return next((one for one in self.of_log(log) if any(j.t_s is not None for j in one.judged.values())), None)

    def _judged(self, log: str, name: str) -> list[Judged]:
        return [one.judged[name] for one in self.of_log(log) if name in one.judged]

    def has(self, log: str, name: str) -> bool:
        """Whether there is anything of an estimator."""
        return bool(self._judged(log, name))

    def rms_m(self, log: str, name: str) -> tuple[float, ...]:
        """Root mean square error in east, north, up over all seeds."""
        return tuple(np.sqrt(np.mean([np.square(j.rms_m) for j in self._judged(log, name)], axis=0)).tolist())

    def rms_3d_m(self, log: str, name: str) -> float:
        """The same of the 3-D error."""
        return float(np.sqrt(np.mean([j.rms_3d_m**2 for j in self._judged(log, name)])))

    def median_rms_m(self, log: str, name: str) -> float:
        """The median seed's rms 3-D error: one run gone astray does not carry it."""
        return float(np.median([j.rms_3d_m for j in self._judged(log, name)]))

    def sep_m(self, log: str, name: str) -> tuple[float, ...]:
        """Median over the seeds of each cycle's SEP."""
        return tuple(np.median([j.sep_m for j in self._judged(log, name)], axis=0).tolist())

    def nees(self, log: str, name: str) -> float | None:
        """Mean position NEES over the seeds."""
        known = [j.nees_position for j in self._judged(log, name) if j.nees_position is not None]
        return float(np.mean(known)) if known else None

    def calibration(self, log: str, name: str, of: Callable[[Calibrated], Array]) -> Array:
        """Root mean square over the seeds of an error (K,) of the calibration."""
        errors = [of(one.calibrated[name]) for one in self.of_log(log) if name in one.calibrated]
        return np.asarray(np.sqrt(np.mean(np.square(errors), axis=0)))

    def names(self) -> list[tuple[str, str]]:
        """Names and units of the calibration."""
        first = next((one for one in self.found if one.names), None)
        return [] if first is None else list(zip(first.names, first.units, strict=True))

    def last_scale_error(self, log: str, name: str) -> float:
        """Root mean square over the seeds of the error of the last scale estimate."""
        scale = [parameter for parameter, _ in self.names()].index("odometer_scale")
        return float(self.calibration(log, name, lambda c: c.final)[scale])

    def inertial_m(self, name: str) -> float:
        """Median over the seeds of the pure inertial solution's error at its end."""
        ends = [float(np.linalg.norm(one.inertial[name][-1])) for one in self.found if name in one.inertial]
        return float(np.median(ends))

    def told(self) -> list[str]:
        """Whose biases the pure inertial solution was told."""
        first = next((one for one in self.found if one.inertial), None)
        return [] if first is None else list(first.inertial)
