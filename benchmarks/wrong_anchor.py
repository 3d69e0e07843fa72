"""All ranges of one UWB anchor off by a metre: which anchor is named, and what the path is worth then.

Scenario face-end-uwb. Each seed is smoothed as it is, with a fifth of its ranges reflected, and with the ranges of one
anchor after the other too long or, every third time, too short. Truth is for judging alone. Takes about 2 minutes a
seed and site.
"""

from __future__ import annotations

import os
import statistics
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from benchmarks._report import Before, Row, Target, parser, publish, row, say

if TYPE_CHECKING:
    from graphnav.log import SensorLog
    from graphnav.run import Run

SITES = ("surface", "underground")
NONE, RIGHT, NEAR = Target(high=0), Target(low=1), Target(high=3)
#: How the warning begins that names an anchor.
_NAMED = "anchor {} contradicted all others", "anchor {} disagree with the rest"
_SHARE, _OFF_M = 0.2, 1.0


@dataclass(frozen=True)
class Case:
    """One log: anchors named, the one that is wrong or "", the rms error and that of the sound log."""

    named: tuple[str, ...]
    wrong: str
    rms_m: float
    sound_m: float


def named(run: Run, anchors: tuple[str, ...]) -> tuple[str, ...]:
    """Anchors that a run blames."""
    lines = run.diagnostics.warnings
    return tuple(a for a in anchors if any(part.format(a) in line for part in _NAMED for line in lines))


def shifted(log: SensorLog, anchor: str, by_m: float) -> SensorLog:
    """The ranges of one anchor longer by a constant; by half of it where they would be less than nothing."""
    import numpy as np

    assert log.uwb is not None
    its = np.asarray(log.uwb.anchor_id) == anchor
    by_m *= 1.0 if (log.uwb.range_m[its] + by_m > 0).all() else 0.5
    return replace(log, uwb=replace(log.uwb, range_m=log.uwb.range_m + by_m * its))


def cases_of(site: str, seed: int) -> list[Case]:
    """Sound, reflected, and each anchor wrong."""
    import numpy as np

    from graphnav.evaluation import evaluate
    from graphnav.simulation import simulate
    from graphnav.smooth import smooth

    log = simulate("face-end-uwb", seed=seed, site=site)
    reflected = simulate("face-end-uwb", seed=seed, site=site, nlos_share=_SHARE)
    assert log.uwb is not None
    anchors = tuple(each.id for each in log.uwb.anchor)
    logs = {"": log, "reflected": reflected}
    logs |= {a: shifted(log, a, -_OFF_M if (seed + k) % 3 == 2 else _OFF_M) for k, a in enumerate(anchors)}
    found, sound_m = [], 0.0
    for name, each in logs.items():
        run = smooth(replace(each, truth=None))
        rms_m = float(np.linalg.norm(evaluate(run.trajectory, each).rms_m))
        sound_m = sound_m or rms_m
        found.append(Case(named(run, anchors), name if name in anchors else "", rms_m, sound_m))
        told = ", ".join(found[-1].named) or "none"
        say(f"{site}, seed {seed}, {name or 'sound'}: {rms_m / sound_m:.2f} of the sound log's error, named: {told}")
    return found


def rows_of(site: str, cases: list[Case]) -> list[Row]:
    """A site's figures."""
    wrong, sound = [each for each in cases if each.wrong], [each for each in cases if not each.wrong]
    right = sum(each.named == (each.wrong,) for each in wrong)
    blamed = sum(bool(set(each.named) - {each.wrong}) for each in cases)
    ratio = [each.rms_m / each.sound_m for each in wrong]
    return [
        row(f"{site}: logs with one anchor off", float(len(wrong)), "1"),
        row(f"{site}: share of them in which it alone is named", right / len(wrong), "1", target=RIGHT),
        row(f"{site}: logs in which a sound anchor is named, of {len(cases)}", float(blamed), "1", target=NONE),
        row(f"{site}: of these sound or with reflections alone", float(len(sound)), "1"),
        row(f"{site}: rms error by that of the sound log, median", statistics.median(ratio), "1"),
        row(f"{site}: the same, largest", max(ratio), "1", target=NEAR),
    ]


def main(argv: list[str] | None = None) -> None:
    """Parse, measure, print."""
    args = parser(__doc__)
    args.add_argument("--seeds", type=int, default=4, help="number of seeds of each site")
    arguments, before = args.parse_args(argv), Before.now()
    os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1", MKL_NUM_THREADS="1")
    rows: list[Row] = []
    for site in SITES:
        rows += rows_of(site, [case for seed in range(arguments.seeds) for case in cases_of(site, seed)])
    publish(rows, arguments.json, before)


if __name__ == "__main__":
    main()
