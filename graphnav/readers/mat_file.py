"""MATLAB files: variables checked as they are taken, with errors that name file, variable and row."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from graphnav._schema import Array
from graphnav.errors import LogError


class MatFile:
    """The variables of a MATLAB file (up to version 7.2)."""

    def __init__(self, path: Path) -> None:
        from scipy.io import loadmat

        self.path = path
        try:
            self._variables: dict[str, Any] = loadmat(str(path))
        except OSError as error:
            raise self._error(f"cannot be read ({error.strerror or error})", fix="check the file's rights") from None
        except Exception as error:  # whatever the parser stumbles over
            raise self._error(f"not a MATLAB file ({error})") from None

    @classmethod
    def first_of(cls, folder: Path, names: tuple[str, ...]) -> MatFile:
        """The first of these files that the folder has."""
        path = next((folder / name for name in names if (folder / name).is_file()), None)
        if path is None:
            raise LogError("no such file", where=str(folder / names[0]), fix="pass the folder of the recording")
        return cls(path)

    def array(self, name: str, shape: tuple[int | None, ...]) -> Array:
        """A variable of finite numbers; None in the shape is any length."""
        if name not in self._variables:
            raise self._error("missing variable", column=name)
        value = np.asarray(self._variables[name])
        if value.dtype.kind not in "fiub":
            raise self._error("not numeric", column=name)
        if value.ndim != len(shape) or any(n not in (None, m) for n, m in zip(shape, value.shape, strict=True)):
            wanted = " x ".join("N" if n is None else str(n) for n in shape)
            raise self._error(f"{' x '.join(map(str, value.shape))} numbers, expected {wanted}", column=name)
        bad = ~np.isfinite(value)
        if bad.any():
            raise self._error("expected a finite number", row=int(np.argwhere(bad)[0][0]), column=name)
        return np.asarray(value, float)

    def column(self, name: str, count: int | None = None) -> Array:
        """A column (N,); `count` rows, where that is known."""
        return self.array(name, (count, 1))[:, 0]

    def number(self, name: str) -> float:
        """A single number."""
        return float(self.column(name, 1)[0])

    def sigma(self, name: str) -> float:
        """The square root of a variance."""
        variance = self.number(name)
        if variance <= 0:
            raise self._error(f"variance {variance:g}, expected above zero", column=name)
        return math.sqrt(variance)

    def times(self, name: str, *, row: bool = False) -> Array:
        """Ascending times (N,), at least two; a column or, in some files, a row."""
        t_s = self.array(name, (1, None))[0] if row else self.column(name)
        if len(t_s) < 2:
            raise self._error(f"{len(t_s)} rows, expected at least 2", column=name)
        wrong = np.flatnonzero(np.diff(t_s) <= 0)
        if len(wrong):
            raise self._error("time does not ascend", row=int(wrong[0]) + 1, column=name)
        return t_s

    def _error(self, problem: str, fix: str = "fetch it again", **place: Any) -> LogError:
        return LogError(problem, where=str(self.path), fix=fix, **place)
