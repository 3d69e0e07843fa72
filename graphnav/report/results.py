"""The run folder: trajectory.parquet, trajectory.tum, config.toml and summary.json.

With UWB ranges also ranges.parquet and ranges.png, what the solution leaves of each. A folder is written beside its
place and renamed into it, so that a reader never meets half a result and a failed run leaves what was there before.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from graphnav._outputs import check_makable
from graphnav._schema import Array
from graphnav.errors import GraphnavError
from graphnav.evaluation import Evaluation
from graphnav.report.text import to_json
from graphnav.trajectory import Trajectory

FILES = ("trajectory.parquet", "trajectory.tum", "config.toml", "summary.json")
#: And with UWB ranges.
RANGE_FILES = ("ranges.parquet", "ranges.png")

_UPPER = tuple((i, j) for i in range(3) for j in range(i, 3))
_STATE = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz", "vx_m_s", "vy_m_s", "vz_m_s")
#: Column prefix -> first row of its block in the 9x9 covariance. Velocity (n, m^2/s^2) comes after the rest.
_BLOCKS = {"p": 3, "a": 0, "v": 6}


class RunLike(Protocol):
    """What a run must have to be saved; see `graphnav.smooth.Run`."""

    @property
    def trajectory(self) -> Trajectory:
        """States at the keyframes."""

    @property
    def calibration(self) -> Mapping[str, Any]:
        """Name -> object with `value`, `sigma`, `unit`."""

    @property
    def diagnostics(self) -> Any:
        """What summary.json reports."""

    @property
    def config(self) -> Any:
        """The effective configuration, with `to_toml`."""


def save(
    run: RunLike,
    folder: str | Path,
    *,
    evaluation: Evaluation | None = None,
    overwrite: bool = False,
) -> Path:
    """Write a run folder.

    Parameters
    ----------
    run : trajectory, calibration (name -> value, sigma, unit), diagnostics and effective configuration.
    folder : where to; parents are made. A run that is there already is replaced.
    evaluation : figures against truth, for summary.json.
    overwrite : also replace a folder that holds anything else; a log folder is never replaced.

    Raises
    ------
    GraphnavError
        The folder may not be replaced or cannot be written, or the trajectory is not finite.
    """
    target = check_folder(folder, overwrite=overwrite)
    state = np.column_stack([getattr(run.trajectory, name) for name in ("pos_n", "quat_nb", "vel_n")])
    if not np.isfinite(state).all():
        when = run.trajectory.t_s[np.argmax(~np.isfinite(state).all(axis=1))]
        raise GraphnavError(f"the trajectory at {when:.3f} s is not finite; nothing was written")
    beside = target.parent / f".{target.name}.writing-{os.getpid()}"
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(beside, ignore_errors=True)
        beside.mkdir()
        _write_parquet(run.trajectory, beside / "trajectory.parquet")
        _write_tum(run.trajectory, beside / "trajectory.tum")
        (beside / "config.toml").write_text(run.config.to_toml(), encoding="utf-8")
        (beside / "summary.json").write_text(to_json(_summary(run, evaluation)) + "\n", encoding="utf-8")
        if getattr(run, "ranges", None) is not None:
            from graphnav.report.ranges import plot, write

            write(run.ranges, beside / "ranges.parquet")  # type: ignore[attr-defined]
            plot(run.ranges, beside / "ranges.png")  # type: ignore[attr-defined]
        _move_into_place(beside, target)
    except OSError as error:
        raise _unwritable(target, error) from error
    finally:
        shutil.rmtree(beside, ignore_errors=True)
    return target


def load(folder: str | Path) -> Trajectory:
    """Read the trajectory of a run folder.

    The files keep the covariance blocks of attitude, position and velocity; the blocks between them are
    unknown here and come back as NaN. A trajectory saved without covariances has none.

    Raises
    ------
    GraphnavError
        No run folder, a table that cannot be read, or a column that is missing or not finite.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = Path(folder) / "trajectory.parquet"
    if not path.is_file():
        is_log = (path.parent / "log.toml").is_file()
        problem = "is a log: the run comes first, then the log" if is_log else "no trajectory.parquet"
        raise GraphnavError(f"{folder}: {problem}; give a folder that `graphnav smooth` wrote")
    try:
        table = pq.read_table(path)
    except (pa.ArrowInvalid, OSError) as error:
        raise GraphnavError(f"{path}: not a readable parquet file ({str(error).splitlines()[0]})") from None
    names = ("t_s", *_STATE, *_cov_columns("p"), *_cov_columns("a"))
    missing = [name for name in names if name not in table.column_names]
    if missing:
        raise GraphnavError(f"{path}: no column {missing[0]}; run `graphnav smooth` again")
    try:
        values = {name: table[name].to_numpy().astype(float) for name in table.column_names}
    except ValueError as error:
        raise GraphnavError(f"{path}: a column is not numeric ({error})") from None
    state = np.column_stack([values[name] for name in ("t_s", *_STATE)])
    if not np.isfinite(state).all():
        row, col = np.argwhere(~np.isfinite(state))[0]
        raise GraphnavError(f"{path}, row {row + 1}, {('t_s', *_STATE)[col]}: not a finite number")
    if (np.diff(state[:, 0]) <= 0).any():
        row = int(np.argmax(np.diff(state[:, 0]) <= 0)) + 1
        raise GraphnavError(f"{path}, row {row + 1}, t_s: time does not ascend")
    return Trajectory(
        t_s=state[:, 0], pos_n=state[:, 1:4], quat_nb=state[:, 4:8], vel_n=state[:, 8:], cov=_read_cov(values)
    )


