"""Figures of the enhancement's benchmark: means over photographs, ratios, and where an enhancement loses."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from benchmarks._dark_images import KINDS, VARIANTS, Score
from benchmarks._report import Row, Target, row

#: The paper's ratio of matched features, 180 by 150; and the time a frame may take.
RATIO, FRAME_MS = Target(low=1.2, of_ratio=True), Target(high=4.0)
#: Variants whose quality is measured and that are compared in full.
SHOWN = ("raw", "CLAHE", "enhanced")
#: The names of `Quality`, with units.
MEASURES = {"mean_grey": "grey", "rms_contrast": "grey", "local_contrast": "grey", "entropy": "bit", "niqe": "1"}


@dataclass(frozen=True)
class Quality:
    """Measures of one image that need no second; NIQE is None without its parameters."""

    mean_grey: float
    rms_contrast: float
    local_contrast: float
    entropy: float
    niqe: float | None


@dataclass(frozen=True)
class Judged:
    """All that was measured of one image of a set.

    Attributes
    ----------
    group : name of the set, or of the drawn roadway; noise : name of the noise.
    scores : (variant, kind) -> matches; quality : variant -> measures of the image without added noise.
    depth : (variant, kind) -> share of the steps of depth with a true match, of drawn scenes.
    """

    group: str
    noise: str
    name: str
    scores: dict[tuple[str, str], Score]
    quality: dict[str, Quality]
    depth: dict[tuple[str, str], float]


@dataclass(frozen=True)
class Results:
    """Everything measured; milliseconds a frame by variant."""

    judged: tuple[Judged, ...]
    ms: dict[str, float]

    def groups(self) -> list[tuple[str, str]]:
        """Sets and noises that were measured, in that order."""
        return list(dict.fromkeys((one.group, one.noise) for one in self.judged))

    def of(self, group: str, noise: str | None = None) -> list[Judged]:
        """Those of one set, and of one noise or all."""
        return [one for one in self.judged if one.group == group and noise in (None, one.noise)]

    def mean(self, group: str, noise: str, variant: str, kind: str, of: str) -> float:
        """Mean over a set of `kept`, `true` or `spread`."""
        return statistics.fmean(getattr(one.scores[variant, kind], of) for one in self.of(group, noise))

    def ratio(self, group: str, noise: str, kind: str, variant: str, base: str = "raw") -> float:
        """Median over a set of the ratio of true matches; an image with none counts as one."""
        pairs = [(one.scores[variant, kind].true, one.scores[base, kind].true) for one in self.of(group, noise)]
        return statistics.median(max(ours, 1) / max(theirs, 1) for ours, theirs in pairs)

    def lost(self, group: str, noise: str, kind: str, variant: str, base: str) -> int:
        """Images of a set on which a variant has fewer true matches than another."""
        return sum(one.scores[variant, kind].true < one.scores[base, kind].true for one in self.of(group, noise))

    def wrong(self, group: str, noise: str, variant: str, kind: str) -> float:
        """Share of the matches kept that the known motion does not confirm."""
        found = [one.scores[variant, kind] for one in self.of(group, noise)]
        kept = sum(score.kept for score in found)
        return (kept - sum(score.true for score in found)) / max(kept, 1)

    def depth(self, group: str, noise: str, variant: str, kind: str) -> float | None:
        """Mean share of the steps of depth with a true match; None for photographs."""
        found = [one.depth[variant, kind] for one in self.of(group, noise) if one.depth]
        return statistics.fmean(found) if found else None

    def quality(self, group: str, variant: str, measure: str) -> float | None:
        """Mean of a measure over a set; None where it was not taken."""
        values = [getattr(one.quality[variant], measure) for one in self.of(group) if one.quality]
        return None if not values or None in values else statistics.fmean(values)


def all_rows(results: Results, missing: Iterable[str]) -> list[Row]:
    """Everything; a set that is not at hand has rows without a value, whose targets are not met."""
    rows = [row(f"milliseconds a frame, {name}", ms, "ms", target=_time(name)) for name, ms in results.ms.items()]
    for group in missing:
        rows += [row(f"{group}, {k}: matched features, enhanced", None, "1", target=RATIO) for k in KINDS]
    for group, noise in results.groups():
        for kind in KINDS:
            rows += _match_rows(results, group, noise, kind)
    for group in dict.fromkeys(group for group, _ in results.groups()):
        rows += _quality_rows(results, group)
    return rows


def _time(name: str) -> Target | None:
    return FRAME_MS if name == "enhanced" else None


def _match_rows(results: Results, group: str, noise: str, kind: str) -> list[Row]:
    """Of one detector on one set: raw is the peer, but for the last rows."""
    name, usual = f"{group}, {noise}, {kind}", noise == "usual noise"

    def mean(variant: str, of: str) -> float:
        return results.mean(group, noise, variant, kind, of)

    found = [
        row(f"{name}: matched features, enhanced", mean("enhanced", "kept"), "1", peer=mean("raw", "kept"),
            target=RATIO if usual else None),
        row(f"{name}: and true to the motion, enhanced", mean("enhanced", "true"), "1", peer=mean("raw", "true"),
            target=RATIO if usual else None),
    ]  # fmt: skip
    for variant in [v for v in VARIANTS if v not in ("raw", "enhanced")] + ["raw, faint"]:
        found.append(row(f"{name}: true, {variant}", mean(variant, "true"), "1", peer=mean("raw", "true")))
    found += [
        row(f"{name}: true, enhanced by CLAHE", mean("enhanced", "true"), "1", peer=mean("CLAHE", "true")),
        row(f"{name}: median ratio of true, enhanced by raw", results.ratio(group, noise, kind, "enhanced"), "1"),
        row(f"{name}: median ratio of true, CLAHE by raw", results.ratio(group, noise, kind, "CLAHE"), "1"),
    ]
    for base in ("raw", "CLAHE"):
        count = len(results.of(group, noise))
        lost = float(results.lost(group, noise, kind, "enhanced", base))
        found.append(row(f"{name}: images of {count} where {base} has more true matches", lost, "1"))
    for variant in SHOWN:
        found.append(row(f"{name}: wrong among those kept, {variant}", results.wrong(group, noise, variant, kind), "1"))
        found.append(row(f"{name}: share of the image with a true match, {variant}", mean(variant, "spread"), "1"))
        depth = results.depth(group, noise, variant, kind)
        if depth is not None:
            found.append(row(f"{name}: share of the depths with a true match, {variant}", depth, "1"))
    return found


def _quality_rows(results: Results, group: str) -> list[Row]:
    """Contrast, entropy, NIQE: the raw image's is the peer."""
    named: Callable[[str], str] = lambda measure: measure.replace("_", " ")  # noqa: E731
    return [
        row(f"{group}: {named(measure)}, {variant}", results.quality(group, variant, measure), unit,
            peer=results.quality(group, "raw", measure))
        for measure, unit in MEASURES.items()
        for variant in SHOWN
    ]  # fmt: skip
