"""Whether a run and a log belong together, and how much of the run its truth can judge."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from graphnav._schema import Array
from graphnav.errors import GraphnavError

if TYPE_CHECKING:
    from graphnav.log import SensorLog

#: Seconds that a run may go beyond what its log recorded: a log is smoothed within its own records.
_SLACK_S = 1.0
#: Share of the keyframes below which a reader must know that the figures leave most of the run unjudged.
_MOST = 0.5


def notes_of_another_log(t_s: Array, log: SensorLog, run_of: str | None) -> tuple[str, ...]:
    """What is to say where a run was made of a log of another name; nothing where the name is not known.

    Parameters
    ----------
    t_s : (N,) keyframes of the run; run_of : name of its log, None where that is not known.

    Raises
    ------
    GraphnavError
        The other name, and keyframes where this log recorded nothing: it is not the run's own.
    """
    if run_of is None or run_of == log.name:
        return ()
    times = [getattr(record, record.TIME) for record in log.tables().values()]
    first, last = min(t[0] for t in times), max(t[-1] for t in times)
    if t_s[0] < first - _SLACK_S or t_s[-1] > last + _SLACK_S:
        raise GraphnavError(
            f"the run is one of log {run_of}, {span(t_s)}, and log {log.name} was recorded from {span([first, last])};"
            " evaluate a run against its own log"
        )
    return (f"the run was made of log {run_of} and is judged by log {log.name}: its own log gives its errors",)


def notes_of_coverage(judged: npt.NDArray[np.bool_]) -> tuple[str, ...]:
    """What is to say where truth covers few of the keyframes (N,)."""
    share = float(judged.mean())
    if share >= _MOST:
        return ()
    return (f"truth covers {100 * share:.0f} % of the keyframes: the figures say nothing of the others",)


def span(t_s: Array | list[float]) -> str:
    """First and last of ascending times."""
    return f"{_second(t_s[0])} to {_second(t_s[-1])} s"


def _second(t_s: float) -> str:
    """To the millisecond, zero without a sign."""
    return f"{round(float(t_s), 3) + 0.0:.3f}"
