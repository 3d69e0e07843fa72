"""Image pairs drawn from a random texture, so that disparities and motions are known exactly."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from graphnav.log import Frames, SensorLog, Stereo, StereoPairs

SIZE = (212, 120)
FX_PX, BASELINE_M = 150.0, 0.1
#: Pixels of the texture per pixel of an image.
_FINE = 4


class Wall:
    """A textured wall square to the view; it is seen at any shift, size and brightness.

    Parameters
    ----------
    seed : of texture and noise.
    noise : sigma in grey levels.
    """

    def __init__(self, seed: int, noise: float = 1.0) -> None:
        import cv2

        self._cv2, self._rng, self._noise = cv2, np.random.default_rng(seed), noise
        raw = self._rng.normal(size=(3 * SIZE[1] * _FINE, 3 * SIZE[0] * _FINE)).astype(np.float32)
        fine, coarse = (cv2.GaussianBlur(raw, (0, 0), sigma * _FINE) for sigma in (1.0, 3.0))
        self._texture = fine / fine.std() + coarse / coarse.std()

    def seen(self, shift_px: tuple[float, float], scale: float = 1.0, gain: float = 1.0) -> np.ndarray:
        """The image in which the wall's point at the centre is moved by `shift_px` and things are `scale` as large."""
        cv2, (width, height) = self._cv2, SIZE
        # pixel centres of the image -> of the texture, area averaged by drawing at the texture's resolution
        fine = np.array([[scale, 0, 0], [0, scale, 0]], float)
        middle = np.array([(self._texture.shape[1] - 1) / 2, (self._texture.shape[0] - 1) / 2])
        target = (np.array([(width - 1) / 2, (height - 1) / 2]) + shift_px) * _FINE + (_FINE - 1) / 2
        fine[:, 2] = target - scale * middle
        large = cv2.warpAffine(self._texture, fine, (width * _FINE, height * _FINE), flags=cv2.INTER_CUBIC)
        image = cv2.resize(large, (width, height), interpolation=cv2.INTER_AREA)
        grey = gain * (90 + 22 * image) + self._noise * self._rng.normal(size=image.shape)
        return np.clip(np.round(grey), 0, 255).astype(np.uint8)


def moved(uv_px: np.ndarray, shift_px: tuple[float, float], scale: float = 1.0) -> np.ndarray:
    """Where a place of the image without shift is in the image of `Wall.seen`."""
    centre = np.array([(SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2])
    return centre + shift_px + scale * (uv_px - centre)


def camera(**changes: float) -> Stereo:
    return Stereo(
        fx_px=FX_PX, fy_px=FX_PX, cx_px=(SIZE[0] - 1) / 2, cy_px=(SIZE[1] - 1) / 2, baseline_m=BASELINE_M
    ).replace(**changes)


def drawn_log(folder: Path, pairs: list[tuple[np.ndarray, np.ndarray]], **changes: float) -> SensorLog:
    """A log of image files in `folder`, five pairs a second."""
    import cv2

    names = []
    for number, images in enumerate(pairs):
        row = [f"{side}_{number:03d}.png" for side in ("left", "right")]
        for name, image in zip(row, images, strict=True):
            cv2.imwrite(str(folder / name), image)
        names.append(row)
    times = np.arange(1, len(pairs) + 1) / 5
    left, right = zip(*names, strict=True)
    return SensorLog(
        name="drawn",
        frames=Frames(latitude_deg=35.0),
        stereo=camera(**changes),
        stereo_pairs=StereoPairs(t_s=times, left=list(left), right=list(right), folder=folder),
    )


def approach(wall: Wall, frames: int, disparity_px: float = 5.0) -> tuple[list[tuple[np.ndarray, np.ndarray]], list]:
    """Pairs while the camera nears the wall and moves aside; and (shift, scale) of the left image in each."""
    pairs, motions = [], []
    for k in range(frames):
        scale, shift = 1 + 0.01 * k, (0.7 * k, -0.3 * k)
        pairs.append((wall.seen(shift, scale), wall.seen((shift[0] - disparity_px * scale, shift[1]), scale)))
        motions.append((shift, scale))
    return pairs, motions
