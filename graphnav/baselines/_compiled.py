"""Compilation of loops over samples, see `factors.compilation`."""

from __future__ import annotations

from factors.compilation import compiled, inlined

__all__ = ["compiled", "inlined"]
