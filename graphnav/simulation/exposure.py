"""From light to 8-bit grey levels: airlight through drifting dust, shot and read noise, the camera's tone."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from graphnav.baselines._compiled import compiled
from graphnav.simulation.roadheader_figures import CameraSpec, LightSpec

Array = npt.NDArray[np.float64]

_CELL_PX = 8
_WAVES = 8


@dataclass(frozen=True)
class Drift:
    """How dense the dust is from place to place: travelling waves, `drift` their 1-sigma as a share of the mean."""

    sigma: float
    waves: Array  # (K, 4) phase per pixel to the right and down, per second, and at the start

    @classmethod
    def drawn(cls, light: LightSpec, camera: CameraSpec, rng: np.random.Generator) -> Drift:
        """Waves of a third of the image to all of it, each new after about `drift_time_s`."""
        angle, length = rng.uniform(0, 2 * np.pi, _WAVES), camera.width_px * rng.uniform(0.33, 1.0, _WAVES)
        rate = rng.standard_normal(_WAVES) / light.drift_time_s
        number = 2 * np.pi / length
        phase = rng.uniform(0, 2 * np.pi, _WAVES)
        return cls(light.drift, np.column_stack([number * np.cos(angle), number * np.sin(angle), rate, phase]))

    def at(self, t_s: float, camera: CameraSpec) -> npt.NDArray[np.float32]:
        """Factor on the airlight on every eighth pixel, never below a tenth."""
        u, v = (_CELL_PX * np.arange(size // _CELL_PX + 2) for size in (camera.width_px, camera.height_px))
        right, down, rate, phase = self.waves.T[:, :, None, None]
        waves = np.cos(right * u + down * v[:, None] + rate * t_s + phase)
        factor: npt.NDArray[np.float32] = np.maximum(
            1 + self.sigma * np.sqrt(2 / _WAVES) * waves.sum(axis=0), 0.1
        ).astype(np.float32)
        return factor


@compiled
def develop(grey: Any, light: Any, air: Any, dust: Any, normal: Any, figures: Any) -> None:
    """Fill the 8-bit image `grey`; `normal`: one unit normal draw a pixel.

    Electrons are normal about their mean with its variance (shot noise) and the read noise's; the grey level is the
    square root of their share of full scale, as a camera's tone curve nearly is.
    """
    exposure, full, read = figures
    rows, columns = grey.shape
    for v in range(rows):
        b = v / _CELL_PX
        i = int(b)
        b -= i
        for u in range(columns):
            a = u / _CELL_PX
            j = int(a)
            a -= j
            density = (1 - b) * ((1 - a) * dust[i, j] + a * dust[i, j + 1])
            density += b * ((1 - a) * dust[i + 1, j] + a * dust[i + 1, j + 1])
            mean = full * exposure * (light[v, u] + density * air[v, u])
            electrons = mean + math.sqrt(mean + read * read) * normal[v, u]
            grey[v, u] = min(255, int(255 * math.sqrt(max(electrons, 0.0) / full) + 0.5))
