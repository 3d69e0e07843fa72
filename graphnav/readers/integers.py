"""Whole numbers stored as floats."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from graphnav.errors import LogError


def whole_numbers(values: npt.NDArray[Any], where: str, column: str, row: int = 0) -> npt.NDArray[np.int64]:
    """``(N,)`` numbers as int64, refusing any that is not whole.

    Parameters
    ----------
    values : ``(N,)`` integers or floats.
    where, column : the place for error texts.
    row : 0-based row of the first value.

    Raises
    ------
    LogError
        A value with a fraction, not finite, or too large.
    """
    whole: npt.NDArray[np.int64]
    if values.dtype.kind == "f":
        floats = values.astype(float)
        with np.errstate(invalid="ignore"):
            bad = ~((floats == np.floor(floats)) & (np.abs(floats) < 2.0**53))
    else:
        bad = values > np.iinfo(np.int64).max if values.dtype.kind == "u" else np.zeros(len(values), bool)
    if bad.any():
        index = int(np.argmax(bad))
        problem = f"value {values[index]}, expected a whole number"
        raise LogError(problem, where=where, row=row + index, column=column)
    whole = values.astype(np.int64)
    return whole
