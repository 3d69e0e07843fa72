"""Outcomes of the INS/LiDAR reproduction as files: rows, page and pictures are made of them again without a run."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.papers._lidar_cases import Course, Found, Job

#: Digits kept of metres and minutes of arc.
_DIGITS = 6


def file_of(job: Job, folder: Path) -> Path:
    """Where a job's outcome is kept."""
    return folder / f"{job.world}-{job.seed}-{job.part}.json"


def keep(job: Job, outcome: Found | str, folder: Path) -> None:
    """Write an outcome, whole or not at all."""
    folder.mkdir(parents=True, exist_ok=True)
    held = {"failed": outcome} if isinstance(outcome, str) else _plain(outcome)
    beside = file_of(job, folder).with_suffix(".part")
    beside.write_text(json.dumps(held, allow_nan=False), encoding="utf-8")
    beside.replace(file_of(job, folder))


def kept(job: Job, folder: Path) -> Found | str | None:
    """A kept outcome, or None."""
    path = file_of(job, folder)
    if not path.exists():
        return None
    held = json.loads(path.read_text(encoding="utf-8"))
    if "failed" in held:
        return str(held["failed"])
    courses = {name: Course(**_arrays(course)) for name, course in held.pop("courses").items()}
    cuts = tuple((start, end) for start, end in held.pop("cuts"))
    return Found(courses=courses, cuts=cuts, **_arrays(held))


def _plain(value: Any) -> Any:
    """Of what JSON has: objects, lists, numbers."""
    if isinstance(value, Found | Course):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, dict):
        return {name: _plain(one) for name, one in value.items()}
    if isinstance(value, tuple):
        return [_plain(one) for one in value]
    return np.round(value, _DIGITS).tolist() if isinstance(value, np.ndarray) else value


def _arrays(held: dict[str, Any]) -> dict[str, Any]:
    """Lists as arrays, everything else as it is."""
    return {name: np.array(value) if isinstance(value, list) else value for name, value in held.items()}
