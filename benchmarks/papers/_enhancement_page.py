"""The page of the image enhancement: text around tables and pictures, every figure from this run."""

from __future__ import annotations

from pathlib import Path

from benchmarks._dark_images import KINDS, NOISES, VARIANTS
from benchmarks._image_rows import MEASURES, SHOWN, Results
from benchmarks._report import Before
from benchmarks.papers import _enhancement_text as text
from benchmarks.papers._enhancement_figures import draw
from benchmarks.papers._sheet import Pictures, filled, number, save, table

#: Of `MEASURES`, in their order.
_HEADS = ("mean grey level", "rms contrast, levels", "local contrast, levels", "entropy, bit", "NIQE")
#: What the paper's text tells of its own method over all its sets.
_PAPER_NIQE = "3.47 to 3.73"


def write(path: Path, results: Results, seeds: int, before: Before) -> None:
    """Write the page and its pictures, the page whole or not at all."""
    pictures = draw(results, path.with_suffix(""))
    link = Pictures(pictures, text.CAPTIONS, path.parent).link
    parts = [text.TITLE, text.source(seeds, before), link("roadway"), text.EQUATIONS, text.settings()]
    parts += [text.MATCHES, text.noise_text()]
    parts += [
        part for noise in NOISES for part in (f"True matches, mean of the images, {noise}:", matches(results, noise))
    ]
    parts += [text.why_matches(results), link("matches")]
    parts += ["Wrong among those kept, and spread of the true ones over the image and over depth:", spread(results)]
    parts += [text.QUALITY, quality(results), text.NO_NIQMC, text.why_quality(results), text.timing(results)]
    save(path, [text.TITLE, *map(filled, parts[1:])])  # code has empty lines


def matches(results: Results, noise: str) -> str:
    """Mean true matches by variant, the ratios, and how often raw or CLAHE wins."""
    rows = []
    for group, other in results.groups():
        for kind in KINDS if other == noise else ():
            means = {v: results.mean(group, noise, v, kind, "true") for v in [*VARIANTS, "raw, faint"]}
            kept = [results.mean(group, noise, v, kind, "kept") for v in ("raw", "enhanced")]
            count = len(results.of(group, noise))
            lost = [f"{results.lost(group, noise, kind, 'enhanced', base)} of {count}" for base in ("raw", "CLAHE")]
            cells = [f"{value:.0f}" for value in means.values()]
            rows.append([
                f"{group}, {kind.upper()}", *cells, f"**{means['enhanced'] / max(means['raw'], 1e-9):.2f}**",
                f"{kept[1] / max(kept[0], 1e-9):.2f}", f"{results.ratio(group, noise, kind, 'enhanced'):.2f}",
                f"{means['enhanced'] / max(means['CLAHE'], 1e-9):.2f}", " / ".join(lost),
            ])  # fmt: skip
    head = ["", *VARIANTS, "raw, faint", "enhanced by raw", "the same, kept by RANSAC", "median of the images' ratios",
            "enhanced by CLAHE", "images where raw / CLAHE has more"]  # fmt: skip
    return table(head, rows)


def spread(results: Results) -> str:
    """Shares of wrong matches, of the image's cells, and of the steps of depth."""
    rows = []
    for group, noise in results.groups():
        for kind in KINDS:
            wrong = [f"{results.wrong(group, noise, v, kind):.1%}" for v in (*SHOWN, "raw, faint")]
            cells = [f"{results.mean(group, noise, v, kind, 'spread'):.2f}" for v in (*SHOWN, "raw, faint")]
            depth = [results.depth(group, noise, v, kind) for v in (*SHOWN, "raw, faint")]
            depths = ["-" if value is None else f"{value:.2f}" for value in depth]
            rows.append([f"{group}, {noise}, {kind.upper()}", *(" / ".join(c) for c in (wrong, cells, depths))])
    return table(
        ["raw / CLAHE / enhanced / raw, faint", "wrong", "share of 60 cells", "share of 8 steps of depth"], rows
    )


def quality(results: Results) -> str:
    """Means over a set; the paper's NIQE beside ours."""
    rows = []
    for group in dict.fromkeys(group for group, _ in results.groups()):
        for variant in SHOWN:
            values = [number(results.quality(group, variant, measure)) for measure in MEASURES]
            paper = f"*{_PAPER_NIQE}*" if variant == "enhanced" and group in ("DICM", "LIME") else "-"
            rows.append([f"{group}, {variant}", *values, paper])
    return table(["mean of the images", *_HEADS, "paper's own method, NIQE"], rows)
