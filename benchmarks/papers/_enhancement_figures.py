"""The pictures of the enhancement's page: the rendered roadway with its parts, and matches photograph by photograph."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._dark_images import KINDS, NOISES, SETS, VARIANTS, photographs
from benchmarks._image_rows import Results
from benchmarks._rendered_roadway import scenes
from benchmarks.papers._figures import _COLOURS, _STYLE, _grid, _save
from graphnav.frontends._opencv import Image

PARTS = ("raw", "CLAHE", "R alone", "P alone", "enhanced")
_USUAL = next(iter(NOISES))
#: Photographs shown side by side, when they are.
_SHOWN = {"DICM": 4, "LIME": 4}


def draw(results: Results, folder: Path) -> dict[str, Path]:
    """Pictures that may be in the repository: name -> file."""
    from matplotlib import rc_context

    folder.mkdir(parents=True, exist_ok=True)
    rendered = [(f"scene {number}", scene.first) for number, scene in enumerate(scenes(3))]
    with rc_context(_STYLE):
        made = {"roadway": _save(parts(rendered), folder / "roadway.png")}
        if any(results.of(group) for group in SETS):
            made["matches"] = _save(matches(results), folder / "matches.png")
    return made


def draw_photographs(folder: Path) -> None:
    """Photographs with their parts, for the eye alone: their licence keeps them out of the repository."""
    from matplotlib import rc_context

    from graphnav.frontends.enhancement import resized

    folder.mkdir(parents=True, exist_ok=True)
    with rc_context(_STYLE):
        for name, count in _SHOWN.items():
            images = [(one, resized(image)) for one, image in photographs(name)[:count]]
            if images:
                _save(parts(images), folder / f"{name}.png")


def parts(images: list[tuple[str, Image]]) -> Any:
    """As the paper's figures 6 and 7: one row an image, one column a variant."""
    figure, axes = _grid(len(images), len(PARTS), (11.0, 1.25 * len(images) + 0.2))
    for (name, image), line in zip(images, axes, strict=True):
        for variant, at in zip(PARTS, line, strict=True):
            at.imshow(VARIANTS[variant](image), cmap="gray", vmin=0, vmax=255)
            at.set(xticks=[], yticks=[])
            at.grid(False)
        line[0].set_ylabel(name)
    for variant, at in zip(PARTS, axes[0], strict=True):
        at.set_title(variant)
    return figure


def matches(results: Results) -> Any:
    """What the paper's figure 8 shows, as pairs: true matches of a photograph enhanced, over those of it raw."""
    from matplotlib.ticker import NullFormatter, ScalarFormatter

    figure, axes = _grid(1, 2, (8.5, 3.6))
    for kind, at in zip(KINDS, axes[0], strict=True):
        found = [one for group in SETS for one in results.of(group, _USUAL)]
        raw = np.array([max(one.scores["raw", kind].true, 1) for one in found])
        for variant, colour, mark in (("CLAHE", _COLOURS[5], "x"), ("enhanced", _COLOURS[0], "o")):
            own = [max(one.scores[variant, kind].true, 1) for one in found]
            at.loglog(raw, own, mark, color=colour, ms=4, mew=1, ls="none", label=variant)
        ends = np.array([raw.min(), raw.max()])
        at.loglog(ends, ends, color="black", lw=0.8, label="as raw")
        at.loglog(ends, 1.2 * ends, color="black", lw=0.8, ls=":", label="1.2 times")
        at.set_title(kind.upper(), loc="left")
        for axis in (at.xaxis, at.yaxis):
            axis.set_major_formatter(ScalarFormatter())
            axis.set_minor_formatter(NullFormatter())
        at.set_xlabel("true matches, raw")
    axes[0, 0].set_ylabel("true matches")
    axes[0, 1].legend(loc="lower right")
    return figure
