"""Seconds and progress of the stages of a run."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

ProgressHook = Callable[[str, float, float], None]


class Stages:
    """Seconds per stage, and progress passed on with the stage's name."""

    def __init__(self, hook: ProgressHook | None) -> None:
        self.hook = hook
        self.began = time.perf_counter()
        self.seconds = dict.fromkeys(("read", "frontend", "assemble", "solve", "covariance"), 0.0)

    @contextmanager
    def stage(self, name: str) -> Iterator[Callable[[float, float], None] | None]:
        """Time one stage; yields what reports its progress, or None."""
        began = time.perf_counter()
        hook = self.hook
        if hook is None:
            yield None
        else:
            hook(name, 0, 1)
            yield lambda done, total: hook(name, done, total)
            hook(name, 1, 1)
        self.seconds[name] += time.perf_counter() - began

    def total(self) -> dict[str, float]:
        """Seconds of every stage and in total."""
        return {**self.seconds, "total": time.perf_counter() - self.began}
