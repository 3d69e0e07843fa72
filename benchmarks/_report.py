"""The one object that every script prints: machine, versions, rows.

Standard library only, so that a parent of measured processes stays small.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import os
import platform
import sys
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("gtsam", "numpy", "scipy", "pyarrow")


@dataclass(frozen=True)
class Target:
    """What an issue or scenario asks of a figure, of its ratio to the peer's figure, or of its size within a band.

    Attributes
    ----------
    low, high : bounds, both included; None for none.
    of_ratio : the bounds are the ratio's.
    """

    low: float | None = None
    high: float | None = None
    of_ratio: bool = False

    def text(self, unit: str) -> str:
        """For readers, as in ``<= 1 GB`` or ``<= 1 x peer``."""
        parts = [f">= {self.low:g}"] if self.low is not None else []
        parts += [f"<= {self.high:g}"] if self.high is not None else []
        tail = "x peer" if self.of_ratio else unit if unit != "1" else ""
        return f"{', '.join(parts)} {tail}".strip()

    def met_by(self, value: float | None) -> bool:
        """Whether a figure meets it; one that could not be measured does not."""
        if value is None or not math.isfinite(value):
            return False
        return (self.low is None or value >= self.low) and (self.high is None or value <= self.high)


@dataclass(frozen=True)
class Row:
    """One figure. `peer` is the peer's figure in the same unit, `ratio` the value by the peer's."""

    name: str
    value: float | None
    unit: str
    peer: float | None
    ratio: float | None
    target: str | None
    met: bool | None


def row(name: str, value: float | None, unit: str, *, peer: float | None = None, target: Target | None = None) -> Row:
    """Make a row; a value or peer that is missing or not finite becomes None, and then no target is met."""
    value, peer = _finite(value), _finite(peer)
    ratio = value / peer if value is not None and peer else None
    if target is None:
        return Row(name, value, unit, peer, ratio, None, None)
    return Row(name, value, unit, peer, ratio, target.text(unit), target.met_by(ratio if target.of_ratio else value))


def _finite(value: float | None) -> float | None:
    return float(value) if value is not None and math.isfinite(value) else None


def exponent(x: list[float], y: list[float]) -> float | None:
    """Least-squares slope of log y on log x; None with fewer than two different x."""
    if len(set(x)) < 2:
        return None
    log_x, log_y = [math.log(v) for v in x], [math.log(v) for v in y]
    mean_x, mean_y = sum(log_x) / len(log_x), sum(log_y) / len(log_y)
    spread = sum((v - mean_x) ** 2 for v in log_x)
    return sum((v - mean_x) * (w - mean_y) for v, w in zip(log_x, log_y, strict=True)) / spread


def sources_id(*folders: str) -> str:
    """Short hash of the project's Python files in the given folders: what a cached log depends on."""
    digest = hashlib.sha256()
    for folder in folders:
        for path in sorted((ROOT / folder).rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:10]


@dataclass(frozen=True)
class Before:
    """What was so before the measurements began.

    Attributes
    ----------
    machine : its load was not yet the benchmark's own; sources : hash of the code that is measured.
    """

    machine: dict[str, Any]
    sources: str

    @classmethod
    def now(cls) -> Before:
        """Take note."""
        return cls(machine(), sources_id("graphnav", "factors", "benchmarks"))


def machine() -> dict[str, Any]:
    """Processor, cores, memory, system."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "load_1_min": round(os.getloadavg()[0], 2),
        "memory_gb": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9, 1),
        "system": f"{platform.system()} {platform.release()}",
    }


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def versions(before: Before) -> dict[str, str]:
    """Python, graphnav with a hash of its sources, and what it computes with.

    Sources that changed meanwhile are named: the figures are then of no one version.
    """
    import graphnav

    known = {name: metadata.version(name) for name in PACKAGES}
    after = Before.now().sources
    sources = before.sources if after == before.sources else f"{before.sources}, changed during the run to {after}"
    if after != before.sources:
        say("warning: the sources changed during the run; its figures are of no one version")
    return {"python": platform.python_version(), "graphnav": graphnav.__version__, "sources": sources, **known}


def parser(description: str | None) -> argparse.ArgumentParser:
    """Arguments that every script has."""
    made = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--json", action="store_true", help="print one JSON object on standard output")
    return made


def say(text: str) -> None:
    """Progress, to standard error."""
    print(text, file=sys.stderr, flush=True)


def publish(rows: Iterable[Row], as_json: bool, before: Before) -> None:
    """Print the object, or a table for people."""
    rows, known = list(rows), versions(before)
    if as_json:
        found = {"machine": before.machine, "versions": known, "rows": [asdict(r) for r in rows]}
        print(json.dumps(found, indent=1, allow_nan=False), flush=True)
        return
    width = max((len(r.name) for r in rows), default=4)
    print(f"{'':{width}}  {'value':>11} {'unit':7} {'peer':>11} {'ratio':>7}  target")
    for r in rows:
        verdict = "" if r.met is None else f"{r.target}: {'met' if r.met else 'NOT MET'}"
        print(
            f"{r.name:{width}}  {_cell(r.value):>11} {r.unit:7} {_cell(r.peer):>11} {_cell(r.ratio, 3):>7}  {verdict}"
        )


def _cell(value: float | None, digits: int = 5) -> str:
    return "-" if value is None else f"{value:.{digits}g}"
