"""Compilation of loops over samples."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

from numba import njit

F = TypeVar("F", bound=Callable[..., object])


def compiled(function: F) -> F:
    """Machine code on the first call, kept in a cache for later processes where there is a place to write it.

    Other threads run meanwhile.
    """
    try:
        return cast(F, njit(cache=True, nogil=True, error_model="numpy")(function))
    except RuntimeError:  # neither beside the file nor in the user's cache folder
        return cast(F, njit(nogil=True, error_model="numpy")(function))


def inlined(function: F) -> F:
    """Code that becomes part of each compiled function that calls it, for what is called millions of times."""
    return cast(F, njit(error_model="numpy", inline="always")(function))
