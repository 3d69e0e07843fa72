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
#: A motion this many times too long is given up for a shorter one. Far above 1: to take a motion because its own
#: estimate is just short enough would choose those that are too short (measured: 0.25 % of the way).
_TOO_FAR = 2.0
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
        at, pace = 0, np.inf
        while at < len(self.frames) - 1:
            link = self._next(at, pace)
            yield link
            at, pace = link.second, self._pace(link)

    def _next(self, at: int, pace: float) -> Link:
        """The motion to the farthest frame that gives one and, at the pace so far, is near enough."""
        ahead = min(self._last_shared(at) - at, pace)
        link = self._reached(at, at + max(1, int(ahead)))
        for _ in range(_NEARER):
            excess = self._excess(link)
            if link.second == at + 1 or excess <= _TOO_FAR:
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

    def _pace(self, link: Link) -> float:
        """Frames in which a motion of that pace goes as far as keyframes may be apart."""
        return (link.second - link.first) / max(self._excess(link), 1e-9)

    def _excess(self, link: Link) -> float:
        """How many times the largest way or turn between keyframes a motion is; 0 for none."""
        if isinstance(link.motion, MotionFailure):
            return 0.0
        way = float(np.linalg.norm(link.motion.pos_m)) / self.settings.keyframe_m
        turn = float(np.rad2deg(np.linalg.norm(so3.log(link.motion.rotation)))) / self.settings.keyframe_deg
        return max(way, turn)