def log_of(folder: str | Path) -> str | None:
    """Name of the log that a run was made of; None where its summary.json does not tell."""
    try:
        known = json.loads((Path(folder) / "summary.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    name = known.get("log") if isinstance(known, dict) else None
    return name if isinstance(name, str) else None


def check_folder(folder: str | Path, *, overwrite: bool = False) -> Path:
    """The full path of a folder that a run may be written to; `GraphnavError` if it may not be replaced."""
    target = Path(folder).resolve()
    try:
        taken = target.exists()
    except OSError as error:  # a name longer than names may be, a folder that may not be looked into
        raise _unwritable(target, error) from error
    if taken and not target.is_dir():
        raise GraphnavError(f"{folder}: is a file; give a folder")
    if (target / "log.toml").exists():
        raise GraphnavError(f"{folder}: is a log folder and is never replaced; give another folder")
    if target.is_dir() and Path.cwd().is_relative_to(target):
        raise GraphnavError(f"{folder}: is the working folder or holds it; give a folder of the run's own")
    held = target.iterdir() if target.is_dir() else ()
    foreign = sorted(item.name for item in held if item.name not in FILES + RANGE_FILES)
    if foreign and not overwrite:
        raise GraphnavError(
            f"{folder}: holds {foreign[0]}, which is no part of a run; give another folder, or "
            "--overwrite to replace all of it"
        )
    return target


def check_writable(folder: str | Path) -> None:
    """Try whether a run folder can be made: to be told after an hour of smoothing that it cannot is late.

    Raises
    ------
    GraphnavError
        The nearest folder above it that exists takes no new folder.
    """
    target = Path(folder).resolve()
    try:
        check_makable(target)
    except OSError as error:
        raise _unwritable(target, error) from error


def _unwritable(target: Path, error: OSError) -> GraphnavError:
    return GraphnavError(f"{target}: cannot write the run folder ({error.strerror or error})")


def _summary(run: RunLike, evaluation: Evaluation | None) -> dict[str, Any]:
    known = run.diagnostics
    summary = {
        **({"log": run.log_name} if getattr(run, "log_name", "") else {}),  # type: ignore[attr-defined]
        "method": known.method,
        "converged": bool(known.converged),
        "iterations": known.iterations,
        "keyframes": known.keyframes,
        "seconds": known.seconds,
        "peak_rss_mb": known.peak_rss_mb,
        "calibration": {
            name: {"value": item.value, "sigma": item.sigma, "unit": item.unit}
            for name, item in run.calibration.items()
        },
        "rejected": known.rejected,
        "warnings": list(known.warnings),
    }
    if known.nis is not None:
        summary["nis"] = known.nis
    return summary if evaluation is None else {**summary, "errors": evaluation.to_dict()}


def _cov_columns(prefix: str) -> tuple[str, ...]:
    return tuple(f"{prefix}_{'xyz'[i]}{'xyz'[j]}" for i, j in _UPPER)


def _write_parquet(trajectory: Trajectory, path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    state = np.column_stack([trajectory.pos_n, trajectory.quat_nb, trajectory.vel_n])
    columns = {"t_s": trajectory.t_s, **{name: state[:, k] for k, name in enumerate(_STATE)}}
    for prefix, first in _BLOCKS.items():
        for name, (i, j) in zip(_cov_columns(prefix), _UPPER, strict=True):
            unknown = np.full(len(trajectory.t_s), np.nan)
            columns[name] = unknown if trajectory.cov is None else trajectory.cov[:, first + i, first + j]
    # NaN (unknown) becomes null, which every reader of parquet takes for a missing value.
    arrays = {name: pa.array(np.ascontiguousarray(column), from_pandas=True) for name, column in columns.items()}
    pq.write_table(pa.table(arrays), path, compression="zstd")


def _read_cov(values: Mapping[str, Array]) -> Array | None:
    """(N, 9, 9) with the known blocks filled and NaN elsewhere; None when no number is known."""
    cov = np.full((len(values["t_s"]), 9, 9), np.nan)
    for prefix, first in _BLOCKS.items():
        for name, (i, j) in zip(_cov_columns(prefix), _UPPER, strict=True):
            if name in values:
                cov[:, first + i, first + j] = cov[:, first + j, first + i] = values[name]
    return cov if np.isfinite(cov).any() else None


def _write_tum(trajectory: Trajectory, path: Path) -> None:
    """Time, position, quaternion x y z w; every number in its shortest form that reads back exactly."""
    rows = np.column_stack([trajectory.t_s, trajectory.pos_n, np.roll(trajectory.quat_nb, -1, axis=1)]).tolist()
    path.write_text("".join(" ".join(map(repr, row)) + "\n" for row in rows), encoding="utf-8")


def _move_into_place(beside: Path, target: Path) -> None:
    if not target.exists():
        beside.rename(target)
        return
    old = target.parent / f".{target.name}.old-{os.getpid()}"
    target.rename(old)
    try:
        beside.rename(target)
    except OSError:
        old.rename(target)
        raise
    shutil.rmtree(old, ignore_errors=True)
