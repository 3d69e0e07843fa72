"""Measured runs, each in a process of its own: its peak memory is that run's and nothing else's.

The high-water mark of the child's own memory map, since ``ru_maxrss`` may count what its parent held at the fork.
"""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from typing import Any

from benchmarks._report import ROOT
from graphnav._memory import peak_bytes

_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Outcome:
    """What one run returned, or why it did not.

    Attributes
    ----------
    result : the task's own figures; empty when it failed.
    peak_gb : peak resident memory of the process, 1e9 bytes.
    error : one line, or None.
    """

    result: dict[str, Any]
    peak_gb: float | None
    error: str | None = None

    @property
    def failed(self) -> bool:
        """Whether there is no result."""
        return self.error is not None


def measured(task: str, arguments: dict[str, Any], limit_s: float | None = None) -> Outcome:
    """Run ``module:function`` with keyword arguments in a child on one thread; stopped after `limit_s`."""
    env = {**os.environ, **dict.fromkeys(_THREADS, "1")}
    env["PYTHONPATH"] = os.pathsep.join(filter(None, [str(ROOT), env.get("PYTHONPATH")]))
    command = [sys.executable, "-m", "benchmarks._measure", task, json.dumps(arguments)]
    try:
        done = subprocess.run(
            command, env=env, cwd=ROOT, stdout=subprocess.PIPE, text=True, timeout=limit_s, check=False
        )
    except subprocess.TimeoutExpired:
        return Outcome({}, None, f"stopped after {limit_s:g} s")
    if done.returncode != 0 or not done.stdout.strip():
        return Outcome({}, None, f"exit status {done.returncode}")
    found = json.loads(done.stdout.splitlines()[-1])
    return Outcome(found["result"], found["peak_gb"], found["error"])


def peak_gb() -> float:
    """Peak resident memory of this process so far, 1e9 bytes."""
    return peak_bytes() / 1e9


def child(task: str, arguments: str) -> None:
    """In the child: run the task, print what it returned; an error is reported, not raised."""
    module, name = task.split(":")
    error, result = None, {}
    try:
        result = getattr(importlib.import_module(module), name)(**json.loads(arguments))
    except Exception as problem:
        error = f"{type(problem).__name__}: {' '.join(str(problem).split())[:160]}"
        print(error, file=sys.stderr)
    # a task that goes on after what is measured notes its peak itself
    print(json.dumps({"result": result, "peak_gb": result.pop("peak_gb", None) or peak_gb(), "error": error}))


class Stopwatch:
    """Elapsed seconds per stage, and processor seconds of all of them."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.cpu_s = 0.0
        self.restart()

    def restart(self) -> None:
        """Count nothing that went before."""
        self._last, self._cpu = time.perf_counter(), time.process_time()

    def lap(self, stage: str) -> None:
        """Everything since the last lap was `stage`."""
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - self._last
        self.cpu_s += time.process_time() - self._cpu
        self.restart()

    def total(self) -> dict[str, float]:
        """Stages and their sum."""
        return {**self.seconds, "total": sum(self.seconds.values())}


if __name__ == "__main__":
    child(sys.argv[1], sys.argv[2])
