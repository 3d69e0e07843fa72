"""What became of a log's UWB ranges: how many were left out, of which anchor, and what that says of the anchor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from factors.increments import npt_int
from graphnav._observability import NOT_OBSERVABLE
from graphnav.config import UwbConfig
from graphnav.frontends.trilateration import usable
from graphnav.log import Uwb
from graphnav.range_clock import ClockScore
from graphnav.ranges import RangeReadings
from graphnav.run import Calibration, RangeResiduals

if TYPE_CHECKING:
    import gtsam

#: Share of an anchor's ranges left out from which on the anchor itself is in doubt, and the fewest ranges that tell.
_MOST, _FEWEST = 0.5, 20
#: Share from which on all of them are, but for chance.
_ALL = 0.95
#: Declared sigmas at which a constant error is far off.
_FAR = 4.0
#: A clock off by this many sigmas, and seconds, is said to be off: by chance, one healthy log in two million.
_CLOCK_SIGMAS, _CLOCK_S = 5.0, 0.02


@dataclass(frozen=True)
class AnchorCount:
    """Ranges of one anchor: used and left out, and the median error of the latter, m, by the rest of the graph."""

    anchor: str
    used: int
    left_out: int
    off_m: float


def anchor_counts(
    uwb: Uwb, used: RangeReadings, left_out: RangeReadings | None, values: gtsam.Values
) -> list[AnchorCount]:
    """For every anchor heard; `values` is the solution."""
    out: npt_int = np.zeros(0, np.int64)
    off_m = np.zeros(0)
    if left_out is not None and len(left_out.row):
        out, off_m = left_out.anchor, -left_out.family.residuals(values)[0] * left_out.family.sigma_m
    found = []
    for a in np.unique(np.concatenate([used.anchor, out])).tolist():
        off = off_m[out == a]
        found.append(
            AnchorCount(
                uwb.anchor[a].id, int((used.anchor == a).sum()), len(off), float(np.median(off)) if len(off) else 0.0
            )
        )
    return found


def range_residuals(
    uwb: Uwb, used: RangeReadings, left_out: RangeReadings | None, values: gtsam.Values
) -> RangeResiduals:
    """What the solution leaves of every range, in order of time."""
    parts = [used] if left_out is None or not len(left_out.row) else [used, left_out]
    row = np.concatenate([part.row for part in parts])
    off = np.concatenate([-part.family.residuals(values)[0] * part.family.sigma_m for part in parts])
    taken = np.repeat([True, False][: len(parts)], [len(part.row) for part in parts])
    order = np.argsort(row)
    row = row[order]
    return RangeResiduals(uwb.t_s[row], np.asarray(uwb.anchor_id)[row], off[order], taken[order])


def rejected(counts: list[AnchorCount]) -> dict[str, int]:
    """Ranges left out, in all and by anchor; empty where there are none."""
    by_anchor = {f"uwb anchor {each.anchor}": each.left_out for each in counts if each.left_out}
    return {"uwb": sum(by_anchor.values()), **by_anchor} if by_anchor else {}


def range_warnings(
    uwb: Uwb, counts: list[AnchorCount], calibration: dict[str, Calibration], may_be: tuple[str, ...] = ()
) -> list[str]:
    """What the user should know of the anchors: one line for one that is wrong, or for all where it might be any.

    Ranges of one anchor that are off by a constant are left out wholesale, and those of the others agree. Where others
    disagree too, or constants are far off, the path is a compromise, and which anchor bent it the geometry may not
    tell: with four anchors near a plane it blames the wrong one as often as the right.

    Parameters
    ----------
    may_be : anchors of which each, off by a constant, would explain the ranges (`graphnav.anchor_doubt`).
    """
    doubted = [each for each in counts if _out(each) > _MOST and each.used + each.left_out >= _FEWEST]
    biased = {each.anchor: abs(_bias(uwb, each, calibration)) for each in counts}
    far = [name for name, sigmas in biased.items() if sigmas > _FAR]
    if not doubted and not far:
        return []
    if len(doubted) == 1 and not far and _out(doubted[0]) > _ALL:
        others = [_out(each) for each in counts if each is not doubted[0]]
        if max(others, default=0.0) < 1 - _ALL:
            (each,) = doubted
            return [
                f"{each.left_out} of {each.used + each.left_out} ranges of UWB anchor {each.anchor} disagree with the"
                f" rest and were left out, by {each.off_m:+.2f} m: check its position, or declare a larger bias_sigma_m"
            ]
    if not doubted and len(far) == 1:
        return [
            f"the constant error of UWB anchor {far[0]} came out at {biased[far[0]]:.0f} times its declared sigma:"
            " check its position"
        ]
    signs = [f"{each.left_out} of {each.used + each.left_out} of anchor {each.anchor} left out" for each in doubted]
    if far:
        worst = max(biased[name] for name in far)
        signs.append(f"constant errors of anchors {', '.join(far)} up to {worst:.0f} times their declared sigma")
    who = "which anchor is wrong these ranges do not tell"
    if len(may_be) == 1:
        who = f"anchor {may_be[0]}, off by a constant, would explain it, but along more than one path"
    elif may_be:
        who = f"any of the anchors {', '.join(may_be)}, off by a constant, would explain it"
    return [
        f"UWB ranges contradict each other ({'; '.join(signs)}): positions may be metres off, and {who}; check all"
        " positions, or declare bias_sigma_m = 1, and the errors are estimated"
    ]


def freed_warning(anchor: str, calibration: dict[str, Calibration]) -> str:
    """What the user should know of an anchor whose constant was estimated, as ranges contradicted each other."""
    found = calibration[f"uwb_bias_{anchor}"]
    sigma = "" if found.sigma is None else f" +- {found.sigma:.3f}"
    return (
        f"the ranges of UWB anchor {anchor} contradicted all others: they are off by {found.value:+.3f}{sigma} m, which"
        " was estimated; check its position, or declare bias_sigma_m in its section [[uwb.anchor]]"
    )


def contradictory(lines: list[str]) -> bool:
    """Whether `range_warnings` says that the path is a compromise: then nothing else that ranges say can be trusted."""
    return any(line.startswith("UWB ranges contradict") for line in lines)


def _out(each: AnchorCount) -> float:
    """Share of an anchor's ranges that were left out."""
    return each.left_out / max(each.used + each.left_out, 1)


