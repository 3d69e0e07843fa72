"""Cut planar scans into runs of neighbouring beams that may lie on one leg.

Beams are one leg's as long as their ranges change by less than a leg's own depth allows. A few beams that stop
short in front of it (dust) or return nothing do not end the run when the same surface goes on behind them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graphnav._schema import Array
from graphnav.baselines._compiled import compiled

Int = npt.NDArray[np.int64]
Bool = npt.NDArray[np.bool_]

#: From one beam to the next the surface of a leg recedes by at most this share of its diameter, but at its very edge.
_STEP_SHARE = 0.3
#: Dust and lost beams within a leg cover at most this share of its diameter.
_GAP_SHARE = 0.4


@dataclass(frozen=True)
class Beams:
    """Scans as a rectangle.

    Attributes
    ----------
    ranges_m : (S, B), NaN where a beam returned nothing or the scan has fewer beams.
    angle_min_rad, angle_step_rad : (S,) angle of the first beam and between beams, counter-clockwise from s's forward
        axis.
    """

    ranges_m: Array
    angle_min_rad: Array
    angle_step_rad: Array

    @classmethod
    def stacked(cls, ranges_m: list[Array], angle_min_rad: Array, angle_step_rad: Array) -> Beams:
        """From scans of any lengths."""
        lengths = {len(r) for r in ranges_m}
        if len(lengths) == 1:
            rectangle = np.array(ranges_m, float)
        else:
            rectangle = np.full((len(ranges_m), max(lengths)), np.nan)
            for row, scan in zip(rectangle, ranges_m, strict=True):
                row[: len(scan)] = scan
        return cls(rectangle, np.asarray(angle_min_rad, float), np.asarray(angle_step_rad, float))


@dataclass(frozen=True)
class Segments:
    """Runs of beams.

    Attributes
    ----------
    scan : (K,) row of the scan, ascending.
    first, last : (K,) its first beam and the one after its last.
    hidden : (K,) something nearer, or the edge of the scan, is beside it: part of it may be out of sight.
    label : (S, B) number of the run that a beam is in, -1 for none (nothing returned, dust).
    """

    scan: Int
    first: Int
    last: Int
    hidden: Bool
    label: npt.NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.scan)


def segment(
    beams: Beams, diameter_m: float, range_sigma_m: float, min_range_m: float = 0.1, max_range_m: float = np.inf
) -> Segments:
    """Cut scans where the range jumps.

    Parameters
    ----------
    beams : the scans; NaN, infinite, zero and negative ranges count as nothing returned.
    diameter_m : of a leg; sets how far the range may change within one.
    range_sigma_m : white noise of a range, 1-sigma.
    min_range_m, max_range_m : returns outside are dropped.

    Returns
    -------
    Segments
        In the order of scans and beams; runs of a single beam among them.
    """
    ranges = np.where((beams.ranges_m >= min_range_m) & (beams.ranges_m <= max_range_m), beams.ranges_m, 0.0)
    # noise beyond a leg's own depth cannot be told from a jump: small legs are cut finely
    step_m = _STEP_SHARE * diameter_m + min(4 * range_sigma_m, _STEP_SHARE * diameter_m)
    label = np.empty(ranges.shape, np.int32)
    pieces = _cut(ranges, np.abs(beams.angle_step_rad), step_m, _GAP_SHARE * diameter_m, label)
    return Segments(pieces[:, 0], pieces[:, 1], pieces[:, 2], pieces[:, 3] > 0, label)


@compiled
def _cut(ranges: Array, step_rad: Array, step_m: float, gap_m: float, label: npt.NDArray[np.int32]) -> Int:
    """Rows of scan, first, last, hidden; labels filled in. Ranges of zero are nothing returned."""
    scans, count = ranges.shape
    found = np.empty((ranges.size + 1, 4), np.int64)
    total = 0
    for scan in range(scans):
        row = ranges[scan]
        for beam in range(count):
            label[scan, beam] = -1
        beam = 0
        while beam < count:
            if row[beam] == 0.0 or label[scan, beam] >= 0:
                beam += 1
                continue
            first = last = beam
            label[scan, first] = total
            ahead = first + 1
            while ahead < count:
                range_m = row[ahead]
                if range_m > 0.0 and label[scan, ahead] < 0 and abs(range_m - row[last]) <= step_m:
                    label[scan, ahead] = total
                    last = ahead
                else:
                    # what is nearer or empty may be dust before the leg; what is farther is behind it: the leg ends
                    wide = (ahead - last + 1) * step_rad[scan] * row[last] > gap_m and ahead - last >= 2
                    if range_m > row[last] + step_m or wide:
                        break
                ahead += 1
            found[total, 0], found[total, 1], found[total, 2] = scan, first, last + 1
            found[total, 3] = _nearer(row, first - 1, -1, row[first], step_m) or _nearer(
                row, last + 1, 1, row[last], step_m
            )
            total += 1
            beam = first + 1
    return found[:total].copy()


@compiled
def _nearer(row: Array, beam: int, way: int, range_m: float, step_m: float) -> bool:
    """Whether the next return beside a run is in front of it, or the scan ends there."""
    for _ in range(3):
        if beam < 0 or beam >= len(row):
            return True
        if row[beam] > 0.0:
            return bool(row[beam] < range_m - step_m / 2)
        beam += way
    return False
