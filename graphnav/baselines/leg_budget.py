"""Error budget of positioning by support legs: what each systematic error of a scanner costs, for planning.

Source: "Research on the shearer positioning method based on INS and LiDAR", section 4.3, equations 25-29. The machine
drives along the face past legs at a fixed
distance to its left and takes each leg's place from when it was first seen, so that every error of a reading is carried
on; the position error is the sum along the way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factors.so3 import Array


@dataclass(frozen=True)
class ScannerErrors:
    """Systematic errors, truth to reading (equation 4): ``rho' = (1 + range_scale) rho + range_bias``.

    Attributes
    ----------
    range_scale : 1; range_bias_m : m.
    angle_square_per_deg, angle_scale, angle_bias_deg : a1, a2 - 1 and a3 of ``theta = a1 t^2 + a2 t + a3``, degrees.
    pitch_rad, heading_rad : error of the attitude about right and up, with that of the mounting about the same axis.
    """

    range_scale: float = 0.0
    range_bias_m: float = 0.0
    angle_square_per_deg: float = 0.0
    angle_scale: float = 0.0
    angle_bias_deg: float = 0.0
    pitch_rad: float = 0.0
    heading_rad: float = 0.0

    def angle_error_rad(self, theta_rad: Array) -> Array:
        """Reading less truth at true angles (...,)."""
        theta, a1 = np.degrees(theta_rad), self.angle_square_per_deg
        a2, a3 = 1 + self.angle_scale, self.angle_bias_deg
        # the root of equation 4 in a form that holds for a1 = 0 too
        read = 2 * (theta - a3) / (a2 + np.sqrt(a2**2 + 4 * a1 * (theta - a3)))
        return np.asarray(np.radians(read) - theta_rad)


@dataclass(frozen=True)
class LegChoice:
    """Which legs are used.

    Attributes
    ----------
    distance_m : of the row of legs from the track, to the machine's left; spacing_m : between neighbours.
    count : legs used at a time (the paper's N); nearest_m : least distance along the face (the paper's d).
    ahead : legs ahead of the machine, or behind it.
    """

    distance_m: float = 4.0
    spacing_m: float = 1.5
    count: int = 1
    nearest_m: float = 0.0
    ahead: bool = True


@dataclass(frozen=True)
class Budget:
    """Position error per metre driven, (3,) each in m (right, forward, up), by source; constant along a straight face.

    Attributes
    ----------
    per_metre : name of the source -> (3,).
    """

    per_metre: dict[str, Array]

    def after(self, mileage_m: float) -> dict[str, Array]:
        """Position error (3,) in m after a distance, by source and in "total"."""
        found = {name: rate * mileage_m for name, rate in self.per_metre.items()}
        return {**found, "total": np.sum(list(found.values()), axis=0)}


def error_budget(errors: ScannerErrors, choice: LegChoice) -> Budget:
    """What each error adds to the position (equations 5, 25-27).

    While a leg is used, its reading's error carries over from where it was first used to where it was last, so each
    passage through one spacing adds the difference of the error at both ends.

    Raises
    ------
    ValueError : a number of legs, a distance or a spacing that is none.
    """
    far, near = (_reading_errors(errors, choice, along) for along in _passages(choice))
    return _named(errors, {name: (far[name] - near[name]).mean(axis=0) / choice.spacing_m for name in far})


def equation_29(errors: ScannerErrors, choice: LegChoice) -> Budget:
    """The paper's own form, for comparison: it takes the range for constant while the angle changes (equation 26).

    That is right for the range's errors and wrong for the angle's: a constant angle bias turns the way and adds nothing
    along it, where equation 29 has a term.
    """
    far, near = _passages(choice)
    share = (np.arange(200) + 0.5) / 200
    along = (near[:, None] + (far - near)[:, None] * share).ravel()
    rho, theta = np.hypot(choice.distance_m, along), np.arctan2(choice.distance_m, along)
    sine, cosine = np.sin(theta), np.cos(theta)
    bias = errors.range_bias_m * choice.distance_m / rho**2 * np.stack([cosine, sine])
    angle = errors.angle_error_rad(theta) * choice.distance_m / rho * np.stack([-sine, cosine])
    rates = {"range scale": np.array([0.0, errors.range_scale]), "range bias": bias.mean(axis=1)}
    return _named(errors, {**rates, "angle": angle.mean(axis=1)})


def _passages(choice: LegChoice) -> tuple[Array, Array]:
    """Distances along the face (N,) where the chosen legs come into use and leave it; negative behind the machine."""
    if choice.count < 1 or choice.distance_m <= 0 or choice.spacing_m <= 0 or choice.nearest_m < 0:
        raise ValueError(
            f"expected at least one leg, distance and spacing above zero, nearest of zero or more: {choice}"
        )
    low = choice.nearest_m + choice.spacing_m * np.arange(choice.count, dtype=np.float64)
    return (low + choice.spacing_m, low) if choice.ahead else (-low, -low - choice.spacing_m)


def _reading_errors(errors: ScannerErrors, choice: LegChoice, along: Array) -> dict[str, Array]:
    """Error of a leg's place as it is read (equation 5), (N, 2) right and forward, by source."""
    rho, theta = np.hypot(choice.distance_m, along), np.arctan2(choice.distance_m, along)
    sine, cosine = np.sin(theta), np.cos(theta)
    toward, across = np.stack([-sine, cosine], axis=-1), np.stack([-cosine, -sine], axis=-1)
    return {
        "range scale": errors.range_scale * rho[:, None] * toward,
        "range bias": errors.range_bias_m * toward,
        "angle": (rho * errors.angle_error_rad(theta))[:, None] * across,
    }


def _named(errors: ScannerErrors, planar: dict[str, Array]) -> Budget:
    attitude = np.array([errors.heading_rad, 0.0, -errors.pitch_rad])
    return Budget({"attitude and mounting": attitude, **{name: np.append(rate, 0.0) for name, rate in planar.items()}})
