"""Advice for a name that is not known."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

_UNIT_WORDS = {"m", "s", "s2", "rad", "deg", "h", "mg", "sqrt", "hz", "db", "px", "per"}


def hint(name: str, known: Iterable[str]) -> str:
    """Advice for an unknown name: the closest known one (units are part of a name), else all of them."""
    known = list(known)
    longer = sorted((k for k in known if k.startswith(f"{name}_")), key=len)
    close = longer or difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    if not close:
        return f"expected one of: {', '.join(known)}"
    why = " (the unit is part of the name)" if longer and _is_unit(close[0].removeprefix(name)) else ""
    return f'did you mean "{close[0]}"{why}?'


def _is_unit(suffix: str) -> bool:
    return set(suffix.strip("_").split("_")) <= _UNIT_WORDS
