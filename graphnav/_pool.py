"""Work on many items in worker processes, results in order, and few of them waiting at a time.

A worker process begins by reading the user's script again. One without ``if __name__ == "__main__":`` would then do
all its work in every worker, and start workers of its own: such a worker leaves without a word, and the script's own
process does the work alone.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
#: Items that a worker takes at a time by default.
BATCH = 4
#: Batches per worker that are done or under way: results may be large.
_AHEAD = 3
#: With fewer items than this a worker's start, about a second, costs more than it saves.
_WORTH_IT = 100
_UNGUARDED = (
    "worker processes ended before they began, and all is done in this process alone, which is slower. "
    'If this is a script of yours, put its calls under: if __name__ == "__main__":'
)


def in_order(
    work: Callable[[Item], Result], items: Sequence[Item], workers: int | None = None, *, batch: int = BATCH
) -> Iterator[Result]:
    """What `work` returns for each item, in their order.

    Parameters
    ----------
    work : can be pickled, as can what it returns.
    items : what it is called with.
    workers : number of processes; 1 works in this one; None takes one per core if there are many items, and none where
        this is a worker process itself.
    batch : items that a worker takes at a time; `work` is pickled with each batch.
    """
    leave_if_starting()
    if workers is None:
        alone = len(items) < _WORTH_IT or multiprocessing.parent_process() is not None
        workers = 1 if alone else os.cpu_count() or 1
    workers = min(workers, -(-len(items) // batch))
    if workers <= 1:
        yield from map(work, items)
        return
    done = 0
    try:
        for result in _pooled(work, items, workers, batch):
            yield result
            done += 1
    except BrokenProcessPool:
        if done:
            raise
        warnings.warn(_UNGUARDED, RuntimeWarning, stacklevel=2)
        yield from map(work, items)


def leave_if_starting() -> None:
    """End a worker process that is still reading the user's script, and came here because of a call in it."""
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        sys.exit(0)


def _pooled(work: Callable[[Item], Result], items: Sequence[Item], workers: int, batch: int) -> Iterator[Result]:
    with _single_threads(), ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        try:
            yield from _windowed(pool, work, items, batch, workers * _AHEAD)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _windowed(
    pool: ProcessPoolExecutor, work: Callable[[Item], Result], items: Sequence[Item], batch: int, ahead: int
) -> Iterator[Result]:
    pending: deque[Future[list[Result]]] = deque()
    for start in range(0, len(items), batch):
        pending.append(pool.submit(_each, work, items[start : start + batch]))
        if len(pending) >= ahead:
            yield from pending.popleft().result()
    while pending:
        yield from pending.popleft().result()


def _each(work: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    return [work(item) for item in items]


@contextmanager
def _single_threads() -> Iterator[None]:
    """One thread for the libraries of processes started within: they read this when they are loaded."""
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