def _bias(uwb: Uwb, each: AnchorCount, calibration: dict[str, Calibration]) -> float:
    """An anchor's constant error in declared sigmas; zero where none is declared."""
    found = calibration.get(f"uwb_bias_{each.anchor}")
    sigma = dict(zip((a.id for a in uwb.anchor), uwb.constant_sigma_m.tolist(), strict=True))[each.anchor]
    return 0.0 if found is None or not sigma else found.value / sigma


def clock_warnings(
    config: UwbConfig, calibration: dict[str, Calibration], moved: bool, score: ClockScore | None
) -> list[str]:
    """What the user should know of the ranges' clock, one line each.

    Parameters
    ----------
    moved : whether an estimated offset still did at the end; score : where none was estimated, what the ranges say.
    """
    lines = []
    found = calibration.get("uwb_time_offset")
    if score is not None and abs(score.offset_s) > max(_CLOCK_SIGMAS * score.sigma_s, _CLOCK_S):
        lines.append(
            f"UWB ranges seem stamped {_amiss(score.offset_s)} against the IMU, by {_sigmas(score)} sigmas: set"
            " uwb.estimate_time_offset = true in the configuration, or declare time_offset_s in [uwb]"
        )
    if found is None:
        return lines
    if moved:
        lines.append("the time offset of UWB ranges still moved at the end: raise batch.bias_move_rounds")
    if found.sigma is not None and found.sigma > NOT_OBSERVABLE * config.time_offset_sigma_s:
        lines.append(
            f"the time offset of UWB ranges is not observable from this motion (sigma {found.sigma:.2g} s, as assumed):"
            " a start, a stop or a turn while ranges come in tells it"
        )
    if abs(found.value) > _FAR * config.time_offset_sigma_s:
        lines.append(
            f"UWB ranges came out stamped {_amiss(found.value)},"
            f" {abs(found.value) / config.time_offset_sigma_s:.0f} times time_offset_sigma_s: check [uwb] time_offset_s"
        )
    return lines


def _amiss(offset_s: float) -> str:
    """A range stamped late measured the tag before its stamp."""
    return f"{abs(offset_s):.3f} s {'late' if offset_s < 0 else 'early'}"


def _sigmas(score: ClockScore) -> str:
    return f"{abs(score.offset_s) / score.sigma_s:.0f}"


def geometry_warnings(uwb: Uwb) -> list[str]:
    """What anchors on one line cannot tell: ranges to them are the same all around it.

    A path that comes close to the line may leave it on the wrong side, with small sigmas: a minimum of its own.
    """
    heard = [anchor.pos_n_m for anchor in uwb.anchor if (np.asarray(uwb.anchor_id) == anchor.id).any()]
    if len(heard) > 2 and usable(np.array(heard), np.ones((1, len(heard)), bool))[0]:
        return []
    return [
        f"the {len(heard)} UWB anchors heard lie on one line: on which side of it the machine is, the IMU and the start"
        " alone tell, and where it comes near the line its path may be a mirror image; survey an anchor beside the line"
    ]
