"""Errors a user may meet: one line that says what is wrong, where, and what to do."""

from __future__ import annotations

import re

#: Letter of a variable's key -> what it is, and what determines it.
_VARIABLES = {
    "x": ("the pose of keyframe", "[initial], the odometer and the position table"),
    "v": ("the velocity of keyframe", "[initial], the IMU and the odometer"),
    "b": ("the IMU bias of epoch", "the bias sigmas in [imu]"),
    "c": ("the odometer calibration of epoch", "scale_sigma and mounting_sigma_deg in [odometer]"),
    "l": ("the place of leg", "lidar_points"),
    "d": ("the LiDAR calibration of epoch", "the sigmas in [lidar]"),
    "e": ("the camera's errors of epoch", "the sigmas in [stereo]"),
    "p": ("the place of tracked feature", "stereo_tracks"),
    "k": ("the creep after cycle", "creep_sigma_m in [face]"),
    "t": ("the time offset of ranges", "uwb.time_offset_sigma_s"),
}


class GraphnavError(Exception):
    """Base of every error that graphnav raises on purpose; its text is one line for the user."""


class LogError(GraphnavError):
    """A recorded log that breaks a rule of the log format.

    Parameters
    ----------
    problem : what was found and what was expected.
    where : the file, table or section, as far as it is known.
    row : 0-based data row; shown counted from 1, the header row not counted.
    column : column or key.
    fix : what the user can do.
    """

    def __init__(
        self,
        problem: str,
        *,
        where: str = "",
        row: int | None = None,
        column: str = "",
        fix: str = "",
    ) -> None:
        self.problem, self.where, self.row, self.column, self.fix = problem, where, row, column, fix
        super().__init__(problem)

    def at(self, where: str) -> LogError:
        """The same error, with its place made more precise (a reader knows the file)."""
        return LogError(self.problem, where=where, row=self.row, column=self.column, fix=self.fix)

    def __str__(self) -> str:
        place = [self.where] if self.where else []
        if self.row is not None:
            place.append(f"row {self.row + 1}")
        if self.column:
            place.append(self.column)
        text = ", ".join(place)
        text = f"{text}: {self.problem}" if text else self.problem
        text = f"{text}; {self.fix}" if self.fix else text
        return text.replace("\n", "\\n").replace("\r", "\\r")


class ConfigError(GraphnavError):
    """A configuration with an unknown key or a value out of range."""


class SolveError(GraphnavError):
    """The smoothing could not produce a converged, complete trajectory."""

    @classmethod
    def singular(cls, error: Exception) -> SolveError:
        """GTSAM's report of an indeterminate system in the user's words: which variable, and what determines it."""
        found = re.search(r"\b([xvbcdeklpt])(\d+)\b|\b(\d{16,20})\b", str(error))
        if found is None:
            return cls(f"the problem is singular: {str(error).strip().splitlines()[0]}")
        if found[1] is None:
            return cls.undetermined(int(found[3]))
        return cls.undetermined(ord(found[1]) << 56 | int(found[2]))

    @classmethod
    def not_converged(cls, iterations: int, step_sigmas: float, also: str = "", suspects: str = "") -> SolveError:
        """The error for a solution that still moved when the iterations ended.

        Sound logs converge: too few iterations are the last thing to think of.

        Parameters
        ----------
        also : what else to check; suspects : what of the log stands out.
        """
        first = f" first: {suspects}" if suspects else " first"
        return cls(
            f"not converged after {iterations} iterations (last step {step_sigmas:.3g} sigma); check the log's sigmas"
            f"{also}{first}; if they are right raise batch.max_iterations"
        )

    @classmethod
    def stuck(cls, suspects: str = "") -> SolveError:
        """The error for values from which no step leads to better ones; suspects : what of the log stands out."""
        first = f" first: {suspects}" if suspects else " first"
        return cls(
            f"no step lowers the error: measurements contradict each other; check the log's sigmas and units{first}; if"
            " they are right the path starts too far off: declare [initial] nearer to it"
        )

    @classmethod
    def undetermined(cls, key: int) -> SolveError:
        """The error for a variable that no measurement determines, given its key."""
        letter, number = chr(key >> 56), key & ((1 << 56) - 1)
        what, missing = _VARIABLES.get(letter, ("variable", "its measurements"))
        return cls(f"the problem is singular: nothing determines {what} {number}; check {missing}")
