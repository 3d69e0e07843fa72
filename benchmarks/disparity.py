"""What disparities of features found in rendered images are off by, on average and along a track: roadheader-stereo.

The truth is where a ray through the feature meets the roadway. `stereo_tracks.bias_px` stands for what is common to all
disparities of a drive. The logs are those of `benchmarks.papers.roadheader_vio`. Takes some two minutes a seed.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._report import Before, Row, Target, parser, publish, row, say
from benchmarks.papers._vio_logs import default_folder, log_of
from factors.so3 import Array
from graphnav.baselines._compiled import compiled
from graphnav.config import StereoTracksConfig
from graphnav.frontends.stereo_tracks import tracked
from graphnav.log import SensorLog, Stereo, StereoTracks
from graphnav.simulation.ray_caster import trace
from graphnav.simulation.roadheader import machine_of
from graphnav.simulation.roadheader_camera import R_BC
from graphnav.simulation.roadheader_figures import ROADHEADER
from graphnav.simulation.roadway_surfaces import box

ENHANCED = ("clahe", "none", "retinex-dust")
DECLARED_PX: float = StereoTracksConfig.model_fields["bias_px"].default
#: A feature farther off is one of another surface, and the graph's loss sees to it, px.
_ANOTHER_PX = 0.5


def off_px(log: SensorLog, tracks: StereoTracks, seed: int) -> tuple[Array, Array]:
    """Errors (K,) of the disparities, and the true disparities."""
    camera = log.stereo
    assert camera is not None
    times, frame = np.unique(tracks.t_s, return_inverse=True)
    pos_n, rot_nb = machine_of(ROADHEADER, seed).poses(times)
    place_n = pos_n + rot_nb.apply(np.array(ROADHEADER.camera.lever_arm_b_m))
    rays = _rays(camera, tracks, rot_nb.as_matrix() @ R_BC, frame)
    depth_m = _depths(tuple(box(ROADHEADER.roadway)), place_n[frame], rays)
    true = camera.fx_px * camera.baseline_m / depth_m
    return tracks.u_left_px - tracks.u_right_px - true, true


def _rays(camera: Stereo, tracks: StereoTracks, rot_nc: Array, frame: Any) -> Array:
    """Rays (K, 3) in n of depth 1."""
    x, y = (tracks.u_left_px - camera.cx_px) / camera.fx_px, (tracks.v_px - camera.cy_px) / camera.fy_px
    ray: Array = np.einsum("kij,kj->ki", rot_nc[frame], np.column_stack([x, y, np.ones(len(x))]))
    return ray


@compiled
def _depths(room: Any, place_n: Array, rays: Array) -> Array:
    found = np.empty(len(rays))
    for k in range(len(rays)):
        found[k] = trace(room, place_n[k], rays[k, 0], rays[k, 1], rays[k, 2])[2]
    return found


def slope_along_tracks(track: Array, error: Array, true: Array) -> float:
    """Least-squares slope of the errors by disparity, with a constant for each track."""
    which = np.unique(track, return_inverse=True)[1]
    count = np.bincount(which)
    error, true = (x - (np.bincount(which, x) / count)[which] for x in (error, true))
    return float(error @ true / (true @ true))


def measured(seed: int, folder: Path) -> dict[str, tuple[float, float, float]]:
    """Mean, standard deviation (px) and slope along tracks (1) by enhancement, for one seed."""
    log, found = log_of(seed, folder), {}
    for enhance in ENHANCED:
        tracks = tracked(log, StereoTracksConfig.model_validate({"enhance": enhance})).tracks
        error, true = off_px(log, tracks, seed)
        near = np.abs(error) < _ANOTHER_PX
        slope = slope_along_tracks(tracks.track[near], error[near], true[near])
        found[enhance] = (float(error[near].mean()), float(error[near].std()), slope)
        say(f"seed {seed}, {enhance}: mean {found[enhance][0]:+.4f} px, slope {slope:+.4f}")
    return found


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))


def main() -> None:
    """Measure and print."""
    args = parser(__doc__)
    args.add_argument("--seeds", type=int, default=5, help="number of seeds")
    args.add_argument("--logs", type=Path, default=default_folder(), help="folder of kept logs (default %(default)s)")
    arguments, before = args.parse_args(), Before.now()
    found = [measured(seed, arguments.logs) for seed in range(arguments.seeds)]
    rows, means = list[Row](), []
    for enhance in ENHANCED:
        mean, spread, slope = np.array([each[enhance] for each in found]).T
        means.append(mean)
        rows += [
            row(f"{enhance}: mean error of a drive, rms of all drives", _rms(mean), "px"),
            row(f"{enhance}: standard deviation of an error", float(spread.mean()), "px"),
            row(f"{enhance}: change of an error along its track by that of the disparity", float(slope.mean()), "1"),
        ]
    overall = _rms(np.array(means))
    rows.append(row("mean error of a drive, rms of all", overall, "px", target=Target(high=DECLARED_PX)))
    publish(rows, arguments.json, before)


if __name__ == "__main__":
    main()
