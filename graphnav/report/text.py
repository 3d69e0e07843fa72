"""Values as text for machines: plain Python values, strict JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np


def plain(value: Any) -> Any:
    """A value as plain dicts, lists and numbers: numpy arrays, dataclasses and pydantic models unpacked."""
    if hasattr(value, "model_dump"):
        return plain(value.model_dump())
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, str | bool | int | float) or value is None:
        return value
    if isinstance(value, Iterable):
        return [plain(item) for item in value]
    return plain(vars(value))


def to_json(value: Any) -> str:
    """Strict JSON, indented; a number that JSON cannot hold (NaN, infinity) becomes null."""
    return json.dumps(_finite(plain(value)), indent=2, allow_nan=False, ensure_ascii=False)


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
