"""What the pages of the papers have in common: paragraphs, tables, links to pictures, and writing them whole."""

from __future__ import annotations

import os
import re
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path


def save(path: Path, parts: Iterable[str]) -> None:
    """Write a page of parts, those that are empty left out; whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f".{path.name}.part")
    beside.write_text("\n\n".join(part.strip() for part in parts if part) + "\n", encoding="utf-8")
    beside.replace(path)


class Pictures:
    """Pictures that were drawn, by name, their captions, and the folder of the page that shows them."""

    def __init__(self, drawn: Mapping[str, Path], captions: Mapping[str, str], folder: Path) -> None:
        self.drawn, self.captions, self.folder = drawn, captions, folder

    def link(self, name: str) -> str:
        """A link to a picture; nothing where it was not drawn."""
        if name not in self.drawn:
            return ""
        return f"![{self.captions[name]}]({os.path.relpath(self.drawn[name], self.folder)})"


def filled(part: str) -> str:
    """Paragraphs and items broken anew, since figures change their length; everything else as it is."""
    blocks = []
    for block in part.split("\n\n"):
        if block.startswith(("|", "#", "!", "`")):
            blocks.append(block)
            continue
        items = re.split(r"\n(?=- )", block)
        blocks.append("\n".join(_wrapped(item) for item in items))
    return "\n\n".join(blocks)


def _wrapped(item: str) -> str:
    hanging = "  " if item.startswith("- ") else ""
    words = " ".join(item.split())
    return textwrap.fill(words, 120, subsequent_indent=hanging, break_long_words=False, break_on_hyphens=False)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table, the first column left."""
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def metres(values: Iterable[float]) -> list[str]:
    """To millimetres, or to centimetres from 10 m on."""
    return [f"{value:.3f}" if value < 10 else f"{value:.2f}" for value in values]


def number(value: float | None) -> str:
    """Three digits; whole numbers from a hundred on."""
    if value is None:
        return "-"
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"
