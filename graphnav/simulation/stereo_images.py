"""Images of a simulated log: rendered frame by frame, or written to a folder by a pool of processes.

A log in memory has the images' names only. What writes its folder has to write them too: the command line does, and
`write_images` for a log that `graphnav.write` has written.
"""

from __future__ import annotations

import os
import shutil
import uuid
from collections.abc import Iterator, Mapping
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from graphnav._pool import in_order, leave_if_starting
from graphnav._stages import ProgressHook
from graphnav.errors import ConfigError, GraphnavError
from graphnav.simulation.roadheader import frame_times, image_names, machine_of
from graphnav.simulation.roadheader_camera import Grey, StereoCamera
from graphnav.simulation.roadheader_figures import RoadheaderSpec
from graphnav.simulation.scenarios import resolve
from graphnav.simulation.world import image_seed

_CHUNK = 16
_COMPRESSION = 1  # noise does not compress: more of it costs time and saves 3 %


class Renderer:
    """The pairs of one seed's log, by the number of their frame; a pair is the same in whatever order they are drawn.

    Parameters
    ----------
    spec, seed : as the log was simulated with.
    """

    def __init__(self, spec: RoadheaderSpec, seed: int) -> None:
        machine = machine_of(spec, seed)
        self.t_s = frame_times(spec, machine)
        self.names = image_names(len(self.t_s))
        self._pos_n, self._rot_nb = machine.poses(self.t_s)
        self._camera = StereoCamera(spec, image_seed(seed))

    def __len__(self) -> int:
        return len(self.t_s)

    def pair(self, frame: int) -> tuple[Grey, Grey]:
        """Left and right image, ``(240, 424)`` 8-bit grey levels."""
        return self._camera.pair(frame, float(self.t_s[frame]), self._pos_n[frame], self._rot_nb[frame])


def render_pairs(scenario: str = "roadheader-stereo", seed: int = 0, **options: Any) -> Iterator[tuple[Grey, Grey]]:
    """The pairs of a simulated log one after another, each rendered when it is asked for.

    Parameters
    ----------
    scenario, seed, **options : as the log was simulated with.
    """
    renderer = Renderer(_with_images(scenario, options), seed)
    return (renderer.pair(frame) for frame in range(len(renderer)))


def write_images(
    folder: str | os.PathLike[str],
    scenario: str = "roadheader-stereo",
    seed: int = 0,
    *,
    workers: int | None = None,
    progress: ProgressHook | None = None,
    **options: Any,
) -> None:
    """Write the images of a simulated log to the folders ``left`` and ``right`` of its folder, whole or not at all.

    >>> gn.write(gn.simulate("roadheader-stereo", seed=2), "L")                    # doctest: +SKIP
    >>> write_images("L", "roadheader-stereo", seed=2)                             # doctest: +SKIP

    Parameters
    ----------
    folder : of the log.
    scenario, seed, **options : as the log was simulated with.
    workers : processes; by default one per core, for 100 pairs or more. The images do not depend on it.
    progress : called with ("images", frames done, frames in all).

    Raises
    ------
    ConfigError
        An unknown scenario or option, or a scenario without images.
    GraphnavError
        The folder has images already, or cannot be written.
    """
    leave_if_starting()
    _with_images(scenario, options)
    target = Path(folder)
    draft = target / f".images.{uuid.uuid4().hex[:8]}"
    for side in ("left", "right"):
        if (target / side).exists():
            raise GraphnavError(f"{target / side}: is there already; remove it, or choose another folder")
    try:
        draft.mkdir(parents=True)
        render_into(scenario, seed, options, draft, workers=workers, progress=progress)
        for side in ("left", "right"):
            (draft / side).rename(target / side)
    except OSError as error:
        raise GraphnavError(f"{target}: images cannot be written ({error.strerror or error})") from error
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def render_into(
    scenario: str,
    seed: int,
    options: Mapping[str, Any],
    folder: Path,
    *,
    workers: int | None = None,
    progress: ProgressHook | None = None,
) -> None:
    """Render all pairs of a log to new folders ``left`` and ``right`` in `folder`; see `write_images`."""
    leave_if_starting()
    spec = _with_images(scenario, options)
    for side in ("left", "right"):
        (folder / side).mkdir()
    frames = range(len(frame_times(spec, machine_of(spec, seed))))
    work = partial(_render, spec, seed, folder)
    for done, _ in enumerate(in_order(work, frames, workers, batch=_CHUNK), start=1):
        if progress is not None:
            progress("images", done, len(frames))


@lru_cache(maxsize=1)
def _renderer(spec: RoadheaderSpec, seed: int) -> Renderer:
    """The scene, made once in each process."""
    return Renderer(spec, seed)


def _render(spec: RoadheaderSpec, seed: int, folder: Path, frame: int) -> None:
    """Write a pair to the folders of its images."""
    from PIL import Image

    renderer = _renderer(spec, seed)
    for side, image in zip(renderer.names, renderer.pair(frame), strict=True):
        Image.fromarray(image).save(folder / side[frame], compress_level=_COMPRESSION)


def _with_images(scenario: str, options: Mapping[str, Any]) -> RoadheaderSpec:
    spec = resolve(scenario, options)
    if not isinstance(spec, RoadheaderSpec) or not spec.images:
        raise ConfigError(f"{scenario}: no images with these options; use roadheader-stereo with images")
    return spec
