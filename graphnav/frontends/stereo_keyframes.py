"""Which frames the motions of a stereo camera lead from and to.

Every keyframe's noise enters the motion to it and the one from it, and every motion adds an error of its own: the
fewest keyframes give the smallest drift. So the next keyframe is the last frame that still sees a given share of the
features that the frame after the keyframe shared with it, and is near enough for a graph to have poses where it needs
them. While the camera stands it goes on seeing the same features: one motion bridges the whole rest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from factors import so3
from graphnav.config import StereoMotionsConfig
from graphnav.frontends.stereo_frames import TrackedFrames
from graphnav.frontends.stereo_motion import MotionFailure, StereoMotion

#: A frame has to share this many times the fewest inliers to be reached over others.
_AMPLE = 2
#: Frames nearer by are tried this often for one that is near enough.
_NEARER = 4


#: The motion between two frames, given by their numbers.
MotionOf = Callable[[int, int], StereoMotion | MotionFailure]


class Link(NamedTuple):
    """A motion, or none, from one frame to another."""

    first: int
    second: int
    motion: StereoMotion | MotionFailure


@dataclass(frozen=True)
class Linker:
    """Chooses keyframes; `motion` gives the motion between two frames."""

    frames: TrackedFrames
    settings: StereoMotionsConfig
    motion: MotionOf

    def links(self) -> Iterator[Link]:
        """From the first frame to the last. Where even the next frame gives no motion, it is where it goes on."""
        at = 0
        while at < len(self.frames) - 1:
            link = self._next(at)
            yield link
            at = link.second

    def _next(self, at: int) -> Link:
        """The motion to the farthest frame that gives one and is near enough."""
        link = self._reached(at, self._last_shared(at))
        for _ in range(_NEARER):
            if link.second == at + 1 or isinstance(link.motion, MotionFailure):
                break
            excess = self._excess(link.motion)
            if excess <= 1:
                break
            link = self._reached(at, at + max(1, int((link.second - at) / excess)))
        return link

    def _reached(self, at: int, target: int) -> Link:
        """The motion to a frame, or to one half as far if that fails, down to the next one."""
        while True:
            motion = self.motion(at, target)
            if isinstance(motion, StereoMotion) or target == at + 1:
                return Link(at, target, motion)
            target = at + (target - at) // 2

    def _last_shared(self, at: int) -> int:
        """The last frame in a row that shares enough features."""
        enough = max(self.settings.shared * self.frames.shared(at, at + 1), float(_AMPLE * self.settings.min_inliers))
        last = at + 1
        while last + 1 < len(self.frames) and self.frames.shared(at, last + 1) >= enough:
            last += 1
        return last

    def _excess(self, motion: StereoMotion) -> float:
        """How many times the largest way or turn between keyframes a motion is."""
        way = float(np.linalg.norm(motion.pos_m)) / self.settings.keyframe_m
        turn = float(np.rad2deg(np.linalg.norm(so3.log(motion.rotation)))) / self.settings.keyframe_deg
        return max(way, turn)
