"""The demonstration: a simulated shearer and a recorded drive, smoothed, judged and drawn."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from graphnav.errors import GraphnavError

if TYPE_CHECKING:
    from graphnav.evaluation import Evaluation, WithheldError
    from graphnav.log import Position, SensorLog
    from graphnav.run import Run

SEED = 11
#: SEP per cycle, m: Zheng et al., Micromachines 12 (2021) 1527, Table 3, Kalman filter and RTS smoother.
PAPER_SEP_M = (0.50, 0.32, 0.13, 0.17)
#: Folders of the two.
_SHEARER, _DRIVE = "shearer-mems", "kitti-gtsam"
ProgressHook = Callable[[str, float, float], None]


@dataclass(frozen=True)
class Demo:
    """Both runs with their figures."""

    folder: Path
    shearer: Run
    shearer_errors: Evaluation
    drive: Run
    drive_errors: WithheldError
    seconds: float

    def to_dict(self) -> dict[str, Any]:
        """Figures for ``graphnav demo --json``."""
        return {
            "folder": str(self.folder),
            "seconds": self.seconds,
            "shearer_mems": {
                "seed": SEED,
                "errors": self.shearer_errors.to_dict(),
                "paper_sep_m": list(PAPER_SEP_M),
                "seconds": self.shearer.diagnostics.seconds,
            },
            "kitti_gtsam": {
                "withheld": self.drive_errors.to_dict(),
                "seconds": self.drive.diagnostics.seconds,
            },
        }


def run_demo(folder: str | Path, progress: ProgressHook | None = None) -> Demo:
    """Run the demonstration.

    Parameters
    ----------
    folder : gets ``shearer-mems/`` and ``kitti-gtsam/``, each with ``log/``, ``run/`` and ``run.png``.
    progress : called as ``progress(stage, done, total)``.

    Raises
    ------
    GraphnavError
        The folder is a file or a log, holds what is not replaced, or cannot be written.
    """
    begun = time.perf_counter()
    folder = Path(folder)
    _check_output(folder)
    shearer, shearer_errors = _shearer(folder / _SHEARER, progress)
    drive, drive_errors = _drive(folder / _DRIVE, progress)
    return Demo(folder, shearer, shearer_errors, drive, drive_errors, time.perf_counter() - begun)


def show(demo: Demo) -> None:
    """Print the figures and where the files are, on standard error."""
    from graphnav.report.terminal import say, table, withheld_table

    rows = [
        (f"cycle {cycle.cycle}", f"{cycle.sep_m:.3f}", f"{paper:.2f}")
        for cycle, paper in zip(demo.shearer_errors.per_cycle, PAPER_SEP_M, strict=True)
    ]
    title = f"Shearer, simulated (shearer-mems, seed {SEED}): SEP (m)"
    table(title, ("", "graphnav", "paper: KF + RTS, its own recording"), rows)
    east, north, up = demo.shearer_errors.rms_m
    say(f"rms {east:.3f} / {north:.3f} / {up:.3f} m east / north / up")
    withheld_table("Car, recorded drive of 472 s (KITTI, from the gtsam package)", demo.drive_errors)
    say("")
    for name in (_SHEARER, _DRIVE):
        say(f"{demo.folder / name}: log/, run/ and run.png")
    say(f"{demo.seconds:.0f} s in all")


def _check_output(folder: Path) -> None:
    """Refuse a folder that does not take all the results, before there is one of them."""
    from graphnav.readers.writer import check_output
    from graphnav.report.plots import check_picture
    from graphnav.report.results import check_folder, check_writable

    try:
        file, log = folder.is_file(), (folder / "log.toml").exists()
    except OSError as error:  # a name longer than names may be
        raise GraphnavError(f"{folder}: cannot be written ({error.strerror or error})") from error
    if file:
        raise GraphnavError(f"{folder}: is a file; give a folder")
    if log:
        raise GraphnavError(f"{folder}: is a log folder; give another folder")
    for part in (folder / _SHEARER, folder / _DRIVE):
        check_output(part / "log")
        check_folder(part / "run")
        check_writable(part / "run")
        check_picture(part / "run.png")


def _shearer(folder: Path, progress: ProgressHook | None) -> tuple[Run, Evaluation]:
    """Simulate, smooth and judge by the simulator's truth."""
    from graphnav.evaluation import evaluate
    from graphnav.simulation import simulate

    log = simulate("shearer-mems", seed=SEED)
    run = _smoothed(log, folder, progress)
    evaluation = evaluate(run.trajectory, log)
    _keep(run, log, folder, evaluation=evaluation)
    return run, evaluation


def _drive(folder: Path, progress: ProgressHook | None) -> tuple[Run, WithheldError]:
    """Convert, withhold every other position, smooth and judge by the positions withheld."""
    from graphnav.evaluation import withheld_error
    from graphnav.readers import kitti_gtsam

    log, withheld = kitti_gtsam.split(kitti_gtsam.convert(None))
    run = _smoothed(log, folder, progress)
    _keep(run, log, folder, withheld=withheld)
    return run, withheld_error(run.trajectory, withheld)


def _smoothed(log: SensorLog, folder: Path, progress: ProgressHook | None) -> Run:
    """Write the log, so that it can be smoothed again by hand, and smooth it."""
    from graphnav.readers import write
    from graphnav.smooth import smooth

    write(log, folder / "log")
    return smooth(replace(log, truth=None), progress=progress)


def _keep(
    run: Run,
    log: SensorLog,
    folder: Path,
    evaluation: Evaluation | None = None,
    withheld: Position | None = None,
) -> None:
    from graphnav.report.plots import plot_run
    from graphnav.report.results import save

    save(run, folder / "run", evaluation=evaluation)
    plot_run(run.trajectory, log, folder / "run.png", evaluation, withheld)
