"""What following features through the pairs of a log gives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from graphnav.frontends.stereo_sides import Skipped
from graphnav.log import StereoTracks


@dataclass(frozen=True)
class Tracked:
    """Features followed through a log's image pairs.

    Attributes
    ----------
    tracks : the table.
    t_s, counts : (K,) times of the frames that were used, and the number of features in each.
    skipped : the frames that were not, and why.
    seconds : how long it took.
    """

    tracks: StereoTracks
    t_s: npt.NDArray[np.float64]
    counts: npt.NDArray[np.int64]
    skipped: tuple[Skipped, ...]
    seconds: float

    @property
    def mean_length(self) -> float:
        """Frames in which a track is seen, on average."""
        return len(self.tracks) / len(np.unique(self.tracks.track))
