"""Which frames the motions of a stereo camera lead from and to.

Every keyframe's noise enters the motion to it and the one from it, and every motion adds an error of its own: the
fewest keyframes give the smallest drift. So the next keyframe is the last frame that still sees a given share of the
features that the frame after the keyframe shared with it, and is near enough for a graph to have poses where it needs
them. While the camera stands it goes on seeing the same features: one motion bridges the whole rest.

But not more than the rest, where no IMU tells how the camera went from keyframe to keyframe. A chain of motions goes at
constant velocity there: one motion from the begin of a rest of 60 s to 0.2 m behind its end has the machine creep all
that time (`docs/stereo-odometry.md`). So frames within a motion are asked: if one of them was elsewhere beyond doubt,
the motion ends at the last frame up to which the camera went evenly. Only places count: a machine that shakes never
turns evenly, and its attitude is soon back.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from factors import so3
from factors.relative_pose import Chain, Motions
from factors.so3 import Array
from graphnav.config import StereoMotionsConfig
from graphnav.frontends.stereo_bundle import gate
from graphnav.frontends.stereo_frames import TrackedFrames
from graphnav.frontends.stereo_motion import MotionFailure, StereoMotion

#: A frame has to share this many times the fewest inliers to be reached over others.
_AMPLE = 2
#: A motion this many times too long is given up for a shorter one. Far above 1: to take a motion because its own
#: estimate is just short enough would choose those that are too short (measured: 0.25 % of the way).
_TOO_FAR = 2.0
#: Frames nearer by are tried this often for one that is near enough.
_NEARER = 4
#: Where within a motion it is asked whether it was even; thrice, since one with a pause may be in the middle in time.
_INNER = (0.25, 0.5, 0.75)
#: Off by more than this it was not. By chance one motion in 5,000 is off by as much, and costs one keyframe more.
_UNEVEN_SIGMAS = 4.0


#: The motion between two frames, given by their numbers.
MotionOf = Callable[[int, int], StereoMotion | MotionFailure]


class Link(NamedTuple):
    """A motion, or none, from one frame to another."""

    first: int
    second: int
    motion: StereoMotion | MotionFailure


@dataclass(frozen=True)
class Linker:
    """Chooses keyframes.

    Attributes
    ----------
    motion : gives the motion between two frames.
    evenly : whether the camera has to have gone evenly from keyframe to keyframe.
    """

    frames: TrackedFrames
    settings: StereoMotionsConfig
    motion: MotionOf
    evenly: bool = True

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
        return link if not self.evenly or self._even(link) else self._even_part(link)

    def _even_part(self, link: Link) -> Link:
        """The longest part of a motion, by halves, that was even; all of it where no part gives a motion."""
        at, uneven = link.first, link.second
        best = self._reached(at, at + 1)
        while uneven - best.second > 1:
            middle = (best.second + uneven) // 2
            shorter = Link(at, middle, self.motion(at, middle))
            if isinstance(shorter.motion, StereoMotion) and self._even(shorter):
                best = shorter
            else:
                uneven = middle
        return best if isinstance(best.motion, StereoMotion) else link

    def _even(self, link: Link) -> bool:
        """Whether no frame within the motion was elsewhere than at constant velocity."""
        if isinstance(link.motion, MotionFailure):
            return True
        inner = {link.first + round(share * (link.second - link.first)) for share in _INNER}
        return not any(self._elsewhere(link, link.motion, k) for k in sorted(inner - {link.first, link.second}))

    def _elsewhere(self, link: Link, whole: StereoMotion, inner: int) -> bool:
        """Whether the motion to a frame within another is, beyond doubt, no such part of it as its time is.

        Both have the noise of the first frame, which counts as if it were two: less is found, nothing more.
        """
        part = self.motion(link.first, inner)
        if isinstance(part, MotionFailure):
            return False
        share, rotation, pos_m = self._evenly(link, whole, inner)
        off = rotation.T @ (part.pos_m - pos_m)
        cov = (part.cov + share**2 * whole.cov)[3:, 3:]
        return bool(off @ np.linalg.solve(cov, off) > gate(_UNEVEN_SIGMAS, len(off)))

    def _evenly(self, link: Link, whole: StereoMotion, inner: int) -> tuple[float, Array, Array]:
        """The share of the time and of the motion (3, 3), (3,) at a frame within, as `Chain` has it."""
        ends_s = self.frames.t_s[[link.first, link.second]]
        motion = Motions(whole.rotation[None], whole.pos_m[None], whole.cov[None])
        t_s = self.frames.t_s[[inner]]
        rotation, pos_m = Chain.of(ends_s, motion).at(t_s)
        return float((t_s[0] - ends_s[0]) / np.diff(ends_s)[0]), rotation[0], pos_m[0]

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
