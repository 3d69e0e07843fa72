"""Image pairs that were of no use, for the user: which, from when to when, and why."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from graphnav.errors import LogError
from graphnav.frontends.image_pairs import FIX_FOLDER
from graphnav.frontends.stereo_sides import Skipped
from graphnav.log import StereoPairs

#: So many reasons are told.
_REASONS = 3
_FIX_DARK = "check the images, or choose an enhancement for dark ones (stereo_tracks.enhance)"


def skipped_notes(pairs: StereoPairs, skipped: Sequence[Skipped]) -> tuple[str, ...]:
    """One line for each of the commonest reasons.

    Parameters
    ----------
    skipped : in order of time.
    """
    lines = []
    for reason, count in Counter(each.reason for each in skipped).most_common(_REASONS):
        times = [each.t_s for each in skipped if each.reason == reason]
        row, file = _first(pairs, times[0], reason)
        span = f"at {times[0]:.1f} s" if count == 1 else f"from {times[0]:.1f} to {times[-1]:.1f} s"
        lines.append(
            f"{count} of {len(pairs)} image pairs were not used, {span}: {reason}"
            f" ({'' if count == 1 else 'the first: '}{file}, row {row + 1} of the table stereo)"
        )
    return tuple(lines)


def none_of_use(pairs: StereoPairs, skipped: Sequence[Skipped]) -> LogError:
    """The error for a log of which every pair was skipped: the commonest reason, at its first file."""
    reason, count = Counter(each.reason for each in skipped).most_common(1)[0]
    first_s = next(each.t_s for each in skipped if each.reason == reason)
    row, file = _first(pairs, first_s, reason)
    problem = f"none of {len(pairs)} image pairs is of use; {count} times, here first: {reason}"
    where = file if pairs.folder is None else str(pairs.folder / file)
    fix = FIX_FOLDER if " file: " in reason else _FIX_DARK
    return LogError(problem, where=f"{where} (row {row + 1} of the table stereo)", fix=fix)


def _first(pairs: StereoPairs, t_s: float, reason: str) -> tuple[int, str]:
    """Row of the pair at a time, and the file of the side that the reason names."""
    row = int(np.argmin(np.abs(pairs.t_s - t_s)))
    side = pairs.right if "right image" in reason else pairs.left
    return row, str(side[row])
