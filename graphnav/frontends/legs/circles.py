"""Circles of known diameter through runs of beams: centre, covariance, and which runs are no leg.

A leg is an upright cylinder; tilted by 10 deg its section is an ellipse 1.5 % longer than wide, which is taken for a
circle (J. Zheng et al.'s LiDAR paper, section 3.2). What that leaves enters the covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graphnav._schema import Array
from graphnav.frontends.legs.fitting import fit_all
from graphnav.frontends.legs.segmentation import Beams, Int, Segments

#: Legs lean by about this much (the paper); half the excess of the section's longer axis is its error as a circle.
_TILT_DEG = 10.0
#: Why a run is no leg, by code; 0 is a leg.
REASONS = ("leg", "few beams", "size", "off the circle", "partial view", "radius", "not solved")


@dataclass(frozen=True)
class Circles:
    """Centres of legs in the sensor's frame s at the time of their scan.

    Attributes
    ----------
    scan : (K,) row of the scan.
    beam : (K,) middle beam, for the time within the scan.
    pos_s_m : (K, 2) right, forward.
    cov_s_m2 : (K, 2, 2) of `pos_s_m`.
    beams : (K,) returns on the circle.
    rejected : number of runs that are no leg, by reason.
    """

    scan: Int
    beam: Array
    pos_s_m: Array
    cov_s_m2: Array
    beams: Int
    rejected: dict[str, int]

    def __len__(self) -> int:
        return len(self.scan)

    @property
    def range_m(self) -> Array:
        """(K,) distance of the centre."""
        distance: Array = np.hypot(self.pos_s_m[:, 0], self.pos_s_m[:, 1])
        return distance

    @property
    def angle_rad(self) -> Array:
        """(K,) direction, counter-clockwise from s's forward axis."""
        angle: Array = np.arctan2(-self.pos_s_m[:, 0], self.pos_s_m[:, 1])
        return angle

    def polar_covariance(self) -> Array:
        """(K, 2, 2) covariance of range (m) and angle (rad)."""
        distance = self.range_m[:, None]
        along = self.pos_s_m / distance
        across = np.column_stack([-along[:, 1], along[:, 0]]) / distance
        jacobian = np.stack([along, across], axis=1)
        return jacobian @ self.cov_s_m2 @ jacobian.transpose(0, 2, 1)

    def where(self, keep: npt.NDArray[np.bool_]) -> Circles:
        """Some of them."""
        return Circles(
            self.scan[keep], self.beam[keep], self.pos_s_m[keep], self.cov_s_m2[keep], self.beams[keep], self.rejected
        )


def fit_circles(
    beams: Beams, segments: Segments, diameter_m: float, range_sigma_m: float, angle_sigma_rad: float
) -> Circles:
    """Fit a circle of known diameter to every run and keep those that are one.

    The distance of returns from the circle is minimised, each weighed by what the noise of its range and angle does to
    that distance. Runs are fitted robustly first; returns more than 3.5 sigma off are then left out and the rest
    fitted by least squares, whose covariance is the centre's. Refused is a run of fewer than 5 beams, wider than the
    diameter, with many beams or large residuals off the circle, that covers too little of it, or whose own radius
    differs significantly from the known one (flat and hollow surfaces).

    Parameters
    ----------
    beams : the scans.
    segments : runs of their beams, from `segment`.
    diameter_m : of the legs.
    range_sigma_m, angle_sigma_rad : white noise of a return, 1-sigma.

    Returns
    -------
    Circles
        Legs, and the number of refused runs by reason.
    """
    radius = diameter_m / 2
    section_m = radius * (1 / np.cos(np.radians(_TILT_DEG)) - 1) / 2
    numbers = np.empty((len(segments), 6))
    code = np.empty(len(segments), np.int64)
    fit_all(
        beams.ranges_m, beams.angle_min_rad, beams.angle_step_rad,
        segments.scan, segments.first, segments.last, segments.hidden, segments.label,
        radius, range_sigma_m, angle_sigma_rad, section_m, numbers, code,
    )  # fmt: skip
    leg = code == 0
    found = numbers[leg]
    cov = np.empty((len(found), 2, 2))
    cov[:, 0, 0], cov[:, 0, 1], cov[:, 1, 0], cov[:, 1, 1] = found[:, 2], found[:, 3], found[:, 3], found[:, 4]
    return Circles(
        scan=segments.scan[leg],
        beam=(segments.first[leg] + segments.last[leg] - 1) / 2,
        pos_s_m=found[:, :2].copy(),
        cov_s_m2=cov,
        beams=found[:, 5].astype(np.int64),
        rejected={name: int((code == number).sum()) for number, name in enumerate(REASONS) if number},
    )


def joined(parts: list[Circles], rejected: dict[str, int]) -> Circles:
    """Several, in their order."""
    return Circles(
        scan=np.concatenate([p.scan for p in parts]),
        beam=np.concatenate([p.beam for p in parts]),
        pos_s_m=np.concatenate([p.pos_s_m for p in parts]),
        cov_s_m2=np.concatenate([p.cov_s_m2 for p in parts]),
        beams=np.concatenate([p.beams for p in parts]),
        rejected=rejected,
    )
