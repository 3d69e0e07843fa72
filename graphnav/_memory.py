"""Memory: its peak, and large arrays in unlinked temporary files, so that a shift's raw samples need not stay in
memory while the graph is solved.

A solve of 7 h takes 0.5 GB for its Bayes tree alone; the 2.5 million IMU rows behind it are read once before and
perhaps once after. In a mapped file the operating system may drop their pages, and `release` asks it to.
"""

from __future__ import annotations

import mmap
import sys
import tempfile
from typing import Any

import numpy as np
import numpy.typing as npt

#: Smaller arrays are not worth a file.
_LARGE_BYTES = 16 << 20


def allocate(shape: tuple[int, ...], dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    """Like `numpy.empty`; large numeric arrays are backed by a temporary file where one can be had."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    if size < _LARGE_BYTES or np.dtype(dtype).hasobject:
        return np.empty(shape, dtype)
    try:
        with tempfile.TemporaryFile(prefix="graphnav-") as file:
            file.truncate(size)
            mapped = mmap.mmap(file.fileno(), size)
    except OSError:
        return np.empty(shape, dtype)
    return np.frombuffer(mapped, dtype).reshape(shape)


def peak_bytes() -> int:
    """Peak resident memory of this process.

    Linux's ``ru_maxrss`` may count what a large parent held at the fork; the high-water mark of the process's own
    memory map does not.
    """
    try:
        with open("/proc/self/status", encoding="ascii") as status:
            for line in status:
                if line.startswith("VmHWM:"):
                    return int(line.split()[1]) * 1024
    except OSError:
        pass
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def release(*arrays: npt.NDArray[Any] | None) -> None:
    """Let go of the memory of arrays made by `allocate`, or views of them; their values stay. Others are left alone."""
    for array in arrays:
        base: Any = array
        while isinstance(base, np.ndarray):
            base = base.base
        base = base.obj if isinstance(base, memoryview) else base
        if isinstance(base, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
            base.madvise(mmap.MADV_DONTNEED)
