"""The log of a roadheader with an IMU and a stereo camera; its images are rendered apart from it.

What is the paper's and what is chosen: `graphnav.simulation.roadheader_figures`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from graphnav.log import Frames, Imu, SensorLog, Stereo, StereoPairs, Truth
from graphnav.simulation import imu
from graphnav.simulation.naming import log_name
from graphnav.simulation.roadheader_figures import RoadheaderSpec
from graphnav.simulation.roadheader_path import Roadheader, build_roadheader
from graphnav.simulation.world import streams

Array = npt.NDArray[np.float64]


def frame_times(spec: RoadheaderSpec, machine: Roadheader) -> Array:
    """Times of the frames (s): one period after the start and each period from then on."""
    count = int(np.floor(machine.count / spec.imu_rate_hz * spec.rate_hz + 1e-6))
    return np.arange(1, count + 1) / spec.rate_hz


def machine_of(spec: RoadheaderSpec, seed: int) -> Roadheader:
    """The true motion of a seed's log."""
    of = streams(seed)
    return build_roadheader(spec, of.geometry, of.machine)


def image_names(count: int) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Paths of the left and right images relative to the log folder."""
    names = [f"{number:06d}.png" for number in range(count)]
    left, right = (np.array([f"{side}/{name}" for name in names], dtype=object) for side in ("left", "right"))
    return left, right


def simulate_roadheader(
    scenario: str, spec: RoadheaderSpec, seed: int, *, noise: bool = True, options: Mapping[str, Any] | None = None
) -> SensorLog:
    """The log of a roadheader scenario; without `noise` IMU, tracks and declared start are exact.

    `options` are those that `spec` was made with, for the name of the log.
    """
    of, on, machine = streams(seed), 1.0 if noise else 0.0, machine_of(spec, seed)
    biases = imu.draw_biases(spec.imu, of.errors, on)
    att_rad = imu.draw_triple(of.errors, np.deg2rad(spec.att_sigma_deg), on)
    vel_m_s = imu.draw_triple(of.errors, spec.vel_sigma_m_s, on)
    pos_m = imu.draw_triple(of.errors, spec.pos_sigma_m, on)
    t_s, motion, rot_nb = machine.states(0, machine.count)
    return SensorLog(
        name=log_name(scenario, options or {}, seed),
        frames=Frames(spec.latitude_deg, spec.longitude_deg, 0.0, spec.gravity_m_s2),
        initial=machine.declared_start(att_rad, vel_m_s, pos_m),
        imu=Imu(t_s[1:], *imu.samples(spec, motion, rot_nb, biases, of.imu, on), **vars(spec.imu)),
        truth=Truth(t_s, motion.pos_n, rot_nb.as_quat(scalar_first=True), motion.vel_n),
        **_stereo(spec, machine, of.tracks, on),
    )


def _stereo(spec: RoadheaderSpec, machine: Roadheader, rng: np.random.Generator, on: float) -> dict[str, Any]:
    """The camera, and the tables of what is made with it; nothing of all that without images and tracks."""
    from graphnav.simulation.feature_tracks import tracks_table

    if not spec.images and spec.tracks is None:
        return {}
    t_s, camera = frame_times(spec, machine), spec.camera
    centre = ((camera.width_px - 1) / 2, (camera.height_px - 1) / 2)
    section = Stereo(
        camera.focal_px,
        camera.focal_px,
        *centre,
        camera.baseline_m,
        sigma_px=spec.sigma_px,
        T_bc_pos_m=np.array(camera.lever_arm_b_m),
        width_px=camera.width_px,
        height_px=camera.height_px,
    )
    parts: dict[str, Any] = {"stereo": section}
    if spec.images:
        parts["stereo_pairs"] = StereoPairs(t_s, *image_names(len(t_s)))
    if spec.tracks is not None:
        parts["stereo_tracks"] = tracks_table(spec, spec.tracks, t_s, machine.poses(t_s), rng, on)
    return parts
